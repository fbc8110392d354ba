//! What runs, what is left out, and why: the words of a plan, which server, client and simulator share (DESIGN.md §8).
//!
//! A plan is a table of *stages*. Who decides about a stage says whether it runs, what was counted, and what would change it.
//! A [`PlanSwitch`] is what a person asks for instead: every stage as counted, every stage on, or single ones on or off.

use std::fmt;
use std::str::FromStr;

/// A part of the work that a scene may not need. Its name is that of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// What is out of view is not drawn.
    Frustum,
    /// What is hidden in view is not drawn.
    Occlusion,
    /// Cells are prisms over a floor plan instead of boxes.
    Prisms,
    /// Beliefs about what moves, and questions about it.
    Tracker,
    /// An eye that stands still is culled for again in each frame.
    LookAgain,
    /// A still eye's bounds are held to the exact moment at which they come into view; what never does is never looked at.
    Exact,
    /// What walls seal off from wherever the eye can go is left alone.
    Sealed,
    /// Bounds that come from preset paths and from rest.
    Swept,
    /// An index over all that moves, filled at each tick, that all who look share.
    Sharing,
    /// States of what moves.
    States,
}

impl Stage {
    /// All of them, in the order of plans.
    pub const ALL: [Stage; 10] = [
        Stage::Frustum,
        Stage::Occlusion,
        Stage::Prisms,
        Stage::Tracker,
        Stage::LookAgain,
        Stage::Exact,
        Stage::Sealed,
        Stage::Swept,
        Stage::Sharing,
        Stage::States,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Frustum => "frustum",
            Stage::Occlusion => "occlusion",
            Stage::Prisms => "prisms",
            Stage::Tracker => "tracker",
            Stage::LookAgain => "look-again",
            Stage::Exact => "exact",
            Stage::Sealed => "sealed",
            Stage::Swept => "swept",
            Stage::Sharing => "sharing",
            Stage::States => "states",
        }
    }

    /// Whether a person may switch it. What states are told follows from the world: there is nothing to leave out that
    /// would not be missed.
    pub const fn can_switch(self) -> bool {
        !matches!(self, Stage::States)
    }

    const fn bit(self) -> u16 {
        1 << self as u16
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// What a person asks of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanSwitch {
    on: u16,
    off: u16,
}

impl PlanSwitch {
    /// Each stage as counted.
    pub const AUTO: PlanSwitch = PlanSwitch { on: 0, off: 0 };

    /// Every stage on that makes the work complete, whether the scene needs it or not. Prisms stand in for other cells, so
    /// they are not among them.
    pub fn full() -> PlanSwitch {
        let all = Stage::ALL.into_iter().filter(|&stage| stage != Stage::Prisms && stage.can_switch());
        all.fold(PlanSwitch::AUTO, |switch, stage| switch.with(stage, true))
    }

    /// With one stage forced.
    pub const fn with(self, stage: Stage, runs: bool) -> PlanSwitch {
        let (on, off) = (self.on & !stage.bit(), self.off & !stage.bit());
        if runs { PlanSwitch { on: on | stage.bit(), off } } else { PlanSwitch { on, off: off | stage.bit() } }
    }

    /// What was asked of a stage; `None` if it is to be as counted.
    pub const fn asked(&self, stage: Stage) -> Option<bool> {
        match (self.on & stage.bit() != 0, self.off & stage.bit() != 0) {
            (true, _) => Some(true),
            (_, true) => Some(false),
            _ => None,
        }
    }

    /// Whether a stage runs, given what was counted.
    pub fn runs(&self, stage: Stage, counted: bool) -> bool {
        self.asked(stage).unwrap_or(counted)
    }
}

/// Why a text is no [`PlanSwitch`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no plan: give auto, full, or stages as in occlusion=off,tracker=on; stages: {stages}")]
pub struct PlanSwitchError {
    text: String,
    stages: String,
}

impl FromStr for PlanSwitch {
    type Err = PlanSwitchError;

    /// `auto`, `full`, or `STAGE=on` and `STAGE=off` with commas between; the first may be followed by the others.
    fn from_str(text: &str) -> Result<PlanSwitch, PlanSwitchError> {
        let stages = || Stage::ALL.into_iter().filter(|stage| stage.can_switch());
        let wrong = || PlanSwitchError {
            text: text.to_owned(),
            stages: stages().map(Stage::name).collect::<Vec<_>>().join(", "),
        };
        let mut switch = PlanSwitch::AUTO;
        for (number, part) in text.split(',').map(str::trim).enumerate() {
            switch = match (part, part.split_once('=')) {
                ("auto", _) if number == 0 => switch,
                ("full", _) if number == 0 => PlanSwitch::full(),
                (_, Some((name, value))) => {
                    let stage = stages().find(|stage| stage.name() == name.trim()).ok_or_else(wrong)?;
                    match value.trim() {
                        "on" => switch.with(stage, true),
                        "off" => switch.with(stage, false),
                        _ => return Err(wrong()),
                    }
                }
                _ => return Err(wrong()),
            };
        }
        Ok(switch)
    }
}

