//! What is what: the roster as it was heard, for those who show it to people.

use std::collections::BTreeMap;

use eyeline_protocol::{ClassId, ObjectId, RosterEntry};

/// What the roster says of an object, apart from where it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Its class, an index into the welcome's classes.
    pub class: ClassId,
    /// A name for people. Somebody else chose it: escape what is printed.
    pub name: String,
    /// Node of the model with its mesh; empty for an avatar.
    pub node: String,
}

/// Every object that is in the roster, us included.
#[derive(Debug, Default)]
pub(super) struct Names {
    named: BTreeMap<ObjectId, Named>,
}

impl Names {
    /// An object is, or has become another.
    pub fn hear(&mut self, entry: &RosterEntry) {
        let RosterEntry { object, class, name, node, .. } = entry;
        self.named.insert(*object, Named { class: *class, name: name.clone(), node: node.clone() });
    }

    /// The object exists no more.
    pub fn leave(&mut self, object: ObjectId) {
        self.named.remove(&object);
    }

    /// What an object is.
    pub fn of(&self, object: ObjectId) -> Option<&Named> {
        self.named.get(&object)
    }

    /// All of them, by id.
    pub fn all(&self) -> impl Iterator<Item = (ObjectId, &Named)> {
        self.named.iter().map(|(object, named)| (*object, named))
    }
}
