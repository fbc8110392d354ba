//! What does a scene look like, ready to be drawn? Vertices in the order of the scene's triangles, and decoded textures.
//!
//! The culler's scene knows where triangles are and no more; how they look is read beside it ([`eyeline_visibility::Looks`]) and
//! joined here, corner by corner. Nothing here knows of a GPU.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use eyeline_visibility::{
    Alpha, Carried, EncodedImage, LoadError, LoadOptions, Looks, Material, Scene, Sides, TextureUse, Triangle,
    TriangleLook, load_file_with_looks, load_glb_with_looks,
};
use glam::{Vec3, Vec4};

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The file is no scene.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// A texture has more pixels than will be drawn.
    #[error("{file}: texture '{name}' is {width}x{height} pixels, more than {limit} a side; scale it down")]
    TextureTooLarge {
        /// The file.
        file: String,
        /// Name of the image.
        name: String,
        /// Its width in pixels.
        width: u32,
        /// Its height in pixels.
        height: u32,
        /// The most pixels a side.
        limit: u32,
    },
    /// A body is nowhere, or reaches infinitely far.
    #[error("{0} cannot be an avatar: it has no size")]
    NoSize(String),
    /// All textures together take more memory than they may.
    #[error("{file}: its textures take {mib} MiB when decoded, more than {limit_mib}; scale them down")]
    TexturesTooMany {
        /// The file.
        file: String,
        /// What they take.
        mib: u64,
        /// What they may take.
        limit_mib: u64,
    },
}

/// One corner of a triangle as the GPU gets it, 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Relative to the scene's anchor, or to the object's origin.
    pub position: [f32; 3],
    /// Unit normal in steps of 1/127; last the cutoff of opacity in the same steps, −127 where there is none.
    pub normal: [i8; 4],
    /// Texture coordinates.
    pub uv: [f32; 2],
    /// Linear colour and opacity, 0 to 65,535: the material's times the vertex's.
    pub color: [u16; 4],
}

/// Which bones carry a corner, as the GPU gets it, 12 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct SkinCorner {
    /// Numbers of bones.
    pub bones: [u8; 4],
    /// How much each of them carries, in steps of 1/65,535; their sum is one to within rounding.
    pub weights: [u16; 4],
}

impl SkinCorner {
    /// A corner as it was loaded.
    pub fn new(carried: &Carried) -> SkinCorner {
        SkinCorner { bones: carried.bones, weights: carried.weights.map(|weight| (weight * 65_535.0).round() as u16) }
    }

    /// Where bones take a point.
    pub(super) fn carry(&self, bones: &[[[f32; 4]; 3]], point: Vec3) -> Vec3 {
        let point = point.extend(1.0);
        let carried = self.bones.iter().zip(self.weights).map(|(&bone, weight)| {
            let row = |row: usize| Vec4::from(bones[usize::from(bone)][row]).dot(point);
            Vec3::new(row(0), row(1), row(2)) * (f32::from(weight) / 65_535.0)
        });
        carried.sum()
    }
}

/// How a triangle is drawn; triangles of one kind that follow each other are drawn together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kind {
    /// Index into [`Model::textures`]; 0 is plain white.
    pub texture: u32,
    /// Whether both sides are drawn.
    pub is_two_sided: bool,
    /// Whether what is behind shines through. Drawn after all that does not.
    pub is_blended: bool,
}

/// A decoded texture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// sRGB and opacity, a byte each, rows from the top.
    pub rgba: Arc<Vec<u8>>,
    /// How it is used; `None` for plain white.
    pub use_: Option<TextureUse>,
}

/// Triangles ready to be drawn: three vertices and a kind each.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Name of the node.
    pub name: String,
    /// Three a triangle.
    pub vertices: Vec<Vertex>,
    /// One a triangle.
    pub kinds: Vec<Kind>,
    /// Three a triangle if bones carry it, else none.
    pub skin: Vec<SkinCorner>,
}

/// A scene and its looks.
#[derive(Clone, Debug)]
pub struct Model {
    /// What cullers see.
    pub scene: Arc<Scene>,
    /// The static triangles, by id.
    pub fixed: Mesh,
    /// The meshes of what moves, as in [`Scene::objects`].
    pub objects: Vec<Mesh>,
    /// The textures; the first is plain white.
    pub textures: Vec<Texture>,
    /// What could not be had and is drawn without, for people.
    pub warnings: Vec<String>,
}

