//! What one worker keeps from frame to frame, whichever culler it uses, and which image speaks for the last cull.

use std::sync::Arc;

use crate::front_to_back::{Leaves, Maps};
use crate::hierarchical_z::PyramidImage;
use crate::{
    Aabb, Bound, CplpScratch, CpuQuery, DepthBuffer, EyeRegion, LargeOccluderScratch, MaskedCplpScratch, Occluders,
    Occlusion, Occupancy, PlpScratch, QueryBackEnd, QueryKind, Resolution, Triangle, UnderOcclusion, View,
};

/// What one worker needs to cull. What a culler does not use stays empty.
#[derive(Clone, Debug)]
pub struct Scratch {
    pub(crate) cplp: CplpScratch,
    pub(crate) depth: DepthBuffer,
    pub(crate) leaves: Leaves,
    pub(crate) maps: Maps,
    pub(crate) plp: PlpScratch,
    pyramid: PyramidImage,
    masked: MaskedCplpScratch,
    large: LargeOccluderScratch,
    under: Option<UnderOcclusion>,
    query: Option<((QueryKind, Occupancy), CpuQuery)>,
    speaker: Speaker,
}

/// What knows the depths that speak for the region of the last cull.
#[derive(Clone, Copy, Debug)]
enum Speaker {
    Nothing,
    Depth,
    Pyramid,
    Query,
    Masked,
    Large,
    Under,
}

impl Default for Scratch {
    fn default() -> Scratch {
        let nowhere = View::level(glam::DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 0));
        Scratch {
            cplp: CplpScratch::default(),
            depth: DepthBuffer::new(&nowhere),
            leaves: Leaves::default(),
            maps: Maps::default(),
            plp: PlpScratch::default(),
            pyramid: PyramidImage::new(&nowhere),
            masked: MaskedCplpScratch::default(),
            large: LargeOccluderScratch::default(),
            under: None,
            query: None,
            speaker: Speaker::Nothing,
        }
    }
}

impl Scratch {
    /// What the last cull knows to be hidden: in that view and at that resolution (see [`DepthBuffer`]), or, by
    /// [`crate::RegionCuller`], for every eye of the region and at every resolution.
    pub fn occlusion(&self) -> &dyn Occlusion {
        match (self.speaker, &self.query, &self.under) {
            (Speaker::Depth, ..) => &self.depth,
            (Speaker::Pyramid, ..) => &self.pyramid,
            (Speaker::Query, Some((_, query)), _) => query.depth(),
            (Speaker::Masked, ..) => self.masked.image(),
            (Speaker::Large, ..) => &self.large,
            (Speaker::Under, _, Some(under)) => under,
            _ => &NothingHidden,
        }
    }

    /// Draws moving things whose places are exact into the image that speaks, so that [`Scratch::occlusion`] hides what is
    /// behind them too, until the next cull (DESIGN.md §4). Positions are relative to the scene's anchor; only triangles that
    /// occlude are drawn, and none with corners that are not finite. Returns whether the image can be drawn into: `false`
    /// after a [`crate::RegionCuller`], which speaks for eyes that see other sides, after a [`crate::LargeOccluder`], which has
    /// no image, and where nothing speaks.
    pub fn draw_moving(&mut self, triangles: &[Triangle]) -> bool {
        let finite = triangles.iter().filter(|triangle| triangle.corners.iter().all(|corner| corner.is_finite()));
        match (self.speaker, &mut self.query) {
            (Speaker::Depth, _) => self.depth.draw_triangles(finite),
            (Speaker::Pyramid, _) => self.pyramid.draw(finite),
            (Speaker::Query, Some((_, query))) => query.depth_mut().draw_triangles(finite),
            (Speaker::Masked, _) => {
                let image = self.masked.image_mut();
                let occluders = finite.filter(|triangle| triangle.occludes);
                occluders.for_each(|triangle| image.draw_polygon_f32(&triangle.corners, triangle.sides));
            }
            _ => return false,
        }
        true
    }

    /// What the last walk of a [`crate::MaskedCplp`] left.
    pub fn masked(&self) -> &MaskedCplpScratch {
        &self.masked
    }

    /// What the last walk of a [`crate::LargeOccluder`] left, with the relations that it keeps.
    pub fn large(&self) -> &LargeOccluderScratch {
        &self.large
    }

