//! Who is let in, and as what? The world asks a [`Gate`] at each hello; what a token is, and how it is checked, is the
//! gate's own matter ([`crate::net`] has the one that a server on a network uses).

use std::net::IpAddr;

use eyeline_protocol::{Rank, Refusal, WorldTime};

/// Whence a connection comes, as its driver knows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Caller {
    /// Its address; `None` where there are none (virtual time).
    pub address: Option<IpAddr>,
    /// What it is to come back with if the connection is lost: chance, which the world has none of. All zero: it can't.
    pub resume: [u8; 16],
}

impl Caller {
    /// Whether it comes from this machine.
    pub fn is_local(&self) -> bool {
        self.address.is_none_or(|address| address.to_canonical().is_loopback())
    }
}

/// What somebody may do, and who it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Permit {
    /// What it may be.
    pub rank: Rank,
    /// Most avatars of one connection.
    pub avatars_max: u16,
    /// Whom the token was issued to; empty for the anonymous.
    pub subject: String,
    /// Which token that was, if there was one.
    pub token: Option<TokenMark>,
}

impl Permit {
    /// Whether it lets the same somebody do the same, by whatever token.
    pub fn is_like(&self, other: &Permit) -> bool {
        (self.rank, self.avatars_max, &self.subject) == (other.rank, other.avatars_max, &other.subject)
    }
}

/// What tells a token from others, so that it can be told later whether it still holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenMark {
    /// Its own name.
    pub id: String,
    /// From when it is good.
    pub issued: WorldTime,
    /// Which of the gate's keys has signed it.
    pub key: usize,
}

/// Why somebody is not let in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Denial {
    /// For programs.
    pub refusal: Refusal,
    /// For people, with the remedy. Must not say more than a stranger may know.
    pub reason: String,
}

/// Decides who is let in.
pub trait Gate: Send {
    /// What the bearer of `token` (empty for none) may do.
    ///
    /// # Errors
    /// If it is not let in.
    fn admit(&mut self, token: &[u8], caller: Caller, now: WorldTime) -> Result<Permit, Denial>;

    /// Nobody of this name, or without one from this address, is let in before `until`.
    fn ban(&mut self, subject: &str, caller: Caller, until: WorldTime);

    /// Looks whether there is news of who may be here. Asked at each tick, so it looks no more often than it has to.
    fn look(&mut self, _now: WorldTime) -> bool {
        false
    }

    /// Why somebody who was let in so may stay no longer; asked of each after news. The reason is theirs to read.
    fn dismisses(&self, _permit: &Permit, _caller: Caller, _now: WorldTime) -> Option<Denial> {
        None
    }
}

/// Lets everybody in, whatever they come with, with any number of avatars: for simulations and tests. Knows no bans.
#[derive(Clone, Copy, Debug)]
pub struct OpenGate {
    /// What everybody may be.
    pub rank: Rank,
}

impl Default for OpenGate {
    /// Actors.
    fn default() -> OpenGate {
        OpenGate { rank: Rank::Actor }
    }
}

impl Gate for OpenGate {
    fn admit(&mut self, _: &[u8], _: Caller, _: WorldTime) -> Result<Permit, Denial> {
        Ok(Permit { rank: self.rank, avatars_max: u16::MAX, subject: String::new(), token: None })
    }

    fn ban(&mut self, _: &str, _: Caller, _: WorldTime) {}
}
