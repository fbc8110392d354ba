//! Seeing with triangles: what of the moving things can be seen from a point, all round.

use std::collections::BTreeMap;
use std::sync::Arc;

use eyeline_protocol::{Class, ObjectId};
use eyeline_visibility::{
    Aabb, AllRound, AllRoundScratch, Bound, Budget, Cplp, CplpScratch, DepthBuffer, EyeRegion, ItemBuffer, Occlusion,
    OctreeRules, RayScene, Resolution, Scene, Triangle, View,
};
use glam::{DQuat, DVec3, Vec3};

use super::Sight;
use crate::world::{AVATAR_CLASS, Object};

/// The meshes of everything that moves, by the name of their node; avatars have a made one.
pub struct Meshes {
    avatar: Arc<[Triangle]>,
    nodes: BTreeMap<String, (Arc<[Triangle]>, f64)>,
}

impl Meshes {
    /// The meshes of a scene's moving nodes. `headings` says how each was turned about +Y in the file, in radians, where
    /// that is not 0; `avatar` is the class of avatars.
    pub fn new<'a>(scene: &Scene, headings: impl IntoIterator<Item = (&'a str, f64)>, avatar: &Class) -> Meshes {
        let headings: BTreeMap<&str, f64> = headings.into_iter().collect();
        let node = |object: &eyeline_visibility::ObjectMesh| {
            let heading = headings.get(object.name.as_str()).copied().unwrap_or(0.0);
            (object.name.clone(), (object.triangles.as_slice().into(), heading))
        };
        Meshes { avatar: prism(avatar).into(), nodes: scene.objects().iter().map(node).collect() }
    }

    /// The triangles of an object at its place, relative to the anchor; none if its node has no mesh.
    pub fn triangles(&self, object: &Object) -> impl Iterator<Item = ([DVec3; 3], &Triangle)> + '_ {
        let turn = object.orientation.quat();
        self.placed(object.class == AVATAR_CLASS, &object.node, object.position.metres(), turn)
    }

    /// The triangles of an avatar, or of a node's mesh, at a place.
    pub fn placed(
        &self,
        is_avatar: bool,
        node: &str,
        place: DVec3,
        turn: DQuat,
    ) -> impl Iterator<Item = ([DVec3; 3], &Triangle)> + '_ {
        let (triangles, heading): (&[Triangle], f64) = if is_avatar {
            (&self.avatar, 0.0)
        } else {
            self.nodes.get(node).map_or((&[], 0.0), |(triangles, heading)| (triangles, *heading))
        };
        let turn = turn * DQuat::from_rotation_y(-heading);
        triangles
            .iter()
            .map(move |triangle| (triangle.corners.map(|corner| place + turn * corner.as_dvec3()), triangle))
    }
}

/// An upright prism of eight sides inside the class's cylinder: the made mesh of an avatar.
fn prism(class: &Class) -> Vec<Triangle> {
    let extent = class.extent;
    let ring = |height: f64| {
        (0..8).map(move |i| {
            let angle = std::f64::consts::TAU * f64::from(i) / 8.0;
            DVec3::new(extent.radius * angle.cos(), height, -extent.radius * angle.sin()).as_vec3()
        })
    };
    let low: Vec<Vec3> = ring(extent.bottom).collect();
    let high: Vec<Vec3> = ring(extent.top).collect();
    let mut triangles = Vec::new();
    let mut push = |corners| {
        triangles.push(Triangle { corners, sides: eyeline_visibility::Sides::Front, occludes: true });
    };
    for i in 0..8 {
        let j = (i + 1) % 8;
        push([low[i], low[j], high[j]]);
        push([low[i], high[j], high[i]]);
        if (1..7).contains(&i) {
            push([high[0], high[i], high[j]]);
            push([low[0], low[j], low[i]]);
        }
    }
    triangles
}

/// The sight of a server that has the scene's triangles. Moving things hide nothing from each other here: what is told
/// must not depend on who stands before whom a moment later.
///
/// Three questions, each only for what the one before left open: is the object's box certainly hidden (under-estimating
/// coverage); does a ray reach one of its corners; does it own a pixel of a small image that looks at it, as fine as a
/// 320-pixel view of 90°.
pub struct ExactSight {
    scene: Arc<Scene>,
    meshes: Arc<Meshes>,
    classes: Vec<Class>,
    all_round: Arc<AllRound>,
    scratch: AllRoundScratch,
    rays: Arc<RayScene>,
    cplp: Arc<Cplp>,
    cplp_scratch: CplpScratch,
    depth: Option<DepthBuffer>,
    items: Option<ItemBuffer>,
    /// For a viewer and an object, the triangle whose first corner a ray reached last.
    seen_last: BTreeMap<(Option<ObjectId>, ObjectId), usize>,
}

