//! The gate of a server on a network: tokens, the anonymous, and bans.
//!
//! What it answers is heard by strangers. To who shows no token that a key of ours has signed it says no more than how to get
//! one; only then what is wrong with it.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::ValueEnum;
use eyeline_protocol::{AVATARS_MAX, Rank, Refusal, WorldTime};

use super::bans::Bans;
use super::checks::TokenChecks;
use super::watched::Watched;
use crate::gate::{Caller, Denial, Gate, Permit, TokenMark};
use crate::token::files::{FileError, Revocations, read_public, revoked_path};
use crate::token::{PublicKey, TokenError};

/// Who may come without a token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Anonymous {
    /// Clients on the server's own machine.
    #[default]
    Loopback,
    /// Clients from anywhere.
    Anywhere,
    /// Nobody.
    Never,
}

/// Most public keys: each may cost a token that nobody signed one check of a signature.
pub const KEYS_MAX: usize = 16;

/// How often keys and revocations are looked at, at most: one look is a few system calls, and a stranger can ask for it.
const LOOK: Duration = Duration::from_secs(1);

/// Why there is no gate.
#[derive(Debug, thiserror::Error)]
pub enum GateError {
    /// A file is not what it should be.
    #[error(transparent)]
    File(#[from] FileError),
    /// More keys than are checked.
    #[error("{keys} public keys are more than {KEYS_MAX}; leave out those whose tokens have ended")]
    TooManyKeys {
        /// How many.
        keys: usize,
    },
}

/// Lets in whose token is good, and the anonymous as far as it was told to.
///
/// Its world's time must be the calendar's, as that of `eyeline-server` is, since tokens end by the calendar.
#[derive(Debug)]
pub struct TokenGate {
    keys: Vec<(Watched<PublicKey>, Watched<Revocations>)>,
    checks: TokenChecks,
    anonymous: Anonymous,
    anonymous_permit: Permit,
    bans: Bans,
    looked: WorldTime,
    /// Whether a list has changed since somebody asked.
    has_news: bool,
}

impl TokenGate {
    /// A gate for tokens to the server `audience`, signed with one of these keys' other halves. It lets in the anonymous from
    /// this machine, as actors.
    ///
    /// # Errors
    /// Names the file that is not what it should be, and the remedy.
    pub fn new(keys: &[PathBuf], audience: impl Into<String>) -> Result<TokenGate, GateError> {
        if keys.len() > KEYS_MAX {
            return Err(GateError::TooManyKeys { keys: keys.len() });
        }
        let read = |path: &PathBuf| {
            let key = Watched::new(vec![path.clone()], key)?;
            let revoked = Watched::new(vec![revoked_path(path)], revoked)?;
            Ok((key, revoked))
        };
        let keys: Vec<(Watched<PublicKey>, _)> = keys.iter().map(read).collect::<Result<_, FileError>>()?;
        let publics = keys.iter().map(|(key, _)| key.get().clone()).collect();
        Ok(TokenGate {
            checks: TokenChecks::new(publics, &audience.into()),
            keys,
            anonymous: Anonymous::default(),
            anonymous_permit: Permit {
                rank: Rank::Actor,
                avatars_max: AVATARS_MAX as u16,
                subject: String::new(),
                token: None,
            },
            bans: Bans::default(),
            looked: WorldTime::MIN,
            has_news: false,
        })
    }

    /// Sets who may come without a token, as what, and with how many avatars at most.
    pub fn with_anonymous(self, anonymous: Anonymous, rank: Rank, avatars_max: u16) -> TokenGate {
        let anonymous_permit = Permit { rank, avatars_max, subject: String::new(), token: None };
        TokenGate { anonymous, anonymous_permit, ..self }
    }

    /// Keeps bans in a file, so that they outlast the server.
    ///
    /// # Errors
    /// Names the line that is not understood.
    pub fn with_bans(self, path: &Path) -> Result<TokenGate, GateError> {
        Ok(TokenGate { bans: Bans::kept_in(path)?, ..self })
    }

