//! A culler that does as much as its scene needs, and goes on to count whether that is still so.

use std::sync::Arc;

use super::{Drawing, Hysteresis, SceneCounts, ViewCounts};
use crate::{Culled, Culler, EyeRegion, Frustum, MaskedCplp, Occlusion, Scene, Scratch, Triangle, View, ZBuffer};

/// Makes the occlusion culler, once it is needed: that may take seconds for a large scene. `None` says that it is not
/// there yet, and to be asked for again.
type Make = Box<dyn FnMut(&Arc<Scene>) -> Option<Arc<dyn Culler + Send + Sync>> + Send>;

/// What is forced of a [`Planned`]; `None` is as counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlannedRules {
    /// Whether what is out of view is left out.
    pub frustum: Option<bool>,
    /// Whether what is hidden is left out.
    pub occlusion: Option<bool>,
}

/// What a [`Planned`] did. Counters since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlannedStats {
    /// Views culled with everything, the frustum alone, and occlusion.
    pub views: [u64; 3],
    /// Views that were counted beside being culled.
    pub probes: u64,
    /// Times that the way to draw changed.
    pub turns: u64,
    /// What the newest counted view said.
    pub newest: ViewCounts,
}

/// Culls by everything, by the frustum, or by occlusion, whichever pays; one for each worker.
///
/// All three are conservative, so that the picture is the same whatever is chosen. While occlusion culling runs, every
/// `CHECK`th view says how much of what is in view it hid; while it does not, every `PROBE`th view is counted as a
/// [`SceneCounts`] does. Only several such counts in a row change the way to draw, and they count triangles, not time: the same
/// views give the same plan on every machine.
pub struct Planned {
    everything: ZBuffer,
    frustum: Arc<Frustum>,
    occlusion: Option<Arc<dyn Culler + Send + Sync>>,
    make: Make,
    counts: SceneCounts,
    rules: PlannedRules,
    by_frustum: Hysteresis,
    by_occlusion: Hysteresis,
    scratch: Scratch,
    number: u64,
    stats: PlannedStats,
}

/// Views between two checks of occlusion culling that runs: a check asks about the box of every cluster, which in a large building
/// costs more than culling it.
pub(crate) const CHECK: u64 = 32;
/// Views between two counts of a scene whose occlusion is left out. A count costs about a frame.
pub(crate) const PROBE: u64 = 128;
/// Counts in a row that turn occlusion on, and off: what was counted once may be a look at a wall, or out of a window.
const TO_ON: u32 = 2;
const TO_OFF: u32 = 4;

impl Planned {
    /// Follows what was counted so far.
    pub fn new(counts: SceneCounts, rules: PlannedRules) -> Planned {
        let frustum = counts.frustum().clone();
        let drawing = counts.counts.drawing();
        Planned {
            everything: ZBuffer::new(frustum.scene().clone()),
            frustum,
            occlusion: None,
            make: Box::new(|scene| Some(Arc::new(MaskedCplp::build(scene.clone())))),
            by_frustum: Hysteresis::new(counts.counts.frustum_pays(), TO_ON, TO_OFF),
            by_occlusion: Hysteresis::new(drawing == Drawing::Occlusion, TO_ON, TO_OFF),
            counts,
            rules,
            scratch: Scratch::default(),
            number: 0,
            stats: PlannedStats::default(),
        }
    }

    /// With another occlusion culler than the fastest. It must be conservative and of the same scene.
    pub fn with_occlusion(
        self,
        make: impl Fn(&Arc<Scene>) -> Arc<dyn Culler + Send + Sync> + Send + 'static,
    ) -> Planned {
        self.with_occlusion_when(move |scene| Some(make(scene)))
    }

    /// With an occlusion culler that somebody else makes meanwhile. `poll` begins it when it is asked first, and has it
    /// some time later; views until then are culled by the frustum, which makes the same picture.
    pub fn with_occlusion_when(
        self,
        poll: impl FnMut(&Arc<Scene>) -> Option<Arc<dyn Culler + Send + Sync>> + Send + 'static,
    ) -> Planned {
        Planned { make: Box::new(poll), occlusion: None, ..self }
    }

    /// How views are to be drawn now. Until the occlusion culler is there they are drawn by the frustum instead, as
    /// [`PlannedStats::views`] says.
    pub fn drawing(&self) -> Drawing {
        let occlusion = self.rules.occlusion.unwrap_or(self.by_occlusion.runs());
        let frustum = self.rules.frustum.unwrap_or(self.by_frustum.runs());
        match (occlusion, frustum) {
            (true, _) => Drawing::Occlusion,
            (false, true) => Drawing::Frustum,
            (false, false) => Drawing::Everything,
        }
    }

    /// What was counted, all in all.
    pub fn counts(&self) -> ViewCounts {
        self.counts.counts
    }

    /// What was done.
    pub fn stats(&self) -> PlannedStats {
        PlannedStats { turns: self.by_frustum.turns() + self.by_occlusion.turns(), ..self.stats }
    }

    /// Culls a view, and revises the plan when it is time.
    pub fn look(&mut self, view: &View, region: EyeRegion) -> Culled {
        let mut drawing = self.drawing();
        if drawing == Drawing::Occlusion && self.occlusion.is_none() {
            self.occlusion = (self.make)(self.frustum.scene());
        }
        let culled = match (drawing, &self.occlusion) {
            (Drawing::Everything, _) => self.everything.cull(view, region, &mut self.scratch),
            (Drawing::Occlusion, Some(culler)) => culler.cull(view, region, &mut self.scratch),
            (Drawing::Frustum | Drawing::Occlusion, _) => {
                drawing = Drawing::Frustum;
                self.frustum.cull(view, region, &mut self.scratch)
            }
        };
        self.stats.views[drawing as usize] += 1;
        self.number += 1;
        let period = if drawing == Drawing::Occlusion { CHECK } else { PROBE };
        if self.number.is_multiple_of(period) && (self.rules.frustum.is_none() || self.rules.occlusion.is_none()) {
            self.revise(view, &culled, drawing);
        }
        culled
    }

    fn revise(&mut self, view: &View, culled: &Culled, drawing: Drawing) {
        // Of a view that makes no sense nothing is counted.
        if view.check().is_err() {
            return;
        }
        let counts = match drawing {
            Drawing::Occlusion => {
                let in_view = self.counts.in_view(view);
                let hidden = in_view.saturating_sub(culled.visible.len() as u64);
                let total = self.frustum.scene().triangles().len() as u64;
                ViewCounts { views: 1, total, in_view, hidden }
            }
            Drawing::Everything | Drawing::Frustum => self.counts.view(view),
        };
        if counts.views == 0 {
            return;
        }
        self.stats.probes += 1;
        self.stats.newest = counts;
        self.by_frustum.count(Some(counts.frustum_pays()));
        let runs = self.by_occlusion.runs();
        self.by_occlusion.count(Some(counts.occlusion_pays(runs)));
    }

    /// What the last cull knows to be hidden.
    pub fn occlusion(&self) -> &dyn Occlusion {
        self.scratch.occlusion()
    }

    /// Draws moving things into the image that speaks for the last cull; see [`Scratch::draw_moving`].
    pub fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        self.scratch.draw_moving(triangles)
    }
}

impl std::fmt::Debug for Planned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Planned").field("drawing", &self.drawing()).field("stats", &self.stats).finish_non_exhaustive()
    }
}