    /// The same, to have its relations forgotten.
    pub fn large_mut(&mut self) -> &mut LargeOccluderScratch {
        &mut self.large
    }

    /// What the last traversal of a [`crate::CplpCuller`] or [`crate::CplpQueryCuller`] left.
    pub fn cplp(&self) -> &CplpScratch {
        &self.cplp
    }

    /// The same, to have its fronts recorded.
    pub fn cplp_mut(&mut self) -> &mut CplpScratch {
        &mut self.cplp
    }

    /// What the last traversal of a [`crate::PlpCuller`] left.
    pub fn plp(&self) -> &PlpScratch {
        &self.plp
    }

    /// The query back end of the last [`crate::CplpQueryCuller`].
    pub fn query(&self) -> Option<&CpuQuery> {
        self.query.as_ref().map(|(_, query)| query)
    }

    /// Nothing is known to be hidden any more.
    pub(crate) fn forget(&mut self) {
        self.speaker = Speaker::Nothing;
    }

    /// Starts a frame; whether the depth buffer can speak for `region` at all.
    pub(crate) fn begin(&mut self, view: &View, region: EyeRegion) -> bool {
        let speaks = self.speak(Speaker::Depth, view, region);
        if speaks {
            self.depth.begin(view);
        }
        speaks
    }

    /// Likewise for a walk against a Z-pyramid, with or without an occupancy map.
    pub(crate) fn begin_pyramid(
        &mut self,
        view: &View,
        region: EyeRegion,
        occupancy: Occupancy,
        scene: &Aabb,
    ) -> Option<(&mut PyramidImage, &mut Leaves)> {
        let speaks = self.speak(Speaker::Pyramid, view, region);
        if speaks {
            self.pyramid.begin(view, occupancy, scene);
        }
        speaks.then_some((&mut self.pyramid, &mut self.leaves))
    }

    /// Likewise for a walk against coverage masks.
    pub(crate) fn begin_masked(&mut self, view: &View, region: EyeRegion) -> Option<&mut MaskedCplpScratch> {
        self.speak(Speaker::Masked, view, region).then_some(&mut self.masked)
    }

    /// Likewise for planes instead of an image, which speak for any ball of eyes.
    pub(crate) fn begin_large(&mut self, view: &View, region: EyeRegion) -> Option<&mut LargeOccluderScratch> {
        let speaks = view.check().is_ok() && crate::large_occluder::is_ball(region);
        self.speaker = if speaks { Speaker::Large } else { Speaker::Nothing };
        speaks.then_some(&mut self.large)
    }

    /// Likewise for a culler that draws into a query back end. The back end is kept while its kind is.
    pub(crate) fn begin_query(
        &mut self,
        view: &View,
        region: EyeRegion,
        kind: QueryKind,
        occupancy: Occupancy,
    ) -> Option<(&mut CpuQuery, &mut CplpScratch)> {
        if !self.speak(Speaker::Query, view, region) {
            return None;
        }
        let (_, query) = match self.query.take() {
            Some(kept) if kept.0 == (kind, occupancy) => self.query.insert(kept),
            _ => self.query.insert(((kind, occupancy), kind.back_end().with_occupancy(occupancy))),
        };
        Some((query, &mut self.cplp))
    }

    /// An under-estimating image of `view` that speaks from now on, and cPLP's part.
    pub(crate) fn under(&mut self, occluders: &Arc<Occluders>, view: &View) -> (&mut UnderOcclusion, &mut CplpScratch) {
        self.speaker = Speaker::Under;
        let kept = self.under.take().and_then(|under| under.aimed(occluders, view));
        let under = kept.unwrap_or_else(|| UnderOcclusion::single(Arc::clone(occluders), view));
        (self.under.insert(under), &mut self.cplp)
    }

    /// Whether an image that is sampled from the view's own eye can speak for a region; it does from now on if so. No image
    /// speaks for a view that makes no sense.
    fn speak(&mut self, speaker: Speaker, view: &View, region: EyeRegion) -> bool {
        let speaks = region == EyeRegion::point(view.eye) && view.check().is_ok();
        self.speaker = if speaks { speaker } else { Speaker::Nothing };
        speaks
    }
}

/// The occlusion of an empty world without edges.
#[derive(Clone, Copy, Debug)]
pub struct NothingHidden;

impl Occlusion for NothingHidden {
    fn hides(&self, _: &Bound) -> bool {
        false
    }
}
