//! Pictures of a view: what is right, what a culler made of it, and where they differ.

use eyeline_visibility::{Aabb, ItemBuffer, PixelRect, Resolution, Scene, Sides, View};
use glam::{DVec3, Vec3};

use super::world::World;

/// A picture in 8-bit RGB, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    resolution: Resolution,
    rgb: Vec<[u8; 3]>,
}

/// Something that a culler shows of itself, over its image: the front, finished tiles.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// What it shows: `front`, `finished tiles`.
    pub name: &'static str,
    /// Strength of each pixel, 0 to 1, row by row from the top; as many as the view has pixels.
    pub strength: Vec<f32>,
}

impl Layer {
    /// Boxes as they show past the primitives of a picture, nearer ones over farther ones.
    pub fn of_boxes(name: &'static str, scene: &Scene, visible: &[u32], boxes: &[Aabb], view: &View) -> Layer {
        let mut items = ItemBuffer::new(view);
        items.draw(scene, visible);
        let first = scene.triangles().len() as u32;
        for (id, aabb) in (first..).zip(boxes) {
            let corner = aabb.corners();
            for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
                items.draw_corners(id, [corner[a], corner[b], corner[c]], Sides::Both);
                items.draw_corners(id, [corner[a], corner[c], corner[d]], Sides::Both);
            }
        }
        let strength = |&id: &u32| match id {
            ItemBuffer::NONE => 0.0,
            id if id < first => 0.0,
            // Neighbours in the list get different strengths, so that one can tell them apart.
            id => 0.4 + 0.15 * ((id - first) % 4) as f32,
        };
        Layer { name, strength: items.ids().iter().map(strength).collect() }
    }

    /// Tiles of an image.
    pub fn of_tiles(name: &'static str, tiles: &[PixelRect], resolution: Resolution) -> Layer {
        let mut strength = vec![0.0; resolution.pixels()];
        let width = resolution.width as usize;
        for tile in tiles {
            let [from, to] = tile.x.map(|x| x.min(resolution.width) as usize);
            for y in tile.y[0]..tile.y[1].min(resolution.height) {
                let row = &mut strength[y as usize * width..][..width];
                row[from..to].fill(0.35);
                // A line at the left and upper border keeps tiles apart.
                row[from..to.min(from + 1)].fill(0.8);
                if y == tile.y[0] {
                    row[from..to].fill(0.8);
                }
            }
        }
        Layer { name, strength }
    }
}

/// What a pixel without a winner shows.
const SKY: [u8; 3] = [38, 43, 54];

impl Picture {
    /// The winners of an item buffer, each triangle by its node's colour and its slant.
    pub fn of_items(world: &World, items: &ItemBuffer, view: &View) -> Picture {
        let forward = view.orientation * DVec3::NEG_Z;
        let rgb = items.ids().iter().map(|&id| if id == ItemBuffer::NONE { SKY } else { shade(world, id, forward) });
        Picture { resolution: items.resolution(), rgb: rgb.collect() }
    }

    /// Nearness, by the logarithm of the distance: white at 0.1 m, black at 300 m and where nothing is.
    pub fn of_depth(items: &ItemBuffer, view: &View) -> Picture {
        let grey = |&depth: &f32| {
            let distance = view.near / f64::from(depth.max(1e-12));
            let share = ((300.0 / distance).ln() / (300.0_f64 / 0.1).ln()).clamp(0.0, 1.0);
            [(share * 255.0) as u8; 3]
        };
        Picture { resolution: items.resolution(), rgb: items.depths().iter().map(grey).collect() }
    }

    /// The picture in grey, with the pixels red whose winner differs.
    pub fn of_difference(self, items: &ItemBuffer, exact: &ItemBuffer) -> Picture {
        let wrong = items.ids().iter().zip(exact.ids()).map(|(here, there)| here != there);
        let rgb = self.rgb.iter().zip(wrong).map(|(rgb, wrong)| if wrong { [255, 0, 0] } else { dimmed(*rgb) });
        Picture { rgb: rgb.collect(), ..self }
    }

    /// The picture in grey, with a layer over it in yellow.
    pub fn with_layer(self, layer: &Layer) -> Picture {
        debug_assert_eq!(layer.strength.len(), self.rgb.len());
        let over = |(rgb, strength): (&[u8; 3], &f32)| {
            let strength = strength.clamp(0.0, 1.0);
            let (grey, yellow) = (dimmed(*rgb), [255.0, 196.0, 0.0_f32]);
            std::array::from_fn(|i| (f32::from(grey[i]) * (1.0 - strength) + yellow[i] * strength) as u8)
        };
        Picture { rgb: self.rgb.iter().zip(&layer.strength).map(over).collect(), ..self }
    }

