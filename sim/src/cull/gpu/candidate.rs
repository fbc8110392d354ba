//! Cullers of a graphics adapter as entries of the registry.

use std::sync::Arc;

use eyeline_client::gpu::{AdapterChoice, Gpu, GpuCuller, GpuError, GpuPicture, GpuQuery, GpuQueryKind, GpuScene};
use eyeline_visibility::{Budget, Culled, EyeRegion, Occlusion, Occupancy, Scene, View};

use crate::cull::candidate::Candidate;
use crate::cull::registry::{Budgets, Entry, Setting};
use crate::cull::shop::{KD_TREE, OCTREE, PRISMS, Shop};

/// A scene on an adapter.
#[derive(Clone, Debug)]
pub(in crate::cull) struct Uploaded {
    gpu: Arc<Gpu>,
    scene: Arc<GpuScene>,
}

impl Uploaded {
    pub(in crate::cull) fn new(scene: &Scene) -> Result<Uploaded, GpuError> {
        let gpu = Arc::new(Gpu::offscreen(AdapterChoice::Best)?);
        let scene = Arc::new(GpuScene::new(&gpu, scene)?);
        Ok(Uploaded { gpu, scene })
    }
}

/// What PLP may draw by guess where nothing is asked for. Each round waits for the adapter, so that a guess is worth more than on a
/// CPU.
const BUDGET: &str = "1000";

/// Nodes that the octree's walk asks about at a time.
const NODES: usize = 64;

const QUERIES: &[&str] = &[
    GpuQueryKind::PerFragment.name(),
    GpuQueryKind::OcclusionQueries.name(),
    GpuQueryKind::ItemBuffer.name(),
    GpuQueryKind::ItemBufferTiled.name(),
    GpuQueryKind::Histogram.name(),
    GpuQueryKind::ZPyramid.name(),
    GpuQueryKind::OneAtATime.name(),
];

const PYRAMID: &[&str] = &[GpuQueryKind::ZPyramid.name()];

/// Those that answer several boxes at once.
const BATCHED: &[&str] = QUERIES.split_at(QUERIES.len() - 1).0;

pub(super) fn entries() -> Vec<Entry> {
    let cplp = Entry {
        name: "gpu-cplp",
        about: "conservative PLP by rounds, drawn and queried on a graphics adapter",
        conservative: true,
        by_rays: false,
        tessellations: &[OCTREE, KD_TREE, PRISMS],
        queries: QUERIES,
        budget: Budgets::Given(BUDGET),
        make: |shop, setting| cplp(shop, setting, Occupancy::Off),
    };
    vec![
        cplp,
        Entry {
            name: "gpu-cplp-occupancy",
            about: "the same, with a map of where was drawn that spares queries of cells that are certainly seen (Staneker)",
            make: |shop, setting| self::cplp(shop, setting, Occupancy::Single),
            ..cplp
        },
        Entry {
            name: "gpu-cplp-batches",
            about: "the same, with four more maps that arrange what is left of a front into batches",
            queries: BATCHED,
            make: |shop, setting| self::cplp(shop, setting, Occupancy::Batched),
            ..cplp
        },
        Entry {
            name: "gpu-hierarchical-z",
            about: "an octree against a pyramid of farthest depths on a graphics adapter, 64 nodes at a time (Greene)",
            tessellations: &[OCTREE],
            queries: PYRAMID,
            budget: Budgets::None,
            make: |shop, setting| {
                let (scene, octree) = (shop.scene(), shop.octree());
                made(shop, setting, |query| GpuCuller::hierarchical_z(scene, octree, NODES, query))
            },
            ..cplp
        },
    ]
}

fn cplp(shop: &mut Shop, setting: &Setting, occupancy: Occupancy) -> Box<dyn Candidate> {
    let budget = Budget { triangles: shop.budget(setting) };
    let (scene, cplp) = (shop.scene(), shop.cplp(setting));
    let candidate = |query| GpuCuller::cplp(scene, cplp, budget, query, occupancy);
    made(shop, setting, candidate)
}

/// A culler over the query back end of a setting, or a candidate that says why there is none.
fn made(shop: &mut Shop, setting: &Setting, culler: impl FnOnce(GpuQuery) -> GpuCuller) -> Box<dyn Candidate> {
    let triangles = shop.scene().triangles().len() as u32;
    let kind = setting.query.and_then(GpuQueryKind::from_name).unwrap_or(GpuQueryKind::PerFragment);
    let budget = setting.budget.as_ref().map(|_| shop.budget(setting));
    let mut parts = || {
        let Uploaded { gpu, scene } = shop.gpu()?;
        let query = GpuQuery::new(gpu.clone(), scene.clone(), kind).map_err(|error| error.to_string())?;
        let picture = GpuPicture::new(gpu, scene).map_err(|error| error.to_string())?;
        Ok((query, picture))
    };
    match parts() {
        Ok((query, picture)) => {
            Box::new(OnGpu { culler: culler(query), picture, triangles, budget, whole: None, fault: None, bytes: 0 })
        }
        Err(why) => Box::new(Missing(why)),
    }
}

/// A culler on an adapter, and the adapter's own pictures beside it.
struct OnGpu {
    culler: GpuCuller,
    picture: GpuPicture,
    triangles: u32,
    budget: Option<usize>,
    /// The picture of everything in the view that was asked about last: the same for one view's repeats.
    whole: Option<(View, Vec<u32>)>,
    fault: Option<String>,
    /// Read back by the last cull.
    bytes: u64,
}

impl OnGpu {
    fn everything(&self) -> Vec<u32> {
        (0..self.triangles).collect()
    }

    fn pictures(&mut self, view: &View, visible: &[u32]) -> Result<[Vec<u32>; 2], GpuError> {
        let whole = match self.whole.take() {
            Some((of, whole)) if of == *view => whole,
            _ => self.picture.winners(view, &self.everything())?,
        };
        self.whole = Some((*view, whole.clone()));
        Ok([whole, self.picture.winners(view, visible)?])
    }
}

impl Candidate for OnGpu {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        let before = self.culler.query().stats().bytes;
        let culled = self.culler.cull(view, region);
        self.bytes = self.culler.query().stats().bytes - before;
        culled.unwrap_or_else(|error| {
            self.fault.get_or_insert(error.to_string());
            Culled { visible: self.everything(), ..Culled::default() }
        })
    }

    fn occlusion(&self) -> &dyn Occlusion {
        self.culler.occlusion()
    }

    fn budget(&self) -> Option<usize> {
        self.budget
    }

    fn own_pictures(&mut self, view: &View, visible: &[u32]) -> Option<[Vec<u32>; 2]> {
        match self.pictures(view, visible) {
            Ok(pictures) => Some(pictures),
            Err(error) => {
                self.fault.get_or_insert(error.to_string());
                None
            }
        }
    }

    fn read_back_bytes(&self) -> Option<u64> {
        Some(self.bytes)
    }

    fn fault(&self) -> Option<String> {
        self.fault.clone()
    }
}

/// What stands where an adapter cannot do what was asked for.
struct Missing(String);

impl Candidate for Missing {
    fn cull(&mut self, _: &View, _: EyeRegion) -> Culled {
        Culled::default()
    }

    fn occlusion(&self) -> &dyn Occlusion {
        unreachable!("a candidate with a fault is left out")
    }

    fn fault(&self) -> Option<String> {
        Some(self.0.clone())
    }
}
