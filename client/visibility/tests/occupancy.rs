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

/// A name, a culler, and the same with a map that is given up where it does not pay, and with one that is not.
type Mapped = (&'static str, Box<dyn Culler>, [Box<dyn Culler>; 2]);

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
    // Small cells, so that there are enough in a view for a map to be given up.
    let octree = Arc::new(Octree::build(&scene, OctreeRules::default().with_max_triangles_per_leaf(8)));
    let cplp = Arc::new(Cplp::new(octree.clone()));
    let front_to_back = QueryFrontToBack::new(scene.clone(), octree.clone());
    let pyramid = HierarchicalZ::new(scene.clone(), octree);
    let sampled = CplpCuller::new(scene.clone(), cplp, Budget::default());
    const MAPS: [Occupancy; 2] = [Occupancy::Single, Occupancy::Always];
    let mapped: [Mapped; 3] = [
        (
            "front to back",
            Box::new(front_to_back.clone()),
            MAPS.map(|occupancy| Box::new(front_to_back.clone().with_occupancy(occupancy)) as Box<dyn Culler>),
        ),
        (
            "hierarchical Z",
            Box::new(pyramid.clone()),
            MAPS.map(|occupancy| Box::new(pyramid.clone().with_occupancy(occupancy)) as Box<dyn Culler>),
        ),
        (
            "cPLP",
            Box::new(sampled.clone()),
            MAPS.map(|occupancy| Box::new(sampled.clone().with_occupancy(occupancy)) as Box<dyn Culler>),
        ),
    ];
    let (mut scratch, mut other) = (Scratch::default(), Scratch::default());
    let mut given_up = 0;
    for (name, without, with) in &mapped {
        let mut pixels = [0; 3];
        for view in views(6, 20) {
            let plain = cull(&**without, &view, &mut scratch);
            assert_eq!(plain.traversal.mapped, [0; 2]);
            pixels[2] += plain.traversal.seen_z_tests;
            let [single, always] = [0, 1].map(|i| {
                let culled = cull(&*with[i], &view, &mut other);
                assert_eq!(culled.visible, plain.visible, "{name} {:?} {view:?}", MAPS[i]);
                pixels[i] += culled.traversal.seen_z_tests;
                culled.traversal.mapped
            });
            assert!(single[0] <= always[0] && single[1] <= always[1], "{name} {single:?} {always:?}");
            given_up += usize::from(single[0] < always[0]);
        }
        assert!(pixels[1] <= pixels[0] && pixels[0] < pixels[2], "{name}: {pixels:?}");
    }
    assert!(given_up > 0);
    let single = CplpQueryCuller::build(scene.clone(), QueryKind::OneAtATime);
    let [kept, pixels] = sums(&single, &scene, &views(6, 10));
    let [with_kept, with_pixels] = sums(&single.with_occupancy(Occupancy::Always), &scene, &views(6, 10));
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
