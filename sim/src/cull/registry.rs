//! Which cullers are there, and with what settings can each run?
//!
//! A culler is one [`Entry`] of [`Registry::standard`]: its name, what can be chosen for it, and how it is made. A sweep is
//! the product of what it can choose and what was asked for. What several settings share (a tessellation of a large scene
//! takes seconds) is made once, by the [`Shop`]. The table is in `entries.rs`.

use super::budget::{AskedBudget, BudgetKind};
use super::candidate::Candidate;
use super::entries;
use super::shop::Shop;

/// What was chosen for a culler. `None` where it has no choice.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Setting {
    /// Name of its [`Entry`].
    pub culler: &'static str,
    /// Name of a tessellation.
    pub tessellation: Option<&'static str>,
    /// Name of a query back end.
    pub query: Option<&'static str>,
    /// Triangles that PLP may draw by guess.
    pub budget: Option<AskedBudget>,
}

impl Setting {
    /// The setting for people, without what has no choice: `cplp · octree · sampled · 100`.
    pub fn label(&self) -> String {
        let parts = [Some(self.culler.to_owned()), self.tessellation.map(Into::into), self.query.map(Into::into)];
        let parts = parts.into_iter().chain([self.budget.as_ref().map(|budget| budget.text().to_owned())]);
        parts.flatten().collect::<Vec<String>>().join(" · ")
    }
}

/// A culler that can be named.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its name on the command line and in rows.
    pub name: &'static str,
    /// What it is, in a phrase.
    pub about: &'static str,
    /// Whether it promises to lose nothing, so that a wrong pixel fails the run.
    pub conservative: bool,
    /// Whether that promise is about rays and no picture of one size. A rasteriser that snaps corners opens cracks where walls
    /// meet without sharing corners; what shows in one and no ray meets is told apart, and does not fail the run.
    pub by_rays: bool,
    /// Tessellations that it can use, best first; empty if it has none.
    pub tessellations: &'static [&'static str],
    /// Query back ends that it can use, best first; empty if it has none.
    pub queries: &'static [&'static str],
    /// Which budgets it can use.
    pub budget: Budgets,
    /// Makes it.
    pub make: fn(&mut Shop, &Setting) -> Box<dyn Candidate>,
}

/// Which budgets a culler can use, with the one it takes if none is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budgets {
    /// It has none.
    None,
    /// Triangles and shares of the scene.
    Given(&'static str),
    /// Multiples of the visible set too.
    Visible(&'static str),
    /// Budgets that are found on the way too: automatic ones and deadlines.
    Any(&'static str),
}

impl Budgets {
    fn default(self) -> Option<&'static str> {
        match self {
            Budgets::None => None,
            Budgets::Given(text) | Budgets::Visible(text) | Budgets::Any(text) => Some(text),
        }
    }

    fn can(self, budget: &AskedBudget) -> bool {
        match budget.kind() {
            BudgetKind::Triangles(_) | BudgetKind::Share(_) => self != Budgets::None,
            BudgetKind::Visible(_) => matches!(self, Budgets::Visible(_) | Budgets::Any(_)),
            BudgetKind::Auto | BudgetKind::Deadline(_) => matches!(self, Budgets::Any(_)),
        }
    }
}

/// All cullers that can be named.
#[derive(Clone, Debug)]
pub struct Registry(Vec<Entry>);

/// What was asked for, by name; an empty list takes each culler's best.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sweep {
    /// Cullers; empty or `all` for all.
    pub cullers: Vec<String>,
    /// Tessellations; `all` for all.
    pub tessellations: Vec<String>,
    /// Query back ends; `all` for all.
    pub queries: Vec<String>,
    /// Budgets; each culler takes those that it can use.
    pub budgets: Vec<AskedBudget>,
}

/// Why there is nothing to run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SweepError {
    /// No culler, tessellation or query of this name.
    #[error("there is no {what} `{name}`; known: {known}")]
    Unknown {
        /// culler, tessellation or query.
        what: &'static str,
        /// What was asked for.
        name: String,
        /// All names.
        known: String,
    },
    /// Every name is known, but no culler has them together.
    #[error(
        "none of the cullers {cullers} can use what was asked for; leave out --tessellation, --query or --budgets, or name others"
    )]
    Nothing {
        /// Their names.
        cullers: String,
    },
}

