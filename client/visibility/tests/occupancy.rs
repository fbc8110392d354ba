//! Occupancy maps spare queries and change no picture (Staneker, Bartz & Meißner 2003).

mod made;

use std::sync::Arc;

use eyeline_visibility::{
    Budget, Cplp, CplpCuller, CplpQueryCuller, Culled, Culler, EyeRegion, HierarchicalZ, Occupancy, Octree,
    OctreeRules, QueryFrontToBack, QueryKind, Resolution, Scene, Scratch, View, exact_set, wrong_pixels,
};
use rand::SeedableRng;
use rand_pcg::Pcg64;

fn views(side: u32, count: usize) -> Vec<View> {
    let mut rng = Pcg64::seed_from_u64(51);
    (0..count).map(|_| made::visitor(&mut rng, side, Resolution::new(256, 256))).collect()
}

fn cull(culler: &dyn Culler, view: &View, scratch: &mut Scratch) -> Culled {
    culler.cull(view, EyeRegion::point(view.eye), scratch)
}

/// A name, a culler, and the same with a map.
type Pair = (&'static str, Box<dyn Culler>, Box<dyn Culler>);

/// Kept triangles, and pixels queried of what was seen.
fn sums(culler: &dyn Culler, scene: &Scene, views: &[View]) -> [u64; 2] {
    let mut scratch = Scratch::default();
    views.iter().fold([0; 2], |[kept, pixels], view| {
        let culled = cull(culler, view, &mut scratch);
        let (_, items) = exact_set(scene, view);
        assert_eq!(wrong_pixels(scene, view, &culled.visible, &items), 0);
        [kept + culled.visible.len() as u64, pixels + culled.traversal.seen_z_tests]
    })
}

#[test]
fn one_map_keeps_every_answer_where_each_cell_is_asked_alone() {
    let scene = Arc::new(made::building(6, 10, 1));
    let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
    let cplp = Arc::new(Cplp::new(octree.clone()));
    let front_to_back = QueryFrontToBack::new(scene.clone(), octree.clone());
    let pyramid = HierarchicalZ::new(scene.clone(), octree);
    let sampled = CplpCuller::new(scene.clone(), cplp.clone(), Budget::default());
    let single = CplpQueryCuller::new(scene.clone(), cplp, Budget::default(), QueryKind::OneAtATime);
    let pairs: [Pair; 3] = [
        ("front to back", Box::new(front_to_back.clone()), Box::new(front_to_back.with_occupancy(Occupancy::Single))),
        ("hierarchical Z", Box::new(pyramid.clone()), Box::new(pyramid.with_occupancy_map(true))),
        ("cPLP", Box::new(sampled.clone()), Box::new(sampled.with_occupancy_map(true))),
    ];
    let (mut scratch, mut other) = (Scratch::default(), Scratch::default());
    for (name, without, with) in &pairs {
        let [mut before, mut after] = [0; 2];
        for view in views(6, 20) {
            let (a, b) = (cull(&**without, &view, &mut scratch), cull(&**with, &view, &mut other));
            assert_eq!(a.visible, b.visible, "{name} {view:?}");
            before += a.traversal.seen_z_tests;
            after += b.traversal.seen_z_tests;
        }
        assert!(after < before, "{name}: {after} of {before}");
    }
    let [kept, pixels] = sums(&single, &scene, &views(6, 10));
    let [with_kept, with_pixels] = sums(&single.with_occupancy(Occupancy::Single), &scene, &views(6, 10));
    // Nearest corners come first here, and the least solid cell does there.
    assert!(
        with_kept * 100 <= kept * 102 && with_pixels * 100 <= pixels * 45,
        "{with_kept} {with_pixels} {kept} {pixels}"
    );
}

#[test]
fn maps_spare_pixels_and_batches_keep_fewer_than_whole_fronts() {
    let scene = Arc::new(made::building(6, 10, 2));
    let cplp = Arc::new(Cplp::build(&scene, OctreeRules::default()));
    for kind in [QueryKind::PerFragmentHistogram, QueryKind::ItemBuffer, QueryKind::Histogram] {
        let culler = CplpQueryCuller::new(scene.clone(), cplp.clone(), Budget::default(), kind);
        let [off, single, batched] = [Occupancy::Off, Occupancy::Single, Occupancy::Batched]
            .map(|occupancy| sums(&culler.clone().with_occupancy(occupancy), &scene, &views(6, 10)));
        assert!(
            off[1] > 0 && single[1] * 100 <= off[1] * 45 && batched[1] * 100 <= off[1] * 45,
            "{kind}: {off:?} {single:?} {batched:?}"
        );
        assert!(batched[0] <= single[0] && single[0] <= off[0], "{kind}: {off:?} {single:?} {batched:?}");
    }
}