    /// Checks the signatures of tokens for this gate, elsewhere and beforehand.
    pub fn checks(&self) -> TokenChecks {
        self.checks.clone()
    }

    fn look_at_files(&mut self, now: WorldTime) {
        if self.looked != WorldTime::MIN && now.since(self.looked) < LOOK {
            return;
        }
        self.looked = now;
        let mut has_new_key = false;
        for (public, list) in &mut self.keys {
            has_new_key |= public.look(key);
            self.has_news |= list.look(revoked);
        }
        self.has_news |= self.bans.look();
        if has_new_key {
            self.checks.use_keys(self.keys.iter().map(|(key, _)| key.get().clone()).collect());
        }
    }

    fn anonymous(&self, caller: Caller) -> Result<Permit, Denial> {
        let is_let_in = match self.anonymous {
            Anonymous::Loopback => caller.is_local(),
            Anonymous::Anywhere => true,
            Anonymous::Never => false,
        };
        if is_let_in {
            return Ok(self.anonymous_permit.clone());
        }
        let reason =
            "nobody is let in here without a token; ask who runs this server for one, and give it with --token";
        Err(Denial { refusal: Refusal::Token, reason: reason.into() })
    }

    fn by_token(&self, token: &[u8], now: WorldTime) -> Result<Permit, Denial> {
        let denied = |reason: String| Denial { refusal: Refusal::Token, reason };
        if self.keys.is_empty() {
            return Err(denied("this server takes no tokens; come without one, or ask who runs it".into()));
        }
        match self.checks.take(token, now) {
            Ok((claims, index)) if self.keys[index].1.get().covers(&claims) => Err(denied(REVOKED.into())),
            Ok((claims, key)) => {
                let token = Some(TokenMark { id: claims.id, issued: claims.issued, key });
                Ok(Permit { rank: claims.role, avatars_max: claims.avatars, subject: claims.subject, token })
            }
            // These say nothing that only we know, or were shown a signature of ours.
            Err(error @ (TokenError::Expired { .. } | TokenError::Early { .. } | TokenError::Format)) => {
                Err(denied(error.to_string()))
            }
            Err(_) => Err(denied(
                "your token is not good at this server; ask who runs it for one that was issued for it".into(),
            )),
        }
    }
}

impl Gate for TokenGate {
    fn admit(&mut self, token: &[u8], caller: Caller, now: WorldTime) -> Result<Permit, Denial> {
        self.look_at_files(now);
        let permit = if token.is_empty() { self.anonymous(caller) } else { self.by_token(token, now) }?;
        match self.bans.until(&permit.subject, caller.address, now) {
            Some(until) => Err(Denial { refusal: Refusal::Banned, reason: super::bans::reason(until) }),
            None => Ok(permit),
        }
    }

    fn ban(&mut self, subject: &str, caller: Caller, until: WorldTime) {
        self.bans.add(subject, caller.address, until);
    }

    fn look(&mut self, now: WorldTime) -> bool {
        self.look_at_files(now);
        std::mem::take(&mut self.has_news)
    }

