//! What a ray from the eye meets first: the oracle that pictures and cullers are checked against.
//!
//! f64 throughout, and no code shared with any culler, so that a common mistake cannot hide. Triangles are met as in
//! Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): shared edges are computed alike from both
//! sides, so no ray slips between neighbours. A bounding volume hierarchy makes it fast enough for whole images.

use glam::DVec3;

use crate::{Aabb, Scene, Sides, Triangle, View};

/// Triangles that rays can be cast at. Primitive ids are those of the scene; extra triangles follow.
#[derive(Clone, Debug)]
pub struct RayScene {
    /// In the order of `nodes`' leaves.
    triangles: Vec<RayTriangle>,
    /// Node 0 is the root; the children of an inner node lie side by side, behind it.
    nodes: Vec<BvhNode>,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Id of the triangle.
    pub primitive: u32,
    /// Distance in lengths of the ray's direction.
    pub t: f64,
}

#[derive(Clone, Copy, Debug)]
struct RayTriangle {
    corners: [DVec3; 3],
    sides: Sides,
    primitive: u32,
}

#[derive(Clone, Copy, Debug)]
struct BvhNode {
    /// A little larger than what it holds, so that rounding in the slab test loses no hit.
    aabb: Aabb,
    /// First triangle of a leaf, or first of two children.
    first: u32,
    /// Number of triangles; 0 in an inner node.
    count: u32,
}

/// A ray with what every triangle needs of it.
struct Ray {
    origin: DVec3,
    inverse: DVec3,
    /// Axes, the last being the one along which the ray is longest.
    axes: [usize; 3],
    /// Takes the ray to +Z of unit length.
    shear: DVec3,
    t_min: f64,
}

/// The direction through the centre of pixel (`x`, `y`), row 0 at the top. Its length is such that a hit's `t` is the
/// depth along the view, so casting from `t_min = view.near` clips as the near plane does.
pub fn pixel_ray(view: &View, x: u32, y: u32) -> DVec3 {
    image_ray(view, f64::from(x) + 0.5, f64::from(y) + 0.5)
}

/// The direction through a place in the image in pixels, (0, 0) being the top left corner; length as in [`pixel_ray`].
pub fn image_ray(view: &View, x: f64, y: f64) -> DVec3 {
    let focal_px = view.focal_px();
    let right = (x - 0.5 * f64::from(view.resolution.width)) / focal_px;
    let up = (0.5 * f64::from(view.resolution.height) - y) / focal_px;
    view.orientation.normalize() * DVec3::new(right, up, -1.0)
}

impl RayScene {
    /// The static triangles of `scene`.
    pub fn new(scene: &Scene) -> RayScene {
        RayScene::build(number(scene.triangles(), 0).collect())
    }

    /// This scene and more triangles in its coordinates, such as those of moving meshes in their places. Their ids
    /// follow the scene's.
    pub fn with_extra(mut self, triangles: &[Triangle]) -> RayScene {
        let first = self.triangles.len() as u32;
        self.triangles.extend(number(triangles, first));
        RayScene::build(self.triangles)
    }

    /// The nearest hit with `t_min` ≤ t ≤ `t_max`; of equally near ones that of the lowest id. Single-sided triangles
    /// are not hit from behind, and zero-area or edge-on ones not at all.
    pub fn first_hit(&self, origin: DVec3, dir: DVec3, t_min: f64, t_max: f64) -> Option<Hit> {
        let mut nearest: Option<Hit> = None;
        self.walk(&Ray::new(origin, dir, t_min)?, t_max, |hit| {
            let is_nearer = |than: &Hit| hit.t.total_cmp(&than.t).then(hit.primitive.cmp(&than.primitive)).is_lt();
            if nearest.as_ref().is_none_or(is_nearer) {
                nearest = Some(hit);
            }
            nearest.map_or(t_max, |hit| hit.t)
        });
        nearest
    }

