//! Until when should the next bound of a hidden object hold?
//!
//! Too short a validity period, and the object must be looked at again before long; too long, and its bound is so large
//! that it comes into view. Sudarsky & Gotsman 1999, §3.4, name three ways out: a fixed period; the *exact* one, for an
//! eye that stands still, found by doubling and bisection; and an *adaptive* one, longer after each bound that
//! expired unseen and shorter after each that was exposed while its object was hidden. No message is needed for any of
//! them as long as whoever chooses can make the bounds.
//!
//! The paper does not say how much longer and shorter: here twice and half. It halves the *exact* period for a moving eye, since
//! a bound found in this way is about to be seen; the adaptive one is its answer to moving eyes already, and is not halved.

use std::time::Duration;

/// Who chooses validity periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Always the same.
    Fixed(Duration),
    /// Each object has its own, which follows what became of its bounds.
    Adaptive {
        /// For an object's first bound.
        first: Duration,
        /// The least; it counts if it is above `longest`.
        shortest: Duration,
        /// The greatest.
        longest: Duration,
    },
    /// The longest for which the bound is hidden now, to one frame; half of it for a moving eye.
    Exact {
        /// The greatest.
        longest: Duration,
    },
}

/// How long an object's next bound would hold: what [`Validity::Adaptive`] remembers of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Period {
    length: Duration,
}

impl Period {
    /// The present length.
    pub fn length(&self) -> Duration {
        self.length
    }
}

impl Validity {
    /// The period of an object that nothing is known of yet.
    pub fn first(&self) -> Period {
        let length = match *self {
            Validity::Fixed(length) => length,
            Validity::Adaptive { first, .. } => self.within(first),
            Validity::Exact { longest } => longest,
        };
        Period { length }
    }

    /// A bound expired before it was seen: it could have held for longer. Twice as long, if adaptive.
    pub fn lengthen(&self, period: &mut Period) {
        if let Validity::Adaptive { .. } = self {
            // From nothing too.
            period.length = self.within(period.length.saturating_mul(2).max(SHORTEST));
        }
    }

    /// A bound was seen although its object was hidden: it was too large. Half as long, if adaptive.
    pub fn shorten(&self, period: &mut Period) {
        if let Validity::Adaptive { .. } = self {
            period.length = self.within(period.length / 2);
        }
    }

    /// How long the next bound is to hold. `hidden(d)` says whether the bound for a validity of `d` would be hidden now; only
    /// [`Validity::Exact`] asks, about 2·log₂(longest/`frame`) times, and never answers less than one `frame`.
    pub fn choose(
        &self,
        period: &Period,
        eye_moves: bool,
        frame: Duration,
        hidden: &mut dyn FnMut(Duration) -> bool,
    ) -> Duration {
        let Validity::Exact { longest } = *self else { return period.length };
        let frame = frame.max(SHORTEST);
        let exact = longest_hidden(frame, longest, hidden);
        let chosen = if eye_moves { exact / 2 } else { exact };
        chosen.max(frame)
    }

    fn within(&self, length: Duration) -> Duration {
        match *self {
            Validity::Adaptive { shortest, longest, .. } => length.min(longest).max(shortest),
            Validity::Fixed(_) | Validity::Exact { .. } => length,
        }
    }
}

/// World time counts microseconds.
const SHORTEST: Duration = Duration::from_micros(1);

/// The longest hidden validity up to `longest`, to within `frame`: doubling until the bound is seen, then bisection. One frame
/// if not even that is hidden.
fn longest_hidden(frame: Duration, longest: Duration, hidden: &mut dyn FnMut(Duration) -> bool) -> Duration {
    if longest <= frame || !hidden(frame) {
        return frame;
    }
    let mut unseen = frame;
    let mut seen = loop {
        let next = unseen.saturating_mul(2).min(longest);
        if !hidden(next) {
            break next;
        }
        if next == longest {
            return longest;
        }
        unseen = next;
    };
    while seen - unseen > frame {
        let middle = unseen + (seen - unseen) / 2;
        if hidden(middle) {
            unseen = middle;
        } else {
            seen = middle;
        }
    }
    unseen
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FRAME: Duration = Duration::from_millis(50);

    fn millis(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    #[test]
    fn adaptive_periods_double_and_halve_within_their_limits() {
        let validity = Validity::Adaptive { first: millis(400), shortest: millis(100), longest: millis(1000) };
        let mut period = validity.first();
        let mut no_question = |_: Duration| -> bool { panic!("only Exact asks") };
        assert_eq!(validity.choose(&period, true, FRAME, &mut no_question), millis(400));
        validity.lengthen(&mut period);
        assert_eq!(period.length(), millis(800));
        validity.lengthen(&mut period);
        assert_eq!(period.length(), millis(1000));
        for expected in [500, 250, 125, 100, 100] {
            validity.shorten(&mut period);
            assert_eq!(period.length(), millis(expected));
        }
    }

    #[test]
    fn only_adaptive_periods_change() {
        for validity in [Validity::Fixed(millis(300)), Validity::Exact { longest: millis(300) }] {
            let mut period = validity.first();
            validity.lengthen(&mut period);
            validity.shorten(&mut period);
            validity.shorten(&mut period);
            assert_eq!(period, validity.first());
        }
        let fixed = Validity::Fixed(Duration::ZERO);
        assert_eq!(fixed.choose(&fixed.first(), false, FRAME, &mut |_| true), Duration::ZERO);
    }

    #[test]
    fn odd_limits_are_defined() {
        let crossed = Validity::Adaptive { first: millis(5), shortest: millis(9), longest: millis(3) };
        let mut period = crossed.first();
        assert_eq!(period.length(), millis(9));
        crossed.lengthen(&mut period);
        assert_eq!(period.length(), millis(9));
        let from_nothing =
            Validity::Adaptive { first: Duration::ZERO, shortest: Duration::ZERO, longest: Duration::MAX };
        let mut period = from_nothing.first();
        from_nothing.lengthen(&mut period);
        assert!(period.length() > Duration::ZERO);
        for _ in 0..200 {
            from_nothing.lengthen(&mut period);
        }
        assert_eq!(period.length(), Duration::MAX);
        let exact = Validity::Exact { longest: Duration::MAX };
        assert_eq!(exact.choose(&exact.first(), false, Duration::ZERO, &mut |_| true), Duration::MAX);
        assert_eq!(exact.choose(&exact.first(), false, Duration::ZERO, &mut |_| false), SHORTEST);
    }

    proptest! {
        #[test]
        fn the_exact_period_is_the_longest_hidden_one_to_a_frame(end in 0u64..200_000, longest in 0u64..100_000, moves: bool) {
            let (end, longest) = (millis(end), millis(longest));
            let mut questions = 0;
            let validity = Validity::Exact { longest };
            let chosen = validity.choose(&validity.first(), moves, FRAME, &mut |validity| {
                questions += 1;
                validity <= end
            });
            let exact = end.min(longest);
            prop_assert!(chosen >= FRAME);
            let whole = if moves { chosen * 2 } else { chosen };
            if chosen > FRAME {
                prop_assert!(whole <= exact, "{chosen:?} is seen");
            }
            prop_assert!(whole + FRAME + millis(1) >= exact, "{chosen:?} could be longer: {exact:?}");
            let doublings = (longest.as_secs_f64() / FRAME.as_secs_f64()).max(1.0).log2();
            prop_assert!(f64::from(questions) <= 2.0 * doublings + 3.0, "{questions} questions");
        }
    }
}
