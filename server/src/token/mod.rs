//! Who somebody is, said by who may say so: a short-lived statement, signed with an Ed25519 key.
//!
//! A token is PASETO `v4.public`, which knows one algorithm, so that nobody can ask for a weaker one. Its payload is JSON that
//! anybody can read and only the key's holder can write:
//!
//! ```text
//! aud     the server's name: a token for another one is not good here
//! sub     whom it was issued to, 1 to 255 bytes
//! jti     its own name, by which it is revoked: 16 hexadecimal digits
//! iat     from when it is good, RFC 3339
//! exp     until when
//! role    viewer, actor or operator
//! avatars most avatars of one connection
//! ```
//!
//! Nothing here reads a clock or a file; [`files`] keeps keys and revocations, and [`crate::net::TokenGate`] asks at the door.

pub mod files;
#[cfg(feature = "audit")]
pub mod verbs;

use std::time::Duration;

use eyeline_protocol::{AVATARS_MAX, NAME_BYTES_MAX, Rank, TOKEN_BYTES_MAX, WorldTime};
use pasetors::Public;
use pasetors::keys::{AsymmetricKeyPair, AsymmetricPublicKey, AsymmetricSecretKey, Generate};
use pasetors::paserk::{FormatAsPaserk, Id};
use pasetors::token::UntrustedToken;
use pasetors::version4::{PublicToken, V4};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// How far the clocks of issuer and server may differ: a token is good from so long before it was issued until so long after
/// it ends.
pub const CLOCK_SKEW: Duration = Duration::from_secs(60);

/// Longest time for which a token can be issued. What has to be good for longer is better issued again.
pub const VALID_MAX: Duration = Duration::from_secs(30 * 86_400);

/// How every token begins.
pub const TOKEN_PREFIX: &str = PublicToken::HEADER;

/// What a token says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claims {
    /// The server's name.
    pub audience: String,
    /// Whom it was issued to.
    pub subject: String,
    /// Its own name.
    pub id: String,
    /// From when it is good, in whole seconds of the calendar's time.
    pub issued: WorldTime,
    /// Until when.
    pub expires: WorldTime,
    /// What its bearer may be.
    pub role: Rank,
    /// Most avatars of one connection.
    pub avatars: u16,
}

/// [`Claims`] as they are written.
#[derive(Serialize, Deserialize)]
struct Written {
    aud: String,
    sub: String,
    jti: String,
    iat: String,
    exp: String,
    role: String,
    avatars: u16,
}

/// Why a token is not good.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// It is longer than a hello carries.
    #[error("a token of {bytes} bytes is longer than {TOKEN_BYTES_MAX}; shorten the subject")]
    TooLong {
        /// Its length.
        bytes: usize,
    },
    /// It is no token at all.
    #[error("this is not a token, which begins with {TOKEN_PREFIX}; was it cut off, or is it another file?")]
    Format,
    /// None of the keys has signed it.
    #[error(
        "no key of this server has signed the token, or it was changed since; have one issued with this server's key"
    )]
    Signature,
    /// It was signed, but does not say what a token has to.
    #[error("the token does not say what it should ({0}); issue one with `eyeline-server token issue`")]
    Claims(String),
    /// It is for another server.
    #[error("the token is for the server '{theirs}', and this is '{ours}'; have one issued with --audience {ours}")]
    Audience {
        /// For whom it is.
        theirs: String,
        /// Who we are.
        ours: String,
    },
    /// It has ended.
    #[error("the token ended at {}; ask for a new one", calendar(*.at))]
    Expired {
        /// When.
        at: WorldTime,
    },
    /// It has not begun.
    #[error("the token is good from {} on, which is to come; is a clock wrong?", calendar(*.from))]
    Early {
        /// From when.
        from: WorldTime,
    },
    /// The subject can't be written.
    #[error(
        "'{0}' is not a subject: give a name of 1 to {NAME_BYTES_MAX} bytes without line breaks, or blanks at its ends"
    )]
    Subject(String),
    /// More avatars than anybody may have.
    #[error("{0} avatars are more than {AVATARS_MAX}, the most of one connection")]
    Avatars(u16),
    /// Chance or signature failed.
    #[error("the token could not be signed: {0}")]
    Sign(String),
}

/// What signs tokens. Shows nothing of itself.
pub struct SecretKey {
    key: AsymmetricSecretKey<V4>,
}

/// What tokens are checked with.
#[derive(Clone, Debug)]
pub struct PublicKey {
    key: AsymmetricPublicKey<V4>,
}

