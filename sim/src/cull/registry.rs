//! Which cullers are there, and with what settings can each run?
//!
//! A culler is one [`Entry`] of [`Registry::standard`]: its name, what can be chosen for it, and how it is made. A sweep is
//! the product of what it can choose and what was asked for. What several settings share (a tessellation of a large scene
//! takes seconds) is made once, by the [`Shop`].

use std::sync::Arc;

use eyeline_visibility::{
    Aabb, AnyTessellation, Budget, CentroidOrder, Cplp, CplpCuller, CplpQueryCuller, CplpScratch, CpuQuery, Culled,
    Culler, Delaunay, DelaunayError, DelaunayRules, DepthBuffer, EyeRegion, FrustumBackface, HierarchicalZ, KdRules,
    KdTree, LargeOccluder, LargeOccluderRules, MaskedCplp, Occluders, Occlusion, Occupancy, Octree, OctreeRules, Plp,
    PlpCells, PlpCuller, PlpRules, Prisms, PrismsError, QueryBackEnd, QueryFrontToBack, QueryKind, RegionCuller, Round,
    Scene, Scratch, Tessellation, Triangle, View, ZBuffer,
};

use super::budget::AskedBudget;
use super::picture::Layer;

/// A culler under test, with all that it keeps from frame to frame.
pub trait Candidate {
    /// Culls a view, for every eye of the region.
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled;

    /// What the last cull knows to be hidden.
    fn occlusion(&self) -> &dyn Occlusion;

    /// Draws opaque triangles that are no part of the scene, in its coordinates, so that they hide from now on what lies behind
    /// them in the view of the last cull. Returns whether the culler can.
    fn draw_moving(&mut self, _triangles: &[Triangle]) -> bool {
        false
    }

    /// Comparisons of depths of the last cull, drawing and queries, if it draws a Z-buffer of its own. Else the report counts
    /// those that drawing the visible set takes.
    fn z_tests(&self) -> Option<u64> {
        None
    }

    /// What the culler can show of itself in a view: the front, finished tiles.
    fn layers(&mut self, _view: &View) -> Vec<Layer> {
        Vec::new()
    }
}

/// Any culler with a scratch of its own.
pub struct WithScratch<C> {
    culler: C,
    scratch: Scratch,
    z_tests: u64,
}

impl<C> WithScratch<C> {
    /// Gives a culler its scratch.
    pub fn new(culler: C) -> WithScratch<C> {
        WithScratch { culler, scratch: Scratch::default(), z_tests: 0 }
    }
}

impl<C: Culler> Candidate for WithScratch<C> {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        let culled = self.culler.cull(view, region, &mut self.scratch);
        self.z_tests = culled.z_tests;
        culled
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.scratch.occlusion()
    }

    fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.scratch.draw_moving(triangles)
    }

    fn z_tests(&self) -> Option<u64> {
        (self.z_tests > 0).then_some(self.z_tests)
    }
}

/// cPLP with any query back end, which can show its front.
struct WithFront<C> {
    inner: WithScratch<C>,
    scene: Arc<Scene>,
    cplp: Arc<Cplp>,
    budget: Budget,
    query: QueryKind,
}

impl<C: Culler> Candidate for WithFront<C> {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        self.inner.cull(view, region)
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.inner.occlusion()
    }

    fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.inner.draw_moving(triangles)
    }

    fn z_tests(&self) -> Option<u64> {
        self.inner.z_tests()
    }

    fn layers(&mut self, view: &View) -> Vec<Layer> {
        // The paper's figure 10: what each of the first rounds asks about, past what was drawn before it, and which tiles are
        // finished then.
        let mut layers = Vec::new();
        let mut query = self.query.back_end();
        let mut drawn: Vec<u32> = {
            let mut depth = DepthBuffer::new(view);
            let (mut scratch, eye) = (CplpScratch::default(), EyeRegion::point(view.eye));
            self.cplp.traverse_plp(&self.scene, eye, self.budget, &mut depth.target(&self.scene), &mut scratch);
            scratch.visible().to_vec()
        };
        let cells = self.cplp.tessellation().clone();
        let watch = |round: Round<'_>, query: &CpuQuery| {
            if let Some(name) = FRONTS.get(round.number - 1) {
                let boxes: Vec<Aabb> = round.cells.iter().map(|&cell| *cells.cell(cell)).collect();
                layers.push(Layer::of_boxes(name, &self.scene, &drawn, &boxes, view));
                let tiles = query.finished_tiles();
                if !tiles.is_empty() {
                    layers.push(Layer::of_tiles(FINISHED[round.number - 1], &tiles, view.resolution));
                }
            }
            let seen = round.cells.iter().zip(round.seen).filter(|(_, seen)| **seen);
            drawn.extend(seen.flat_map(|(&cell, _)| cells.primitives(cell)));
        };
        self.cplp.watch_rounds(&self.scene, view, self.budget, &mut query, &mut CplpScratch::default(), watch);
        layers
    }
}

