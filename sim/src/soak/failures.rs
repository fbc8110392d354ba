//! What was wrong with a run.

use eyeline_protocol::WorldTime;

/// Things that were wrong: the first few in words, all of them in number.
#[derive(Clone, Debug, Default)]
pub struct Failures {
    /// The first few, in order.
    pub texts: Vec<String>,
    /// How many there were.
    pub count: u64,
}

/// So many are told in words.
const TEXTS_MAX: usize = 8;

impl Failures {
    /// `what` was wrong with `client` at `at`.
    pub fn note(&mut self, client: usize, at: WorldTime, what: impl FnOnce() -> String) {
        self.count += 1;
        if self.texts.len() < TEXTS_MAX {
            self.texts.push(format!("client {client} at {} µs: {}", at.micros(), what()));
        }
    }

    /// Adds those of another checker.
    pub fn extend(&mut self, other: &Failures) {
        self.count += other.count;
        let room = TEXTS_MAX.saturating_sub(self.texts.len());
        self.texts.extend(other.texts.iter().take(room).cloned());
    }

    /// Fails the test if anything was wrong.
    #[track_caller]
    pub fn assert_none(&self, what: &str) {
        assert!(self.count == 0, "{what}: {} promises broken, first:\n{}", self.count, self.texts.join("\n"));
    }
}