impl fmt::Display for PlanSwitch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == PlanSwitch::AUTO {
            return f.write_str("auto");
        }
        let forced = Stage::ALL.into_iter().filter_map(|stage| Some((stage, self.asked(stage)?)));
        let forced = forced.map(|(stage, runs)| format!("{stage}={}", if runs { "on" } else { "off" }));
        f.write_str(&forced.collect::<Vec<_>>().join(","))
    }
}

/// One line of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanLine {
    /// Which part of the work.
    pub stage: Stage,
    /// Whether it runs.
    pub runs: bool,
    /// Whether a person asked for that, so that nothing counted decides.
    pub is_forced: bool,
    /// What was counted: sentences.
    pub evidence: String,
    /// What would change it: sentences, too.
    pub change: String,
}

impl PlanLine {
    /// A line that runs as `counted` unless `switch` says otherwise.
    pub fn new(
        switch: PlanSwitch,
        stage: Stage,
        counted: bool,
        evidence: impl Into<String>,
        change: impl Into<String>,
    ) -> PlanLine {
        PlanLine {
            stage,
            runs: switch.runs(stage, counted),
            is_forced: switch.asked(stage).is_some(),
            evidence: evidence.into(),
            change: change.into(),
        }
    }

    /// `runs`, `left out`, and whether that was asked for.
    pub fn verdict(&self) -> &'static str {
        match (self.runs, self.is_forced) {
            (true, false) => "runs",
            (false, false) => "left out",
            (true, true) => "forced on",
            (false, true) => "forced off",
        }
    }
}

/// A plan: its [`fmt::Display`] is the table, a line a stage.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// Lines, one a stage.
    pub lines: Vec<PlanLine>,
}

impl Plan {
    /// Whether a stage runs; stages that nobody decided about do.
    pub fn runs(&self, stage: Stage) -> bool {
        self.line(stage).is_none_or(|line| line.runs)
    }

    /// A stage's line.
    pub fn line(&self, stage: Stage) -> Option<&PlanLine> {
        self.lines.iter().find(|line| line.stage == stage)
    }

    /// What runs and what is left out in one line, for logs.
    pub fn short(&self) -> String {
        let of = |runs: bool| {
            let names = self.lines.iter().filter(|line| line.runs == runs).map(|line| line.stage.name());
            let names = names.collect::<Vec<_>>().join(", ");
            if names.is_empty() { "nothing".to_owned() } else { names }
        };
        format!("runs {}; leaves out {}", of(true), of(false))
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for line in &self.lines {
            writeln!(f, "{:<11}{:<11}{} {}", line.stage, line.verdict(), line.evidence, line.change)?;
        }
        Ok(())
    }
}

/// So many of something, for people: `1 object`, `2 objects`. `one` takes an s for more.
pub fn how_many(count: usize, one: &str) -> String {
    format!("{count} {one}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_switch_reads_back_as_it_is_written() {
        for text in ["auto", "occlusion=off", "tracker=on,swept=off"] {
            let switch: PlanSwitch = text.parse().unwrap();
            assert_eq!(switch.to_string().parse(), Ok(switch));
        }
        let full: PlanSwitch = "full,occlusion=off".parse().unwrap();
        assert_eq!(full.asked(Stage::Occlusion), Some(false));
        assert_eq!(full.asked(Stage::Tracker), Some(true));
        assert_eq!(full.asked(Stage::Prisms), None);
        assert_eq!("".parse::<PlanSwitch>().unwrap_err().text, "");
        for text in ["occlusion", "occlusion=maybe", "portals=on", "occlusion=on,full", "states=off", "auto,"] {
            let error = text.parse::<PlanSwitch>().unwrap_err().to_string();
            assert!(error.contains("auto, full") && error.contains("look-again"), "{error}");
        }
    }

    #[test]
    fn what_is_forced_is_not_counted() {
        let line = |text: &str, counted| {
            PlanLine::new(text.parse().unwrap(), Stage::Tracker, counted, "Nothing moves.", "It starts with who comes.")
        };
        assert_eq!(line("auto", false).verdict(), "left out");
        assert_eq!(line("tracker=on", false).verdict(), "forced on");
        assert_eq!(line("tracker=off", true).verdict(), "forced off");
        let plan = Plan { lines: vec![line("auto", false)] };
        assert!(!plan.runs(Stage::Tracker) && plan.runs(Stage::Frustum));
        assert_eq!(plan.short(), "runs nothing; leaves out tracker");
        assert_eq!(plan.to_string(), "tracker    left out   Nothing moves. It starts with who comes.\n");
        assert_eq!((how_many(1, "object"), how_many(0, "object")), ("1 object".into(), "0 objects".into()));
    }
}
