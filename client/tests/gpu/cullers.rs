//! Cullers on an adapter lose nothing of its own picture.

use std::sync::Arc;

use eyeline_client::gpu::{Gpu, GpuCuller, GpuPicture, GpuQuery, GpuQueryKind};
use eyeline_visibility::{Budget, Cplp, EyeRegion, KdRules, KdTree, Occupancy, Octree, OctreeRules, Resolution, Scene};

use crate::{gpu_or_skip, made};

const RESOLUTION: Resolution = Resolution::new(128, 96);

/// Whether its depths are asked box by box, so that all such kinds report the same.
const fn is_exact(kind: GpuQueryKind) -> bool {
    !matches!(kind, GpuQueryKind::ZPyramid | GpuQueryKind::OneAtATime)
}

fn compare(gpu: &Arc<Gpu>, scene: Scene, seed: u64, occupancies: &[Occupancy]) {
    let scene = Arc::new(scene);
    let uploaded = made::uploaded(gpu, &scene);
    let octree = Arc::new(Octree::build(&scene, OctreeRules::default().with_max_triangles_per_leaf(40)));
    let kd_tree = Arc::new(KdTree::build(&scene, KdRules::default()));
    let query = |kind| GpuQuery::new(Arc::clone(gpu), Arc::clone(&uploaded), kind).unwrap();
    let mut cullers = Vec::new();
    for &occupancy in occupancies {
        for kind in GpuQueryKind::ALL {
            let cplp = Arc::new(Cplp::new(kd_tree.clone()));
            let culler = GpuCuller::cplp(scene.clone(), cplp, Budget { triangles: 60 }, query(kind), occupancy);
            cullers.push((format!("{occupancy:?} {kind}"), (is_exact(kind)).then_some(occupancy), culler));
        }
    }
    for kind in [GpuQueryKind::ZPyramid, GpuQueryKind::PerFragment] {
        let culler = GpuCuller::hierarchical_z(scene.clone(), octree.clone(), 16, query(kind));
        cullers.push((format!("octree {kind}"), None, culler));
    }
    let mut picture = GpuPicture::new(Arc::clone(gpu), uploaded).unwrap();
    let everything = made::all(&scene);
    let (mut kept, mut exact_total, mut rounds) = (vec![0; cullers.len()], 0, vec![0; cullers.len()]);
    let views = made::views(seed, 8, RESOLUTION);
    for view in &views {
        let whole = picture.winners(view, &everything).unwrap();
        let exact = GpuPicture::owners(&whole);
        exact_total += exact.len();
        let mut same: Vec<(Occupancy, Vec<u32>)> = Vec::new();
        for (at, (name, sameness, culler)) in cullers.iter_mut().enumerate() {
            let visible = culler.cull(view, EyeRegion::point(view.eye)).unwrap().visible;
            let lost: Vec<u32> = exact.iter().copied().filter(|id| visible.binary_search(id).is_err()).collect();
            assert!(lost.is_empty(), "{name} lost {lost:?} in {view:?}");
            assert!(picture.winners(view, &visible).unwrap() == whole, "{name} looks different in {view:?}");
            kept[at] += visible.len();
            rounds[at] += culler.rounds().traversal.rounds;
            if let Some(occupancy) = sameness {
                match same.iter().find(|(of, _)| of == occupancy) {
                    Some((_, other)) => assert!(visible == *other, "{name} reports another set in {view:?}"),
                    None => same.push((*occupancy, visible)),
                }
            }
        }
    }
    let all = everything.len() * views.len();
    for ((name, ..), (kept, rounds)) in cullers.iter().zip(kept.iter().zip(&rounds)) {
        println!("{name}: kept {kept} of {all}, exact {exact_total}, {rounds} rounds");
        assert!(*kept * 2 < all && *kept >= exact_total, "{name}: {kept} of {all}");
        assert!(*rounds >= views.len() - 1, "{name}: {rounds}");
    }
}

#[test]
fn nothing_of_the_adapter_s_own_picture_is_lost() {
    let Some(gpu) = gpu_or_skip("nothing_of_the_adapter_s_own_picture_is_lost") else { return };
    compare(&gpu, made::rooms(21), 22, &[Occupancy::Off]);
}

#[test]
fn nor_with_occupancy_maps() {
    let Some(gpu) = gpu_or_skip("nor_with_occupancy_maps") else { return };
    compare(&gpu, made::rooms(23), 24, &[Occupancy::Single, Occupancy::Batched]);
}

/// That the comparison can fail: a picture without some of what is visible is another.
#[test]
fn what_is_left_out_is_missed() {
    let Some(gpu) = gpu_or_skip("what_is_left_out_is_missed") else { return };
    let scene = made::rooms(25);
    let mut picture = GpuPicture::new(Arc::clone(&gpu), made::uploaded(&gpu, &scene)).unwrap();
    let view = made::views(26, 1, RESOLUTION)[0];
    let whole = picture.winners(&view, &made::all(&scene)).unwrap();
    let owners = GpuPicture::owners(&whole);
    assert!(owners.len() > 5, "{owners:?}");
    assert!(picture.winners(&view, &owners).unwrap() == whole);
    assert!(picture.winners(&view, &owners[1..]).unwrap() != whole);
}