    /// Appends every hit whose t exceeds the nearest by at most the share `tolerance` of it, nearest first and then by
    /// id. If there is more than one, a picture of finite precision may show any of them.
    pub fn near_hits(&self, origin: DVec3, dir: DVec3, t_min: f64, t_max: f64, tolerance: f64, hits: &mut Vec<Hit>) {
        let Some(ray) = Ray::new(origin, dir, t_min) else { return };
        let start = hits.len();
        let mut limit = t_max;
        self.walk(&ray, t_max, |hit| {
            hits.push(hit);
            limit = limit.min(hit.t + hit.t.abs() * tolerance);
            limit
        });
        hits[start..].sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.primitive.cmp(&b.primitive)));
        let kept = hits[start..].partition_point(|hit| hit.t <= limit);
        hits.truncate(start + kept);
    }

    /// Calls `meet` with every hit up to the limit, which it returns anew each time.
    fn walk(&self, ray: &Ray, t_max: f64, mut meet: impl FnMut(Hit) -> f64) {
        let mut limit = t_max;
        // Entry distances are kept, since the limit may have come nearer when a node is taken off.
        let mut stack: Vec<(u32, f64)> = Vec::with_capacity(64);
        stack.extend(self.nodes.first().and_then(|root| ray.enters(&root.aabb, limit)).map(|t| (0, t)));
        while let Some((node, entry)) = stack.pop() {
            if entry > limit {
                continue;
            }
            let node = &self.nodes[node as usize];
            if node.count > 0 {
                for triangle in &self.triangles[node.first as usize..][..node.count as usize] {
                    if let Some(t) = ray.meets(triangle).filter(|&t| t <= limit) {
                        limit = meet(Hit { primitive: triangle.primitive, t });
                    }
                }
                continue;
            }
            let [left, right] =
                [node.first, node.first + 1].map(|child| (child, ray.enters(&self.nodes[child as usize].aabb, limit)));
            let (near, far) = match (left.1, right.1) {
                (Some(l), Some(r)) if r < l => (right, left),
                _ => (left, right),
            };
            // The nearer one goes on top.
            for (child, entry) in [far, near] {
                stack.extend(entry.map(|t| (child, t)));
            }
        }
    }

    fn build(mut triangles: Vec<RayTriangle>) -> RayScene {
        let mut nodes = Vec::new();
        if triangles.is_empty() {
            return RayScene { triangles, nodes };
        }
        let whole = bounds(&triangles);
        // Far above the rounding of the slab test and far below any size that matters.
        let margin = 1e-12 * (1.0 + whole.min.abs().max(whole.max.abs()).max_element());
        nodes.push(BvhNode { aabb: whole.inflated(margin), first: 0, count: triangles.len() as u32 });
        let mut open = vec![0];
        while let Some(at) = open.pop() {
            let BvhNode { first, count, .. } = nodes[at];
            if count <= LEAF_MAX {
                continue;
            }
            let (left, right) = {
                let inside = &mut triangles[first as usize..][..count as usize];
                let middle = split(inside);
                let (left, right) = inside.split_at(middle);
                let leaf = |triangles: &[RayTriangle], first: u32| BvhNode {
                    aabb: bounds(triangles).inflated(margin),
                    first,
                    count: triangles.len() as u32,
                };
                (leaf(left, first), leaf(right, first + middle as u32))
            };
            nodes[at].first = nodes.len() as u32;
            nodes[at].count = 0;
            open.extend([nodes.len(), nodes.len() + 1]);
            nodes.extend([left, right]);
        }
        RayScene { triangles, nodes }
    }
}

/// Most triangles of a leaf.
const LEAF_MAX: u32 = 4;
/// Places where a split is tried along the longest axis.
const BINS: usize = 16;

/// Reorders the triangles into two parts, neither empty, by the surface area heuristic; returns the first part's size.
fn split(triangles: &mut [RayTriangle]) -> usize {
    let centroids = triangles.iter().fold(Aabb::EMPTY, |aabb, triangle| aabb.with_point(triangle.centroid()));
    let size = centroids.size();
    let axis = size.max_position();
    let bin = |triangle: &RayTriangle| {
        let share = (triangle.centroid()[axis] - centroids.min[axis]) / size[axis];
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    if size[axis] > 0.0 {
        let mut bins = [(0usize, Aabb::EMPTY); BINS];
        for triangle in triangles.iter() {
            let (count, aabb) = &mut bins[bin(triangle)];
            *count += 1;
            *aabb = triangle.corners.iter().fold(*aabb, |aabb, corner| aabb.with_point(*corner));
        }
        let cost = |bins: &[(usize, Aabb)]| {
            let (count, aabb) = bins.iter().fold((0, Aabb::EMPTY), |(n, all), (m, aabb)| (n + m, all.union(aabb)));
            let size = aabb.size().max(DVec3::ZERO);
            count as f64 * (size.x * size.y + size.y * size.z + size.z * size.x)
        };
        let costs = (1..BINS).map(|at| (cost(&bins[..at]) + cost(&bins[at..]), at));
        if let Some((_, at)) = costs.min_by(|a, b| a.0.total_cmp(&b.0)) {
            triangles.sort_unstable_by_key(|triangle| (bin(triangle) >= at, triangle.primitive));
            let middle = triangles.partition_point(|triangle| bin(triangle) < at);
            if middle > 0 && middle < triangles.len() {
                return middle;
            }
        }
    }
    // All in one place: any half will do.
    triangles.len() / 2
}

fn number(triangles: &[Triangle], first: u32) -> impl Iterator<Item = RayTriangle> {
    (first..).zip(triangles).map(|(primitive, triangle)| RayTriangle {
        corners: triangle.corners.map(|corner| corner.as_dvec3()),
        sides: triangle.sides,
        primitive,
    })
}

fn bounds(triangles: &[RayTriangle]) -> Aabb {
    triangles.iter().flat_map(|triangle| triangle.corners).fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner))
}

