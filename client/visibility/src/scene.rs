//! The static world as cullers see it: triangles with ids, where they came from, and the meshes of what moves.

use std::ops::Range;

use glam::{DVec3, Vec3};

use crate::Aabb;

/// Which sides of a triangle are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// Only the side from which the corners run anticlockwise.
    Front,
    /// Both. A triangle without a material is two-sided.
    Both,
}

/// One primitive. Its id is its index in [`Scene::triangles`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Corners relative to the scene's anchor, all finite.
    pub corners: [Vec3; 3],
    /// Which sides are drawn.
    pub sides: Sides,
    /// Whether it hides what is behind it; MASK and BLEND materials never do. It is drawn in either case.
    pub occludes: bool,
}

impl Triangle {
    /// The least box around the triangle.
    pub fn aabb(&self) -> Aabb {
        self.corners.iter().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner.as_dvec3()))
    }
}

/// Why triangles make no scene.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A corner is NaN or infinite.
    #[error("triangle {triangle} has corners {corners:?}, which must be finite")]
    NotFinite {
        /// Index of the triangle.
        triangle: usize,
        /// Its corners.
        corners: [Vec3; 3],
    },
}

/// The triangles of one node of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// Name in the file, or empty.
    pub name: String,
    /// Ids of its triangles.
    pub primitives: Range<u32>,
}

/// The mesh of something that moves, taken out of the static scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectMesh {
    /// Name of its node.
    pub name: String,
    /// Where the node's origin stood in the file, relative to the anchor.
    pub origin: DVec3,
    /// Triangles relative to that origin, turned and scaled as in the file.
    pub triangles: Vec<Triangle>,
    /// Radius in metres about that origin that holds the mesh at every turn, in every pose of every animation of the file
    /// and in every mixture of them, whatever morph targets are weighted with from 0 to 1 or as animated. Without poses
    /// it is the distance of the farthest corner. Joints that are not below the node count as moving with it.
    pub reach: f64,
    /// Whether it has poses other than that of its triangles: it is skinned, morphed, or animated in itself.
    pub deforms: bool,
}

/// A static scene. Never changes once made, so that thousands of clients can share one.
#[derive(Clone, Debug)]
pub struct Scene {
    anchor: DVec3,
    triangles: Vec<Triangle>,
    nodes: Vec<Node>,
    objects: Vec<ObjectMesh>,
    bounds: Aabb,
}

impl Scene {
    /// A scene of these triangles, in this order, with one nameless node.
    ///
    /// Any finite triangle will do: one of zero area, or a point, covers no pixel and hides nothing.
    ///
    /// # Panics
    /// If a corner is not finite. What comes from outside belongs into [`Scene::try_from_triangles`].
    pub fn from_triangles(triangles: Vec<Triangle>) -> Scene {
        Scene::try_from_triangles(triangles).unwrap_or_else(|error| panic!("{error}"))
    }

    /// The same for triangles that nobody has looked at.
    ///
    /// # Errors
    /// If a corner is not finite. Leaving its triangle out would change the ids of all that follow.
    pub fn try_from_triangles(triangles: Vec<Triangle>) -> Result<Scene, SceneError> {
        let bad = triangles.iter().position(|triangle| !triangle.corners.iter().all(|corner| corner.is_finite()));
        if let Some(triangle) = bad {
            return Err(SceneError::NotFinite { triangle, corners: triangles[triangle].corners });
        }
        let nodes = vec![Node { name: String::new(), primitives: 0..triangles.len() as u32 }];
        Ok(Scene::from_parts(DVec3::ZERO, triangles, nodes, Vec::new()))
    }

    /// A scene of given parts. `nodes` must cover the triangles in order.
    pub(crate) fn from_parts(
        anchor: DVec3,
        triangles: Vec<Triangle>,
        nodes: Vec<Node>,
        objects: Vec<ObjectMesh>,
    ) -> Scene {
        debug_assert!(triangles.iter().flat_map(|t| t.corners).all(|corner| corner.is_finite()));
        let bounds = triangles.iter().fold(Aabb::EMPTY, |aabb, triangle| aabb.union(&triangle.aabb()));
        Scene { anchor, triangles, nodes, objects, bounds }
    }

    /// The point of the file's space that all positions are relative to.
    pub fn anchor(&self) -> DVec3 {
        self.anchor
    }

    /// All primitives; a primitive's id is its index.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The nodes with triangles, in the order of their ids.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Meshes of the nodes that were named as moving.
    pub fn objects(&self) -> &[ObjectMesh] {
        &self.objects
    }

    /// The least box around all static triangles; [`Aabb::EMPTY`] if there are none.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }
}
