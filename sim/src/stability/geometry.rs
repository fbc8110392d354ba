//! Scenes and views: is everything drawn that shows, whatever the coordinates?
//!
//! Each case asks every conservative culler of the registry, over its best cells, for the visible sets of some views, and
//! holds them against the item buffer of everything. That buffer is held against f64 rays in cases of its own.

use std::sync::Arc;

use eyeline_visibility::{
    Delaunay, DelaunayRules, EyeRegion, LoadOptions, MaskedCplp, MaskedCplpScratch, RayScene, Resolution, Scene,
    SimdLevel, Tessellation, View, exact_set, image_ray, load_glb, wrong_pixels,
};
use glam::{DQuat, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::scenes::{self, triangle};
use super::{Case, Finding, Oracle};
use crate::cull::{Candidate, Registry, Setting, Shop, Sweep};

const SMALL: Resolution = Resolution::new(64, 48);
const LOST: &str = "primitives that own a pixel and were not reported, and wrong pixels, over all cullers and views";

/// All cases.
pub fn cases() -> Vec<Case> {
    let mut cases = culled();
    cases.extend(regions());
    cases.extend(rays());
    cases.extend(simd());
    cases.extend(files());
    cases
}

/// A case for every culler.
fn lost(name: &'static str, make: fn() -> (Arc<Scene>, Vec<View>)) -> Case {
    Case::new("geometry", name, LOST, Oracle::Reference, move || {
        let (scene, views) = make();
        ask_all(&scene, &views)
    })
}

/// Four views from each eye.
fn looks(eyes: &[DVec3], resolution: Resolution) -> Vec<View> {
    let turns = |&eye: &DVec3| (0..4).map(move |turn| (eye, f64::from(turn) * std::f64::consts::FRAC_PI_2));
    eyes.iter().flat_map(turns).map(|(eye, yaw)| View::level(eye, yaw, 1.5, resolution)).collect()
}

fn rooms() -> Arc<Scene> {
    scenes::rooms(3, 1.0, Vec3::ZERO)
}

fn culled() -> Vec<Case> {
    vec![
        lost("rooms as they are", || {
            (scenes::rooms(3, 1.0, Vec3::ZERO), scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 24, 1))
        }),
        lost("rooms 10^4 m from the anchor", || {
            let offset = Vec3::new(1e4, -1e4, 1e4);
            (scenes::rooms(3, 1.0, offset), scenes::visits(3, 1.0, offset.as_dvec3(), SMALL, 24, 2))
        }),
        lost("rooms 10^6 m from the anchor", || {
            let offset = Vec3::new(1e6, 0.0, 1e6);
            (scenes::rooms(3, 1.0, offset), scenes::visits(3, 1.0, offset.as_dvec3(), SMALL, 24, 3))
        }),
        lost("rooms a millimetre wide", || {
            (scenes::rooms(3, 1e-4, Vec3::ZERO), scenes::visits(3, 1e-4, DVec3::ZERO, SMALL, 24, 4))
        }),
        lost("rooms a thousand kilometres wide", || {
            (scenes::rooms(3, 1e5, Vec3::ZERO), scenes::visits(3, 1e5, DVec3::ZERO, SMALL, 24, 5))
        }),
        lost("a millimetre beside ten kilometres", || {
            let views = [0.0005, 0.01, 1.0, 300.0].map(|y| {
                let orientation = DQuat::from_rotation_x(if y < 1.0 { 0.0 } else { -0.9 });
                let near = (y * 0.01_f64).max(View::NEAR_MIN);
                let at = DVec3::new(0.013, y, 0.1);
                View { orientation, near, ..View::level(at, 0.0, 1.2, Resolution::new(96, 64)) }
            });
            (scenes::small_beside_large(), views.into())
        }),
        lost("needles a nanometre wide", || {
            let mut chance = Pcg64::seed_from_u64(6);
            let eyes: Vec<DVec3> =
                (0..6).map(|_| DVec3::from_array(std::array::from_fn(|_| chance.random_range(-6.0..6.0)))).collect();
            let views = eyes.iter().enumerate().map(|(i, &eye)| View::level(eye, i as f64, 1.5, SMALL)).collect();
            (scenes::slivers(6), views)
        }),
        lost("coplanar and duplicate faces", || {
            (scenes::coplanar(), looks(&[DVec3::new(1.0, 0.7, 1.0), DVec3::new(-3.0, 4.0, 9.0)], SMALL))
        }),
        lost("triangles without area", || (scenes::without_area(), looks(&[DVec3::ZERO, DVec3::Z], SMALL))),
        lost("eyes on vertices", || {
            let scene = rooms();
            let corners = [0, 40, 200, 500].map(|i| scene.triangles()[i].corners[0].as_dvec3());
            (scene, looks(&corners, SMALL))
        }),
        lost("eyes on edges and faces", || {
            let scene = rooms();
            let mut eyes = Vec::new();
            for i in [3, 77, 301] {
                let [a, b, c] = scene.triangles()[i].corners.map(Vec3::as_dvec3);
                eyes.extend([(a + b) * 0.5, (a + b + c) / 3.0]);
            }
            (scene, looks(&eyes, SMALL))
        }),
        lost("eyes on faces of cells", || {
            let scene = rooms();
            let cells = Shop::new(scene.clone()).octree();
            let root = cells.root();
            let middle = root.centre();
            let eyes = [
                middle,
                DVec3::new(middle.x, 1.0, 2.0),
                DVec3::new(root.min.x, 1.0, 2.0),
                root.corners()[7],
                DVec3::new(middle.x, middle.y, 5.0),
            ];
            (scene, looks(&eyes, SMALL))
        }),
        lost("eyes inside walls and furniture", || {
            let eyes = [DVec3::new(4.0, 1.0, 0.5), DVec3::new(3.2, 0.4, 1.0), DVec3::new(6.0, -0.1, 6.0)];
            (rooms(), looks(&eyes, SMALL))
        }),
        lost("eyes outside, near and far", || {
            let eyes = [DVec3::new(-1.0, 1.0, 6.0), DVec3::new(6.0, 50.0, 6.0), DVec3::new(1e6, 1.0, 6.0)];
            (rooms(), looks(&eyes, SMALL))
        }),
        lost("near planes through everything", || {
            let near = [1e-6, 0.5, 2.0, 7.0];
            let eyes = [DVec3::new(2.0, 1.0, 2.0), DVec3::new(6.0, 1.6, 6.1)];
            let views = looks(&eyes, SMALL).into_iter();
            (rooms(), views.flat_map(|view| near.map(|near| View { near, ..view })).collect())
        }),
        lost("a view of 0.1 degrees", || {
            let views = scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 24, 8).into_iter();
            (rooms(), views.map(|view| View { fov_x: 0.1_f64.to_radians(), ..view }).collect())
        }),
        lost("a view of 179 degrees", || {
            let views = scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 24, 9).into_iter();
            (rooms(), views.map(|view| View { fov_x: 179_f64.to_radians(), ..view }).collect())
        }),
        lost("looking straight down, and upside down", || {
            let turns = [DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2), DQuat::from_rotation_z(3.0)];
            let views = scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 12, 10).into_iter();
            (rooms(), views.flat_map(|view| turns.map(|orientation| View { orientation, ..view })).collect())
        }),
        lost("images of 1×1, 1×8192 and 8192×1 pixels", || {
            let sizes = [(1, 1), (1, 8192), (8192, 1)].map(|(width, height)| Resolution::new(width, height));
            let eye = DVec3::new(6.0, 1.6, 6.1);
            (rooms(), sizes.map(|resolution| View::level(eye, 0.7, 1.5, resolution)).into())
        }),
        lost("an empty scene", || (Arc::new(Scene::from_triangles(Vec::new())), looks(&[DVec3::ZERO], SMALL))),
        lost("one triangle", || {
            let one = triangle([Vec3::new(-1.0, -1.0, -2.0), Vec3::new(1.0, -1.0, -2.0), Vec3::new(0.0, 1.0, -2.0)]);
            (Arc::new(Scene::from_triangles(vec![one])), looks(&[DVec3::ZERO, DVec3::NEG_Z * 2.0], SMALL))
        }),
        lost("all in one point", || {
            (Arc::new(Scene::from_triangles(vec![triangle([Vec3::ONE; 3]); 300])), looks(&[DVec3::ZERO], SMALL))
        }),
        Case::new("geometry", "NaN in a triangle", "a refusal that names it", Oracle::Refusal, || {
            let made = Scene::try_from_triangles(vec![triangle([Vec3::NAN; 3])]);
            Finding::refusal(made, &["triangle 0", "finite"])
        }),
        Case::new("geometry", "cospherical points", "cells that share no volume, or a refusal", Oracle::Exact, || {
            cospherical()
        }),
    ]
}