impl RayTriangle {
    fn centroid(&self) -> DVec3 {
        (self.corners[0] + self.corners[1] + self.corners[2]) / 3.0
    }
}

impl Ray {
    /// `None` if the ray has no finite origin or direction: it hits nothing.
    fn new(origin: DVec3, dir: DVec3, t_min: f64) -> Option<Ray> {
        if !origin.is_finite() || !dir.is_finite() || dir == DVec3::ZERO {
            return None;
        }
        let z = dir.abs().max_position();
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        // Keeps the corners' turn as seen along the ray.
        if dir[z] < 0.0 {
            (x, y) = (y, x);
        }
        let shear = DVec3::new(dir[x] / dir[z], dir[y] / dir[z], 1.0 / dir[z]);
        Some(Ray { origin, inverse: dir.recip(), axes: [x, y, z], shear, t_min })
    }

    /// The distance at which the ray enters the box, if it does so before `limit`.
    fn enters(&self, aabb: &Aabb, limit: f64) -> Option<f64> {
        let (mut near, mut far) = (self.t_min, limit);
        for axis in 0..3 {
            let a = (aabb.min[axis] - self.origin[axis]) * self.inverse[axis];
            let b = (aabb.max[axis] - self.origin[axis]) * self.inverse[axis];
            // 0 · ∞ is NaN: the ray lies in a face of the box. `max` and `min` then keep the other operand.
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near <= far).then_some(near)
    }