/// Stands for every name in a list.
const ALL: &str = "all";

impl Registry {
    /// The cullers of `eyeline-visibility`.
    pub fn standard() -> Registry {
        Registry(entries::standard())
    }

    /// With one culler more, which replaces one of the same name.
    pub fn with(mut self, entry: Entry) -> Registry {
        self.0.retain(|known| known.name != entry.name);
        self.0.push(entry);
        self
    }

    /// All cullers.
    pub fn entries(&self) -> &[Entry] {
        &self.0
    }

    /// The culler of a name.
    pub fn entry(&self, name: &str) -> Option<&Entry> {
        self.0.iter().find(|entry| entry.name == name)
    }

    /// The known names, for messages and help.
    pub fn names(&self) -> String {
        self.0.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", ")
    }

    /// Every setting that was asked for and that a culler has, each once.
    pub fn settings(&self, sweep: &Sweep) -> Result<Vec<Setting>, SweepError> {
        let names: Vec<&'static str> = self.0.iter().map(|entry| entry.name).collect();
        let cullers = chosen("culler", &sweep.cullers, &names)?.unwrap_or(names);
        let union = |of: fn(&Entry) -> &'static [&'static str]| {
            let mut names: Vec<_> = self.0.iter().flat_map(of).copied().collect();
            names.sort_unstable();
            names.dedup();
            names
        };
        let tessellations = chosen("tessellation", &sweep.tessellations, &union(|entry| entry.tessellations))?;
        let queries = chosen("query", &sweep.queries, &union(|entry| entry.queries))?;
        let mut settings = Vec::new();
        for culler in &cullers {
            let Some(entry) = self.entry(culler) else { continue };
            let budgets: Vec<Option<AskedBudget>> = match (entry.budget.default(), sweep.budgets.is_empty()) {
                (None, _) => vec![None],
                (Some(default), true) => vec![default.parse().ok()],
                (Some(_), false) => {
                    sweep.budgets.iter().filter(|budget| entry.budget.can(budget)).cloned().map(Some).collect()
                }
            };
            for &tessellation in &choices(entry.tessellations, tessellations.as_deref()) {
                for &query in &choices(entry.queries, queries.as_deref()) {
                    for budget in &budgets {
                        let setting = Setting { culler: entry.name, tessellation, query, budget: budget.clone() };
                        if !settings.contains(&setting) {
                            settings.push(setting);
                        }
                    }
                }
            }
        }
        if settings.is_empty() {
            return Err(SweepError::Nothing { cullers: cullers.join(", ") });
        }
        Ok(settings)
    }
}

/// What of `known` was asked for; `None` if nothing was.
fn chosen(
    what: &'static str,
    asked: &[String],
    known: &[&'static str],
) -> Result<Option<Vec<&'static str>>, SweepError> {
    if asked.is_empty() {
        return Ok(None);
    }
    let mut names = Vec::new();
    for name in asked {
        match known.iter().find(|known| **known == name.as_str()) {
            Some(known) => names.push(*known),
            None if name == ALL => names.extend(known),
            None => return Err(SweepError::Unknown { what, name: name.clone(), known: known.join(", ") }),
        }
    }
    Ok(Some(names))
}