/// Names of the pictures of the first rounds.
const FRONTS: [&str; 2] = ["front, round 1", "front, round 2"];
const FINISHED: [&str; 2] = ["finished tiles, round 1", "finished tiles, round 2"];

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
    /// Its budget of triangles if none is asked for; `None` if it has none.
    pub budget: Option<&'static str>,
    /// Makes it.
    pub make: fn(&mut Shop, &Setting) -> Box<dyn Candidate>,
}

/// What cullers of one scene are made from; parts are made once.
pub struct Shop {
    scene: Arc<Scene>,
    octree: Option<Arc<Octree>>,
    kd_tree: Option<Arc<KdTree>>,
    occluders: Option<Arc<Occluders>>,
    plp_octree: Option<PlpCells>,
    delaunay: Option<Result<Arc<Delaunay>, DelaunayError>>,
    prisms: Option<Result<Arc<Prisms>, PrismsError>>,
}

impl Shop {
    /// A shop for a scene.
    pub fn new(scene: Arc<Scene>) -> Shop {
        Shop { scene, octree: None, kd_tree: None, occluders: None, plp_octree: None, delaunay: None, prisms: None }
    }

    /// The same with a tessellation that was made before, in place of the one of its kind.
    pub fn with_tessellation(mut self, made: AnyTessellation) -> Shop {
        match made {
            AnyTessellation::Octree(octree) => {
                self.plp_octree = Some(PlpCells::Boxes(octree.clone()));
                self.octree = Some(octree);
            }
            AnyTessellation::KdTree(kd_tree) => self.kd_tree = Some(kd_tree),
            AnyTessellation::Delaunay(delaunay) => self.delaunay = Some(Ok(delaunay)),
            AnyTessellation::Prisms(prisms) => self.prisms = Some(Ok(prisms)),
        }
        self
    }

    /// Which tessellation stands in for the one that a setting names, and why, if that could not be made.
    pub fn instead(&self, setting: &Setting) -> Option<(&'static str, String)> {
        let why = match setting.tessellation? {
            PRISMS => self.prisms.as_ref()?.as_ref().err()?.to_string(),
            DELAUNAY => self.delaunay.as_ref()?.as_ref().err()?.to_string(),
            _ => return None,
        };
        Some((OCTREE, why))
    }

    /// Prisms, or why there are none.
    fn prisms(&mut self) -> Option<Arc<Prisms>> {
        let scene = &self.scene;
        self.prisms.get_or_insert_with(|| Prisms::build(scene).map(Arc::new)).clone().ok()
    }

    /// The scene.
    pub fn scene(&self) -> Arc<Scene> {
        self.scene.clone()
    }

    /// The octree.
    pub fn octree(&mut self) -> Arc<Octree> {
        self.octree.get_or_insert_with(|| Arc::new(Octree::build(&self.scene, OctreeRules::default()))).clone()
    }

    /// The tessellation that a setting names.
    pub fn tessellation(&mut self, setting: &Setting) -> Arc<dyn Tessellation> {
        match setting.tessellation {
            Some(KD_TREE) => {
                let kd_tree = &mut self.kd_tree;
                kd_tree.get_or_insert_with(|| Arc::new(KdTree::build(&self.scene, KdRules::default()))).clone()
            }
            // Where there are no storeys the octree stands in for prisms.
            Some(PRISMS) => match self.prisms() {
                Some(prisms) => prisms,
                None => self.octree(),
            },
            _ => self.octree(),
        }
    }

    /// cPLP over the tessellation that a setting names.
    pub fn cplp(&mut self, setting: &Setting) -> Arc<Cplp> {
        Arc::new(Cplp::new(self.tessellation(setting)))
    }

