//! How far is it? A bar in a terminal, and now and then a plain line in a log.

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Shows on standard error how much of some work is done. Can be shared among threads.
pub struct Progress {
    what: String,
    shown: Shown,
    started: Instant,
}

enum Shown {
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
}

impl Progress {
    /// Begins `total` steps of `what` ("measuring visible").
    pub fn new(total: u64, what: &str) -> Self {
        let started = now();
        let shown = if std::io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}  {elapsed}, {eta} left");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.set_message(what.to_owned());
            Shown::Bar(bar)
        } else {
            Shown::Lines(Mutex::new(Lines { done: 0, total, last: Duration::ZERO }))
        };
        Self { what: what.to_owned(), shown, started }
    }

    /// Counts `steps` more as done.
    pub fn inc(&self, steps: u64) {
        match &self.shown {
            Shown::Bar(bar) => bar.inc(steps),
            Shown::Lines(lines) => {
                let elapsed = now() - self.started;
                let line = lines.lock().unwrap_or_else(PoisonError::into_inner).advance(steps, elapsed);
                if let Some(line) = line {
                    eprintln!("{}: {line}", self.what);
                }
            }
        }
    }

    /// Ends the bar and leaves one line that says how long it took.
    pub fn finish(self) {
        let elapsed = (now() - self.started).as_secs_f64();
        let done = match &self.shown {
            Shown::Bar(bar) => {
                bar.finish_and_clear();
                bar.position()
            }
            Shown::Lines(lines) => lines.lock().unwrap_or_else(PoisonError::into_inner).done,
        };
        eprintln!("{}: {done} in {elapsed:.1} s", self.what);
    }
}

#[expect(clippy::disallowed_methods, reason = "a progress display is a driver: it shows time and decides nothing")]
fn now() -> Instant {
    Instant::now()
}

/// Decides when a log deserves another line.
struct Lines {
    done: u64,
    total: u64,
    last: Duration,
}

/// A log is read afterwards: seldom enough not to fill it, often enough to see that the work goes on.
const LINE_EVERY: Duration = Duration::from_secs(5);

impl Lines {
    fn advance(&mut self, steps: u64, elapsed: Duration) -> Option<String> {
        self.done = self.done.saturating_add(steps);
        if elapsed < self.last + LINE_EVERY || self.done >= self.total {
            return None;
        }
        self.last = elapsed;
        let (done, total, seconds) = (self.done, self.total, elapsed.as_secs_f64());
        let share = done as f64 / total as f64;
        let left = if done == 0 { String::new() } else { format!(", about {:.0} s left", seconds / share - seconds) };
        Some(format!("{done}/{total} ({:.0} %) after {seconds:.0} s{left}", share * 100.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_gets_a_line_at_most_every_five_seconds() {
        let mut lines = Lines { done: 0, total: 100, last: Duration::ZERO };
        let written: Vec<String> =
            (1..=100).filter_map(|step| lines.advance(1, Duration::from_millis(step * 200))).collect();
        assert_eq!(written.len(), 3);
        assert_eq!(written[0], "25/100 (25 %) after 5 s, about 15 s left");
    }

    #[test]
    fn no_steps_and_too_many_are_harmless() {
        let mut lines = Lines { done: 0, total: 0, last: Duration::ZERO };
        assert_eq!(lines.advance(u64::MAX, Duration::from_secs(60)), None);
        assert_eq!(lines.advance(1, Duration::from_secs(120)), None);
        let mut lines = Lines { done: 0, total: 5, last: Duration::ZERO };
        assert_eq!(lines.advance(0, Duration::from_secs(6)).as_deref(), Some("0/5 (0 %) after 6 s"));
    }
}