/// The most pixels a side of a texture: what every adapter of the last decade takes.
pub const TEXTURE_SIDE_MAX: u32 = 8192;

/// The most bytes of all textures decoded, without their smaller copies.
const TEXTURE_BYTES_MAX: u64 = 2 << 30;

impl Model {
    /// Loads a file and its looks.
    ///
    /// # Errors
    /// If it can't be loaded, or its textures are too large.
    pub fn load_file(path: &Path, options: &LoadOptions) -> Result<Model, ModelError> {
        let (scene, looks) = load_file_with_looks(path, options)?;
        Model::new(Arc::new(scene), &looks, &path.display().to_string())
    }

    /// The same from a binary file's bytes; `name` stands for the file in errors.
    ///
    /// # Errors
    /// As [`Model::load_file`].
    pub fn load_glb(bytes: &[u8], name: &str, options: &LoadOptions) -> Result<Model, ModelError> {
        let (scene, looks) = load_glb_with_looks(bytes, name, options)?;
        Model::new(Arc::new(scene), &looks, name)
    }

    /// Joins a scene and looks of the same file.
    fn new(scene: Arc<Scene>, looks: &Looks, file: &str) -> Result<Model, ModelError> {
        assert_eq!(scene.triangles().len(), looks.triangles.len(), "the looks are another scene's");
        let mut warnings = Vec::new();
        let (textures, texture_of) = textures(looks, file, &mut warnings)?;
        let joined = |triangles: &[Triangle], of: &[TriangleLook], name: &str| {
            joined(triangles, of, &looks.materials, &texture_of, name)
        };
        let fixed = joined(scene.triangles(), &looks.triangles, "");
        let objects = scene.objects().iter().zip(&looks.objects);
        let objects = objects.map(|(object, looks)| joined(&object.triangles, looks, &object.name)).collect();
        Ok(Model { scene, fixed, objects, textures, warnings })
    }

    /// Further triangles and their looks, from another file, as a mesh. Their textures join the model's.
    ///
    /// # Errors
    /// If the textures are too large.
    pub(super) fn join(&mut self, triangles: &[Triangle], looks: &Looks, file: &str) -> Result<Mesh, ModelError> {
        let (textures, mut texture_of) = textures(looks, file, &mut self.warnings)?;
        // Plain white is there already.
        let shift = self.textures.len() as u32 - 1;
        texture_of.values_mut().filter(|number| **number > 0).for_each(|number| *number += shift);
        self.textures.extend(textures.into_iter().skip(1));
        Ok(joined(triangles, &looks.triangles, &looks.materials, &texture_of, file))
    }
}

fn joined(
    triangles: &[Triangle],
    of: &[TriangleLook],
    materials: &[Material],
    texture_of: &BTreeMap<Key, u32>,
    name: &str,
) -> Mesh {
    let mut mesh = Mesh { name: name.to_owned(), ..Mesh::default() };
    mesh.vertices.reserve_exact(3 * triangles.len());
    mesh.kinds.reserve_exact(triangles.len());
    for (triangle, look) in triangles.iter().zip(of) {
        let material = &materials[look.material as usize];
        mesh.kinds.push(Kind {
            texture: material.texture.map_or(0, |use_| texture_of[&key(use_)]),
            is_two_sided: triangle.sides == Sides::Both,
            is_blended: material.alpha == Alpha::Blend,
        });
        mesh.vertices.extend((0..3).map(|corner| vertex(triangle, look, material, corner)));
    }
    mesh
}

fn vertex(triangle: &Triangle, look: &TriangleLook, material: &Material, corner: usize) -> Vertex {
    let [x, y, z] = (look.normals[corner] * 127.0).round().to_array().map(|x| x as i8);
    // What is not opaque at all may be cut off at nothing, so opaque is below nothing.
    let cutoff = match material.alpha {
        Alpha::Mask(cutoff) => (cutoff.clamp(0.0, 1.0) * 127.0).round() as i8,
        Alpha::Opaque | Alpha::Blend => -127,
    };
    let color = std::array::from_fn(|axis| {
        let product = material.base_color[axis] * f32::from(look.colors[corner][axis]) / 255.0;
        (product * 65_535.0).round() as u16
    });
    let position = triangle.corners[corner].to_array();
    Vertex { position, normal: [x, y, z, cutoff], uv: look.uvs[corner].to_array(), color }
}

