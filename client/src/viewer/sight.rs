//! Which culler decides what the viewer draws, and what it found.

use std::sync::Arc;

use eyeline_protocol::PlanSwitch;
use eyeline_visibility::{
    CplpCuller, Culled, Culler, EyeRegion, FrustumBackface, MaskedCplp, Planned, RegionCuller, Scene, SceneCounts,
    Scratch, View, ZBuffer, count_storeys,
};

use crate::later::Later;
use crate::plan;

/// A culler, by its name on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum CullerKind {
    /// What pays in this scene, counted while it runs: everything, the frustum, or the fastest
    #[default]
    Plan,
    /// Nothing: everything is drawn
    All,
    /// What is in view and not turned away
    Frustum,
    /// cPLP over octree cells with a sampled depth buffer
    Cplp,
    /// cPLP by queries of faces against coverage masks, the fastest
    Masked,
    /// For every eye of a ball and at every resolution
    Region,
}

/// A culler at work. The viewer draws what it says and never decides itself.
pub struct Sight {
    way: Way,
    scratch: Scratch,
    culled: Culled,
}

/// Who decides.
enum Way {
    Fixed(Box<dyn Culler + Send + Sync>),
    /// The plan of a scene, as soon as it is known from where one looks.
    Planned {
        scene: Arc<Scene>,
        switch: PlanSwitch,
        /// Whether cells are made by another thread, while frames go on.
        in_background: bool,
        planned: Option<Box<Planned>>,
        turns: u64,
    },
}

impl Sight {
    /// Prepares a culler for a scene, which may take seconds for a large one.
    pub fn new(kind: CullerKind, scene: &Arc<Scene>) -> Sight {
        Sight::with_plan(kind, scene, PlanSwitch::AUTO)
    }

    /// The same with what is asked of the plan, if a plan is followed.
    pub fn with_plan(kind: CullerKind, scene: &Arc<Scene>, switch: PlanSwitch) -> Sight {
        let scene = Arc::clone(scene);
        let culler: Box<dyn Culler + Send + Sync> = match kind {
            CullerKind::Plan => {
                let way = Way::Planned { scene, switch, in_background: false, planned: None, turns: 0 };
                return Sight { way, scratch: Scratch::default(), culled: Culled::default() };
            }
            CullerKind::All => Box::new(ZBuffer::new(scene)),
            CullerKind::Frustum => Box::new(FrustumBackface::new(scene)),
            CullerKind::Cplp => Box::new(CplpCuller::build(scene)),
            CullerKind::Masked => Box::new(MaskedCplp::build(scene)),
            CullerKind::Region => Box::new(RegionCuller::build(scene)),
        };
        Sight { way: Way::Fixed(culler), scratch: Scratch::default(), culled: Culled::default() }
    }

    /// The same for who has frames to show: what a plan begins to need is made by another thread, and until it is there
    /// views are drawn by the frustum, which makes the same picture. What a look finds depends on the clock then.
    pub fn in_background(mut self) -> Sight {
        if let Way::Planned { in_background, .. } = &mut self.way {
            *in_background = true;
        }
        self
    }

    /// Culls from a view's eye.
    pub fn look(&mut self, view: &View) -> &Culled {
        let region = EyeRegion::point(view.eye);
        self.culled = match &mut self.way {
            Way::Fixed(culler) => culler.cull(view, region, &mut self.scratch),
            Way::Planned { scene, switch, in_background, planned, turns } => {
                let planned = planned.get_or_insert_with(|| {
                    let counts = SceneCounts::around(scene.clone(), view.eye);
                    tell(*switch, &counts, scene);
                    let planned = plan::planned(counts, *switch);
                    Box::new(if *in_background { made_later(planned, *switch) } else { planned })
                });
                let culled = planned.look(view, region);
                if *turns != planned.stats().turns {
                    *turns = planned.stats().turns;
                    tracing::info!(drawing = ?planned.drawing(), newest = ?planned.stats().newest, "the plan is revised");
                }
                culled
            }
        };
        &self.culled
    }

    /// What the last look found.
    pub fn culled(&self) -> &Culled {
        &self.culled
    }
}

/// Has another thread make the cells once they are needed.
fn made_later(planned: Planned, switch: PlanSwitch) -> Planned {
    let make = plan::occlusion_maker(switch);
    let mut later = None;
    planned.with_occlusion_when(move |scene| {
        let scene = Arc::clone(scene);
        later.get_or_insert_with(|| Later::start(move || make(&scene))).poll()
    })
}

/// Says in the log what is left out, a line a stage.
fn tell(switch: PlanSwitch, counts: &SceneCounts, scene: &Scene) {
    let lines = plan::drawing_lines(switch, &counts.counts, &count_storeys(scene));
    for line in &lines {
        tracing::info!(stage = line.stage.name(), "{}: {}", line.verdict(), line.evidence);
    }
}