/// Pixels a side of the cube for the first question; coarser is quicker and leaves more for the others, which cost more.
const SIDE: u32 = 128;

/// Pixels per unit of tangent of the small images: 320 pixels over 90°.
const FOCAL_PX: f64 = 160.0;

impl ExactSight {
    /// Prepares a scene.
    pub fn new(scene: Arc<Scene>, meshes: Arc<Meshes>, classes: Vec<Class>) -> ExactSight {
        let all_round = Arc::new(AllRound::new(&scene));
        ExactSight {
            scratch: all_round.scratch(SIDE),
            all_round,
            rays: Arc::new(RayScene::new(&scene)),
            cplp: Arc::new(Cplp::build(&scene, OctreeRules::default())),
            cplp_scratch: CplpScratch::default(),
            depth: None,
            items: None,
            seen_last: BTreeMap::new(),
            scene,
            meshes,
            classes,
        }
    }

    fn is_seen(&mut self, eye: DVec3, aabb: &Aabb, object: &Object, pair: (Option<ObjectId>, ObjectId)) -> bool {
        let corners: Vec<[DVec3; 3]> = self.meshes.triangles(object).map(|(corners, _)| corners).collect();
        // Rays to some corners; a mesh has a few dozen triangles. The one that was seen last is likely to be still.
        let stride = (corners.len() / 16).max(1);
        let last = self.seen_last.get(&pair).copied();
        for index in last.into_iter().chain((0..corners.len()).step_by(stride)) {
            let Some(&[corner, ..]) = corners.get(index) else { continue };
            let direction = corner - eye;
            if direction.length_squared() < 1e-12 || self.rays.first_hit(eye, direction, 0.0, 1.0 - 1e-9).is_none() {
                self.seen_last.insert(pair, index);
                return true;
            }
        }
        self.seen_last.remove(&pair);
        self.owns_a_pixel(eye, aabb, &corners)
    }

    fn owns_a_pixel(&mut self, eye: DVec3, aabb: &Aabb, corners: &[[DVec3; 3]]) -> bool {
        let centre = aabb.centre();
        let distance = eye.distance(centre);
        let radius = aabb.size().length() * 0.5;
        if distance <= radius * 1.2 {
            return true; // all but touching
        }
        // A square view that just holds the bounding ball.
        let tangent = (radius / distance).asin().tan();
        let side = ((2.0 * tangent * FOCAL_PX).ceil() as u32).clamp(4, 256);
        let view = View {
            eye,
            orientation: DQuat::from_rotation_arc(DVec3::NEG_Z, (centre - eye) / distance),
            fov_x: 2.0 * tangent.atan(),
            resolution: Resolution::new(side, side),
            near: 0.01,
        };
        let depth = self.depth.get_or_insert_with(|| DepthBuffer::new(&view));
        depth.begin(&view);
        let mut target = depth.target(&self.scene);
        let region = EyeRegion::point(eye);
        self.cplp.traverse(&self.scene, region, Budget::default(), &mut target, &mut self.cplp_scratch);
        let items = self.items.get_or_insert_with(|| ItemBuffer::new(&view));
        items.begin(&view);
        items.draw(&self.scene, self.cplp_scratch.visible());
        let id = self.scene.triangles().len() as u32;
        for &corners in corners {
            items.draw_corners(id, corners, eyeline_visibility::Sides::Both);
        }
        items.ids().contains(&id)
    }
}

impl Sight for ExactSight {
    fn begin_tick(&mut self, _: &[Object]) {}

    fn visible_from(&mut self, objects: &[Object], eye: DVec3, own: Option<ObjectId>, visible: &mut Vec<ObjectId>) {
        // A region of radius 0 is what this occlusion is made for.
        let Ok(_) = self.all_round.cull(EyeRegion::point(eye), &mut self.scratch) else { return };
        for (id, object) in crate::world::present(objects) {
            if Some(id) == own {
                continue;
            }
            let extent = self.classes[usize::from(object.class.0)].extent;
            let place = object.position.metres();
            let aabb = Aabb::new(
                place + DVec3::new(-extent.radius, extent.bottom, -extent.radius),
                place + DVec3::new(extent.radius, extent.top, extent.radius),
            );
            let bound = Bound::Upright {
                centre: aabb.centre(),
                radius: extent.radius,
                half_height: 0.5 * (extent.top - extent.bottom),
            };
            if !self.scratch.occlusion().hides(&bound) && self.is_seen(eye, &aabb, object, (own, id)) {
                visible.push(id);
            }
        }
    }
}
