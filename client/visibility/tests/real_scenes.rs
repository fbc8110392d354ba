//! The conservative cullers on scenes that nobody here made: `EYELINE_DATA`, else `shared/data` beside the workspace.

mod made;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Budget, Cplp, CplpCuller, CplpQueryCuller, Culler, EyeRegion, FrustumBackface, HierarchicalZ, KdRules,
    KdTree, LoadOptions, Octree, OctreeRules, QueryFrontToBack, QueryKind, Resolution, Scene, Scratch, Tessellation,
    View, exact_set, load_file, wrong_pixels,
};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Scene files, or none if the data is not there.
fn scene_files() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from);
    let Ok(entries) = std::fs::read_dir(data.join("scenes")) else {
        eprintln!("skipped: no scenes in {} (set EYELINE_DATA)", data.display());
        return Vec::new();
    };
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<PathBuf> = paths.filter(|path| path.extension().is_some_and(|e| e == "glb")).collect();
    files.sort();
    files
}

/// Eyes of avatars that stand on the places of `NAME.places.json`; none if there is no such file.
fn standing_eyes(file: &Path, scene: &Scene) -> Vec<DVec3> {
    let Ok(text) = std::fs::read(file.with_extension("places.json")) else { return Vec::new() };
    let json: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let coordinate = |place: &serde_json::Value, i: usize| place["position"][i].as_f64().unwrap();
    let feet = json["places"]
        .as_array()
        .unwrap()
        .iter()
        .map(|place| DVec3::from_array([0, 1, 2].map(|i| coordinate(place, i))));
    feet.map(|feet| feet + DVec3::Y * 1.44 - scene.anchor()).collect()
}

fn anywhere(rng: &mut Pcg64, aabb: &Aabb) -> DVec3 {
    aabb.min + aabb.size() * DVec3::from_array(std::array::from_fn(|_| rng.random::<f64>()))
}

#[test]
fn real_scenes_are_culled_without_error() {
    for file in scene_files() {
        let scene = Arc::new(load_file(&file, &LoadOptions::default()).unwrap());
        let tree = KdTree::build(&scene, KdRules::default());
        eprintln!(
            "{}: {:?}, {} cells, {} references",
            file.display(),
            tree.stats(),
            tree.cell_count(),
            tree.cells().reference_count()
        );
        let tree = Arc::new(Cplp::new(Arc::new(tree)));
        let cullers: [(&str, Box<dyn Culler>); 3] = [
            ("VF-BF", Box::new(FrustumBackface::new(scene.clone()))),
            ("cPLP", Box::new(CplpCuller::build(scene.clone()))),
            ("cPLP in a kD-tree", Box::new(CplpCuller::new(scene.clone(), tree, Budget::default()))),
        ];
        let standing = standing_eyes(&file, &scene);
        let mut scratch = Scratch::default();
        let mut rng = Pcg64::seed_from_u64(21);
        let mut drawn = [0; 3];
        for i in 0..100 {
            for side in [64, 128] {
                let resolution = Resolution::new(side, side);
                let view = if i % 2 == 0 {
                    let eye = if standing.is_empty() {
                        let middle = scene.bounds().centre();
                        DVec3 {
                            y: scene.bounds().min.y + 1.44,
                            ..anywhere(&mut rng, &scene.bounds()).lerp(middle, 0.5)
                        }
                    } else {
                        standing[rng.random_range(0..standing.len())]
                    };
                    View::level(eye, rng.random_range(0.0..std::f64::consts::TAU), 1.4, resolution)
                } else {
                    let around = scene.bounds().inflated(scene.bounds().size().max_element() * 0.3);
                    let eye = anywhere(&mut rng, &around);
                    made::any_view(&mut rng, eye, resolution)
                };
                let (exact, items) = exact_set(&scene, &view);
                for ((name, culler), drawn) in cullers.iter().zip(&mut drawn) {
                    let visible = culler.cull(&view, EyeRegion::point(view.eye), &mut scratch).visible;
                    let missing = exact.iter().filter(|id| visible.binary_search(id).is_err()).count();
                    let wrong = wrong_pixels(&scene, &view, &visible, &items);
                    assert_eq!((missing, wrong), (0, 0), "{name} in {} from {view:?}", file.display());
                    *drawn += visible.len();
                }
            }
        }
        let [frustum, cplp, kd] = drawn.map(|drawn| drawn / 200);
        let name = file.file_stem().unwrap_or_default().display();
        eprintln!(
            "{name}: {} triangles; VF-BF {frustum}, cPLP {cplp}, in a kD-tree {kd} per view",
            scene.triangles().len()
        );
    }
}

#[test]
fn query_back_ends_and_baselines_cull_real_scenes_without_error() {
    for file in scene_files() {
        let scene = Arc::new(load_file(&file, &LoadOptions::default()).unwrap());
        let octree = Arc::new(Octree::build(&scene, OctreeRules::default()));
        let cplp = Arc::new(Cplp::new(octree.clone()));
        let mut cullers: Vec<(&str, Box<dyn Culler>)> = vec![
            ("front to back", Box::new(QueryFrontToBack::new(scene.clone(), octree.clone()))),
            ("hierarchical Z", Box::new(HierarchicalZ::new(scene.clone(), octree))),
        ];
        for query in QueryKind::ALL {
            let culler = CplpQueryCuller::new(scene.clone(), cplp.clone(), Budget::default(), query);
            cullers.push((query.name(), Box::new(culler)));
        }
        let standing = standing_eyes(&file, &scene);
        let mut scratch = Scratch::default();
        let mut rng = Pcg64::seed_from_u64(22);
        for i in 0..8 {
            let resolution = Resolution::new(64 << (i % 2), 64 << (i % 2));
            let eye = if i < 4 && !standing.is_empty() {
                standing[rng.random_range(0..standing.len())]
            } else {
                anywhere(&mut rng, &scene.bounds().inflated(scene.bounds().size().max_element() * 0.1))
            };
            let view = made::any_view(&mut rng, eye, resolution);
            let (exact, items) = exact_set(&scene, &view);
            for (name, culler) in &cullers {
                let visible = culler.cull(&view, EyeRegion::point(view.eye), &mut scratch).visible;
                let missing = exact.iter().filter(|id| visible.binary_search(id).is_err()).count();
                let wrong = wrong_pixels(&scene, &view, &visible, &items);
                assert_eq!((missing, wrong), (0, 0), "{name} in {} from {view:?}", file.display());
            }
        }
    }
}