/// The conservative cullers of the registry, each over its best cells.
fn candidates(scene: &Arc<Scene>) -> Vec<(Setting, Box<dyn Candidate>, bool)> {
    let registry = Registry::standard();
    let conservative = registry.entries().iter().filter(|entry| entry.conservative);
    let names = conservative.map(|entry| entry.name.to_owned()).collect();
    let settings = registry.settings(&Sweep { cullers: names, ..Sweep::default() }).unwrap_or_default();
    let mut shop = Shop::new(scene.clone());
    let made = settings.into_iter().filter_map(|setting| {
        let entry = registry.entry(setting.culler)?;
        Some((setting.clone(), (entry.make)(&mut shop, &setting), entry.by_rays))
    });
    made.collect()
}

/// What all cullers lose over all views.
fn ask_all(scene: &Arc<Scene>, views: &[View]) -> Finding {
    let (mut candidates, rays) = (candidates(scene), RayScene::new(scene));
    let (mut lost, mut wrong, mut shown) = (0, 0, 0);
    let mut first = String::new();
    for view in views {
        let (exact, items) = exact_set(scene, view);
        shown += exact.len();
        for (setting, candidate, by_rays) in &mut candidates {
            // Who speaks of true triangles, not of one picture's, answers for what a ray meets: see `cull`.
            let is_own_kind = !*by_rays;
            let visible = candidate.cull(view, EyeRegion::point(view.eye)).visible;
            let missing = exact.iter().filter(|id| visible.binary_search(id).is_err());
            let missing = missing.filter(|&&id| is_own_kind || shows_to_rays(&rays, view, id, &items)).count();
            if missing > 0 && first.is_empty() {
                first = format!("; first {} from {}", setting.label(), view.eye);
            }
            lost += missing;
            if is_own_kind {
                wrong += wrong_pixels(scene, view, &visible, &items);
            }
        }
    }
    let said = format!("{} cullers, {} views, {shown} primitives visible{first}", candidates.len(), views.len());
    Finding::new((lost + wrong) as f64, 0.0, said)
}

