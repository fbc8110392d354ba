//! What can be seen in a view? Everything drawn, for all cullers once.
//!
//! The exact set of a view is an item buffer of everything. For a ball of eyes it is the union over sampled eyes, all with the view's
//! orientation.

use eyeline_visibility::{Bound, DepthBuffer, ItemBuffer, Occlusion, Target, View};
use glam::DVec3;
use rand::RngExt;

use super::run::CullConfig;
use super::world::World;
use crate::chance;

/// Everything drawn: the scene's primitives under their ids, then each object under the id that follows.
pub(super) fn exact_items(world: &World, view: &View) -> ItemBuffer {
    let mut items = ItemBuffer::new(view);
    items.draw_all(&world.scene);
    draw_objects(world, &mut items, 0..world.object_boxes.len() as u32);
    items
}

pub(super) fn draw_objects(world: &World, items: &mut ItemBuffer, objects: impl IntoIterator<Item = u32>) {
    let first = world.scene.triangles().len() as u32;
    for object in objects {
        let mesh = &world.scene.objects()[object as usize];
        for triangle in &mesh.triangles {
            items.draw_triangle(first + object, triangle, mesh.origin);
        }
    }
}

/// What can be seen in a view, from every eye of the ball.
pub(super) struct Truth {
    /// The middle's picture, then those of the other eyes.
    pub(super) items: Vec<ItemBuffer>,
    pub(super) eyes: Vec<DVec3>,
    /// Primitives and objects that own a pixel in any of them, ascending.
    pub(super) winners: Vec<u32>,
    /// Objects that a screen rectangle against everything drawn keeps; `None` for a ball, where it is no bound.
    pub(super) rectangle: Option<u64>,
}

impl Truth {
    pub(super) fn new(world: &World, view: &View, radius: f64, config: &CullConfig, number: u64) -> Truth {
        let mut chance = chance(config.seed ^ 0xE7E, number);
        let (mut items, mut eyes) = (vec![exact_items(world, view)], vec![view.eye]);
        let mut winners = items[0].winners();
        if radius > 0.0 {
            while items.len() < config.eyes.max(1) {
                let offset = DVec3::from_array(std::array::from_fn(|_| chance.random_range(-1.0..=1.0)));
                if offset.length() <= 1.0 {
                    let eye = view.eye + offset * radius;
                    let other = exact_items(world, &View { eye, ..*view });
                    eyes.push(eye);
                    winners.extend(other.winners());
                    items.push(other);
                }
            }
            winners.sort_unstable();
            winners.dedup();
        }
        let rectangle = (radius == 0.0 && !world.object_boxes.is_empty()).then(|| {
            let mut depth = DepthBuffer::new(view);
            let everything: Vec<u32> = (0..world.scene.triangles().len() as u32).collect();
            depth.target(&world.scene).draw(&everything);
            world.object_boxes.iter().filter(|aabb| !depth.hides(&Bound::Box(**aabb))).count() as u64
        });
        Truth { items, eyes, winners, rectangle }
    }

    /// Static triangles that own a pixel.
    pub(super) fn visible(&self, world: &World) -> usize {
        self.winners.partition_point(|id| (*id as usize) < world.scene.triangles().len())
    }
}
