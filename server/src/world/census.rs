//! Who is here, and how much do they see? Counted when somebody asks, not as it changes.

use super::session::Phase;
use super::{World, present};
use crate::histogram::{Histogram, NUMBERS};

/// The sessions of a world, and what they are told.
#[derive(Clone, Debug, PartialEq)]
pub struct Census {
    /// Connections that have not been let in.
    pub greeting: usize,
    /// Clients that look, with an avatar or without.
    pub watching: usize,
    /// Clients that only move avatars.
    pub acting: usize,
    /// Clients whose connection is lost and whose avatars wait for them.
    pub away: usize,
    /// Of all, those that were told to go and have not gone yet.
    pub leaving: usize,
    /// Objects in the world.
    pub objects: usize,
    /// Of them, avatars.
    pub avatars: usize,
    /// Objects whose states a watching client is told of, by client.
    pub visible: Histogram,
    /// Objects in the world that it is told nothing of but bounds, by client.
    pub hidden: Histogram,
}

impl World {
    /// Counts who is here. Looks at each watching client's list of objects: about 10 ns for each entry.
    pub fn census(&self) -> Census {
        let mut census = Census {
            greeting: 0,
            watching: 0,
            acting: 0,
            away: 0,
            leaving: 0,
            objects: 0,
            avatars: 0,
            visible: Histogram::new(NUMBERS),
            hidden: Histogram::new(NUMBERS),
        };
        for (_, object) in present(&self.objects) {
            census.objects += 1;
            census.avatars += usize::from(object.class == super::AVATAR_CLASS);
        }
        for session in self.sessions.values() {
            census.leaving += usize::from(session.is_refused);
            match session.phase {
                _ if session.away_since.is_some() => census.away += 1,
                Phase::Live { watches: true, .. } => {
                    census.watching += 1;
                    let visible = session.visible();
                    let own = session.avatars.iter().filter(|avatar| self.objects[avatar.index()].present).count();
                    census.visible.observe(visible as f64);
                    census.hidden.observe(census.objects.saturating_sub(visible + own) as f64);
                }
                Phase::Live { watches: false, .. } => census.acting += 1,
                Phase::Greeting => census.greeting += 1,
            }
        }
        census
    }
}