/// Whether a ray through the middle of a pixel that shows a primitive meets it first.
fn shows_to_rays(rays: &RayScene, view: &View, id: u32, items: &eyeline_visibility::ItemBuffer) -> bool {
    let Resolution { width, height } = view.resolution;
    let shows = |x, y| items.id_at(x, y) == Some(id) && meets(rays, view, x, y, 0.0) == Some(id);
    (0..height).any(|y| (0..width).any(|x| shows(x, y)))
}

/// What a ray meets that goes through a pixel, `aside` pixels from its middle.
fn meets(rays: &RayScene, view: &View, x: u32, y: u32, aside: f64) -> Option<u32> {
    let ray = image_ray(view, f64::from(x) + 0.5 + aside, f64::from(y) + 0.5 + aside);
    rays.first_hit(view.eye, ray, view.near, f64::INFINITY).map(|hit| hit.primitive)
}

/// From a ball of eyes: what any of many eyes in it sees is reported.
fn regions() -> Vec<Case> {
    let asked = "primitives that an eye of the ball sees and the ball's answer lacks";
    let places = [
        ("in a room", DVec3::new(2.0, 1.6, 2.0), 0.3),
        ("in a door", DVec3::new(4.0, 1.6, 2.0), 0.3),
        ("a metre wide, across walls", DVec3::new(4.0, 1.6, 4.0), 1.0),
        ("touching a wall", DVec3::new(4.3, 1.6, 3.2), 0.2),
        ("around a vertex", DVec3::new(4.1, 0.0, 1.5), 0.05),
        ("a micrometre wide", DVec3::new(6.0, 1.6, 6.1), 1e-6),
    ];
    let case = |(name, centre, radius): (&'static str, DVec3, f64)| {
        Case::new("region", name, asked, Oracle::Reference, move || {
            let scene = scenes::rooms(3, 1.0, Vec3::ZERO);
            from_a_ball(&scene, EyeRegion { centre, radius })
        })
    };
    places.map(case).into()
}

