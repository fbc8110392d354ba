//! Which triangles are tested and drawn together? Objects, and clusters of at most [`Clusters::TRIANGLES_MAX`] triangles.
//!
//! A cell that holds a furnished room is too much to draw as a whole, and its triangles are too many to test one by one. So
//! each node of the scene stays an *object* with a box, its triangles are halved at the median along the longest axis into
//! *clusters* with boxes of their own, and each cell lists the clusters that have a triangle in it. Test the cell, then
//! the object, then the cluster (DESIGN.md §4).

use crate::{Aabb, CellId, Scene, Tessellation};

/// The objects of a scene and their clusters. Never changes once made.
#[derive(Clone, Debug)]
pub struct Clusters {
    objects: Vec<Object>,
    clusters: Vec<Cluster>,
    /// All primitives, cluster by cluster, ascending in each.
    primitives: Vec<u32>,
    /// The cluster of each primitive.
    cluster_of: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Object {
    aabb: Aabb,
    /// First and end of its clusters.
    clusters: [u32; 2],
}

#[derive(Clone, Copy, Debug)]
struct Cluster {
    aabb: Aabb,
    object: u32,
    /// First and end in `primitives`.
    primitives: [u32; 2],
}

impl Clusters {
    /// The most triangles of a cluster.
    pub const TRIANGLES_MAX: usize = 128;

    /// The clusters of a scene, each of at most `triangles_max` triangles (0 counts as 1): object by object, and near each
    /// other in space where their numbers are near.
    pub fn build(scene: &Scene, triangles_max: usize) -> Clusters {
        let triangles_max = triangles_max.max(1);
        let total = scene.triangles().len();
        let mut built = Clusters {
            objects: Vec::with_capacity(scene.nodes().len()),
            clusters: Vec::new(),
            primitives: (0..total as u32).collect(),
            cluster_of: vec![0; total],
        };
        let boxes: Vec<Aabb> = scene.triangles().iter().map(|triangle| triangle.aabb()).collect();
        let around = |ids: &[u32]| ids.iter().fold(Aabb::EMPTY, |aabb, &id| aabb.union(&boxes[id as usize]));
        for (object, node) in (0..).zip(scene.nodes()) {
            let [first, end] = [node.primitives.start, node.primitives.end];
            let aabb = around(&built.primitives[first as usize..end as usize]);
            let first_cluster = built.clusters.len() as u32;
            let mut open = if first < end { vec![[first, end]] } else { Vec::new() };
            while let Some([from, to]) = open.pop() {
                let ids = &mut built.primitives[from as usize..to as usize];
                let centres = ids.iter().fold(Aabb::EMPTY, |aabb, &id| aabb.with_point(boxes[id as usize].centre()));
                if ids.len() <= triangles_max {
                    ids.sort_unstable();
                    let cluster = built.clusters.len() as u32;
                    ids.iter().for_each(|&id| built.cluster_of[id as usize] = cluster);
                    built.clusters.push(Cluster { aabb: around(ids), object, primitives: [from, to] });
                    continue;
                }
                let size = centres.size();
                let axis = if size.x >= size.y.max(size.z) { 0 } else { 1 + usize::from(size.z > size.y) };
                // Whole clusters on the lower side, so that not all are half empty.
                let middle = (ids.len() / 2).next_multiple_of(triangles_max).min(ids.len() - 1);
                let along = |id: u32| boxes[id as usize].centre()[axis];
                ids.select_nth_unstable_by(middle, |&a, &b| along(a).total_cmp(&along(b)).then(a.cmp(&b)));
                open.extend([[from + middle as u32, to], [from, from + middle as u32]]);
            }
            built.objects.push(Object { aabb, clusters: [first_cluster, built.clusters.len() as u32] });
        }
        built
    }

    /// Number of clusters.
    pub fn len(&self) -> usize {
        self.clusters.len()
    }

    /// Whether the scene has no triangles.
    pub fn is_empty(&self) -> bool {
        self.clusters.is_empty()
    }

    /// The least box around a cluster.
    pub fn aabb(&self, cluster: u32) -> &Aabb {
        &self.clusters[cluster as usize].aabb
    }

    /// The primitives of a cluster, ascending.
    pub fn primitives(&self, cluster: u32) -> &[u32] {
        let [first, end] = self.clusters[cluster as usize].primitives;
        &self.primitives[first as usize..end as usize]
    }

    /// The object that a cluster is part of: the index of the scene's node.
    pub fn object_of(&self, cluster: u32) -> u32 {
        self.clusters[cluster as usize].object
    }

    /// The cluster that a primitive is in.
    pub fn cluster_of(&self, primitive: u32) -> u32 {
        self.cluster_of[primitive as usize]
    }

    /// Number of objects: of the scene's nodes.
    pub fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// The least box around an object; [`Aabb::EMPTY`] for a node without triangles.
    pub fn object_aabb(&self, object: u32) -> &Aabb {
        &self.objects[object as usize].aabb
    }

