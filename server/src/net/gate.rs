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
use super::watched::Watched;
use crate::gate::{Caller, Denial, Gate, Permit};
use crate::token::files::{FileError, Revocations, read_public, revoked_path};
use crate::token::{PublicKey, TokenError, verify};

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
    audience: String,
    anonymous: Anonymous,
    anonymous_permit: Permit,
    bans: Bans,
    looked: WorldTime,
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
        Ok(TokenGate {
            keys: keys.iter().map(read).collect::<Result<_, FileError>>()?,
            audience: audience.into(),
            anonymous: Anonymous::default(),
            anonymous_permit: Permit { rank: Rank::Actor, avatars_max: AVATARS_MAX as u16, subject: String::new() },
            bans: Bans::default(),
            looked: WorldTime::MIN,
        })
    }

    /// Sets who may come without a token, as what, and with how many avatars at most.
    pub fn with_anonymous(self, anonymous: Anonymous, rank: Rank, avatars_max: u16) -> TokenGate {
        let anonymous_permit = Permit { rank, avatars_max, subject: String::new() };
        TokenGate { anonymous, anonymous_permit, ..self }
    }

    /// Keeps bans in a file, so that they outlast the server.
    ///
    /// # Errors
    /// Names the line that is not understood.
    pub fn with_bans(self, path: &Path) -> Result<TokenGate, GateError> {
        Ok(TokenGate { bans: Bans::kept_in(path)?, ..self })
    }

    fn look(&mut self, now: WorldTime) {
        if self.looked != WorldTime::MIN && now.since(self.looked) < LOOK {
            return;
        }
        self.looked = now;
        for (public, list) in &mut self.keys {
            public.look(key);
            list.look(revoked);
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
        let keys = self.keys.iter().map(|(key, _)| key.get());
        match verify(token, keys, &self.audience, now) {
            Ok((claims, index)) if self.keys[index].1.get().covers(&claims) => {
                Err(denied("your token was revoked; ask who runs this server for another".into()))
            }
            Ok((claims, _)) => Ok(Permit { rank: claims.role, avatars_max: claims.avatars, subject: claims.subject }),
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
        self.look(now);
        let permit = if token.is_empty() { self.anonymous(caller) } else { self.by_token(token, now) }?;
        match self.bans.until(&permit.subject, caller.address, now) {
            Some(until) => Err(Denial { refusal: Refusal::Banned, reason: super::bans::reason(until) }),
            None => Ok(permit),
        }
    }

    fn ban(&mut self, subject: &str, caller: Caller, until: WorldTime) {
        self.bans.add(subject, caller.address, until);
    }
}

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