/// What a culler runs with: what was asked for and it has, its best if nothing was asked for, and `None` if it has no
/// choice at all.
fn choices(has: &'static [&'static str], asked: Option<&[&'static str]>) -> Vec<Option<&'static str>> {
    match asked {
        _ if has.is_empty() => vec![None],
        None => vec![Some(has[0])],
        Some(asked) => has.iter().filter(|name| asked.contains(name)).copied().map(Some).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(cullers: &[&str], tessellations: &[&str], queries: &[&str], budgets: &[usize]) -> Sweep {
        let own = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let (cullers, tessellations, queries) = (own(cullers), own(tessellations), own(queries));
        Sweep { cullers, tessellations, queries, budgets: budgets.iter().map(|&budget| budget.into()).collect() }
    }

    fn labels(registry: &Registry, sweep: &Sweep) -> Vec<String> {
        registry.settings(sweep).unwrap().iter().map(Setting::label).collect()
    }

    #[test]
    fn a_sweep_is_a_product_over_what_each_culler_can_choose() {
        let registry = Registry::standard();
        let best = [
            "zbuffer",
            "frustum-backface",
            "frustum",
            "large-occluder · planes",
            "planned",
            "masked · kd-tree · masks",
            "cplp · octree · sampled · 100",
            "cplp-occupancy · octree · sampled · 100",
            "cplp-occupancy-always · octree · sampled · 100",
            "cplp-batches · octree · per-fragment-histogram · 100",
            "plp · delaunay · 10%",
            "plp-paper · delaunay · 10%",
            "centroid · 10%",
            "centroid-culled · 10%",
            "query-front-to-back · octree · sampled",
            "query-front-to-back-occupancy · octree · sampled",
            "query-front-to-back-occupancy-always · octree · sampled",
            "query-front-to-back-batches · octree · sampled",
            "hierarchical-z · octree · pyramid",
            "hierarchical-z-plp · octree · pyramid · 4000",
            "hierarchical-z-occupancy · octree · pyramid",
            "hierarchical-z-occupancy-always · octree · pyramid",
            "region · kd-tree · under",
        ];
        assert_eq!(labels(&registry, &sweep(&["all"], &[], &[], &[])), best);
        assert_eq!(labels(&registry, &Sweep::default()), best);
        assert_eq!(
            labels(&registry, &sweep(&["cplp", "zbuffer", "cplp"], &["octree"], &["sampled"], &[0, 500, 0])),
            ["cplp · octree · sampled · 0", "cplp · octree · sampled · 500", "zbuffer"]
        );
        assert_eq!(labels(&registry, &sweep(&["cplp"], &["all"], &["all"], &[])).len(), 3 * 6);
        let other = Entry { name: "other", tessellations: &["slabs", "octree"], ..*registry.entry("cplp").unwrap() };
        let registry = registry.with(other);
        assert_eq!(
            labels(&registry, &sweep(&["cplp", "other"], &["slabs"], &[], &[7])),
            ["other · slabs · sampled · 7"]
        );
        assert_eq!(labels(&registry, &sweep(&["other"], &["all"], &[], &[7])).len(), 2);
    }

    #[test]
    fn each_culler_takes_the_budgets_that_it_can_use() {
        let budgets = ["5%", "2x", "auto", "4ms"].map(|text| text.parse().unwrap()).to_vec();
        let sweep = Sweep { budgets, ..sweep(&["cplp", "plp", "centroid", "zbuffer"], &[], &[], &[]) };
        let expected = [
            "cplp · octree · sampled · 5%",
            "plp · delaunay · 5%",
            "plp · delaunay · 2x",
            "plp · delaunay · auto",
            "plp · delaunay · 4ms",
            "centroid · 5%",
            "centroid · 2x",
            "zbuffer",
        ];
        assert_eq!(labels(&Registry::standard(), &sweep), expected);
    }

    #[test]
    fn unknown_names_are_refused_with_the_known_ones() {
        let registry = Registry::standard();
        let message = |sweep: &Sweep| registry.settings(sweep).unwrap_err().to_string();
        let text = message(&sweep(&["cplp", "plpp"], &[], &[], &[]));
        assert!(
            text.contains("no culler `plpp`")
                && text.contains("zbuffer, frustum-backface, frustum, large-occluder, planned, masked, cplp"),
            "{text}"
        );
        assert!(
            message(&sweep(&[], &["bsp"], &[], &[]))
                .contains("no tessellation `bsp`; known: delaunay, fine-octree, kd-tree, octree, prisms")
        );
        assert!(message(&sweep(&[], &[], &["gpu"], &[])).contains("no query `gpu`; known: histogram, "));
        let other = Entry { name: "other", tessellations: &["slabs"], ..*registry.entry("cplp").unwrap() };
        let found_on_the_way =
            Sweep { budgets: vec!["auto".parse().unwrap()], ..sweep(&["cplp", "centroid"], &[], &[], &[]) };
        assert!(message(&found_on_the_way).contains("--budgets"));
        let error = Registry::standard().with(other).settings(&sweep(&["cplp"], &["slabs"], &[], &[])).unwrap_err();
        assert!(error.to_string().contains("none of the cullers cplp"));
    }
}
