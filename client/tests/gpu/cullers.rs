//! Cullers on an adapter lose nothing of its own picture.

use std::sync::Arc;

use eyeline_client::gpu::{Gpu, GpuCuller, GpuPicture, GpuQuery, GpuQueryKind};
use eyeline_visibility::{
    Bound, Budget, Cplp, EyeRegion, KdRules, KdTree, Occupancy, Octree, OctreeRules, Resolution, Scene, Triangle,
};
use glam::DVec3;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::{gpu_or_skip, made};

const RESOLUTION: Resolution = Resolution::new(128, 96);

/// Whether its depths are asked box by box, so that all such kinds report the same. Tiles that are finished leave out what a box shows there
/// only because it is drawn larger than it is.
const fn is_exact(kind: GpuQueryKind) -> bool {
    !matches!(kind, GpuQueryKind::ZPyramid | GpuQueryKind::OneAtATime | GpuQueryKind::ItemBufferTiled)
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
    let bytes = |name: &str| {
        let of = cullers.iter().filter(|(known, ..)| known.ends_with(&format!(" {name}")));
        of.map(|(.., culler)| culler.query().stats().bytes).collect::<Vec<u64>>()
    };
    for (tiled, whole) in bytes("gpu-item-buffer-tiled").into_iter().zip(bytes("gpu-item-buffer")) {
        // Images of four tiles: with more of them the share is smaller.
        println!("read back: {tiled} bytes by tiles, {whole} of whole images");
        assert!(tiled * 10 < whole * 9, "{tiled} of {whole} bytes read back");
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

/// A ball around something that owns a pixel is never hidden, nor is one of which nothing is known; most of what is behind walls is.
#[test]
fn a_bound_of_what_owns_a_pixel_is_never_hidden() {
    let Some(gpu) = gpu_or_skip("a_bound_of_what_owns_a_pixel_is_never_hidden") else { return };
    let scene = Arc::new(made::rooms(27));
    let kd_tree = Arc::new(KdTree::build(&scene, KdRules::default()));
    let uploaded = made::uploaded(&gpu, &scene);
    let query = |kind| GpuQuery::new(Arc::clone(&gpu), Arc::clone(&uploaded), kind).unwrap();
    let mut cullers = GpuQueryKind::ALL.map(|kind| {
        let cplp = Arc::new(Cplp::new(kd_tree.clone()));
        GpuCuller::cplp(scene.clone(), cplp, Budget { triangles: 60 }, query(kind), Occupancy::Off)
    });
    let mut rng = Pcg64Mcg::seed_from_u64(28);
    // Somebody in each ball: a small box that stands anywhere in it.
    let things: Vec<(Bound, [Triangle; 12])> = (0..200)
        .map(|_| {
            let mut any = |low: f64, high: f64| rng.random_range(low..high);
            let (centre, radius) = (DVec3::new(any(0.5, 19.5), any(0.3, 2.7), any(0.5, 19.5)), any(0.2, 0.6));
            let at = centre + DVec3::new(any(-1.0, 1.0), any(-1.0, 1.0), any(-1.0, 1.0)) * radius * 0.3;
            (Bound::Sphere { centre, radius }, made::closed_box(at.as_vec3(), radius as f32 * 0.25))
        })
        .collect();
    let bounds: Vec<Bound> = things.iter().map(|(bound, _)| *bound).collect();
    let with: Vec<Triangle> =
        scene.triangles().iter().copied().chain(things.iter().flat_map(|(_, thing)| *thing)).collect();
    let with = Scene::from_triangles(with);
    let first = scene.triangles().len() as u32;
    let mut picture = GpuPicture::new(Arc::clone(&gpu), made::uploaded(&gpu, &with)).unwrap();
    let (mut owning, mut hidden_total, mut total) = (0, 0, 0);
    for view in made::views(29, 8, RESOLUTION) {
        let owners = GpuPicture::owners(&picture.winners(&view, &made::all(&with)).unwrap());
        let owns: Vec<bool> = (0..things.len() as u32)
            .map(|thing| (0..12).any(|side| owners.binary_search(&(first + 12 * thing + side)).is_ok()))
            .collect();
        owning += owns.iter().filter(|owns| **owns).count();
        for culler in &mut cullers {
            let kind = culler.query().kind();
            culler.cull(&view, EyeRegion::point(view.eye)).unwrap();
            let mut hidden = Vec::new();
            culler.hidden(&bounds, &mut hidden).unwrap();
            assert!(
                hidden.iter().zip(&owns).all(|(hidden, owns)| !(*hidden && *owns)),
                "{kind} hides somebody in {view:?}"
            );
            hidden_total += hidden.iter().filter(|hidden| **hidden).count();
            total += hidden.len();
            // Nothing is known of these.
            let odd = [
                Bound::Everywhere,
                Bound::Sphere { centre: DVec3::NAN, radius: 1.0 },
                Bound::Sphere { centre: view.eye, radius: -1.0 },
            ];
            culler.hidden(&odd, &mut hidden).unwrap();
            assert_eq!(hidden, [false; 3], "{kind}");
            // Nor of any, if the last cull spoke for no single eye.
            culler.cull(&view, EyeRegion { centre: view.eye, radius: 0.1 }).unwrap();
            culler.hidden(&bounds, &mut hidden).unwrap();
            assert!(!hidden.contains(&true), "{kind}");
        }
    }
    println!("{owning} own a pixel, {hidden_total} of {total} hidden");
    assert!(owning > 20 && hidden_total * 2 > total, "{owning} own a pixel, {hidden_total} of {total} hidden");
}
