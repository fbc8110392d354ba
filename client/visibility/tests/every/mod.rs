//! Every culler over one scene, and the check that all of them must pass: each view's exact set is found once, and asked of all.

#![allow(dead_code, reason = "each user takes what it needs")]

use std::sync::Arc;

use eyeline_visibility::{
    Budget, Cplp, CplpCuller, CplpQueryCuller, Culler, EyeRegion, FrustumBackface, HierarchicalZ, KdRules, KdTree,
    LargeOccluder, LargeOccluderRules, MaskedCplp, Occluders, Occupancy, Octree, OctreeRules, Prisms, QueryFrontToBack,
    QueryKind, RegionCuller, Scene, Scratch, Tessellation, View, ZBuffer, exact_set, wrong_pixels,
};

/// A culler and what failures call it.
pub type Named = (String, Box<dyn Culler>);

fn named(name: impl Into<String>, culler: impl Culler + 'static) -> Named {
    (name.into(), Box::new(culler))
}

/// Both kinds of cells over a scene, by default rules.
pub fn tessellations(scene: &Arc<Scene>) -> (Arc<Octree>, Arc<KdTree>) {
    (Arc::new(Octree::build(scene, OctreeRules::default())), Arc::new(KdTree::build(scene, KdRules::default())))
}

/// [`cullers`] and [`odd_cullers`].
pub fn all(scene: &Arc<Scene>) -> Vec<Named> {
    let mut cullers = cullers(scene);
    cullers.extend(odd_cullers(scene));
    cullers
}

/// Every culler by default, over one octree and one kD-tree.
pub fn cullers(scene: &Arc<Scene>) -> Vec<Named> {
    let (octree, kd) = tessellations(scene);
    let in_octree = Arc::new(Cplp::new(octree.clone()));
    let in_kd = Arc::new(Cplp::new(kd.clone()));
    let occluders = Arc::new(Occluders::build(scene));
    let mut cullers = vec![
        named("ZB", ZBuffer::new(scene.clone())),
        named("VF-BF", FrustumBackface::new(scene.clone())),
        named("cPLP", CplpCuller::new(scene.clone(), in_octree.clone(), Budget::default())),
        named("cPLP in a kD-tree", CplpCuller::new(scene.clone(), in_kd.clone(), Budget::default())),
        named("front to back", QueryFrontToBack::new(scene.clone(), octree.clone())),
        named("hierarchical Z", HierarchicalZ::new(scene.clone(), octree.clone())),
        named(
            "hierarchical Z, mapped",
            HierarchicalZ::new(scene.clone(), octree.clone()).with_occupancy(Occupancy::Single),
        ),
        named(
            "cPLP, mapped",
            CplpCuller::new(scene.clone(), in_octree.clone(), Budget::default()).with_occupancy(Occupancy::Single),
        ),
        named("large occluders", LargeOccluder::build(scene.clone())),
        named(FROM_A_REGION, RegionCuller::new(scene.clone(), in_kd, occluders, 64 * 64)),
    ];
    let octree_again = octree.clone();
    cullers.extend(masked(scene, octree, "an octree"));
    cullers.extend(masked(scene, kd, "a kD-tree"));
    for query in QueryKind::ALL {
        let culler = CplpQueryCuller::new(scene.clone(), in_octree.clone(), Budget::default(), query);
        cullers.push(named(query.name(), culler.clone()));
        for occupancy in [Occupancy::Single, Occupancy::Always, Occupancy::Batched] {
            let name = format!("{}, {occupancy:?}", query.name());
            cullers.push(named(name, culler.clone().with_occupancy(occupancy)));
        }
    }
    for occupancy in [Occupancy::Single, Occupancy::Batched] {
        let culler = QueryFrontToBack::new(scene.clone(), octree_again.clone()).with_occupancy(occupancy);
        cullers.push(named(format!("front to back, {occupancy:?}"), culler));
    }
    cullers.extend(in_prisms(scene));
    cullers
}

/// What walks any cells, over prisms: none where the scene has no storeys.
pub fn in_prisms(scene: &Arc<Scene>) -> Vec<Named> {
    let Ok(prisms) = Prisms::build(scene).map(Arc::new) else { return Vec::new() };
    let cplp = Arc::new(Cplp::new(prisms.clone()));
    let query = CplpQueryCuller::new(scene.clone(), cplp.clone(), Budget::default(), QueryKind::ItemBufferTiled);
    vec![
        named("cPLP in prisms", CplpCuller::new(scene.clone(), cplp.clone(), Budget::default())),
        named("cPLP 0 in prisms", CplpCuller::new(scene.clone(), cplp.clone(), Budget { triangles: 0 })),
        named("item-buffer-tiled in prisms", query.clone()),
        named("item-buffer-tiled in prisms, batched", query.with_occupancy(Occupancy::Batched)),
        named("front to back in prisms", QueryFrontToBack::new(scene.clone(), prisms.clone())),
        named("masks instead of prisms", MaskedCplp::new(scene.clone(), prisms)),
    ]
}

