//! What does it save to update an octree under the least common ancestor? Sudarsky & Gotsman's two test scenes (1999, §6.1.1).
//!
//! Scene 1 is a small cube that moves along the edge of a large one; scene 2 is a table laid for four, with a small cube that
//! circles a candlestick. Entries are polygons: those of what stands still and the six faces of the small cube, each an
//! entry of its own that is updated at every step. Whatever the update, the tree must end up the same.
//!
//! The paper gives times. Here nodes are counted, which says the same on every machine; `benches/dynamic.rs` has the times.

mod table;

use eyeline_visibility::{Aabb, Bound, DynamicIndex, References, SplitOctree, SplitRules, SplitStats, Update};
use glam::DVec3;

pub use table::polygons as table_polygons;

/// Depth of the smallest nodes: more than is reached, so that what is there decides.
const DEPTH_MAX: u32 = 20;

/// A small cube on its way through what stands still.
#[derive(Clone, Debug)]
pub struct LcaScene {
    /// `cubes` or `table`.
    pub name: &'static str,
    /// Side of the octree's world over the small cube's.
    pub ratio: f64,
    /// What the octree is made for.
    pub world: Aabb,
    /// The boxes of the polygons that stand still.
    pub still: Vec<Aabb>,
    /// A node with more polygons than this is split.
    pub primitives_max: usize,
    /// Half the side of the small cube in metres.
    pub half: f64,
    /// Where the small cube's centre is, step by step. At the end it returns to the first place.
    pub path: Vec<DVec3>,
}

/// Both updates over one scene: totals over all steps, without the building of the tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LcaRow {
    /// `cubes` or `table`.
    pub scene: &'static str,
    /// Side of the octree's world over the small cube's.
    pub ratio: f64,
    /// How nodes refer to polygons. The paper's scenes have [`References::Multiple`].
    pub references: References,
    /// Polygons that stand still.
    pub still: usize,
    /// Depth of the tree before the first step.
    pub depth: u32,
    /// Polygons updated: six a step.
    pub updates: u64,
    /// Nodes visited by updates from the root.
    pub visits_whole: u64,
    /// Nodes visited by updates under the least common ancestor.
    pub visits_lca: u64,
    /// Nodes made by updates from the root.
    pub made_whole: u64,
    /// Nodes made by updates under the least common ancestor.
    pub made_lca: u64,
    /// Nodes deleted by updates from the root.
    pub deleted_whole: u64,
    /// Nodes deleted by updates under the least common ancestor.
    pub deleted_lca: u64,
}

impl LcaRow {
    /// How many times more nodes an update from the root visits.
    pub fn visits_ratio(&self) -> f64 {
        self.visits_whole as f64 / self.visits_lca as f64
    }
}

/// The paper's scene 1: a cube of side 1 m, and one of side 1/`ratio` that goes round along the edge of its floor, in steps of
/// half its side, its own side away from the floor and from the wall. Ratios below 4, where there is no way round, count as 4.
///
/// The tree is built for the small cube alone, as in the paper: fewer polygons than it has split a node.
pub fn cubes(ratio: f64) -> LcaScene {
    // NaN too.
    let ratio = if ratio >= 4.0 { ratio.min(1e6) } else { 4.0 };
    let side = 1.0 / ratio;
    let world = Aabb::new(DVec3::ZERO, DVec3::ONE);
    let [low, high] = [1.5 * side, 1.0 - 1.5 * side];
    let corners = [(low, low), (high, low), (high, high), (low, high), (low, low)].map(|(x, z)| DVec3::new(x, low, z));
    let mut path = Vec::new();
    for wall in corners.windows(2) {
        let along = wall[1] - wall[0];
        let steps = (along.length() / (0.5 * side)).floor();
        let step = along.normalize() * 0.5 * side;
        path.extend((0..steps.max(1.0) as u32).map(|i| wall[0] + step * f64::from(i)));
    }
    LcaScene { name: "cubes", ratio, world, still: faces(&world).to_vec(), primitives_max: 4, half: 0.5 * side, path }
}

/// The paper's scene 2: a table for four, and a cube of 2 cm that circles one of its candlesticks in steps of 1°.
///
/// The tree is that of what stands still, as in the paper: the small cube has too few polygons to split a node by itself.
pub fn table() -> LcaScene {
    let still = table::polygons();
    let world = still.iter().fold(Aabb::EMPTY, |all, aabb| all.union(aabb));
    let half = 0.01;
    let around = table::CANDLESTICKS[0] + DVec3::Y * 0.1;
    let at = |degrees: u32| {
        let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
        around + DVec3::new(cos, 0.0, sin) * 0.05
    };
    let ratio = world.size().max_element() / (2.0 * half);
    LcaScene { name: "table", ratio, world, still, primitives_max: 8, half, path: (0..360).map(at).collect() }
}