    fn meets(&self, triangle: &RayTriangle) -> Option<f64> {
        let [x, y, z] = self.axes;
        let [a, b, c] = triangle.corners.map(|corner| {
            let relative = corner - self.origin;
            let depth = relative[z];
            DVec3::new(relative[x] - self.shear.x * depth, relative[y] - self.shear.y * depth, self.shear.z * depth)
        });
        let u = c.x * b.y - c.y * b.x;
        let v = a.x * c.y - a.y * c.x;
        let w = b.x * a.y - b.y * a.x;
        let outside_front = u < 0.0 || v < 0.0 || w < 0.0;
        let outside_back = u > 0.0 || v > 0.0 || w > 0.0;
        if outside_front && (outside_back || triangle.sides == Sides::Front) {
            return None;
        }
        let determinant = u + v + w;
        if determinant == 0.0 {
            return None;
        }
        let t = (u * a.z + v * b.z + w * c.z) / determinant;
        (t >= self.t_min).then_some(t)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::Resolution;

    fn triangle(corners: [[f32; 3]; 3], sides: Sides) -> Triangle {
        Triangle { corners: corners.map(Vec3::from), sides, occludes: true }
    }

    fn all_hits(triangles: &[Triangle], origin: DVec3, dir: DVec3, t_min: f64, t_max: f64) -> Vec<Hit> {
        let ray = Ray::new(origin, dir, t_min).unwrap();
        let mut hits: Vec<Hit> = number(triangles, 0)
            .filter_map(|t| ray.meets(&t).map(|at| Hit { primitive: t.primitive, t: at }))
            .filter(|hit| hit.t <= t_max)
            .collect();
        hits.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.primitive.cmp(&b.primitive)));
        hits
    }

    /// Möller & Trumbore 1997, as a second opinion on one triangle: t, and how far inside the edges it is.
    fn second_opinion(triangle: &Triangle, origin: DVec3, dir: DVec3) -> Option<(f64, f64)> {
        let [a, b, c] = triangle.corners.map(|corner| corner.as_dvec3());
        let (p, q) = (dir.cross(c - a), (origin - a).cross(b - a));
        let determinant = (b - a).dot(p);
        if triangle.sides == Sides::Front && determinant <= 0.0 {
            return None;
        }
        let (u, v) = ((origin - a).dot(p) / determinant, dir.dot(q) / determinant);
        let inside = u.min(v).min(1.0 - u - v);
        Some(((c - a).dot(q) / determinant, inside))
    }

    fn soup() -> impl Strategy<Value = Vec<Triangle>> {
        // Coordinates on a grid make shared planes, edges and corners frequent.
        let coordinate = prop_oneof![(-8i8..8).prop_map(f32::from), -8f32..8.0];
        let corner = prop::array::uniform3(coordinate);
        let sides = prop_oneof![Just(Sides::Front), Just(Sides::Both)];
        let one = (prop::array::uniform3(corner), sides).prop_map(|(corners, sides)| triangle(corners, sides));
        prop::collection::vec(one, 0..120)
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        let coordinate = || prop_oneof![(-9i8..9).prop_map(f64::from), -9f64..9.0];
        (coordinate(), coordinate(), coordinate()).prop_map(DVec3::from)
    }

    proptest! {
        #[test]
        fn hierarchy_agrees_with_every_triangle_in_turn(
            triangles in soup(), origin in vector(), dir in vector(), t_min in 0f64..1.0, t_max in 0.5f64..20.0
        ) {
            prop_assume!(dir != DVec3::ZERO);
            let (some, extra) = triangles.split_at(triangles.len() / 2);
            let scene = RayScene::new(&Scene::from_triangles(some.to_vec())).with_extra(extra);
            let all = all_hits(&triangles, origin, dir, t_min, t_max);
            prop_assert_eq!(scene.first_hit(origin, dir, t_min, t_max), all.first().copied());
            let mut near = Vec::new();
            scene.near_hits(origin, dir, t_min, t_max, 0.25, &mut near);
            let limit = all.first().map_or(0.0, |hit| hit.t * 1.25);
            let expected: Vec<Hit> = all.into_iter().take_while(|hit| hit.t <= limit).collect();
            prop_assert_eq!(near, expected);
        }

        #[test]
        fn triangle_test_agrees_with_moller_and_trumbore(
            triangles in soup(), origin in vector(), dir in vector()
        ) {
            prop_assume!(dir.length() > 0.1);
            let ray = Ray::new(origin, dir, 0.0).unwrap();
            for (triangle, other) in number(&triangles, 0).zip(&triangles) {
                let Some((t, inside)) = second_opinion(other, origin, dir) else {
                    // Edge-on, where the sign is a matter of rounding, or from behind.
                    let [a, b, c] = triangle.corners;
                    let turned = dir.dot((b - a).cross(c - a));
                    prop_assert!(ray.meets(&triangle).is_none() || turned.abs() < 1e-9);
                    continue;
                };
                if inside.abs() > 1e-9 && (t.abs() > 1e-9) && t.is_finite() {
                    let met = ray.meets(&triangle);
                    prop_assert_eq!(met.is_some(), inside > 0.0 && t > 0.0, "{:?} {} {}", other, t, inside);
                    prop_assert!(met.is_none_or(|met| (met - t).abs() < 1e-6 * (1.0 + t)), "{:?} {}", met, t);
                }
            }
        }

        #[test]
        fn no_ray_slips_between_the_triangles_of_a_closed_box(eye in vector(), at in vector()) {
            let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|bit| if bit == 0 { -10.3f32 } else { 10.7 });
            let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
            let triangles: Vec<Triangle> = faces.iter().flat_map(|&[a, b, c, d]| {
                [[a, b, c], [a, c, d]].map(|corners| triangle(corners.map(corner), Sides::Both))
            }).collect();
            let scene = RayScene::new(&Scene::from_triangles(triangles));
            // At corners and at points of edges and diagonals, where it would slip if it could.
            let targets = (0..8).flat_map(|i| (0..8).map(move |j| (i, j)));
            for (i, j) in targets {
                let [i, j] = [i, j].map(|i| DVec3::from(corner(i).map(f64::from)));
                let target = i.lerp(j, (at.x + 9.0) / 18.0);
                if target != eye {
                    prop_assert!(scene.first_hit(eye, target - eye, 0.0, f64::INFINITY).is_some());
                }
            }
        }
    }

    #[test]
    fn equal_distances_go_to_the_lowest_id_and_fronts_are_single_sided() {
        // Anticlockwise from +Z.
        let wall = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]];
        let scene = Scene::from_triangles(vec![
            triangle(wall, Sides::Front),
            triangle(wall, Sides::Both),
            triangle(wall, Sides::Both),
        ]);
        let scene = RayScene::new(&scene);
        let from = |z: f64| scene.first_hit(DVec3::new(0.1, 0.0, z), DVec3::new(0.0, 0.0, -z), 0.0, 9.0).unwrap();
        assert_eq!(from(2.0), Hit { primitive: 0, t: 1.0 });
        assert_eq!(from(-2.0), Hit { primitive: 1, t: 1.0 });
        assert_eq!(scene.first_hit(DVec3::Z, DVec3::NEG_Z, 1.5, 9.0), None);
        assert_eq!(scene.first_hit(DVec3::Z, DVec3::NAN, 0.0, 9.0), None);
        assert_eq!(RayScene::new(&Scene::from_triangles(vec![])).first_hit(DVec3::Z, DVec3::X, 0.0, 9.0), None);
    }

    #[test]
    fn pixel_rays_go_where_the_pixels_are() {
        let view = View::level(DVec3::ZERO, 0.0, std::f64::consts::FRAC_PI_2, Resolution::new(4, 2));
        assert!(pixel_ray(&view, 0, 0).abs_diff_eq(DVec3::new(-0.75, 0.25, -1.0), 1e-12));
        assert!(pixel_ray(&view, 3, 1).abs_diff_eq(DVec3::new(0.75, -0.25, -1.0), 1e-12));
        let left = View::level(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 1.0, Resolution::new(2, 2));
        assert!(image_ray(&left, 1.0, 1.0).abs_diff_eq(DVec3::NEG_X, 1e-12));
    }

    /// `cargo test --release -p eyeline-visibility rays_per_second -- --ignored --nocapture`
    #[test]
    #[ignore = "measures"]
    #[expect(clippy::disallowed_methods, reason = "a measurement, not a core")]
    fn rays_per_second() {
        // Rooms of 6 m with 45,000 triangles in all, walls and furniture.
        let (rooms, mut triangles) = (15, Vec::new());
        let mut quad = |origin: Vec3, u: Vec3, v: Vec3| {
            for corners in [[origin, origin + u, origin + u + v], [origin, origin + u + v, origin + v]] {
                triangles.push(Triangle { corners, sides: Sides::Both, occludes: true });
            }
        };
        for (x, z) in (0..rooms).flat_map(|x| (0..rooms).map(move |z| (x as f32 * 6.0, z as f32 * 6.0))) {
            let at = Vec3::new(x, 0.0, z);
            quad(at, Vec3::X * 6.0, Vec3::Z * 6.0);
            quad(at + Vec3::Y * 3.0, Vec3::X * 6.0, Vec3::Z * 6.0);
            quad(at, Vec3::X * 5.0, Vec3::Y * 3.0);
            quad(at, Vec3::Z * 5.0, Vec3::Y * 3.0);
            for i in 0..96 {
                let corner = at + Vec3::new((i % 10) as f32 * 0.5 + 0.2, 0.2 * (i % 7) as f32, (i / 10) as f32 * 0.5);
                quad(corner, Vec3::X * 0.4, Vec3::new(0.0, 0.1, 0.3));
            }
        }
        let scene = RayScene::new(&Scene::from_triangles(triangles));
        let views = View::cube(DVec3::new(45.3, 1.6, 44.1), 256);
        let begin = std::time::Instant::now();
        let mut hits = 0;
        for view in &views {
            for (x, y) in (0..256).flat_map(|y| (0..256).map(move |x| (x, y))) {
                let ray = pixel_ray(view, x, y);
                hits += usize::from(scene.first_hit(view.eye, ray, view.near, f64::INFINITY).is_some());
            }
        }
        let rays = views.len() * 256 * 256;
        let rate = rays as f64 / begin.elapsed().as_secs_f64();
        eprintln!("{} triangles: {:.2} M rays/s, {hits} of {rays} hit", scene.triangles.len(), rate / 1e6);
        assert!(hits * 2 > rays);
    }
}
