//! Every culler on scenes that nobody here made: `EYELINE_DATA`, else `shared/data` beside the workspace.

mod every;
mod made;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_visibility::{Aabb, LoadOptions, Resolution, Scene, Scratch, View, load_file};
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

/// Half of the views stand where avatars do, the others look anywhere from in or about the scene.
fn views(rng: &mut Pcg64, scene: &Scene, standing: &[DVec3], count: usize, resolution: Resolution) -> Vec<View> {
    let bounds = scene.bounds();
    let view = |i: usize| {
        if i.is_multiple_of(2) {
            let eye = if standing.is_empty() {
                let middle = bounds.centre();
                DVec3 { y: bounds.min.y + 1.44, ..anywhere(rng, &bounds).lerp(middle, 0.5) }
            } else {
                standing[rng.random_range(0..standing.len())]
            };
            View::level(eye, rng.random_range(0.0..std::f64::consts::TAU), 1.4, resolution)
        } else {
            let around = bounds.inflated(bounds.size().max_element() * 0.3);
            let eye = anywhere(rng, &around);
            made::any_view(rng, eye, resolution)
        }
    };
    (0..count).map(view).collect()
}

#[test]
fn every_culler_culls_real_scenes_without_error() {
    for (file, seed) in scene_files().into_iter().zip(21..) {
        let scene = Arc::new(load_file(&file, &LoadOptions::default()).unwrap());
        let cullers = every::cullers(&scene);
        let standing = standing_eyes(&file, &scene);
        let mut scratch = Scratch::default();
        let mut rng = Pcg64::seed_from_u64(seed);
        for (count, resolution) in [(50, (64, 64)), (50, (128, 128)), (1, (1000, 900))] {
            let resolution = Resolution::new(resolution.0, resolution.1);
            let views = views(&mut rng, &scene, &standing, count, resolution);
            let checked = every::check(&scene, &cullers, views, &mut scratch);
            eprintln!(
                "{}: {resolution}, {} exact of {}:",
                file.display(),
                checked.exact,
                scene.triangles().len() * count
            );
            checked.kept.iter().for_each(|(name, kept)| eprintln!("  {kept:9} {name}"));
        }
    }
}
