//! Who is here, and how much do they see? Counted when somebody asks, not as it changes.

use eyeline_protocol::PlanSwitch;

use super::session::Phase;
use super::{Object, World, present};
use crate::histogram::{Histogram, NUMBERS};
use crate::plan::{PlanCounts, Running};

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
    /// Counts who is here. Looks at each watching client's list of objects, so that its cost grows with what all of
    /// them see together; the measurement below says how.
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

impl World {
    /// Whether paths and rest make bounds, if anything has them ([`super::WorldConfig::swept`]).
    pub fn sweeps(&self) -> bool {
        self.config.swept
    }

    /// What is asked of the plan.
    pub(crate) fn plan_switch(&self) -> PlanSwitch {
        self.config.plan
    }

    /// What is left out by now.
    pub(crate) fn running(&self) -> &Running {
        &self.running
    }

    /// The policy's name, and whether it has an index that watchers share.
    pub(crate) fn index_of(&self) -> (&'static str, bool) {
        (self.policy.name(), self.policy.has_index())
    }

    /// Clients that were let in and look at the world, or may come back to.
    pub(super) fn watching(&self) -> usize {
        self.sessions.values().filter(|session| matches!(session.phase, Phase::Live { watches: true, .. })).count()
    }

    /// Bytes that objects, sessions and the policy's index take, by the capacity of their lists: an estimate, without
    /// what waits to be sent and what allocators add.
    pub fn memory_bytes(&self) -> usize {
        self.objects.iter().map(Object::memory_bytes).sum::<usize>()
            + self.sessions.values().map(|session| session.memory_bytes()).sum::<usize>()
            + self.policy.memory_bytes()
    }

    /// What [`crate::plan::plan`] is made from. Looks at each object once.
    pub fn plan_counts(&self) -> PlanCounts {
        let mut counts = PlanCounts {
            avatars: self.avatars_alive,
            clients: self.sessions.len(),
            watching: self.watching(),
            states: self.stats.out.states,
            ..PlanCounts::default()
        };
        for object in self.objects.iter().filter(|object| object.alive) {
            counts.sharing_bytes += object.sharing_bytes();
            if object.class == super::AVATAR_CLASS {
                continue;
            }
            counts.objects += 1;
            match &object.path {
                Some(path) => counts.on_paths += usize::from(path.spring().is_none()),
                None => counts.at_rest += usize::from(object.owner.is_none()),
            }
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use eyeline_protocol::{ClientRecord, ObjectId, Reason, Role, Want, WorldTime};

    use super::super::SessionId;
    use super::super::tests::{datagram, drain, join, world};
    use super::*;
    use crate::policy::Visible;

    #[test]
    fn everybody_counts_once_by_how_far_they_have_got() {
        let mut world = world(Box::new(Visible));
        let watcher = join(&mut world, Role::Avatar);
        let _actor = join(&mut world, Role::Actor { avatars: 3 });
        let _greeting = world.connect(WorldTime::ZERO);
        let refused = join(&mut world, Role::Actor { avatars: 0 });
        drain(&mut world, refused);
        for object in 1..4 {
            let place = world.objects()[object].position;
            world.place(SessionId(2), ObjectId(object as u32), place, true);
        }
        world.tick(WorldTime::from_micros(50_000));
        let ask = ClientRecord::Request { object: ObjectId(2), want: Want::State, reason: Reason::Exposed };
        world.handle_datagram(watcher, &datagram(1, &[ask]), WorldTime::ZERO);
        let census = world.census();
        let Census { greeting, watching, acting, away, leaving, objects, avatars, .. } = census;
        assert_eq!((greeting, watching, acting, away, leaving), (2, 1, 1, 0, 1));
        assert_eq!((objects, avatars), (4, 4));
        // It sees one of the three, and not itself.
        assert_eq!((census.visible.count(), census.visible.sum(), census.hidden.sum()), (1, 1.0, 2.0));
    }

    /// `cargo test --release -p eyeline-server --lib -- --ignored --nocapture share_of_a_tick`
    #[test]
    #[ignore = "a measurement, of the release build"]
    #[expect(clippy::disallowed_methods, reason = "it measures")]
    fn a_census_takes_a_small_share_of_a_tick() {
        use std::time::Instant;
        let mut world = world(Box::new(Visible));
        let ids: Vec<_> = (0..1_000).map(|_| join(&mut world, Role::Avatar)).collect();
        while world.poll_transmit(WorldTime::ZERO).is_some() {}
        let mut ratios = Vec::new();
        for round in 1..=21u32 {
            let now = WorldTime::from_micros(50_000 * i64::from(round));
            for (index, &id) in ids.iter().enumerate() {
                let mut records: Vec<_> = (0..40)
                    .map(|n| ObjectId((index as u32 + 1 + n) % 1_000))
                    .map(|object| ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed })
                    .collect();
                let (position, orientation) = (world.objects()[index].position, Default::default());
                records.truncate(if round == 1 { 40 } else { 0 });
                records.push(ClientRecord::Pose { object: ObjectId(index as u32), position, orientation });
                world.handle_datagram(id, &datagram(round, &records), now);
            }
            let started = Instant::now();
            world.tick(now);
            while world.poll_transmit(now).is_some() {}
            let tick = started.elapsed();
            let started = Instant::now();
            let census = world.census();
            let census_took = started.elapsed();
            assert_eq!(census.visible.sum(), 40_000.0);
            ratios.push((census_took.as_secs_f64() / tick.as_secs_f64(), census_took, tick));
        }
        ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
        println!("census, tick of 1,000 clients that see 40 each: median {:?}", ratios[ratios.len() / 2]);
    }
}