/// A [`TextureUse`] that can be looked up.
type Key = (usize, [u8; 2], bool);

fn key(use_: TextureUse) -> Key {
    (use_.image, use_.wrap.map(|wrap| wrap as u8), use_.is_nearest)
}

/// White, and every texture that a material uses, each once.
fn textures(
    looks: &Looks,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<(Vec<Texture>, BTreeMap<Key, u32>), ModelError> {
    let white = Texture { width: 1, height: 1, rgba: Arc::new(vec![255; 4]), use_: None };
    let mut textures = vec![white];
    let mut texture_of = BTreeMap::new();
    let mut decoded: BTreeMap<usize, Option<Pixels>> = BTreeMap::new();
    let mut total = 0;
    for use_ in looks.materials.iter().filter_map(|material| material.texture) {
        if texture_of.contains_key(&key(use_)) {
            continue;
        }
        let image = match decoded.get(&use_.image) {
            Some(image) => image.clone(),
            None => {
                let image = decode(&looks.images[use_.image], file, warnings)?;
                total += image.as_ref().map_or(0, |(.., rgba)| rgba.len() as u64);
                decoded.insert(use_.image, image.clone());
                image
            }
        };
        if total > TEXTURE_BYTES_MAX {
            let (mib, limit_mib) = (total >> 20, TEXTURE_BYTES_MAX >> 20);
            return Err(ModelError::TexturesTooMany { file: file.into(), mib, limit_mib });
        }
        // What can't be had is drawn in its material's colour alone.
        let number = image.map_or(0, |(width, height, rgba)| {
            textures.push(Texture { width, height, rgba, use_: Some(use_) });
            textures.len() as u32 - 1
        });
        texture_of.insert(key(use_), number);
    }
    Ok((textures, texture_of))
}

/// Width, height, and sRGB with opacity.
type Pixels = (u32, u32, Arc<Vec<u8>>);

/// The image's pixels; `None`, and a warning, if it is no image. Too large a one is an error, since it says what to do.
fn decode(image: &EncodedImage, file: &str, warnings: &mut Vec<String>) -> Result<Option<Pixels>, ModelError> {
    let mut warn = |reason: String| {
        warnings.push(format!("{file}: texture '{}' is left out: {reason}", image.name.escape_debug()));
        Ok(None)
    };
    let bytes = match &image.bytes {
        Ok(bytes) => bytes,
        Err(reason) => return warn(reason.clone()),
    };
    let reader = match image::ImageReader::new(Cursor::new(bytes)).with_guessed_format() {
        Ok(reader) => reader,
        Err(error) => return warn(error.to_string()),
    };
    // Its header alone, before room is made for what it claims.
    let (width, height) = match reader.into_dimensions() {
        Ok(size) => size,
        Err(error) => return warn(error.to_string()),
    };
    if width.max(height) > TEXTURE_SIDE_MAX {
        let (name, limit) = (image.name.clone(), TEXTURE_SIDE_MAX);
        return Err(ModelError::TextureTooLarge { file: file.into(), name, width, height, limit });
    }
    if width.min(height) == 0 {
        return warn("it has no pixels".into());
    }
    match image::load_from_memory(bytes) {
        Ok(image) => Ok(Some((width, height, Arc::new(image.into_rgba8().into_raw())))),
        Err(error) => warn(error.to_string()),
    }
}

/// A mesh of an upright capsule around the origin's axis, from `bottom` to `top`, for avatars without a mesh of their own.
pub fn capsule(radius: f64, bottom: f64, top: f64) -> Mesh {
    const ROUND: usize = 16;
    const ARC: usize = 4;
    let radius = if radius.is_finite() { radius.max(0.01) } else { 0.3 };
    let height = (top - bottom).max(2.0 * radius);
    let (low, high) = (bottom + radius, bottom + height - radius);
    // From the lower pole to the upper one: distance from the axis, height, and the normal's two parts.
    let mut rings = Vec::new();
    for (middle, from) in [(low, -1.0), (high, 0.0)] {
        for step in 0..=ARC {
            let angle = (from + step as f64 / ARC as f64) * std::f64::consts::FRAC_PI_2;
            rings.push((radius * angle.cos(), middle + radius * angle.sin(), angle.cos(), angle.sin()));
        }
    }
    let corner = |ring: usize, around: usize| {
        let (r, y, out, up) = rings[ring];
        let (sin, cos) = (around as f64 / ROUND as f64 * std::f64::consts::TAU).sin_cos();
        let normal = Vec3::new((out * sin) as f32, up as f32, (out * cos) as f32) * 127.0;
        let [nx, ny, nz] = normal.round().to_array().map(|x| x as i8);
        let position = [(r * sin) as f32, y as f32, (r * cos) as f32];
        Vertex { position, normal: [nx, ny, nz, -127], uv: [0.0; 2], color: [65_535; 4] }
    };
    let mut mesh = Mesh { name: "capsule".into(), ..Mesh::default() };
    for ring in 0..rings.len() - 1 {
        for around in 0..ROUND {
            let [a, b] = [around, around + 1].map(|around| corner(ring, around));
            let [c, d] = [around, around + 1].map(|around| corner(ring + 1, around));
            mesh.vertices.extend([a, b, d, a, d, c]);
        }
    }
    let kind = Kind { texture: 0, is_two_sided: false, is_blended: false };
    mesh.kinds = vec![kind; mesh.vertices.len() / 3];
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(width: u32, height: u32) -> EncodedImage {
        let mut bytes = Cursor::new(Vec::new());
        image::RgbaImage::new(width, height).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        EncodedImage { name: "skin".into(), bytes: Ok(bytes.into_inner()) }
    }

    #[test]
    fn a_texture_that_is_too_large_says_so_and_one_that_is_none_is_left_out() {
        let mut warnings = Vec::new();
        let found = decode(&png(3, 2), "w.glb", &mut warnings).unwrap().unwrap();
        assert_eq!((found.0, found.1, found.2.len()), (3, 2, 24));
        assert_eq!(warnings, [""; 0]);
        let error = decode(&png(TEXTURE_SIDE_MAX + 1, 1), "w.glb", &mut warnings).unwrap_err().to_string();
        assert!(error.contains("w.glb") && error.contains("skin") && error.contains("8193x1"), "{error}");
        let mut cut_off = png(300, 200);
        cut_off.bytes.as_mut().unwrap().truncate(60);
        let empty = EncodedImage { name: "none".into(), bytes: Ok(Vec::new()) };
        let missing = EncodedImage { name: "far".into(), bytes: Err("lies in another file".into()) };
        for image in [&cut_off, &empty, &missing] {
            assert_eq!(decode(image, "w.glb", &mut warnings).unwrap(), None);
        }
        assert_eq!(warnings.len(), 3);
        assert!(warnings[2].contains("far") && warnings[2].contains("lies in another file"), "{}", warnings[2]);
    }

    #[test]
    fn a_capsule_is_closed_and_of_its_size() {
        let mesh = capsule(0.3, -0.1, 1.7);
        let places = || mesh.vertices.iter().map(|vertex| Vec3::from(vertex.position));
        let (low, high) =
            places().fold((f32::INFINITY, -f32::INFINITY), |(low, high), p| (low.min(p.y), high.max(p.y)));
        assert!((low + 0.1).abs() < 1e-6 && (high - 1.7).abs() < 1e-6);
        assert!(places().all(|p| p.x.hypot(p.z) <= 0.3 + 1e-6));
        // The volume within, which is right only if all faces look outwards.
        let corners: Vec<_> = places().collect();
        let volume: f32 = corners.chunks(3).map(|c| c[0].cross(c[1]).dot(c[2]) / 6.0).sum();
        let exact = std::f32::consts::PI * 0.3f32.powi(2) * (1.2 + 4.0 / 3.0 * 0.3);
        assert!((volume / exact - 1.0).abs() < 0.06, "{volume} {exact}");
        assert_eq!(mesh.kinds.len() * 3, mesh.vertices.len());
        // Bad measures make some body all the same.
        assert!(
            capsule(f64::NAN, 0.0, 0.0).vertices.iter().all(|vertex| vertex.position.iter().all(|x| x.is_finite()))
        );
    }
}
