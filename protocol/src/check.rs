//! What types can't say about messages: lengths and ranges, in one place for both directions.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::codec::DecodeError;
use crate::{
    Class, ClientControl, ClientEntry, ClientHeader, ClientRecord, Command, Extent, MotionBound, PAYLOAD_BYTES_MAX,
    Role, RosterEntry, ServerControl, ServerHeader, ServerRecord, TEXT_BYTES_MAX, Welcome,
};

/// Greatest size of a token in hello, in bytes.
pub const TOKEN_BYTES_MAX: usize = 1024;

/// Greatest length of any name, in bytes: that of a file's name on most systems.
pub const NAME_BYTES_MAX: usize = 255;

/// Most avatars of one client.
pub const AVATARS_MAX: usize = 4096;

/// Most kinds of objects in a world.
pub const CLASSES_MAX: usize = 512;

/// Something that is said: a whole control message, a datagram's header, or one record.
///
/// Every decoder refuses what fails [`check`](Message::check); every encoder asserts it, so that a mistake shows at
/// the end that made it.
pub trait Message: Serialize + DeserializeOwned {
    /// Checks what types can't: lengths, and numbers that are out of range or none.
    ///
    /// # Errors
    /// Names the field.
    fn check(&self) -> Result<(), DecodeError>;
}

impl Message for ClientControl {
    fn check(&self) -> Result<(), DecodeError> {
        match self {
            ClientControl::Hello { token, name, role, .. } => {
                at_most("token", token.len(), TOKEN_BYTES_MAX)?;
                at_most("name", name.len(), NAME_BYTES_MAX)?;
                match *role {
                    Role::Avatar | Role::Viewer => Ok(()),
                    Role::Actor { avatars } => at_most("avatars", usize::from(avatars), AVATARS_MAX),
                }
            }
            ClientControl::Payload { bytes, .. } => at_most("payload", bytes.len(), PAYLOAD_BYTES_MAX),
            ClientControl::Command(command) => match command {
                Command::List => Ok(()),
                Command::Kick { reason: text, .. } | Command::Ban { reason: text, .. } | Command::Say { text } => {
                    at_most("text", text.len(), TEXT_BYTES_MAX)
                }
            },
            ClientControl::WorldWanted
            | ClientControl::Place { .. }
            | ClientControl::Goodbye
            | ClientControl::Take { .. }
            | ClientControl::LetGo { .. } => Ok(()),
        }
    }
}

impl Message for ServerControl {
    fn check(&self) -> Result<(), DecodeError> {
        match self {
            ServerControl::Welcome(welcome) => check_welcome(welcome),
            // The reason is as long as the message may be.
            ServerControl::Refused { .. } => Ok(()),
            ServerControl::Roster { entries, .. } => {
                at_most("entries", entries.len(), ServerControl::ROSTER_MAX)?;
                entries.iter().try_for_each(|RosterEntry { name, node, .. }| {
                    at_most("object name", name.len(), NAME_BYTES_MAX)?;
                    at_most("node", node.len(), NAME_BYTES_MAX)
                })
            }
            ServerControl::Left { objects } => at_most("objects", objects.len(), AVATARS_MAX),
            ServerControl::Payload { bytes, .. } => at_most("payload", bytes.len(), PAYLOAD_BYTES_MAX),
            ServerControl::Clients { entries } => {
                at_most("entries", entries.len(), ServerControl::ROSTER_MAX)?;
                entries.iter().try_for_each(|ClientEntry { name, subject, .. }| {
                    at_most("client name", name.len(), NAME_BYTES_MAX)?;
                    at_most("subject", subject.len(), NAME_BYTES_MAX)
                })
            }
            ServerControl::Said { text } => at_most("text", text.len(), TEXT_BYTES_MAX),
            ServerControl::Done { .. } | ServerControl::Held { .. } => Ok(()),
        }
    }
}

fn check_welcome(welcome: &Welcome) -> Result<(), DecodeError> {
    at_most("avatars", welcome.avatars.len(), AVATARS_MAX)?;
    in_range("anchor", welcome.anchor.iter().all(|x| x.is_finite()))?;
    in_range("tick", welcome.tick_micros > 0)?;
    at_most("policy", welcome.policy.len(), NAME_BYTES_MAX)?;
    in_range("blur", is_size(welcome.blur))?;
    in_range("dead reckoning", welcome.dead_reckoning_px.is_none_or(is_size))?;
    at_most("world name", welcome.world.name.len(), NAME_BYTES_MAX)?;
    at_most("classes", welcome.classes.len(), CLASSES_MAX)?;
    welcome.classes.iter().try_for_each(|Class { name, motion, extent, eye_height, turn_max }| {
        let MotionBound { speed_max, slack } = *motion;
        let Extent { radius, bottom, top } = *extent;
        at_most("class name", name.len(), NAME_BYTES_MAX)?;
        in_range("motion", is_size(speed_max) && is_size(slack))?;
        in_range("extent", is_size(radius) && bottom.is_finite() && top.is_finite() && bottom <= top)?;
        in_range("eye height", eye_height.is_finite())?;
        in_range("turn", turn_max.is_none_or(is_size))
    })
}

macro_rules! any_value_is_legal {
    ($($message:ty),*) => {
        $(impl Message for $message {
            fn check(&self) -> Result<(), DecodeError> {
                Ok(())
            }
        })*
    };
}

// Integers throughout, and what they mean saturates.
any_value_is_legal!(ClientHeader, ServerHeader, ClientRecord, ServerRecord);

fn is_size(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}

fn at_most(field: &'static str, length: usize, limit: usize) -> Result<(), DecodeError> {
    if length > limit { Err(DecodeError::Field { field, limit }) } else { Ok(()) }
}

fn in_range(field: &'static str, legal: bool) -> Result<(), DecodeError> {
    if legal { Ok(()) } else { Err(DecodeError::Value { field }) }
}
