//! How much may a culler draw? A number of triangles, or a share of the scene's: `5000` or `10%`.

use std::str::FromStr;

/// A budget as it was given. Rows and reports keep the text.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct AskedBudget {
    /// Legal: [`AskedBudget::from_str`] made it.
    text: String,
}

/// Why a text is no budget.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no budget: give a number of triangles, as 5000, or a share of the scene's from 0 to 100, as 2.5%")]
pub struct BudgetError(String);

impl AskedBudget {
    /// The text given.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Triangles of a scene of `total`, rounded down.
    pub fn triangles(&self, total: usize) -> usize {
        match self.text.strip_suffix('%') {
            Some(percent) => (percent.parse::<f64>().unwrap_or(0.0) * total as f64 / 100.0) as usize,
            None => self.text.parse().unwrap_or(0),
        }
    }
}

impl From<usize> for AskedBudget {
    fn from(triangles: usize) -> AskedBudget {
        AskedBudget { text: triangles.to_string() }
    }
}

impl FromStr for AskedBudget {
    type Err = BudgetError;

    fn from_str(text: &str) -> Result<AskedBudget, BudgetError> {
        let is_legal = match text.strip_suffix('%') {
            // `parse` takes infinities and NaN too; those are in no range.
            Some(percent) => percent.parse::<f64>().is_ok_and(|percent| (0.0..=100.0).contains(&percent)),
            None => text.parse::<usize>().is_ok(),
        };
        if is_legal { Ok(AskedBudget { text: text.to_owned() }) } else { Err(BudgetError(text.to_owned())) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_counts_or_shares() {
        let triangles = |text: &str| text.parse::<AskedBudget>().map(|budget| budget.triangles(1_234));
        assert_eq!(triangles("70"), Ok(70));
        assert_eq!(triangles("10%"), Ok(123));
        assert_eq!(triangles("0.5%"), Ok(6));
        assert_eq!(triangles("100%"), Ok(1_234));
        for bad in ["", "%", "-1", "-1%", "101%", "NaN%", "inf%", "5 %", "ten", "1.5"] {
            assert_eq!(triangles(bad), Err(BudgetError(bad.to_owned())));
        }
        assert_eq!(AskedBudget::from(9).text(), "9");
    }
}