/// Why a text is not a key.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// It is the other half of the pair.
    #[error("this is a {is} key, and a {wanted} one is wanted; name the other file of the pair")]
    OtherHalf {
        /// What it is.
        is: &'static str,
        /// What was wanted.
        wanted: &'static str,
    },
    /// It is no key.
    #[error("this is not a {wanted} key, which begins with {begins}; make a pair with `eyeline-server token key`")]
    Format {
        /// What was wanted.
        wanted: &'static str,
        /// How one begins.
        begins: &'static str,
    },
}

/// A new pair of keys.
///
/// # Errors
/// If the system has no randomness to give.
pub fn make_keys() -> Result<(SecretKey, PublicKey), TokenError> {
    let pair = AsymmetricKeyPair::<V4>::generate().map_err(|error| TokenError::Sign(error.to_string()))?;
    Ok((SecretKey { key: pair.secret }, PublicKey { key: pair.public }))
}

impl SecretKey {
    /// Reads a key as [`SecretKey::text`] writes it.
    ///
    /// # Errors
    /// If it is none, or the public one.
    pub fn parse(text: &str) -> Result<SecretKey, KeyError> {
        let text = text.trim();
        if text.starts_with("k4.public.") {
            return Err(KeyError::OtherHalf { is: "public", wanted: "private" });
        }
        let key = AsymmetricSecretKey::try_from(text);
        key.map(|key| SecretKey { key }).map_err(|_| KeyError::Format { wanted: "private", begins: "k4.secret." })
    }

    /// The key as text (PASERK `k4.secret`). To be kept secret.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing into a text can't fail.
        let _ = self.key.fmt(&mut text);
        text
    }

    /// The half that servers have.
    ///
    /// # Errors
    /// If the key's own halves don't fit together.
    pub fn public(&self) -> Result<PublicKey, KeyError> {
        let public = AsymmetricPublicKey::try_from(&self.key);
        public.map(|key| PublicKey { key }).map_err(|_| KeyError::Format { wanted: "private", begins: "k4.secret." })
    }

    /// Signs what `claims` say.
    ///
    /// # Errors
    /// If they can't be said.
    pub fn issue(&self, claims: &Claims) -> Result<String, TokenError> {
        let subject = &claims.subject;
        if !is_subject(subject) {
            return Err(TokenError::Subject(subject.escape_debug().to_string()));
        }
        if usize::from(claims.avatars) > AVATARS_MAX {
            return Err(TokenError::Avatars(claims.avatars));
        }
        let written = Written {
            aud: claims.audience.clone(),
            sub: subject.clone(),
            jti: claims.id.clone(),
            iat: calendar(claims.issued),
            exp: calendar(claims.expires),
            role: claims.role.name().to_owned(),
            avatars: claims.avatars,
        };
        let sign = |error: &dyn std::fmt::Display| TokenError::Sign(error.to_string());
        let payload = serde_json::to_vec(&written).map_err(|error| sign(&error))?;
        let token = PublicToken::sign(&self.key, &payload, None, None).map_err(|error| sign(&error))?;
        if token.len() > TOKEN_BYTES_MAX { Err(TokenError::TooLong { bytes: token.len() }) } else { Ok(token) }
    }
}

impl PublicKey {
    /// Reads a key as [`PublicKey::text`] writes it.
    ///
    /// # Errors
    /// If it is none, or the private one.
    pub fn parse(text: &str) -> Result<PublicKey, KeyError> {
        let text = text.trim();
        if text.starts_with("k4.secret.") {
            return Err(KeyError::OtherHalf { is: "private", wanted: "public" });
        }
        let key = AsymmetricPublicKey::try_from(text);
        key.map(|key| PublicKey { key }).map_err(|_| KeyError::Format { wanted: "public", begins: "k4.public." })
    }

    /// The key as text (PASERK `k4.public`).
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing into a text can't fail.
        let _ = self.key.fmt(&mut text);
        text
    }

    /// The key's short name, for people (PASERK `k4.pid`).
    pub fn id(&self) -> String {
        let mut text = String::new();
        // Writing into a text can't fail.
        let _ = Id::from(&self.key).fmt(&mut text);
        text
    }
}