    /// The cells that PLP walks: octree leaves by the paper's rules, tetrahedra over them, or prisms. Where these cannot be made,
    /// the octree stands in for them.
    pub fn plp_cells(&mut self, setting: &Setting) -> PlpCells {
        let scene = &self.scene;
        let made = match setting.tessellation {
            Some(PRISMS) => self.prisms().map(PlpCells::Prisms),
            Some(DELAUNAY) => {
                let made = || Delaunay::build(scene, DelaunayRules::default()).map(Arc::new);
                self.delaunay.get_or_insert_with(made).clone().ok().map(PlpCells::Tetrahedra)
            }
            _ => None,
        };
        made.unwrap_or_else(|| {
            let scene = &self.scene;
            let made = || PlpCells::Boxes(Arc::new(Octree::build(scene, OctreeRules::paper())));
            self.plp_octree.get_or_insert_with(made).clone()
        })
    }

    /// PLP over the cells that a setting names.
    pub fn plp(&mut self, setting: &Setting, rules: PlpRules) -> PlpCuller {
        let plp = Plp::new(self.scene(), self.plp_cells(setting), rules);
        PlpCuller::new(Arc::new(plp), self.budget(setting))
    }

    /// The budget that a setting names, in triangles.
    pub fn budget(&self, setting: &Setting) -> usize {
        let total = self.scene.triangles().len();
        setting.budget.as_ref().map_or(Budget::default().triangles, |budget| budget.triangles(total))
    }

    /// The polygons that under-estimating coverage draws.
    pub fn occluders(&mut self) -> Arc<Occluders> {
        self.occluders.get_or_insert_with(|| Arc::new(Occluders::build(&self.scene))).clone()
    }
}

/// Pixels of the image that `region` draws, whatever the picture's resolution.
const REGION_PIXELS: u32 = 256 * 128;

/// Budgets where none is asked for: [`Budget::default`] for cPLP, the paper's largest for PLP alone.
const CPLP_BUDGET: &str = "100";
const PLP_BUDGET: &str = "10%";

/// Query back ends of cPLP; those that answer several cells at once can be asked in batches.
const CPLP_QUERIES: &[&str] =
    &["sampled", "item-buffer", "item-buffer-tiled", "histogram", "one-at-a-time", "per-fragment-histogram"];
const CPLP_QUERIES_BATCHED: [&str; 4] = ["per-fragment-histogram", "item-buffer", "item-buffer-tiled", "histogram"];