fn from_a_ball(scene: &Arc<Scene>, region: EyeRegion) -> Finding {
    let (mut candidates, rays) = (candidates(scene), RayScene::new(scene));
    let mut chance = Pcg64::seed_from_u64(11);
    let mut lost = 0;
    for turn in 0..4 {
        let view = View::level(region.centre, f64::from(turn) * 1.6, 1.5, SMALL);
        let answers: Vec<Vec<u32>> = candidates.iter_mut().map(|(_, c, _)| c.cull(&view, region).visible).collect();
        for _ in 0..60 {
            let aside = DVec3::from_array(std::array::from_fn(|_| chance.random_range(-1.0..1.0)));
            // Half of them on the ball's own surface.
            let aside =
                if chance.random_bool(0.5) { aside.normalize_or(DVec3::X) } else { aside.clamp_length_max(1.0) };
            let eye = region.centre + aside * region.radius * (1.0 - 1e-12);
            let view = View { eye, ..view };
            let (exact, items) = exact_set(scene, &view);
            for (answer, (_, _, by_rays)) in answers.iter().zip(&candidates) {
                let missing = exact.iter().filter(|id| answer.binary_search(id).is_err());
                lost += missing.filter(|&&id| !by_rays || shows_to_rays(&rays, &view, id, &items)).count();
            }
        }
    }
    Finding::new(lost as f64, 0.0, format!("{} cullers, 4 views of 60 eyes", candidates.len()))
}

/// The item buffer against f64 rays that share no code with it.
fn rays() -> Vec<Case> {
    let asked = "share of pixels whose winner is not what rays through and around the middle meet";
    let case = |name: &'static str, bound: f64, make: fn() -> (Arc<Scene>, Vec<View>)| {
        Case::new("rays", name, asked, Oracle::Reference, move || {
            let (scene, views) = make();
            let rays = RayScene::new(&scene);
            let (mut pixels, mut clear, mut different) = (0_u32, 0_u32, 0_u32);
            for view in &views {
                let (_, items) = exact_set(&scene, view);
                for y in 0..view.resolution.height {
                    for x in 0..view.resolution.width {
                        pixels += 1;
                        // Near an edge the snapping of corners to 1/256 px decides; a tie in depth is decided by f32.
                        let near = [-1.0, 0.0, 1.0].map(|side| meets(&rays, view, x, y, side / 64.0));
                        if near[0] != near[1] || near[1] != near[2] {
                            continue;
                        }
                        clear += 1;
                        different += u32::from(items.id_at(x, y) != near[1]);
                    }
                }
            }
            let said = format!("{clear} of {pixels} pixels are clear of edges; {different} differ");
            Finding::new(f64::from(different) / f64::from(clear.max(1)), bound, said)
        })
    };
    vec![
        case("rooms as they are", 2e-3, || {
            (scenes::rooms(3, 1.0, Vec3::ZERO), scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 12, 21))
        }),
        case("rooms in a file 10^7 m away, anchored anew", 2e-3, || {
            let scene = scenes::rooms_file(DVec3::new(1e7, 0.0, -1e7)).expect("re-anchored");
            let views = scenes::visits(3, 1.0, scene.bounds().min + DVec3::new(0.1, 0.2, 0.1), SMALL, 12, 21);
            (scene, views)
        }),
        case("a view of 179 degrees", 2e-3, || {
            let views = scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 12, 22).into_iter();
            (
                scenes::rooms(3, 1.0, Vec3::ZERO),
                views.map(|view| View { fov_x: 179_f64.to_radians(), ..view }).collect(),
            )
        }),
    ]
}

/// Every SIMD level against the portable one.
fn simd() -> Vec<Case> {
    let best = SimdLevel::new();
    let mut levels: Vec<(&str, SimdLevel)> = vec![("portable", SimdLevel::baseline())];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse4_2().map(|level| ("SSE4.2", SimdLevel::Sse4_2(level))));
        levels.extend(best.as_avx2().map(|level| ("AVX2", SimdLevel::Avx2(level))));
        levels.extend(best.as_avx512().map(|level| ("AVX-512", SimdLevel::Avx512(level))));
    }
    let asked = "views whose visible set differs from the portable path's";
    let case = |(name, level): (&'static str, SimdLevel)| {
        Case::new("simd", format!("{name} against portable"), asked, Oracle::Exact, move || {
            let mut different = 0;
            let worlds = [
                (scenes::rooms(3, 1.0, Vec3::ZERO), scenes::visits(3, 1.0, DVec3::ZERO, SMALL, 24, 31)),
                (scenes::slivers(6), scenes::visits(1, 1.0, DVec3::ZERO, SMALL, 24, 32)),
                (scenes::coplanar(), scenes::visits(2, 1.0, DVec3::ZERO, Resolution::new(97, 13), 24, 33)),
            ];
            let mut views = 0;
            for (scene, looks) in &worlds {
                views += looks.len();
                different += differing(scene, looks, level);
            }
            Finding::new(different as f64, 0.0, format!("{views} views of 3 scenes"))
        })
    };
    levels.into_iter().skip(1).map(case).collect()
}

