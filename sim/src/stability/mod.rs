//! Where can numbers go wrong, and do they? Every case of DESIGN §9 against an oracle.
//!
//! A case asks one thing, measures one error and states one bound. What it is compared with is said per case
//! ([`Oracle`]): exact arithmetic, an analytic solution, or a slow reference in f64. A case that must be refused is one
//! too: it passes if the refusal names what is wrong. Nothing here is allowed to panic, and a panic is a failed case.
//!
//! [`stiff`] has springs, [`geometry`] scenes and views, [`bounds`] time, motion and the wire. [`integrators`] holds the
//! production integrator beside the textbook's, error against run time; those rows judge nothing.

pub mod bounds;
pub mod geometry;
pub mod integrators;
pub mod report;
pub mod scenes;
pub mod stiff;

use std::panic::{AssertUnwindSafe, catch_unwind};

use serde::Serialize;

/// What an answer is held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Oracle {
    /// Integers, or a comparison that must agree bit for bit.
    Exact,
    /// The solution as a formula.
    Analytic,
    /// f64 and much more work: rays, steps of a hundredth, every eye asked.
    Reference,
    /// The only right answer is a refusal that says why.
    Refusal,
}

/// What a case found.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// How wrong the answer is, in the case's own unit.
    pub error: f64,
    /// How wrong it may be.
    pub bound: f64,
    /// What a reader should know: counts, a refusal's words.
    pub said: String,
}

impl Finding {
    /// An error and how large it may be.
    pub fn new(error: f64, bound: f64, said: impl Into<String>) -> Finding {
        Finding { error, bound, said: said.into() }
    }

    /// A thing that was refused, or should have been: the error is 0 if the refusal has all of `words`.
    pub fn refusal<T, E: std::fmt::Display>(answer: Result<T, E>, words: &[&str]) -> Finding {
        match answer {
            Ok(_) => Finding::new(1.0, 0.0, "was not refused"),
            Err(error) => {
                let said = error.to_string();
                let missing = words.iter().filter(|word| !said.contains(**word)).count();
                Finding::new(missing as f64, 0.0, said)
            }
        }
    }
}

/// One thing that could go wrong.
pub struct Case {
    /// `geometry`, `simd`, `region`, `file`, `bounds`, `clock`, `wire`, `stiff`.
    pub group: &'static str,
    /// Its name, unique in its group.
    pub name: String,
    /// What is measured, with its unit.
    pub asked: &'static str,
    /// What it is held against.
    pub oracle: Oracle,
    run: Box<dyn Fn() -> Finding>,
}

impl Case {
    /// A case.
    pub fn new(
        group: &'static str,
        name: impl Into<String>,
        asked: &'static str,
        oracle: Oracle,
        run: impl Fn() -> Finding + 'static,
    ) -> Case {
        Case { group, name: name.into(), asked, oracle, run: Box::new(run) }
    }

    /// Runs it. A panic is an answer too, and the wrong one.
    pub fn find(&self) -> Finding {
        catch_unwind(AssertUnwindSafe(&self.run)).unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Finding::new(f64::INFINITY, 0.0, format!("panicked: {}", text.unwrap_or_default()))
        })
    }
}

/// A case and what came of it, as a row of the report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseRow {
    /// See [`Case::group`].
    pub group: &'static str,
    /// See [`Case::name`].
    pub case: String,
    /// See [`Case::asked`].
    pub asked: &'static str,
    /// See [`Case::oracle`].
    pub oracle: Oracle,
    /// See [`Finding::error`].
    pub error: f64,
    /// See [`Finding::bound`].
    pub bound: f64,
    /// How long it took, oracle included.
    pub run_ms: f64,
    /// Whether error ≤ bound; an error that is NaN is too large.
    pub ok: bool,
    /// See [`Finding::said`].
    pub said: String,
}

impl CaseRow {
    /// The verdict.
    pub fn new(case: &Case, finding: Finding, run_ms: f64) -> CaseRow {
        let Finding { error, bound, said } = finding;
        CaseRow {
            group: case.group,
            case: case.name.clone(),
            asked: case.asked,
            oracle: case.oracle,
            error,
            bound,
            run_ms,
            ok: error <= bound,
            said,
        }
    }
}

/// All cases, in the order of the report.
pub fn cases() -> Vec<Case> {
    let mut cases = geometry::cases();
    cases.extend(bounds::cases());
    cases.extend(stiff::cases());
    cases
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_there_are_enough() {
        let cases = cases();
        let names: std::collections::BTreeSet<_> = cases.iter().map(|case| (case.group, &case.name)).collect();
        assert_eq!(names.len(), cases.len());
        assert!(cases.len() >= 60, "{}", cases.len());
    }

    #[test]
    fn every_case_is_within_its_bound() {
        let failed: Vec<String> = cases()
            .iter()
            .map(|case| CaseRow::new(case, case.find(), 0.0))
            .filter(|row| !row.ok)
            .map(|row| format!("{} {}: {} of {}; {}", row.group, row.case, row.error, row.bound, row.said))
            .collect();
        assert!(failed.is_empty(), "{}", failed.join("\n"));
    }

    #[test]
    fn a_panic_a_nan_and_a_silent_acceptance_fail() {
        let verdict = |run: fn() -> Finding| {
            let case = Case::new("test", "it", "nothing", Oracle::Exact, run);
            CaseRow::new(&case, case.find(), 0.0)
        };
        assert!(!verdict(|| panic!("on purpose")).ok);
        assert!(!verdict(|| Finding::new(f64::NAN, 1.0, "")).ok);
        assert!(!verdict(|| Finding::refusal::<(), String>(Ok(()), &[])).ok);
        assert!(!verdict(|| Finding::refusal::<(), _>(Err("no"), &["why"])).ok);
        assert!(verdict(|| Finding::refusal::<(), _>(Err("no, because"), &["because"])).ok);
    }
}
