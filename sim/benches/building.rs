//! A whole culled frame of `building`, per culler, beside one f32 max pass over an image: traversal, occluders and box
//! queries, the furniture being objects that are asked about. 1024 × 512 px, 90° across, single thread.
//!
//! Each iteration takes the next of the building's 48 cameras. That nothing is lost is checked before, on a few of them.

use divan::Bencher;
use eyeline_sim::cull::run::run;
use eyeline_sim::cull::{CullConfig, MaxPass, Registry, Shop, Sweep, World, WorldRules};
use eyeline_visibility::{Bound, DynamicIndex, DynamicOctree, EyeRegion, Resolution};

const RESOLUTION: Resolution = Resolution::new(1024, 512);

fn main() {
    divan::main();
}

#[divan::bench(args = ["masked", "cplp", "hierarchical-z", "frustum-backface"])]
fn frame(bencher: Bencher, culler: &str) {
    let objects = WorldRules { query_objects: Some("object.".into()), ..WorldRules::default() };
    let world = World::open("building", &objects).unwrap();
    let path = world.cameras(None, 7);
    let registry = Registry::standard();
    let settings = registry.settings(&Sweep { cullers: vec![culler.to_owned()], ..Sweep::default() }).unwrap();
    let mut few = path.clone();
    few.cameras.truncate(4);
    let resolutions = vec![RESOLUTION];
    let config = CullConfig { settings, resolutions, eye_radii: vec![0.0], eyes: 1, repeats: 0, seed: 7 };
    assert!(run(&world, &few, &config, &registry, || {}).rows.iter().all(|row| row.ok));

    let setting = &config.settings[0];
    let mut candidate = (registry.entry(culler).unwrap().make)(&mut Shop::new(world.scene.clone()), setting);
    let mut index = DynamicOctree::new(world.scene.bounds());
    for (key, aabb) in (0..).zip(&world.object_boxes) {
        index.insert(key, Bound::Box(*aabb));
    }
    let views = path.views(world.scene.anchor(), RESOLUTION);
    let mut exposed = Vec::new();
    let mut next = 0;
    bencher.bench_local(|| {
        let view = &views[next % views.len()];
        next += 1;
        let culled = candidate.cull(view, EyeRegion::point(view.eye));
        exposed.clear();
        index.exposed(candidate.occlusion(), &mut exposed);
        culled.visible.len() + exposed.len()
    });
}

#[divan::bench]
fn max_pass(bencher: Bencher) {
    let mut max_pass = MaxPass::new(RESOLUTION);
    bencher.bench_local(|| max_pass.pass());
}
