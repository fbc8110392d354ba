//! *View + scene → visible set*: scenes from glTF files and cullers over them.
//!
//! Nothing here knows of a network, a clock or another thread; it is worth using alone. The words are the papers'
//! (Klosowski & Silva 2000 and 2001, Staneker 2003, Coorg & Teller 1997, Sudarsky & Gotsman 1999).
//!
//! World: metres, right-handed, +Y up, −Z forward (glTF's convention). Inside a [`Scene`] every position is relative
//! to the scene's `anchor`.

mod all_round;
mod all_round_cells;
mod bound;
mod camera_path;
mod closers;
mod clusters;
mod cplp;
mod culler;
mod delaunay;
mod dynamic_index;
mod facets;
mod flat_index;
mod front;
mod front_to_back;
mod frustum;
mod hierarchical_z;
mod id_map;
mod kd_tree;
mod large_occluder;
mod load;
mod masked;
mod masked_cplp;
mod model_share;
mod occluder_tree;
mod occluders;
mod occlusion;
mod occupancy_map;
mod octree;
mod octree_rounds;
mod plan;
mod plp;
mod plp_auto;
mod plp_cells;
mod plp_coverage;
mod plp_culler;
mod plp_rules;
mod portals;
mod prisms;
mod pyramid;
mod query;
mod raster_sampled;
mod ray;
mod region_culler;
mod rounds;
mod scene;
mod scratch;
mod sealed;
mod sealed_parts;
mod shaft;
mod sheets;
mod split_octree;
mod storeys;
mod tessellation;
mod tessellation_file;
mod under;
mod under_extent;
mod under_face;
mod under_region;
mod view;
mod wedge;

pub use all_round::{AllRound, AllRoundScratch, AllRoundStats};
pub use all_round_cells::{AllRoundCells, AllRoundCellsScratch};
pub use bound::{Aabb, Bound};
pub use camera_path::{Camera, CameraPath, CameraPathError, CameraStop};
pub use clusters::{CellClusters, Clusters};
pub use cplp::{Budget, Cplp, CplpScratch, Traversal};
pub use culler::{CplpCuller, Culled, Culler, FrustumBackface, ZBuffer, exact_set, wrong_pixels};
pub use delaunay::{Delaunay, DelaunayError, DelaunayRules};
pub use dynamic_index::DynamicOctree;
pub use flat_index::FlatIndex;
pub use front_to_back::QueryFrontToBack;
pub use frustum::Frustum;
pub use hierarchical_z::HierarchicalZ;
pub use id_map::IdMap;
pub use kd_tree::{KdRules, KdStats, KdTree};
pub use large_occluder::{LargeOccluder, LargeOccluderRules, LargeOccluderScratch, LargeOccluderStats};
pub use load::{
    Alpha, BONES_MAX, Bone, Carried, Clip, Curve, EncodedImage, Joint, LoadError, LoadOptions, LoadStats, Looks,
    Material, Part, Place, Rig, TextureUse, Track, TriangleLook, Wrap, load_file, load_file_with_looks,
    load_file_with_stats, load_glb, load_glb_with_looks, load_glb_with_stats, load_rig_file, load_rig_glb, pack_glb,
};
pub use masked::{Coverage, MaskedDepth, MaskedStats, SimdLevel};
pub use masked_cplp::{MaskedCplp, MaskedCplpScratch};
pub use model_share::{ModelShare, model_shares};
pub use occluders::Occluders;
pub use occlusion::{DynamicIndex, Occlusion, Open, Target};
pub use occupancy_map::{Batches, Occupancy, OccupancyMap, OccupancyQuery};
pub use octree::{Octree, OctreeRules};
pub use octree_rounds::OctreeRounds;
pub use plan::{Drawing, Hysteresis, Planned, PlannedRules, PlannedStats, SceneCounts, ViewCounts};
pub use plp::{Plp, PlpScratch, PlpStep, PlpTraversal};
pub use plp_auto::{AutoBudget, AutoBudgetRules};
pub use plp_cells::PlpCells;
pub use plp_culler::{CentroidOrder, PlpCuller};
pub use plp_rules::{PlpRules, Requeue, Seeds, Solidity, SolidityMax, Transfer};
pub use prisms::{Prisms, PrismsError};
pub use query::{
    CplpQueryCuller, CpuQuery, HistogramQuery, ItemBufferQuery, OneAtATimeQuery, PerFragmentHistogram, PlacedBox,
    QueryBackEnd, QueryCost, QueryKind, TILE_SIDE,
};
pub use raster_sampled::{BoxOnImage, DepthBuffer, ItemBuffer, PixelRect, SampledTarget};
pub use ray::{Hit, RayScene, image_ray, pixel_ray};
pub use region_culler::RegionCuller;
pub use rounds::{Round, RoundsTraversal};
pub use scene::{Node, ObjectMesh, Scene, SceneError, Sides, Triangle};
pub use scratch::{NothingHidden, Scratch};
pub use sealed::SealedFace;
pub use sealed_parts::{PartsInSight, SealedParts};
pub use split_octree::{References, SplitOctree, SplitRules, SplitStats, Update};
pub use storeys::count_storeys;
pub use tessellation::{CellId, Cells, Face, Neighbour, Tessellation};
pub use tessellation_file::{AnyTessellation, TessellationError, TessellationFault, TessellationFileError};
pub use under::{RegionError, UnderOcclusion, UnderStats};
pub use view::{EyeRegion, Resolution, View, ViewError};
pub use wedge::Wedge;
