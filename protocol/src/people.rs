//! What people do besides walking and looking: come back, take things, speak, keep order. All of it goes over the control
//! streams, since none of it may be lost and none of it is often.

use serde::{Deserialize, Serialize};

use crate::{ClientId, untrusted};

/// Greatest size of an application's payload, in bytes.
pub const PAYLOAD_BYTES_MAX: usize = 1024;

/// Greatest length of what is said to people, in bytes.
pub const TEXT_BYTES_MAX: usize = 1024;

/// What a client may do, by its token. Each may do what the ones before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Rank {
    /// Looks, from wherever it likes, and is nowhere.
    Viewer,
    /// Has avatars; its eye stays within [`crate::EYE_REACH`] of its avatar.
    Actor,
    /// Keeps order, and may fly.
    Operator,
}

impl Rank {
    /// All of them, the least first.
    pub const ALL: [Rank; 3] = [Rank::Viewer, Rank::Actor, Rank::Operator];

    /// Its name in tokens, settings and logs.
    pub fn name(self) -> &'static str {
        match self {
            Rank::Viewer => "viewer",
            Rank::Actor => "actor",
            Rank::Operator => "operator",
        }
    }
}

impl std::fmt::Display for Rank {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Comes back after its connection was lost, to the avatars that it had.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Resume {
    /// What the last welcome gave it. Good once: the next welcome gives another.
    pub token: [u8; 16],
    /// If it still has the roster and its bounds: how many messages of [`crate::ServerControl::Roster`] and
    /// [`crate::ServerControl::Left`] it has had since it was told everything. Then it is told only what it missed.
    pub heard: Option<u32>,
}

/// How a welcome goes on from what was before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Continuity {
    /// Nothing was, or it is forgotten: new avatars, and the roster follows.
    New,
    /// The avatars are those it had; the roster follows.
    Returned,
    /// So are its roster and bounds; of these only what it missed follows.
    Kept,
}

/// What an operator wants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Who is here?
    List,
    /// Send somebody away.
    Kick {
        /// Whom.
        client: ClientId,
        /// Why, for them.
        #[serde(deserialize_with = "untrusted::string")]
        reason: String,
    },
    /// Send somebody away who is not to come back: not with their token, and if they came without one, not from their
    /// address.
    Ban {
        /// Whom.
        client: ClientId,
        /// For how long, seconds; 0 is until the server ends.
        seconds: u32,
        /// Why, for them.
        #[serde(deserialize_with = "untrusted::string")]
        reason: String,
    },
    /// Tell everybody something.
    Say {
        /// What.
        #[serde(deserialize_with = "untrusted::string")]
        text: String,
    },
}

/// Somebody who is here, as operators see them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClientEntry {
    /// Its number.
    pub client: ClientId,
    /// What it calls itself.
    #[serde(deserialize_with = "untrusted::string")]
    pub name: String,
    /// Whom its token was issued to; empty without one.
    #[serde(deserialize_with = "untrusted::string")]
    pub subject: String,
    /// What it may do.
    pub rank: Rank,
    /// Number of its avatars.
    pub avatars: u16,
    /// For how long it has been here, seconds.
    pub seconds: u32,
    /// Round trip to it, microseconds; `None` before the first measurement.
    pub rtt_micros: Option<u32>,
    /// Whether its connection is lost and its avatars wait for it.
    pub away: bool,
}

/// Whose a thing is now, or why it could not be taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Hold {
    /// The asker's, who moves it with poses from now on.
    Yours,
    /// Nobody's.
    Free,
    /// Somebody else's.
    Taken,
    /// It is farther than [`crate::TAKE_REACH`] from the asker's avatar.
    TooFar,
    /// It is no thing that people move, or is not in the world.
    Fixed,
}
