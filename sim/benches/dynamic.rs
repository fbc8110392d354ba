//! Updates of an octree from the root and under the least common ancestor (Sudarsky & Gotsman 1999, §6.1.1), by both kinds of
//! references: a step of the small cube, which is six polygons, on the table and along the edge of a cube 1,000 times as
//! wide. The paper's speedup on its table is 2.7.

use divan::{Bencher, counter::ItemsCount};
use eyeline_sim::track::lca::{LcaScene, cubes, table};
use eyeline_visibility::{References, Update};

fn main() {
    divan::main();
}

const WAYS: [(References, Update); 4] = [
    (References::Multiple, Update::Whole),
    (References::Multiple, Update::UnderLca),
    (References::Single, Update::Whole),
    (References::Single, Update::UnderLca),
];

fn lap(bencher: Bencher, scene: &LcaScene, (references, update): (References, Update)) {
    let mut tree = scene.tree(references, update);
    let steps = scene.path.len();
    bencher.counter(ItemsCount::new(6 * steps)).bench_local(|| {
        (1..=steps).for_each(|step| scene.step(&mut tree, step));
    });
}

#[divan::bench(args = WAYS, sample_count = 60)]
fn table_lap(bencher: Bencher, way: (References, Update)) {
    lap(bencher, &table(), way);
}

#[divan::bench(args = WAYS, sample_count = 20)]
fn cubes_lap(bencher: Bencher, way: (References, Update)) {
    lap(bencher, &cubes(1_000.0), way);
}
