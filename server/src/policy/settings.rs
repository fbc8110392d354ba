//! What the policies are told besides their name, and how one is made from both.

use std::ops::RangeInclusive;
use std::sync::Arc;

use eyeline_protocol::WorldInfo;

use super::table::{PvsError, PvsTable};
use super::{Broadcast, Grid, Policy, Pvs, Radius, Visible};

/// Settings of every policy; each reads its own.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PolicySettings {
    /// `radius`: how far an object may be from the eye to be told of, metres. Default 30; more costs messages.
    pub radius: f64,
    /// `radius`: how much farther what is told of may go, as a share of the radius. Default 0.1.
    pub hysteresis: f64,
    /// `grid`: side of a square, metres. Default 30; more costs messages.
    pub cell: f64,
    /// `pvs`: its table. Default none, and then there is no such policy.
    pub pvs: Option<Arc<PvsTable>>,
}

impl Default for PolicySettings {
    fn default() -> PolicySettings {
        PolicySettings { radius: 30.0, hysteresis: 0.1, cell: 30.0, pvs: None }
    }
}

/// Why there is no such policy.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// A setting that is out of range.
    #[error("{what} = {value} is not between {} and {}", range.start(), range.end())]
    Setting {
        /// Which setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: RangeInclusive<f64>,
    },
    /// `pvs` without a table.
    #[error("the policy pvs needs a table of potential visibility: `eyeline-sim bake` makes one, --pvs names it")]
    NoTable,
    /// The table is of no use here.
    #[error(transparent)]
    Table(#[from] PvsError),
}

/// Whether a setting is within its range; NaN is not.
pub(super) fn check(what: &'static str, value: f64, range: RangeInclusive<f64>) -> Result<(), PolicyError> {
    if range.contains(&value) { Ok(()) } else { Err(PolicyError::Setting { what, value, range }) }
}

impl PolicySettings {
    /// Sets the radius of `radius`, metres.
    pub fn with_radius(self, radius: f64) -> PolicySettings {
        PolicySettings { radius, ..self }
    }

    /// Sets how much farther what is told of may go under `radius`, as a share of it.
    pub fn with_hysteresis(self, hysteresis: f64) -> PolicySettings {
        PolicySettings { hysteresis, ..self }
    }

    /// Sets the side of a square of `grid`, metres.
    pub fn with_cell(self, cell: f64) -> PolicySettings {
        PolicySettings { cell, ..self }
    }

    /// Sets the table of `pvs`.
    pub fn with_pvs(self, table: Arc<PvsTable>) -> PolicySettings {
        PolicySettings { pvs: Some(table), ..self }
    }

    /// The policy of this name in the world of this model; `None` if there is none that does without triangles.
    ///
    /// # Errors
    /// If one of its settings is of no use.
    pub fn policy(&self, name: &str, world: &WorldInfo) -> Result<Option<Box<dyn Policy>>, PolicyError> {
        Ok(Some(match name {
            "visible" => Box::new(Visible),
            "broadcast" => Box::new(Broadcast),
            "radius" => Box::new(Radius::new(self.radius, self.hysteresis)?),
            "grid" => Box::new(Grid::new(self.cell)?),
            "pvs" => {
                let table = self.pvs.as_ref().ok_or(PolicyError::NoTable)?;
                table.check_world(world)?;
                Box::new(Pvs::new(table.clone()))
            }
            _ => return Ok(None),
        }))
    }

    /// The settings that the policy of this name reads, for reports; empty if it reads none.
    pub fn describe(&self, name: &str) -> String {
        match (name, &self.pvs) {
            ("radius", _) => {
                format!("{:.2} m, kept to {:.2} m", self.radius, self.radius * (1.0 + self.hysteresis))
            }
            ("grid", _) => format!("squares of {:.2} m", self.cell),
            ("pvs", Some(table)) => format!("sampled, cells of {} m", table.grid().cell()),
            _ => String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policies_are_made_by_name_or_refused_with_the_reason() {
        let info = |byte| WorldInfo { name: "hall.glb".into(), hash: [byte; 32], size_bytes: 0, two_sided: false };
        let settings = PolicySettings::default();
        for name in ["visible", "broadcast", "radius", "grid"] {
            assert_eq!(settings.policy(name, &info(7)).unwrap().unwrap().name(), name);
        }
        assert!(settings.policy("oracle", &info(7)).unwrap().is_none());
        let error = |settings: PolicySettings, name: &str, world: u8| {
            settings.policy(name, &info(world)).err().unwrap().to_string()
        };
        assert!(error(settings.clone(), "pvs", 7).contains("bake"));
        assert!(error(settings.clone().with_radius(f64::NAN), "radius", 7).contains("radius = NaN"));
        assert!(error(settings.clone().with_hysteresis(-1.0), "radius", 7).contains("hysteresis = -1"));
        assert!(error(settings.clone().with_cell(0.0), "grid", 7).contains("cell = 0"));
        let table = Arc::new(super::super::table::tests::table(|cell| vec![cell]));
        let with_table = settings.with_pvs(table);
        assert_eq!(with_table.policy("pvs", &info(7)).unwrap().unwrap().name(), "pvs");
        assert!(error(with_table, "pvs", 8).contains("hall.glb"));
    }
}