/// Views in which the walk against masks reports another set at this level than by portable code.
fn differing(scene: &Arc<Scene>, views: &[View], level: SimdLevel) -> usize {
    let culler = MaskedCplp::build(scene.clone());
    let mut portable = MaskedCplpScratch::with_level(SimdLevel::baseline());
    let mut fast = MaskedCplpScratch::with_level(level);
    let differs = |view: &&View| {
        culler.walk(view, &mut portable);
        culler.walk(view, &mut fast);
        portable.visible() != fast.visible()
    };
    views.iter().filter(differs).count()
}

/// Files: moved far away, or with numbers that are none.
fn files() -> Vec<Case> {
    vec![
        Case::new(
            "file",
            "nodes 10^7 m from the origin",
            "metres by which corners moved against each other",
            Oracle::Exact,
            || match (scenes::rooms_file(DVec3::ZERO), scenes::rooms_file(DVec3::new(1e7, 0.0, -1e7))) {
                (Ok(near), Ok(far)) => {
                    let base = |scene: &Scene| scene.triangles()[0].corners[0].as_dvec3();
                    let (near_base, far_base) = (base(&near), base(&far));
                    let corners = |scene: &Scene| -> Vec<DVec3> {
                        scene.triangles().iter().flat_map(|t| t.corners).map(Vec3::as_dvec3).collect()
                    };
                    let pairs = corners(&near).into_iter().zip(corners(&far));
                    let moved = pairs.map(|(a, b)| ((a - near_base) - (b - far_base)).length()).fold(0.0, f64::max);
                    // An ulp of 10^7 m in f64, and one of f32 at 12 m, at both ends.
                    Finding::new(moved, 4e-6, format!("anchor {}", far.anchor()))
                }
                (_, Err(error)) | (Err(error), _) => Finding::new(f64::INFINITY, 0.0, error.to_string()),
            },
        ),
        Case::new("file", "nodes 10^300 m from the origin", "a refusal that names the file", Oracle::Refusal, || {
            Finding::refusal(scenes::rooms_file(DVec3::new(1e300, 0.0, 0.0)), &["rooms.glb"])
        }),
        Case::new("file", "NaN in a position", "a refusal that names file and mesh", Oracle::Refusal, || {
            let loaded = load_glb(&scenes::file_with(f32::NAN), "nan.glb", &LoadOptions::default());
            Finding::refusal(loaded, &["nan.glb", "mesh 0", "finite"])
        }),
        Case::new("file", "infinity in a position", "a refusal that names file and mesh", Oracle::Refusal, || {
            let loaded = load_glb(&scenes::file_with(f32::INFINITY), "inf.glb", &LoadOptions::default());
            Finding::refusal(loaded, &["inf.glb", "mesh 0", "finite"])
        }),
    ]
}

/// Tetrahedra over a lattice, whose cell centres lie eight by eight on spheres: they fill the box once, or say why not.
fn cospherical() -> Finding {
    let scene = scenes::lattice();
    match Delaunay::build(&scene, DelaunayRules::default()) {
        Err(error) => Finding::new(0.0, 0.0, format!("refused: {error}")),
        Ok(delaunay) => {
            let cells = delaunay.len();
            let mut chance = Pcg64::seed_from_u64(12);
            let bounds = scene.bounds();
            // Every point inside lies in exactly one tetrahedron, faces apart.
            let missing = (0..200)
                .filter(|_| {
                    let share = DVec3::from_array(std::array::from_fn(|_| chance.random_range(0.0..1.0)));
                    delaunay.cell_at(bounds.min + share * bounds.size()).is_none()
                })
                .count();
            Finding::new(missing as f64, 0.0, format!("{cells} tetrahedra, 200 points each in one"))
        }
    }
}
