//! What does a server leave out, and why? The server's lines of a plan (DESIGN.md §8).
//!
//! Most of it follows by itself: a state is told only of what moves and is seen, a swept volume is made only of what has a
//! path or stands. The lines say so with what was counted. What serves that clients share bounds is two sets of bits an
//! object: for a single client they are a word each, and no message is made for sharing alone, so nothing is left out there.

use eyeline_protocol::{Plan, PlanLine, PlanSwitch, Stage};

use crate::world::World;

/// The plan of a world as it is now.
pub fn plan(world: &World) -> Plan {
    let census = world.plan_counts();
    let auto = PlanSwitch::AUTO;
    let PlanCounts { objects, on_paths, at_rest, avatars, clients, sharing_bytes, states } = census;
    let bounded = on_paths + at_rest;
    let swept = match world.sweeps() {
        true => auto,
        false => auto.with(Stage::Swept, false),
    };
    let others = (objects + avatars).saturating_sub(usize::from(clients <= 1 && avatars <= 1) * avatars);
    Plan {
        lines: vec![
            PlanLine::new(
                swept,
                Stage::Swept,
                bounded > 0,
                format!("{on_paths} objects follow a preset path, {at_rest} are moved by nobody"),
                "an object gets a path, or is let stand",
            ),
            PlanLine::new(
                auto,
                Stage::States,
                others > 0,
                format!("{objects} objects and {avatars} avatars, {clients} clients; {states} states told so far"),
                "there is something to see besides one's own avatar",
            ),
            PlanLine::new(
                auto,
                Stage::Sharing,
                objects + avatars > 0,
                format!("{clients} clients: who holds what takes {sharing_bytes} bytes, and no message"),
                "there is nothing to hold a bound of",
            ),
        ],
    }
}

/// What is counted for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanCounts {
    /// Objects of the model.
    pub objects: usize,
    /// Of these, those that follow a preset path exactly.
    pub on_paths: usize,
    /// Of these, those that nobody moves.
    pub at_rest: usize,
    /// Avatars in the world, or waiting to enter it.
    pub avatars: usize,
    /// Connections.
    pub clients: usize,
    /// Bytes of the sets that say who may hold a bound.
    pub sharing_bytes: usize,
    /// States told since the start.
    pub states: u64,
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use eyeline_protocol::codec::encode_control;
    use eyeline_protocol::{ClientControl, Interest, Role, VERSION, WorldInfo, WorldTime};
    use glam::DVec3;

    use super::*;
    use crate::policy::Visible;
    use crate::spec::WorldSpec;
    use crate::world::{Transmit, WorldConfig};

    fn world() -> World {
        let info = WorldInfo { name: "still".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let config = WorldConfig::default();
        World::new(config, WorldSpec::default(), info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO).unwrap()
    }

    #[test]
    fn a_world_in_which_nothing_moves_tells_no_states_and_says_so() {
        let mut world = world();
        let verdicts = |world: &World| plan(world).lines.iter().map(PlanLine::verdict).collect::<Vec<_>>();
        assert_eq!(verdicts(&world), ["left out", "left out", "left out"]);
        let join = |world: &mut World| {
            let id = world.connect(world.committed_at());
            let hello = ClientControl::Hello {
                version: VERSION,
                token: Vec::new(),
                resolution: (320, 240),
                interest: Interest::Around,
                role: Role::Avatar,
                name: String::new(),
                resume: None,
            };
            world.handle_control(id, &encode_control(&hello)[4..], world.committed_at());
        };
        join(&mut world);
        let mut datagrams = 0;
        for _ in 0..100 {
            let now = world.committed_at() + Duration::from_millis(50);
            world.tick(now);
            while let Some((_, transmit)) = world.poll_transmit(now) {
                datagrams += usize::from(matches!(transmit, Transmit::Datagram(_)));
            }
        }
        assert_eq!(datagrams, 0);
        assert_eq!(world.stats().out.pushed() + world.stats().out.hidden_caused(), 0);
        assert!(!plan(&world).runs(Stage::States), "{}", plan(&world));
        // Somebody else is something to see.
        join(&mut world);
        assert!(plan(&world).runs(Stage::States) && plan(&world).runs(Stage::Sharing), "{}", plan(&world));
    }
}