/// Walks against coverage masks with all, the default, and no occluders.
fn masked(scene: &Arc<Scene>, cells: Arc<dyn Tessellation>, of: &str) -> Vec<Named> {
    let culler = |occluder_px| MaskedCplp::new(scene.clone(), cells.clone()).with_occluder_px(occluder_px);
    [0.0, 64.0, 1e9].map(|px| named(format!("masks in {of}, occluders above {px} px"), culler(px))).into()
}

/// cPLP and masks over odd cells and budgets: small cells, no seals to speak of, nothing by guess, everything by guess.
pub fn odd_cullers(scene: &Arc<Scene>) -> Vec<Named> {
    let mut cullers = Vec::new();
    let octree = Octree::build(scene, OctreeRules::default().with_max_triangles_per_leaf(6).with_max_depth(6));
    let kd = KdRules::default().with_max_triangles_per_leaf(6).with_min_obscuration(0.1);
    let cells: [(&str, Arc<dyn Tessellation>); 3] = [
        ("small cells", Arc::new(octree)),
        ("a kD-tree of small cells", Arc::new(KdTree::build(scene, kd))),
        ("a kD-tree without skin", Arc::new(KdTree::build(scene, kd.with_skin(0.0)))),
    ];
    let rules = LargeOccluderRules::default().with_cells(kd.with_skin(0.0)).with_area_min(0.0);
    cullers.push(named("large occluders, small cells", LargeOccluder::new(scene.clone(), rules.with_occluders(64))));
    cullers.push(named("large occluders, one each", LargeOccluder::new(scene.clone(), rules.with_occluders(1))));
    for (name, cells) in cells {
        let cplp = Arc::new(Cplp::new(cells.clone()));
        for triangles in [0, 50, usize::MAX] {
            let culler = CplpCuller::new(scene.clone(), cplp.clone(), Budget { triangles });
            cullers.push(named(format!("cPLP {triangles} in {name}"), culler));
        }
        let query = QueryKind::PerFragmentHistogram;
        let culler = CplpQueryCuller::new(scene.clone(), cplp, Budget { triangles: 0 }, query);
        cullers.push(named(format!("{} in {name}", query.name()), culler));
        cullers.extend(masked(scene, cells, name));
    }
    cullers
}

/// Whether a culler answers for the picture of a view. All do but [`RegionCuller`], which speaks of true triangles: from
/// farther than this, depths in f32 tie over more than the thickness of a wall, and what wins a tie in the picture is hidden in
/// truth.
fn answers_for(name: &str, view: &View) -> bool {
    name != FROM_A_REGION || view.eye.length() < 1e6
}

/// Whether a culler answers for balls of eyes too; others keep everything then.
pub fn answers_for_balls(name: &str) -> bool {
    name == FROM_A_REGION || name.starts_with("large occluders")
}

/// Whether a culler has an image that moving things can be drawn into. Planes and shrunken polygons have none.
pub fn has_an_image(name: &str) -> bool {
    !answers_for_balls(name)
}

/// The name of the [`RegionCuller`].
pub const FROM_A_REGION: &str = "from a region";

/// What a check came to.
#[derive(Debug, Default)]
pub struct Checked {
    pub views: usize,
    /// Primitives that own a pixel, summed over the views.
    pub exact: usize,
    /// Primitives kept, summed over the views, per culler.
    pub kept: Vec<(String, usize)>,
}

/// Panics unless each culler keeps what is exactly visible in each view. `scratch` may come from any scene.
pub fn check(
    scene: &Scene,
    cullers: &[Named],
    views: impl IntoIterator<Item = View>,
    scratch: &mut Scratch,
) -> Checked {
    let mut checked =
        Checked { kept: cullers.iter().map(|(name, _)| (name.clone(), 0)).collect(), ..Checked::default() };
    let mut faults = Vec::new();
    for view in views {
        let (exact, items) = exact_set(scene, &view);
        checked.views += 1;
        checked.exact += exact.len();
        for ((name, culler), (_, kept)) in cullers.iter().zip(&mut checked.kept) {
            let visible = culler.cull(&view, EyeRegion::point(view.eye), scratch).visible;
            assert!(visible.is_sorted_by(|a, b| a < b), "{name} from {view:?}");
            assert!(
                visible.last().is_none_or(|&last| (last as usize) < scene.triangles().len()),
                "{name} from {view:?}"
            );
            if !answers_for(name, &view) {
                continue;
            }
            let missing: Vec<&u32> = exact.iter().filter(|id| visible.binary_search(id).is_err()).collect();
            if !missing.is_empty() {
                faults.push(format!("{name} misses {missing:?} of {} from {view:?}", exact.len()));
                continue;
            }
            *kept += visible.len();
            // A superset of the winners has the same winners, so a few views confirm it.
            if checked.views % 16 == 1 {
                assert_eq!(wrong_pixels(scene, &view, &visible, &items), 0, "{name} from {view:?}");
            }
        }
    }
    // All of them: which cullers fail, and from where, says more than the first.
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
    checked
}