    /// The clusters of an object.
    pub fn clusters_of(&self, object: u32) -> std::ops::Range<u32> {
        let [first, end] = self.objects[object as usize].clusters;
        first..end
    }
}

/// Which clusters have a triangle in which cell.
#[derive(Clone, Debug)]
pub struct CellClusters {
    /// `clusters[starts[c]..starts[c + 1]]` are those of cell c, ascending.
    starts: Vec<u32>,
    clusters: Vec<u32>,
}

impl CellClusters {
    /// Lists the clusters of each cell. Both must be of one scene.
    pub fn build(tessellation: &dyn Tessellation, clusters: &Clusters) -> CellClusters {
        let cells = tessellation.cells();
        assert_eq!(cells.primitive_total(), clusters.cluster_of.len(), "the clusters are another scene's");
        let mut listed = CellClusters { starts: vec![0], clusters: Vec::new() };
        let mut here = Vec::new();
        for cell in 0..cells.len() as CellId {
            here.clear();
            here.extend(cells.primitives(cell).iter().map(|&id| clusters.cluster_of(id)));
            here.sort_unstable();
            here.dedup();
            listed.clusters.extend_from_slice(&here);
            listed.starts.push(listed.clusters.len() as u32);
        }
        listed
    }

    /// The clusters with a triangle that touches a cell, ascending, so that those of one object follow each other.
    pub fn of(&self, cell: CellId) -> &[u32] {
        let cell = cell as usize;
        &self.clusters[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::Node;
    use crate::tessellation::laws::soup;
    use crate::{KdRules, KdTree, Octree, OctreeRules};

    fn scene() -> Scene {
        let triangles = soup(4, 1000).triangles().to_vec();
        let node = |primitives| Node { name: String::new(), primitives };
        let nodes = vec![node(0..1), node(1..1), node(1..700), node(700..1000)];
        Scene::from_parts(DVec3::ZERO, triangles, nodes, Vec::new())
    }

    #[test]
    fn each_triangle_is_in_one_cluster_of_its_object() {
        let scene = scene();
        for most in [0, 1, 7, Clusters::TRIANGLES_MAX, 5000] {
            let clusters = Clusters::build(&scene, most);
            let mut seen = vec![0; 1000];
            for cluster in 0..clusters.len() as u32 {
                let primitives = clusters.primitives(cluster);
                assert!((1..=most.max(1)).contains(&primitives.len()));
                assert!(primitives.is_sorted_by(|a, b| a < b));
                let node = &scene.nodes()[clusters.object_of(cluster) as usize];
                for &id in primitives {
                    seen[id as usize] += 1;
                    assert!(node.primitives.contains(&id));
                    assert_eq!(clusters.cluster_of(id), cluster);
                    assert!(clusters.aabb(cluster).contains_box(&scene.triangles()[id as usize].aabb()));
                }
                assert!(clusters.object_aabb(clusters.object_of(cluster)).contains_box(clusters.aabb(cluster)));
                assert!(clusters.clusters_of(clusters.object_of(cluster)).contains(&cluster));
            }
            assert!(seen.iter().all(|&count| count == 1));
            assert_eq!(clusters.object_count(), 4);
            assert!(clusters.object_aabb(1).is_empty() && clusters.clusters_of(1).is_empty());
        }
        // 699 = 5 · 128 + 59, 300 = 2 · 128 + 44: no more clusters than needed.
        assert_eq!(Clusters::build(&scene, 128).len(), 1 + 6 + 3);
    }

    #[test]
    fn clusters_are_small_in_space() {
        let clusters = Clusters::build(&scene(), 16);
        let volume = |aabb: &Aabb| aabb.size().element_product();
        let mean = (0..clusters.len() as u32).map(|c| volume(clusters.aabb(c))).sum::<f64>() / clusters.len() as f64;
        assert!(mean < volume(clusters.object_aabb(2)) * 0.1, "{mean}");
    }

    #[test]
    fn a_cell_lists_the_clusters_of_its_triangles() {
        let scene = scene();
        let clusters = Clusters::build(&scene, 16);
        let tessellations: [Box<dyn Tessellation>; 2] = [
            Box::new(Octree::build(&scene, OctreeRules::default())),
            Box::new(KdTree::build(&scene, KdRules::default().with_max_triangles_per_leaf(32))),
        ];
        for tessellation in &tessellations {
            let listed = CellClusters::build(&**tessellation, &clusters);
            for cell in 0..tessellation.cell_count() as u32 {
                let of = listed.of(cell);
                assert!(of.is_sorted_by(|a, b| a < b));
                let held = |cluster: &u32| {
                    clusters.primitives(*cluster).iter().any(|id| tessellation.primitives(cell).contains(id))
                };
                assert!(of.iter().all(held));
                assert!(tessellation.primitives(cell).iter().all(|&id| of.contains(&clusters.cluster_of(id))));
            }
        }
    }

    #[test]
    fn an_empty_scene_has_no_clusters() {
        let scene = Scene::from_triangles(Vec::new());
        let clusters = Clusters::build(&scene, 128);
        assert!(clusters.is_empty());
        assert_eq!(clusters.object_count(), 1);
        let octree = Octree::build(&scene, OctreeRules::default());
        assert!(CellClusters::build(&octree, &clusters).of(0).is_empty());
    }
}
