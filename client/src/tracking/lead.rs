//! How far ahead visibility is asked about, so that the answer is there when it is needed.
//!
//! DESIGN §3.3 and §5: a question takes a round trip and a frame. Who asks only about what could be seen *now* shows it that
//! much late. With a **lead** a tracker asks what could be seen until then: from every eye that it can reach
//! ([`eyeline_visibility::EyeRegion`], a ball), of bounds as large as they will be. Growing the bounds alone is not that: a step at a
//! door frame uncovers a room.

use std::time::Duration;

use eyeline_protocol::MotionBound;

/// How a tracker chooses its lead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lead {
    /// None: what comes into view is shown a round trip and a frame late.
    #[default]
    None,
    /// As long as a question takes on this path: its greatest round trip lately, its jitter, and a frame.
    Auto,
    /// So long, whatever the path is like.
    Fixed(Duration),
}

impl std::str::FromStr for Lead {
    type Err = String;

    fn from_str(text: &str) -> Result<Lead, String> {
        match text {
            "none" => Ok(Lead::None),
            "auto" => Ok(Lead::Auto),
            millis => {
                let number = millis.strip_suffix("ms").unwrap_or(millis).trim().parse::<f64>().ok();
                let legal = number.filter(|number| (0.0..=1000.0 * LEAD_MAX.as_secs_f64()).contains(number));
                let legal = legal.ok_or_else(|| format!("'{text}' is not none, auto or 0 to 2000 milliseconds"))?;
                Ok(Lead::Fixed(Duration::from_secs_f64(legal * 1e-3)))
            }
        }
    }
}

impl std::fmt::Display for Lead {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Lead::None => f.write_str("none"),
            Lead::Auto => f.write_str("auto"),
            Lead::Fixed(lead) => write!(f, "{}ms", lead.as_secs_f64() * 1e3),
        }
    }
}

/// A lead is at most so long: beyond it the eye may be anywhere, and all would be asked for.
pub const LEAD_MAX: Duration = Duration::from_secs(2);

/// What a frame must look ahead for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ahead {
    /// For how long what is hidden must stay so.
    pub time: Duration,
    /// How far the eye can get in that time, metres: the radius of its region.
    pub eye_radius: f64,
    /// How far the head can turn in that time, radians, if only what lies before it counts; `None` looks all round.
    pub turn: Option<f64>,
}

impl Lead {
    /// The lead of a frame, for who moves as `motion` says. `round_trip` is the path's greatest lately with its jitter, if known.
    pub fn ahead(self, round_trip: Option<Duration>, frame: Duration, motion: MotionBound) -> Ahead {
        let time = match self {
            Lead::None => Duration::ZERO,
            Lead::Auto => round_trip.map_or(Duration::ZERO, |round_trip| round_trip + frame),
            Lead::Fixed(lead) => lead,
        };
        let time = time.min(LEAD_MAX);
        // The slack is for how late poses are told. Where it is itself, a client knows.
        Ahead { time, eye_radius: motion.speed_max * time.as_secs_f64(), turn: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALK: MotionBound = MotionBound { speed_max: 2.0, slack: 0.12 };
    const FRAME: Duration = Duration::from_millis(50);

    #[test]
    fn auto_is_a_round_trip_and_a_frame() {
        let ahead = Lead::Auto.ahead(Some(Duration::from_millis(70)), FRAME, WALK);
        assert_eq!(ahead.time, Duration::from_millis(120));
        assert!((ahead.eye_radius - 0.24).abs() < 1e-12);
        assert_eq!(Lead::Auto.ahead(None, FRAME, WALK), Ahead::default());
        assert_eq!(Lead::None.ahead(Some(FRAME), FRAME, WALK), Ahead::default());
        assert_eq!(Lead::Auto.ahead(Some(Duration::from_secs(60)), FRAME, WALK).time, LEAD_MAX);
    }

    #[test]
    fn leads_are_read_and_shown() {
        for (text, lead) in [
            ("none", Lead::None),
            ("auto", Lead::Auto),
            ("120ms", Lead::Fixed(Duration::from_millis(120))),
            ("80", Lead::Fixed(Duration::from_millis(80))),
        ] {
            assert_eq!(text.parse(), Ok(lead));
            assert_eq!(lead.to_string().parse(), Ok(lead));
        }
        for bad in ["", "-1", "nan", "1e9", "soon"] {
            assert!(bad.parse::<Lead>().is_err(), "{bad}");
        }
    }
}