/// Both scenes by both kinds of references, each row one scene of one ratio.
pub fn rows(ratios: &[f64]) -> Vec<LcaRow> {
    let scenes: Vec<LcaScene> = ratios.iter().map(|ratio| cubes(*ratio)).chain([table()]).collect();
    let kinds = [References::Single, References::Multiple];
    kinds.iter().flat_map(|references| scenes.iter().map(|scene| scene.compare(*references))).collect()
}

impl LcaScene {
    /// The octree of everything, with the small cube at the first place. Counts start at 0.
    pub fn tree(&self, references: References, update: Update) -> SplitOctree {
        let rules = SplitRules { primitives_max: self.primitives_max, depth_max: DEPTH_MAX, references, update };
        let mut tree = SplitOctree::new(self.world, rules);
        (6..).zip(&self.still).for_each(|(key, aabb)| tree.insert(key, Bound::Box(*aabb)));
        self.step(&mut tree, 0);
        tree.reset_stats();
        tree
    }

    /// Moves the small cube to a place of its path, counted round and round. Its faces are keys 0 to 5.
    pub fn step(&self, tree: &mut SplitOctree, step: usize) {
        let cube = Aabb::around(self.path[step % self.path.len()], DVec3::splat(self.half));
        (0..).zip(faces(&cube)).for_each(|(key, face)| tree.insert(key, Bound::Box(face)));
    }

    /// Goes round once with both updates.
    ///
    /// # Panics
    /// If the two end up with different trees.
    pub fn compare(&self, references: References) -> LcaRow {
        let mut trees = [Update::Whole, Update::UnderLca].map(|update| self.tree(references, update));
        let depth = trees[0].depth();
        for step in 1..=self.path.len() {
            trees.iter_mut().for_each(|tree| self.step(tree, step));
        }
        assert!(trees[0].same_structure(&trees[1]), "the update changes what is done, not what comes out");
        let [whole, lca]: [SplitStats; 2] = trees.each_ref().map(SplitOctree::stats);
        LcaRow {
            scene: self.name,
            ratio: self.ratio,
            references,
            still: self.still.len(),
            depth,
            updates: 6 * self.path.len() as u64,
            visits_whole: whole.node_visits,
            visits_lca: lca.node_visits,
            made_whole: whole.nodes_made,
            made_lca: lca.nodes_made,
            deleted_whole: whole.nodes_deleted,
            deleted_lca: lca.nodes_deleted,
        }
    }
}

/// The six faces of a box, as boxes without thickness.
fn faces(aabb: &Aabb) -> [Aabb; 6] {
    std::array::from_fn(|face| {
        let (axis, mut flat) = (face / 2, *aabb);
        let at = if face % 2 == 0 { aabb.min[axis] } else { aabb.max[axis] };
        (flat.min[axis], flat.max[axis]) = (at, at);
        flat
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn under_the_ancestor_the_table_costs_2_7_times_fewer_nodes() {
        let row = table().compare(References::Multiple);
        assert!((5_600..5_800).contains(&row.still), "{row:?}");
        assert!((9..=13).contains(&row.depth), "{row:?}");
        assert_eq!(row.updates, 6 * 360);
        assert!(row.visits_ratio() >= 2.7, "{}: {row:?}", row.visits_ratio());
    }

    #[test]
    fn the_gain_grows_with_the_depth_of_the_tree_and_is_never_a_loss() {
        for references in [References::Single, References::Multiple] {
            let rows = [10.0, 100.0, 1_000.0].map(|ratio| cubes(ratio).compare(references));
            let gains = rows.map(|row| row.visits_ratio());
            assert!(gains[0] > 1.0 && gains.is_sorted() && gains[2] > 1.5 * gains[0], "{references:?}: {gains:?}");
            assert!(rows[0].depth < rows[1].depth && rows[1].depth < rows[2].depth, "{rows:?}");
            for row in rows {
                // It comes back to where it was.
                assert_eq!((row.made_lca, row.made_whole), (row.deleted_lca, row.deleted_whole), "{row:?}");
                assert!(row.made_lca < row.made_whole && row.made_lca > 0, "{row:?}");
            }
        }
    }

    #[test]
    fn the_small_cube_stays_inside_and_makes_half_steps() {
        for ratio in [f64::NAN, 0.0, 4.0, 10.0, 77.7] {
            let scene = cubes(ratio);
            let inner = scene.world.inflated(-scene.half * 3.0 * 0.999_999);
            assert!(scene.path.iter().all(|centre| inner.contains(*centre)), "{ratio}");
            let step = |pair: &[DVec3]| pair[0].distance(pair[1]) <= scene.half * 1.000_001;
            assert!(scene.path.windows(2).filter(|pair| !step(pair)).count() <= 3, "but at corners: {ratio}");
        }
    }
}
