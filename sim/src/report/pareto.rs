//! Which rows are worth having? Those that no other row beats in everything at once.

use serde::{Deserialize, Serialize};

use super::Row;

/// Which way a column is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goal {
    /// Less is better.
    Minimise,
    /// More is better.
    Maximise,
}

/// How a row stands among the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// No other row is at least as good in every column and better in one.
    Front,
    /// This row of the front is.
    DominatedBy(usize),
    /// The row lacks a number in one of the columns, and takes no part.
    Incomparable,
}

/// Where each row stands by the given columns. Rows with equal values stand together.
pub fn pareto(rows: &[Row], keys: &[(&str, Goal)]) -> Vec<Standing> {
    let costs: Vec<Option<Vec<f64>>> = rows.iter().map(|row| costs(row, keys)).collect();
    let dominates = |a: usize, b: usize| match (&costs[a], &costs[b]) {
        (Some(a), Some(b)) => a.iter().zip(b).all(|(a, b)| a <= b) && a != b,
        _ => false,
    };
    let front: Vec<usize> =
        (0..rows.len()).filter(|&b| costs[b].is_some() && !(0..rows.len()).any(|a| dominates(a, b))).collect();
    (0..rows.len())
        .map(|b| match front.iter().find(|&&a| dominates(a, b)) {
            _ if costs[b].is_none() => Standing::Incomparable,
            Some(&a) => Standing::DominatedBy(a),
            None => Standing::Front,
        })
        .collect()
}

fn costs(row: &Row, keys: &[(&str, Goal)]) -> Option<Vec<f64>> {
    keys.iter()
        .map(|(key, goal)| {
            let number = row.number(key)?;
            Some(if *goal == Goal::Minimise { number } else { -number })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn rows(values: &[(f64, f64)]) -> Vec<Row> {
        values.iter().map(|(ms, error)| Row::of(&json!({ "ms": ms, "error": error })).unwrap()).collect()
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let rows = rows(&[(1.0, 9.0), (2.0, 3.0), (3.0, 3.0), (2.0, 3.0), (f64::NAN, 0.0), (9.0, 0.0)]);
        use Standing::*;
        assert_eq!(
            pareto(&rows, &[("ms", Goal::Minimise), ("error", Goal::Minimise)]),
            [Front, Front, DominatedBy(1), Front, Incomparable, Front]
        );
        assert_eq!(pareto(&rows[..2], &[("ms", Goal::Minimise), ("error", Goal::Maximise)]), [Front, DominatedBy(0)]);
        assert_eq!(pareto(&rows[..1], &[("no such column", Goal::Minimise)]), [Incomparable]);
        assert!(pareto(&[], &[("ms", Goal::Minimise)]).is_empty());
    }

    #[test]
    fn who_dominates_is_itself_on_the_front() {
        let rows = rows(&[(3.0, 3.0), (2.0, 2.0), (1.0, 1.0)]);
        let standing = pareto(&rows, &[("ms", Goal::Minimise), ("error", Goal::Minimise)]);
        assert_eq!(standing, [Standing::DominatedBy(2), Standing::DominatedBy(2), Standing::Front]);
    }
}
