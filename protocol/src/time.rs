//! Two clocks that must never be mixed: the world's, and a process's own.

use std::time::Duration;

use serde::{Deserialize, Serialize};

macro_rules! instant {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        pub struct $name {
            micros: i64,
        }

        impl $name {
            /// The zero of this clock.
            pub const ZERO: $name = $name { micros: 0 };
            /// Later than everything else.
            pub const MAX: $name = $name { micros: i64::MAX };
            /// Earlier than everything else.
            pub const MIN: $name = $name { micros: i64::MIN };

            /// The instant `micros` microseconds after zero.
            pub const fn from_micros(micros: i64) -> $name {
                $name { micros }
            }

            /// Microseconds since zero.
            pub const fn micros(self) -> i64 {
                self.micros
            }

            /// Seconds since zero.
            pub fn seconds(self) -> f64 {
                self.micros as f64 * 1e-6
            }

            /// How long ago `earlier` was; zero if it is not earlier. Saturates.
            pub fn since(self, earlier: $name) -> Duration {
                Duration::from_micros(self.micros.saturating_sub(earlier.micros).max(0) as u64)
            }

            /// Seconds from `earlier` to this instant, negative if this one is earlier.
            pub fn seconds_since(self, earlier: $name) -> f64 {
                self.micros.saturating_sub(earlier.micros) as f64 * 1e-6
            }

            /// This instant moved by a signed number of microseconds. Saturates.
            pub const fn offset_micros(self, micros: i64) -> $name {
                $name { micros: self.micros.saturating_add(micros) }
            }
        }

        impl std::ops::Add<Duration> for $name {
            type Output = $name;
            fn add(self, duration: Duration) -> $name {
                self.offset_micros(i64::try_from(duration.as_micros()).unwrap_or(i64::MAX))
            }
        }

        impl std::ops::Sub<Duration> for $name {
            type Output = $name;
            fn sub(self, duration: Duration) -> $name {
                self.offset_micros(i64::try_from(duration.as_micros()).unwrap_or(i64::MAX).saturating_neg())
            }
        }
    };
}

instant! {
    /// The world's time in microseconds. Never wraps, goes on after a restart.
    WorldTime
}

instant! {
    /// A process's own monotonic time in microseconds since it started. Says nothing to anybody else.
    LocalTime
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates_instead_of_wrapping() {
        assert_eq!(WorldTime::MAX + Duration::from_secs(1), WorldTime::MAX);
        assert_eq!(WorldTime::MIN - Duration::MAX, WorldTime::MIN);
        assert_eq!(WorldTime::ZERO.since(WorldTime::MAX), Duration::ZERO);
        assert_eq!(WorldTime::MAX.since(WorldTime::MIN), Duration::from_micros(i64::MAX as u64));
        assert_eq!(LocalTime::from_micros(1_500_000).seconds(), 1.5);
    }
}