    fn dismisses(&self, permit: &Permit, caller: Caller, now: WorldTime) -> Option<Denial> {
        let is_revoked = permit.token.as_ref().is_some_and(|token| {
            let list = self.keys.get(token.key).map(|(_, list)| list.get());
            list.is_some_and(|list| list.covers_token(&token.id, &permit.subject, token.issued))
        });
        if is_revoked {
            return Some(Denial { refusal: Refusal::Token, reason: REVOKED.into() });
        }
        let until = self.bans.until(&permit.subject, caller.address, now)?;
        Some(Denial { refusal: Refusal::Banned, reason: super::bans::reason(until) })
    }
}

/// What is said to whose token was revoked, at the door and inside.
const REVOKED: &str = "your token was revoked; ask who runs this server for another";

fn key(paths: &[PathBuf]) -> Result<PublicKey, FileError> {
    read_public(&paths[0])
}

fn revoked(paths: &[PathBuf]) -> Result<Revocations, FileError> {
    Revocations::read(&paths[0])
}

/// An address as bans know it: of IPv6 the network of 64 bits that one subscriber has at least.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => IpAddr::V4(address),
        IpAddr::V6(address) => IpAddr::V6((u128::from(address) >> 64 << 64).into()),
    }
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;
    use crate::token::files::write_keys;
    use crate::token::{Claims, SecretKey, from_calendar, make_keys};

    fn caller(address: &str) -> Caller {
        Caller { address: Some(address.parse().unwrap()), ..Caller::default() }
    }

    fn noon() -> WorldTime {
        from_calendar("2026-01-01T12:00:00Z").unwrap()
    }

    const fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// A folder with a key, and what signs with it.
    fn key() -> (TempDir, PathBuf, SecretKey) {
        let folder = TempDir::new().unwrap();
        let (secret, public) = make_keys().unwrap();
        let public = write_keys(&folder.path().join("tokens.key"), &secret, &public).unwrap();
        (folder, public, secret)
    }

    fn claims(subject: &str) -> Claims {
        Claims {
            audience: "hall".into(),
            subject: subject.into(),
            id: "0123456789abcdef".into(),
            issued: noon(),
            expires: noon() + seconds(3_600),
            role: Rank::Operator,
            avatars: 3,
        }
    }

    fn refused(gate: &mut TokenGate, token: &[u8], from: &str, now: WorldTime) -> (Refusal, String) {
        let denial = gate.admit(token, caller(from), now).unwrap_err();
        (denial.refusal, denial.reason)
    }

    #[test]
    fn the_anonymous_come_from_where_they_may_and_as_what_they_may() {
        let gate = |anonymous| TokenGate::new(&[], "hall").unwrap().with_anonymous(anonymous, Rank::Viewer, 7);
        let is_let_in = |anonymous, from: &str| gate(anonymous).admit(&[], caller(from), noon()).is_ok();
        for (from, is_local) in [
            ("127.0.0.1", true),
            ("127.9.9.9", true),
            ("::1", true),
            ("::ffff:127.0.0.1", true),
            ("192.168.1.1", false),
            ("203.0.113.7", false),
            ("::ffff:203.0.113.7", false),
            ("fe80::1", false),
            ("0.0.0.0", false),
        ] {
            assert_eq!(is_let_in(Anonymous::Loopback, from), is_local, "{from}");
            assert!(is_let_in(Anonymous::Anywhere, from) && !is_let_in(Anonymous::Never, from), "{from}");
        }
        let permit = gate(Anonymous::Anywhere).admit(&[], caller("203.0.113.7"), noon());
        assert_eq!(permit, Ok(Permit { rank: Rank::Viewer, avatars_max: 7, subject: String::new(), token: None }));
        // Unless told otherwise, replays drive whole crowds without a token, from this machine only.
        let mut plain = TokenGate::new(&[], "hall").unwrap();
        assert_eq!(plain.admit(&[], caller("::1"), noon()).map(|permit| permit.avatars_max), Ok(4_096));
        let (refusal, reason) = refused(&mut plain, &[], "203.0.113.7", noon());
        assert!(refusal == Refusal::Token && reason.contains("--token"), "{reason}");
    }

    #[test]
    fn a_good_token_is_a_permit_and_another_says_what_is_wrong_to_who_may_know() {
        let (_folder, public, secret) = key();
        let mut gate = TokenGate::new(&[public], "hall").unwrap().with_anonymous(Anonymous::Never, Rank::Actor, 1);
        let token = |claims: Claims| secret.issue(&claims).unwrap().into_bytes();
        let good = token(claims("anna"));
        let permit = gate.admit(&good, caller("203.0.113.7"), noon());
        let mark = TokenMark { id: "0123456789abcdef".into(), issued: noon(), key: 0 };
        let anna = Permit { rank: Rank::Operator, avatars_max: 3, subject: "anna".into(), token: Some(mark) };
        assert_eq!(permit, Ok(anna));

        let stranger = make_keys().unwrap().0.issue(&claims("anna")).unwrap().into_bytes();
        let elsewhere = token(Claims { audience: "tower of london".into(), ..claims("anna") });
        let cases: [(&[u8], u64, &str); 5] = [
            (&good, 3_661, "ended at 2026-01-01T13:00:00Z"),
            (b"v4.public.AAAA", 0, "not a token"),
            (&[0xff; 1_024], 0, "not a token"),
            (&stranger, 0, "not good at this server"),
            (&elsewhere, 0, "not good at this server"),
        ];
        for (token, later, said) in cases {
            let (refusal, reason) = refused(&mut gate, token, "203.0.113.7", noon() + seconds(later));
            assert!(refusal == Refusal::Token && reason.contains(said), "{reason}");
            // Where else a token is good is nobody's business here, nor is what the server is called.
            assert!(!reason.contains("tower") && !reason.contains("hall"), "{reason}");
        }
        // A bad token is no way in, even where none is needed.
        let mut open = TokenGate::new(&[], "hall").unwrap();
        assert!(refused(&mut open, &good, "127.0.0.1", noon()).1.contains("takes no tokens"));
    }

    #[test]
    fn a_revocation_is_noticed_within_a_second_and_a_broken_list_keeps_the_old_one() {
        let (_folder, public, secret) = key();
        let list = revoked_path(&public);
        let mut gate = TokenGate::new(std::slice::from_ref(&public), "hall").unwrap();
        let token = secret.issue(&claims("anna")).unwrap().into_bytes();
        let mut is_let_in = |later: u64| gate.admit(&token, caller("203.0.113.7"), noon() + seconds(later)).is_ok();
        assert!(is_let_in(0));
        let mut revoked = Revocations::default();
        revoked.revoke_id("0123456789abcdef");
        revoked.write(&list).unwrap();
        assert!(!is_let_in(1));
        // Neither a slip of the pen nor a deleted file lets anybody in.
        std::fs::write(&list, "id of nobody\n").unwrap();
        assert!(!is_let_in(2));
        std::fs::remove_file(&list).unwrap();
        assert!(!is_let_in(3));
        Revocations::default().write(&list).unwrap();
        assert!(is_let_in(4));
        revoked = Revocations::default();
        revoked.revoke_subject("anna", noon());
        revoked.write(&list).unwrap();
        assert!(!is_let_in(5));
    }

    #[test]
    fn who_is_inside_is_dismissed_once_its_token_is_revoked_or_its_name_is_on_the_list_of_bans() {
        let (folder, public, secret) = key();
        let bans = folder.path().join("bans");
        let mut gate = TokenGate::new(std::slice::from_ref(&public), "hall").unwrap().with_bans(&bans).unwrap();
        let from = caller("203.0.113.7");
        let mut let_in = |subject: &str, id: &str| {
            let token = secret.issue(&Claims { id: id.into(), ..claims(subject) }).unwrap().into_bytes();
            gate.admit(&token, from, noon()).unwrap()
        };
        let (anna, anna_too) = (let_in("anna", "0123456789abcdef"), let_in("anna", "fedcba9876543210"));
        let bob = let_in("bob", "00000000000000bb");
        let nobody = Permit { token: None, subject: String::new(), ..bob.clone() };
        assert!(!gate.look(noon()));
        let mut revoked = Revocations::default();
        revoked.revoke_id("0123456789abcdef");
        revoked.write(&revoked_path(&public)).unwrap();
        assert!(!gate.look(noon()), "files are looked at once a second");
        let later = noon() + seconds(1);
        assert!(gate.look(later) && !gate.look(later));
        let why = |gate: &TokenGate, permit: &Permit| gate.dismisses(permit, from, later).map(|denial| denial.refusal);
        let of_all = |gate: &TokenGate| [&anna, &anna_too, &bob, &nobody].map(|permit| why(gate, permit));
        assert_eq!(of_all(&gate), [Some(Refusal::Token), None, None, None]);
        assert!(gate.dismisses(&anna, from, later).unwrap().reason.contains("revoked"));
        std::fs::write(&bans, "subject 2027-01-01T00:00:00Z bob\n").unwrap();
        let later_still = noon() + seconds(2);
        assert!(gate.look(later_still));
        assert_eq!(of_all(&gate), [Some(Refusal::Token), None, Some(Refusal::Banned), None]);
    }

    #[test]
    fn keys_are_exchanged_without_a_restart_and_there_are_not_too_many() {
        let (_folder, public, _) = key();
        let (_other_folder, other, secret) = key();
        let mut gate = TokenGate::new(std::slice::from_ref(&public), "hall").unwrap();
        let token = secret.issue(&claims("anna")).unwrap().into_bytes();
        assert!(gate.admit(&token, caller("203.0.113.7"), noon()).is_err());
        std::fs::rename(&other, &public).unwrap();
        assert!(gate.admit(&token, caller("203.0.113.7"), noon() + seconds(1)).is_ok());
        let many = vec![public; KEYS_MAX + 1];
        assert!(TokenGate::new(&many, "hall").unwrap_err().to_string().contains("17 public keys are more than 16"));
    }

    #[test]
    fn who_is_banned_stays_out_by_name_or_address_until_the_time() {
        let (folder, public, secret) = key();
        let file = folder.path().join("bans");
        let make = || {
            let gate = TokenGate::new(std::slice::from_ref(&public), "hall").unwrap();
            gate.with_anonymous(Anonymous::Anywhere, Rank::Actor, 1).with_bans(&file).unwrap()
        };
        let token = |subject: &str| secret.issue(&claims(subject)).unwrap().into_bytes();
        let mut gate = make();
        gate.ban("anna", caller("203.0.113.7"), noon() + seconds(60));
        gate.ban("", caller("2001:db8:1:2:3::4"), noon() + seconds(60));
        gate.ban("", caller("203.0.113.9"), WorldTime::MAX);
        // In virtual time nobody has an address, and a ban of nobody holds for nobody.
        gate.ban("", Caller::default(), WorldTime::MAX);
        let check = |gate: &mut TokenGate, has_ended: bool, restarted: bool| {
            let now = noon() + seconds(if has_ended { 60 } else { 59 });
            let mut is_let_in = |token: &[u8], from: &str| gate.admit(token, caller(from), now).is_ok();
            // With a token it is the name that counts, and another's address is no matter.
            assert_eq!(is_let_in(&token("anna"), "198.51.100.1"), has_ended);
            assert!(is_let_in(&token("bob"), "203.0.113.9"));
            assert!(is_let_in(&[], "203.0.113.7"));
            // One subscriber has a whole /64.
            assert_eq!(is_let_in(&[], "2001:db8:1:2:ffff::1"), has_ended);
            assert!(is_let_in(&[], "2001:db8:1:3::1"));
            // Until the server ends.
            assert_eq!(is_let_in(&[], "::ffff:203.0.113.9"), restarted);
        };
        check(&mut gate, false, false);
        check(&mut gate, true, false);
        check(&mut make(), false, true);
        check(&mut make(), true, true);
        let (refusal, reason) = refused(&mut gate, &token("anna"), "203.0.113.7", noon());
        assert!(refusal == Refusal::Banned && reason.contains("before 2026-01-01T12:01:00Z"), "{reason}");
        std::fs::write(&file, "\naddress 2026-01-01T00:00:00Z nowhere\n").unwrap();
        let broken = TokenGate::new(&[], "hall").unwrap().with_bans(&file).unwrap_err().to_string();
        assert!(broken.contains("bans:2: 'address 2026-01-01T00:00:00Z nowhere' is not understood"), "{broken}");
    }
}
