//! What does a server leave out, and why? The server's lines of a plan (DESIGN.md §8), revised while it runs.
//!
//! Two things are really left out. While there is nothing to see besides one's own avatar nobody is looked at for
//! states that are due. And the index of policies that have one is not filled while fewer than [`SHARED_BY`] look: who
//! looks alone has every object looked at instead, and is told the same. What is about bounds follows by itself, since
//! a swept volume is made only of what has a path or stands.
//!
//! Where more is counted than before, the plan follows at once: somebody may wait for it. Where it is less, only after
//! [`LASTS`], so that who comes and goes turns nothing to and fro.

use std::time::Duration;

use eyeline_protocol::{Plan, PlanLine, PlanSwitch, Stage, WorldTime, how_many};

use crate::world::World;

/// With so many watchers an index is filled for all of them.
pub const SHARED_BY: usize = 2;

/// For how long there must be less of something before the plan does without what it was for.
pub const LASTS: Duration = Duration::from_secs(5);

/// Objects are looked at for what moves them once in this time: each of them, which is a share of a tick's own work.
const RECOUNT: Duration = Duration::from_secs(1);

/// The plan of a world: what is done now, and what is counted now.
pub fn plan(world: &World) -> Plan {
    Plan { lines: lines(world, &Stage::ALL) }
}

/// The lines about these stages, of those that are a server's.
pub(crate) fn lines(world: &World, stages: &[Stage]) -> Vec<PlanLine> {
    let counts = world.plan_counts();
    let (switch, running) = (world.plan_switch(), world.running());
    let PlanCounts { objects, on_paths, at_rest, avatars, clients, watching, sharing_bytes, states } = counts;
    let swept = if world.sweeps() { switch } else { switch.with(Stage::Swept, false) };
    let sharing = match world.index_of() {
        (policy, true) => {
            let watchers = how_many(watching, "watcher");
            format!("The policy {policy} has an index over all that is in the world, which is there for {watchers}.")
        }
        (policy, false) => format!(
            "The policy {policy} has no index to share; who may hold which bound takes {}.",
            how_many(sharing_bytes, "byte")
        ),
    };
    let lines = [
        PlanLine::new(
            swept,
            Stage::Swept,
            running.bounds(),
            format!("A preset path moves {on_paths} of {}, and nobody moves {at_rest}.", how_many(objects, "object")),
            "It runs while there is one of either.",
        ),
        PlanLine::new(
            running.at_least(switch, Stage::States),
            Stage::States,
            running.tells(),
            format!(
                "The world has {} and {} for {} to hear of, and {} been told so far.",
                how_many(objects, "object"),
                how_many(avatars, "avatar"),
                how_many(clients, "client"),
                if states == 1 { "1 state has".to_owned() } else { format!("{states} states have") },
            ),
            format!(
                "It runs while there is something besides one's own avatar, and stops {} s after.",
                LASTS.as_secs()
            ),
        ),
        PlanLine::new(
            switch,
            Stage::Sharing,
            running.shares() && world.index_of().1,
            sharing,
            format!(
                "It runs while {SHARED_BY} or more look under grid, radius or pvs, and stops {} s after.",
                LASTS.as_secs()
            ),
        ),
    ];
    lines.into_iter().filter(|line| stages.contains(&line.stage)).collect()
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
    /// Of these, those that were let in and look at the world.
    pub watching: usize,
    /// Bytes of the sets that say who may hold a bound.
    pub sharing_bytes: usize,
    /// States told since the start.
    pub states: u64,
}

/// Something counted that is believed at once where it is more than before, and only after a while where it is less.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    held: usize,
    less_since: Option<WorldTime>,
}

impl Level {
    /// One more count; whether another number holds from now on.
    fn count(&mut self, counted: usize, now: WorldTime) -> bool {
        let before = self.held;
        if counted >= self.held || now.since(*self.less_since.get_or_insert(now)) >= LASTS {
            (self.held, self.less_since) = (counted, None);
        }
        self.held != before
    }
}

/// What a world does now, by what was counted while it ran.
#[derive(Debug, Default)]
pub(crate) struct Running {
    /// How many look, as far as that matters: up to [`SHARED_BY`].
    watchers: Level,
    /// Whether there is something to see besides one's own avatar.
    others: Level,
    /// Whether there are objects on preset paths, and objects that nobody moves.
    on_paths: Level,
    at_rest: Level,
    recounted_at: Option<WorldTime>,
    /// Stages whose lines are others than at the last look.
    revised: Vec<Stage>,
}

impl Running {
    /// Whether objects are to be counted again.
    pub fn is_recount_due(&self, now: WorldTime) -> bool {
        self.recounted_at.is_none_or(|at| now.since(at) >= RECOUNT)
    }

    /// Counts what moves objects.
    pub fn recount(&mut self, counts: &PlanCounts, now: WorldTime) {
        self.recounted_at = Some(now);
        // Both, always.
        let paths = self.on_paths.count(counts.on_paths.min(1), now);
        if self.at_rest.count(counts.at_rest.min(1), now) || paths {
            self.revise(Stage::Swept);
        }
    }

    /// Counts who looks, and whether there is something to see for any of them.
    pub fn count(&mut self, watching: usize, has_others: bool, now: WorldTime) {
        let watchers = self.watchers.count(watching.min(SHARED_BY), now);
        if self.others.count(usize::from(has_others), now) || watchers {
            self.revise(Stage::States);
        }
        if watchers {
            self.revise(Stage::Sharing);
        }
    }

    fn revise(&mut self, stage: Stage) {
        if !self.revised.contains(&stage) {
            self.revised.push(stage);
        }
    }

    /// Stages whose lines have changed since the last call.
    pub fn take_revised(&mut self) -> Vec<Stage> {
        std::mem::take(&mut self.revised)
    }

    /// Whether there may be anything to tell anybody.
    pub fn tells(&self) -> bool {
        self.others.held > 0
    }

    /// Whether several look.
    pub fn shares(&self) -> bool {
        self.watchers.held >= SHARED_BY
    }

    /// Whether paths or rest make bounds.
    pub fn bounds(&self) -> bool {
        self.on_paths.held + self.at_rest.held > 0
    }

    /// The switch, without what must not be left out.
    pub fn at_least(&self, switch: PlanSwitch, stage: Stage) -> PlanSwitch {
        if switch.asked(stage) == Some(false) { PlanSwitch::AUTO } else { switch }
    }
}

#[cfg(test)]
mod tests;