/// Names of tessellations.
const DELAUNAY: &str = "delaunay";
const OCTREE: &str = "octree";
const KD_TREE: &str = "kd-tree";
const PRISMS: &str = "prisms";

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
    /// Budgets in triangles or shares of the scene.
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
        "none of the cullers {cullers} can use what was asked for; leave out --tessellation or --query, or name others"
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
        Registry(vec![
            Entry {
                name: "zbuffer",
                about: "everything, the baseline ZB",
                conservative: true,
                by_rays: false,
                tessellations: &[],
                queries: &[],
                budget: None,
                make: |shop, _| Box::new(WithScratch::new(ZBuffer::new(shop.scene()))),
            },
            Entry {
                name: "frustum-backface",
                about: "what is in view and not turned away, the baseline VF-BF",
                conservative: true,
                by_rays: false,
                tessellations: &[],
                queries: &[],
                budget: None,
                make: |shop, _| Box::new(WithScratch::new(FrustumBackface::new(shop.scene()))),
            },
            Entry {
                name: "frustum",
                about: "what is in view, by a kD-tree's nodes, objects and clusters: Coorg & Teller's baseline",
                conservative: true,
                by_rays: false,
                tessellations: &[],
                queries: &[],
                budget: None,
                make: |shop, _| {
                    let rules = LargeOccluderRules::default().with_occluders(0);
                    Box::new(WithScratch::new(LargeOccluder::new(shop.scene(), rules)))
                },
            },
            Entry {
                name: "large-occluder",
                about: "nodes of a kD-tree against planes of a few large polygons, kept from frame to frame (Coorg & Teller)",
                conservative: true,
                by_rays: false,
                tessellations: &[],
                queries: &["planes"],
                budget: None,
                make: |shop, _| Box::new(WithScratch::new(LargeOccluder::build(shop.scene()))),
            },
            Entry {
                name: "masked",
                about: "conservative PLP against coverage masks: faces of cells are asked about, then objects and clusters",
                conservative: true,
                by_rays: false,
                tessellations: &[KD_TREE, OCTREE],
                queries: &["masks"],
                budget: None,
                make: |shop, setting| {
                    let tessellation = shop.tessellation(setting);
                    Box::new(WithScratch::new(MaskedCplp::new(shop.scene(), tessellation)))
                },
            },
            Entry {
                name: "cplp",
                about: "conservative PLP: cells of a tessellation from the eye outward, queried against what was drawn",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: CPLP_QUERIES,
                budget: Some(CPLP_BUDGET),
                make: |shop, setting| cplp(shop, setting, Occupancy::Off),
            },
            Entry {
                name: "cplp-occupancy",
                about: "the same, with a map of where was drawn that spares queries of cells that are certainly seen (Staneker)",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: CPLP_QUERIES,
                budget: Some(CPLP_BUDGET),
                make: |shop, setting| cplp(shop, setting, Occupancy::Single),
            },
            Entry {
                name: "cplp-batches",
                about: "the same, with four more maps that arrange what is left of a front into batches",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: &CPLP_QUERIES_BATCHED,
                budget: Some(CPLP_BUDGET),
                make: |shop, setting| cplp(shop, setting, Occupancy::Batched),
            },
            Entry {
                name: "plp",
                about: "PLP within a budget by its default rule: cells by how much of them looks covered, not conservative",
                conservative: false,
                by_rays: false,
                tessellations: &[DELAUNAY, OCTREE, PRISMS],
                queries: &[],
                budget: Some(PLP_BUDGET),
                make: |shop, setting| Box::new(WithScratch::new(shop.plp(setting, PlpRules::default()))),
            },
            Entry {
                name: "plp-paper",
                about: "PLP within a budget by the paper's rule: solidity from counts of triangles, not conservative",
                conservative: false,
                by_rays: false,
                tessellations: &[DELAUNAY, OCTREE, PRISMS],
                queries: &[],
                budget: Some(PLP_BUDGET),
                make: |shop, setting| Box::new(WithScratch::new(shop.plp(setting, PlpRules::paper()))),
            },
            Entry {
                name: "centroid",
                about: "the nearest triangles of the scene up to a budget, then culled: PLP's baseline, not conservative",
                conservative: false,
                by_rays: false,
                tessellations: &[],
                queries: &[],
                budget: Some(PLP_BUDGET),
                make: |shop, setting| {
                    let budget = shop.budget(setting);
                    Box::new(WithScratch::new(CentroidOrder::new(shop.scene(), budget, false)))
                },
            },
            Entry {
                name: "centroid-culled",
                about: "the same with culling first, so that only what is in view and not turned away counts",
                conservative: false,
                by_rays: false,
                tessellations: &[],
                queries: &[],
                budget: Some(PLP_BUDGET),
                make: |shop, setting| {
                    let budget = shop.budget(setting);
                    Box::new(WithScratch::new(CentroidOrder::new(shop.scene(), budget, true)))
                },
            },
            Entry {
                name: "query-front-to-back",
                about: "cells in view by distance, one query each: the paper's HP baseline",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: &["sampled"],
                budget: None,
                make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Off),
            },
            Entry {
                name: "query-front-to-back-occupancy",
                about: "the same, with a map of where was drawn that spares queries of cells that are certainly seen (Staneker)",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: &["sampled"],
                budget: None,
                make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Single),
            },
            Entry {
                name: "query-front-to-back-batches",
                about: "the same, with what is left asked in five batches after that, as four more maps arrange them",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: &["sampled"],
                budget: None,
                make: |shop, setting| query_front_to_back(shop, setting, Occupancy::Batched),
            },
            Entry {
                name: "hierarchical-z",
                about: "an octree against a pyramid of farthest depths (Greene)",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE],
                queries: &["pyramid"],
                budget: None,
                make: |shop, _| {
                    let octree = shop.octree();
                    Box::new(WithScratch::new(HierarchicalZ::new(shop.scene(), octree)))
                },
            },
            Entry {
                name: "hierarchical-z-occupancy",
                about: "the same, with a map of where was drawn that is asked first",
                conservative: true,
                by_rays: false,
                tessellations: &[OCTREE],
                queries: &["pyramid"],
                budget: None,
                make: |shop, _| {
                    let culler = HierarchicalZ::new(shop.scene(), shop.octree()).with_occupancy_map(true);
                    Box::new(WithScratch::new(culler))
                },
            },
            Entry {
                name: "region",
                about: "for every eye of a ball and every resolution: under-estimating coverage with supporting planes",
                conservative: true,
                by_rays: true,
                tessellations: &[OCTREE, KD_TREE, PRISMS],
                queries: &["under"],
                budget: None,
                make: |shop, setting| {
                    let (cplp, occluders) = (shop.cplp(setting), shop.occluders());
                    Box::new(WithScratch::new(RegionCuller::new(shop.scene(), cplp, occluders, REGION_PIXELS)))
                },
            },
        ])
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
            let budgets: Vec<Option<AskedBudget>> = match (entry.budget, sweep.budgets.is_empty()) {
                (None, _) => vec![None],
                (Some(default), true) => vec![default.parse().ok()],
                (Some(_), false) => sweep.budgets.iter().cloned().map(Some).collect(),
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

/// cPLP with the query back end of a setting, with or without occupancy maps.
fn cplp(shop: &mut Shop, setting: &Setting, occupancy: Occupancy) -> Box<dyn Candidate> {
    let budget = Budget { triangles: shop.budget(setting) };
    let (scene, cplp) = (shop.scene(), shop.cplp(setting));
    match QueryKind::ALL.into_iter().find(|kind| Some(kind.name()) == setting.query) {
        Some(kind) => {
            let culler = CplpQueryCuller::new(scene.clone(), cplp.clone(), budget, kind).with_occupancy(occupancy);
            Box::new(WithFront { inner: WithScratch::new(culler), scene, cplp, budget, query: kind })
        }
        None => {
            let culler = CplpCuller::new(scene.clone(), cplp.clone(), budget);
            let culler = culler.with_occupancy_map(occupancy != Occupancy::Off);
            let query = QueryKind::PerFragmentHistogram;
            Box::new(WithFront { inner: WithScratch::new(culler), scene, cplp, budget, query })
        }
    }
}

/// One query a cell, with or without occupancy maps.
fn query_front_to_back(shop: &mut Shop, setting: &Setting, occupancy: Occupancy) -> Box<dyn Candidate> {
    let tessellation = shop.tessellation(setting);
    Box::new(WithScratch::new(QueryFrontToBack::new(shop.scene(), tessellation).with_occupancy(occupancy)))
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
            "masked · kd-tree · masks",
            "cplp · octree · sampled · 100",
            "cplp-occupancy · octree · sampled · 100",
            "cplp-batches · octree · per-fragment-histogram · 100",
            "plp · delaunay · 10%",
            "plp-paper · delaunay · 10%",
            "centroid · 10%",
            "centroid-culled · 10%",
            "query-front-to-back · octree · sampled",
            "query-front-to-back-occupancy · octree · sampled",
            "query-front-to-back-batches · octree · sampled",
            "hierarchical-z · octree · pyramid",
            "hierarchical-z-occupancy · octree · pyramid",
            "region · octree · under",
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
    fn unknown_names_are_refused_with_the_known_ones() {
        let registry = Registry::standard();
        let message = |sweep: &Sweep| registry.settings(sweep).unwrap_err().to_string();
        let text = message(&sweep(&["cplp", "plpp"], &[], &[], &[]));
        assert!(
            text.contains("no culler `plpp`")
                && text.contains("zbuffer, frustum-backface, frustum, large-occluder, masked, cplp"),
            "{text}"
        );
        assert!(
            message(&sweep(&[], &["bsp"], &[], &[]))
                .contains("no tessellation `bsp`; known: delaunay, kd-tree, octree, prisms")
        );
        assert!(message(&sweep(&[], &[], &["gpu"], &[])).contains("no query `gpu`; known: histogram, "));
        let other = Entry { name: "other", tessellations: &["slabs"], ..*registry.entry("cplp").unwrap() };
        let error = Registry::standard().with(other).settings(&sweep(&["cplp"], &["slabs"], &[], &[])).unwrap_err();
        assert!(error.to_string().contains("none of the cullers cplp"));
    }
}