    /// The bytes of a PNG file; empty for a picture without pixels, which the format does not know.
    pub fn png(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.resolution.width, self.resolution.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(self.rgb.as_flattened()));
        if written.is_err() {
            bytes.clear();
        }
        bytes
    }
}

fn dimmed(rgb: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = rgb.map(u32::from);
    [((2 * r + 5 * g + b) / 16 + 20) as u8; 3]
}

fn shade(world: &World, id: u32, forward: DVec3) -> [u8; 3] {
    let (triangle, owner) = match world.scene.triangles().get(id as usize) {
        Some(triangle) => (triangle, node_of(&world.scene, id)),
        None => {
            let object = id as usize - world.scene.triangles().len();
            let Some(mesh) = world.scene.objects().get(object) else { return SKY };
            (&mesh.triangles[0], world.scene.nodes().len() + object)
        }
    };
    let [a, b, c] = triangle.corners;
    let normal = (b - a).cross(c - a).normalize_or_zero().as_dvec3();
    let light = 0.35 + 0.45 * normal.dot(forward).abs() + 0.2 * normal.y.abs();
    // A hue per node, spread by the golden ratio so that neighbours differ.
    let turn = (owner as f32 * 0.618_034).fract() * std::f32::consts::TAU;
    let hue = Vec3::new(turn.cos(), (turn - 2.1).cos(), (turn + 2.1).cos());
    ((Vec3::splat(0.7) + hue * 0.25) * light as f32 * 255.0)
        .clamp(Vec3::ZERO, Vec3::splat(255.0))
        .to_array()
        .map(|v| v as u8)
}

/// The node that a primitive belongs to.
pub fn node_of(scene: &Scene, id: u32) -> usize {
    scene.nodes().partition_point(|node| node.primitives.end <= id)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use eyeline_visibility::{Sides, Triangle, exact_set};

    use super::*;

    fn decoded(bytes: &[u8]) -> (u32, u32, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.width, info.height, pixels)
    }

    #[test]
    fn pictures_say_where_they_differ() {
        let at = |x: f32| [[x - 1.0, -1.0, -3.0], [x + 1.0, -1.0, -3.0], [x, 1.0, -3.0]].map(Vec3::from);
        let triangles = [-1.5, 1.5].map(|x| Triangle { corners: at(x), sides: Sides::Both, occludes: true });
        let world = World::of(Arc::new(Scene::from_triangles(triangles.to_vec())), "two");
        let view = View::level(DVec3::ZERO, 0.0, 1.6, Resolution::new(40, 20));
        let (_, exact) = exact_set(&world.scene, &view);
        let mut items = ItemBuffer::new(&view);
        items.draw(&world.scene, &[1]);
        let right = Picture::of_items(&world, &exact, &view);
        let (width, height, pixels) = decoded(&right.png());
        assert_eq!((width, height, pixels.len()), (40, 20, 2_400));
        assert_eq!(pixels, right.rgb.as_flattened());
        let difference = Picture::of_items(&world, &items, &view).of_difference(&items, &exact);
        let red = difference.rgb.iter().filter(|rgb| **rgb == [255, 0, 0]).count();
        assert_eq!(red, exact.ids().iter().filter(|id| **id == 0).count());
        assert!(red > 20);
        let depth = Picture::of_depth(&exact, &view);
        let lit = |picture: &Picture| picture.rgb.iter().filter(|rgb| rgb[0] > 0 && **rgb != SKY).count();
        assert_eq!(lit(&depth), lit(&right));
        let mut strength = vec![0.0; 800];
        strength[799] = 1.0;
        let layered = right.with_layer(&Layer { name: "front", strength });
        assert_eq!(layered.rgb[799], [255, 196, 0]);
    }

    #[test]
    fn a_picture_without_pixels_has_no_file() {
        let view = View::level(DVec3::ZERO, 0.0, 1.0, Resolution::new(0, 5));
        let world = World::of(Arc::new(Scene::from_triangles(Vec::new())), "none");
        assert!(Picture::of_items(&world, &ItemBuffer::new(&view), &view).png().is_empty());
    }
}