/// What a token says, and by which of `keys`, if it is good for the server `audience` now. Revocations are not looked at.
///
/// # Errors
/// If it is not good. What a stranger sent is told apart from what a key of ours has signed: before the signature holds the
/// error is [`TokenError::Format`], [`TokenError::TooLong`] or [`TokenError::Signature`].
pub fn verify<'a>(
    token: &[u8],
    keys: impl IntoIterator<Item = &'a PublicKey>,
    audience: &str,
    now: WorldTime,
) -> Result<(Claims, usize), TokenError> {
    let token = untrusted(token)?;
    let signer = |key: &PublicKey| PublicToken::verify(&key.key, &token, None, None).ok();
    let found = keys.into_iter().enumerate().find_map(|(index, key)| signer(key).map(|signed| (index, signed)));
    let (index, signed) = found.ok_or(TokenError::Signature)?;
    let claims = claims(signed.payload())?;
    if claims.audience != audience {
        return Err(TokenError::Audience { theirs: claims.audience, ours: audience.to_owned() });
    }
    if now > claims.expires + CLOCK_SKEW {
        return Err(TokenError::Expired { at: claims.expires });
    }
    if now + CLOCK_SKEW < claims.issued {
        return Err(TokenError::Early { from: claims.issued });
    }
    Ok((claims, index))
}

/// What a token says of itself, whoever signed it: to be shown, never to be believed.
///
/// # Errors
/// If it is none.
pub fn peek(token: &[u8]) -> Result<Claims, TokenError> {
    let token = untrusted(token)?;
    let payload = std::str::from_utf8(token.untrusted_payload()).map_err(|_| TokenError::Format)?;
    claims(payload)
}

fn untrusted(token: &[u8]) -> Result<UntrustedToken<Public, V4>, TokenError> {
    if token.len() > TOKEN_BYTES_MAX {
        return Err(TokenError::TooLong { bytes: token.len() });
    }
    let text = std::str::from_utf8(token).map_err(|_| TokenError::Format)?;
    UntrustedToken::try_from(text.trim()).map_err(|_| TokenError::Format)
}

/// Lists have a subject a line, and don't tell blanks at its ends.
fn is_subject(text: &str) -> bool {
    (1..=NAME_BYTES_MAX).contains(&text.len()) && text.trim() == text && !text.chars().any(char::is_control)
}

fn claims(payload: &str) -> Result<Claims, TokenError> {
    let wrong = |what: String| TokenError::Claims(what);
    let written: Written = serde_json::from_str(payload).map_err(|error| wrong(error.to_string()))?;
    let instant = |name, text: &str| from_calendar(text).ok_or_else(|| wrong(format!("{name} = '{text}' is no time")));
    let role = Rank::ALL.into_iter().find(|rank| rank.name() == written.role);
    if !is_subject(&written.sub) {
        return Err(wrong(format!("sub has {} bytes, or characters that no name has", written.sub.len())));
    }
    if usize::from(written.avatars) > AVATARS_MAX {
        return Err(wrong(format!("avatars = {} are too many", written.avatars)));
    }
    Ok(Claims {
        issued: instant("iat", &written.iat)?,
        expires: instant("exp", &written.exp)?,
        role: role.ok_or_else(|| wrong(format!("role = '{}' is none", written.role)))?,
        audience: written.aud,
        subject: written.sub,
        id: written.jti,
        avatars: written.avatars,
    })
}

/// A time as people and tokens write it: RFC 3339 in whole seconds, UTC.
pub fn calendar(time: WorldTime) -> String {
    let seconds = time.micros().div_euclid(1_000_000);
    let date = OffsetDateTime::from_unix_timestamp(seconds).ok().and_then(|date| date.format(&Rfc3339).ok());
    // Before the year 0 or after 9999.
    date.unwrap_or_else(|| "the end of the calendar".to_owned())
}

