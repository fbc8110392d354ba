//! Names of things on the wire.

use serde::{Deserialize, Deserializer, Serialize, Serializer, ser};

/// Something that may move: an avatar, a chair. Three bytes on the wire, so that a pose record fits in 20.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ObjectId(pub u32);

impl From<ObjectId> for u32 {
    fn from(object: ObjectId) -> u32 {
        object.0
    }
}

impl ObjectId {
    /// The greatest id that the wire can carry.
    pub const MAX: ObjectId = ObjectId(0xff_ffff);

    /// The id as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl std::fmt::Display for ObjectId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "#{}", self.0)
    }
}

impl Serialize for ObjectId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if *self > ObjectId::MAX {
            return Err(ser::Error::custom("object id above 2^24 - 1"));
        }
        let [a, b, c, _] = self.0.to_le_bytes();
        [a, b, c].serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for ObjectId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ObjectId, D::Error> {
        let [a, b, c] = <[u8; 3]>::deserialize(deserializer)?;
        Ok(ObjectId(u32::from_le_bytes([a, b, c, 0])))
    }
}

/// A connected client, in the order of arrival.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ClientId(pub u32);

impl std::fmt::Display for ClientId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "client {}", self.0)
    }
}

/// A kind of object: index into [`crate::Welcome::classes`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ClassId(pub u16);

/// How often an object has broken its bound. A bound of an older issue than a violation is void.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Issue(pub u32);