/// Reads what [`calendar`] wrote, and any other RFC 3339 time.
pub fn from_calendar(text: &str) -> Option<WorldTime> {
    let seconds = OffsetDateTime::parse(text, &Rfc3339).ok()?.unix_timestamp();
    Some(WorldTime::from_micros(seconds.checked_mul(1_000_000)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-01-01, in seconds.
    const NEW_YEAR: i64 = 1_767_225_600;

    fn at(seconds: i64) -> WorldTime {
        WorldTime::from_micros((NEW_YEAR + seconds) * 1_000_000)
    }

    fn anna() -> Claims {
        Claims {
            audience: "hall".into(),
            subject: "anna".into(),
            id: "0123456789abcdef".into(),
            issued: at(0),
            expires: at(3_600),
            role: Rank::Operator,
            avatars: 3,
        }
    }

    #[test]
    fn a_token_says_what_was_signed_and_keys_survive_as_text() {
        let (secret, public) = make_keys().unwrap();
        let token = SecretKey::parse(&secret.text()).unwrap().issue(&anna()).unwrap();
        let public = PublicKey::parse(&public.text()).unwrap();
        assert_eq!(public.text(), secret.public().unwrap().text());
        let other = make_keys().unwrap().1;
        assert_eq!(verify(token.as_bytes(), [&other, &public], "hall", at(1)), Ok((anna(), 1)));
        assert_eq!(peek(token.as_bytes()), Ok(anna()));
        assert!(token.starts_with(TOKEN_PREFIX) && public.id().starts_with("k4.pid."));
    }

    #[test]
    fn a_token_is_good_for_its_server_its_time_and_no_other() {
        let (secret, public) = make_keys().unwrap();
        let token = secret.issue(&anna()).unwrap();
        let check = |audience: &str, seconds| verify(token.as_bytes(), [&public], audience, at(seconds));
        for good in [-60, 0, 1, 3_600, 3_660] {
            assert!(check("hall", good).is_ok(), "{good}");
        }
        assert_eq!(check("hall", -61), Err(TokenError::Early { from: at(0) }));
        assert_eq!(check("hall", 3_661), Err(TokenError::Expired { at: at(3_600) }));
        let text = check("hall", 3_661).unwrap_err().to_string();
        assert_eq!(text, "the token ended at 2026-01-01T01:00:00Z; ask for a new one");
        assert!(matches!(check("tower", 1), Err(TokenError::Audience { .. })));
        let stranger = make_keys().unwrap().1;
        assert_eq!(verify(token.as_bytes(), [&stranger], "hall", at(1)), Err(TokenError::Signature));
        assert_eq!(verify(token.as_bytes(), [], "hall", at(1)), Err(TokenError::Signature));
    }

    #[test]
    fn no_changed_byte_and_no_cut_leaves_a_token_good() {
        let (secret, public) = make_keys().unwrap();
        let token = secret.issue(&anna()).unwrap().into_bytes();
        for index in 0..token.len() {
            let mut changed = token.clone();
            changed[index] = if changed[index] == b'A' { b'B' } else { b'A' };
            // The last digit of base64 has bits that mean nothing, which a decoder may refuse or ignore.
            if index + 1 < token.len() {
                assert!(verify(&changed, [&public], "hall", at(1)).is_err(), "{index}");
            }
            assert!(verify(&token[..index], [&public], "hall", at(1)).is_err(), "cut at {index}");
        }
        assert_eq!(verify(&[0xff; 40], [&public], "hall", at(1)), Err(TokenError::Format));
        assert_eq!(verify(&[b'v'; 2_000], [&public], "hall", at(1)), Err(TokenError::TooLong { bytes: 2_000 }));
    }

    #[test]
    fn what_was_signed_without_sense_is_refused() {
        let (secret, public) = make_keys().unwrap();
        let full = r#"{"aud":"hall","sub":"anna","jti":"1","iat":"2026-01-01T00:00:00Z","exp":"2026-01-01T01:00:00Z","role":"actor","avatars":1}"#;
        let check = |payload: &str| {
            let token = PublicToken::sign(&secret.key, payload.as_bytes(), None, None).unwrap();
            verify(token.as_bytes(), [&public], "hall", at(1))
        };
        assert!(check(full).is_ok());
        let cases = [
            (r#""role":"actor""#, r#""role":"king""#, "role = 'king'"),
            (r#""avatars":1"#, r#""avatars":4097"#, "4097"),
            (r#""avatars":1"#, r#""avatars":-1"#, "expected u16"),
            ("2026-01-01T01:00:00Z", "tomorrow", "exp = 'tomorrow'"),
            ("2026-01-01T00:00:00Z", "9", "iat = '9'"),
            (r#""sub":"anna","#, "", "sub"),
            (r#""sub":"anna""#, r#""sub":"""#, "sub has 0 bytes"),
            ("{", "[", "line 1"),
        ];
        for (from, to, said) in cases {
            let error = check(&full.replacen(from, to, 1)).unwrap_err();
            assert!(matches!(error, TokenError::Claims(_)) && error.to_string().contains(said), "{error}");
        }
    }

    #[test]
    fn what_can_not_be_signed_says_why() {
        let (secret, _) = make_keys().unwrap();
        let issue = |claims: Claims| secret.issue(&claims).map_err(|error| error.to_string());
        assert!(issue(Claims { subject: "a".repeat(255), ..anna() }).is_ok());
        for bad in [String::new(), "a".repeat(256), "a\nb".into()] {
            assert!(issue(Claims { subject: bad, ..anna() }).unwrap_err().contains("is not a subject"));
        }
        assert!(issue(Claims { avatars: 4_097, ..anna() }).unwrap_err().contains("4097 avatars"));
        let quotes = Claims { subject: "\"".repeat(255), audience: "\"".repeat(64), ..anna() };
        assert!(issue(quotes).unwrap_err().contains("longer than 1024"));
    }
}
