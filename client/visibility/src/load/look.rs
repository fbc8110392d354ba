//! How do the triangles of a scene look? Their materials, normals, texture coordinates and colours, in the order of their ids.
//!
//! No culler needs this, so it is read only when it is asked for; but by the same checked accessors as shapes, since a file may
//! come from anyone. Images stay encoded: decoding them is the affair of whoever draws.

use std::path::Path;

use glam::{Affine2, DMat3, DVec3, Vec2, Vec3};
use gltf::json::{
    self, Root,
    accessor::Type,
    image::Image,
    material::AlphaMode,
    mesh::Semantic,
    texture::{MagFilter, WrappingMode},
    validation::Checked,
};

use super::{Elements, Instance, LoadError, Loader, buffers, buffers::Bytes};

/// How a scene looks. Made beside a [`crate::Scene`] by [`crate::load_file_with_looks`].
#[derive(Clone, Debug, Default)]
pub struct Looks {
    /// The file's materials in its order, and one more at the end: that of triangles without.
    pub materials: Vec<Material>,
    /// The file's images in its order, encoded as they are there.
    pub images: Vec<EncodedImage>,
    /// Of each static triangle, by its id.
    pub triangles: Vec<TriangleLook>,
    /// Of each triangle of each [`crate::ObjectMesh`], in the order of [`crate::Scene::objects`].
    pub objects: Vec<Vec<TriangleLook>>,
}

/// What a surface is made of, as far as it is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Linear red, green, blue and opacity, 0 to 1.
    pub base_color: [f32; 4],
    /// What `base_color` is multiplied by.
    pub texture: Option<TextureUse>,
    /// What becomes of opacity.
    pub alpha: Alpha,
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TextureUse {
    /// Index into [`Looks::images`].
    pub image: usize,
    /// What is beyond the image, along x and y.
    pub wrap: [Wrap; 2],
    /// Whether it is magnified without smoothing.
    pub is_nearest: bool,
}

/// What is beyond the edge of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// The image again.
    Repeat,
    /// The image again, mirrored.
    Mirror,
    /// Its last pixels.
    Clamp,
}

/// What becomes of a material's opacity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Nothing.
    Opaque,
    /// What is below this is not there.
    Mask(f32),
    /// What is behind shines through.
    Blend,
}

/// An image of the file: a PNG or JPEG as a rule.
#[derive(Clone, Debug)]
pub struct EncodedImage {
    /// Its name in the file, or its number.
    pub name: String,
    /// Its bytes, or why they can't be had. Without an image one can still draw, so this fails no load.
    pub bytes: Result<Vec<u8>, String>,
}

/// How one triangle looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleLook {
    /// Index into [`Looks::materials`].
    pub material: u32,
    /// Unit normal at each corner, in the scene; the triangle's own where the file has none. Zero if it has no area either.
    pub normals: [Vec3; 3],
    /// Texture coordinates at each corner; zero where the file has none.
    pub uvs: [Vec2; 3],
    /// Linear colour at each corner, which the material's is multiplied by; 255 where the file has none.
    pub colors: [[u8; 4]; 3],
}

/// What a primitive has besides its shape.
struct Attributes<'a> {
    material: u32,
    /// What is done to texture coordinates first.
    placed: Option<Affine2>,
    normals: Option<Elements<'a>>,
    uvs: Option<Elements<'a>>,
    colors: Option<(Elements<'a>, usize)>,
}

impl Loader<'_> {
    /// How everything looks, once it has been checked and placed.
    pub(super) fn looks(&self, instances: &[Instance], folder: Option<&Path>) -> Result<Looks, LoadError> {
        let root = self.source.root;
        let materials =
            (root.materials.iter().map(|material| self.material(material))).collect::<Result<Vec<_>, _>>()?;
        let images = root.images.iter().enumerate().map(|(at, image)| encoded(root, &self.source, at, image, folder));
        let mut looks = Looks { materials, images: images.collect(), ..Looks::default() };
        looks.materials.push(Material { base_color: [1.0; 4], texture: None, alpha: Alpha::Opaque });
        let mut object_of = std::collections::BTreeMap::new();
        for instance in instances {
            if instance.mover == Some(instance.node) {
                object_of.insert(instance.node, looks.objects.len());
                looks.objects.push(Vec::new());
            }
            let triangles = match instance.mover {
                Some(mover) => &mut looks.objects[object_of[&mover]],
                None => &mut looks.triangles,
            };
            self.add_looks(instance, triangles)?;
        }
        Ok(looks)
    }

    /// In the order of [`Loader::triangles`].
    pub(super) fn add_looks(&self, instance: &Instance, looks: &mut Vec<TriangleLook>) -> Result<(), LoadError> {
        let Some(mesh) = instance.mesh else { return Ok(()) };
        let linear = DMat3::from_mat4(instance.world_from_local);
        // Normals go by the inverse transpose; a flat transform has none, and then corners tell.
        let normal_from_local = (linear.determinant() != 0.0).then(|| linear.inverse().transpose());
        let is_mirrored = instance.is_mirrored();
        let mut corners = self.world_corners(instance);
        for primitive in self.primitives(instance) {
            let attributes = self.attributes(mesh, primitive.at, primitive.positions.count)?;
            for ([a, b, c], world) in primitive.corners().zip(&mut corners) {
                // As `world_corners` does.
                let vertices = if is_mirrored { [a, c, b] } else { [a, b, c] };
                let flat = (world[1] - world[0]).cross(world[2] - world[0]).normalize_or_zero();
                let normal = |vertex: usize| {
                    let given = attributes.normals.as_ref().zip(normal_from_local);
                    let given = given.map(|(normals, matrix)| matrix * DVec3::from(normals.position(vertex)));
                    let given = given.and_then(DVec3::try_normalize);
                    given.unwrap_or(flat).as_vec3()
                };
                let uv = |vertex: usize| {
                    let uvs = attributes.uvs.as_ref()?;
                    let uv = Vec2::new(uvs.number(vertex, 0) as f32, uvs.number(vertex, 1) as f32);
                    let uv = attributes.placed.map_or(uv, |placed| placed.transform_point2(uv));
                    uv.is_finite().then_some(uv)
                };
                let color = |vertex: usize| {
                    let Some((colors, width)) = &attributes.colors else { return [255; 4] };
                    // A cast saturates, and makes NaN zero.
                    let byte = |axis| (colors.number(vertex, axis) * 255.0).round() as u8;
                    [byte(0), byte(1), byte(2), if *width == 4 { byte(3) } else { 255 }]
                };
                looks.push(TriangleLook {
                    material: attributes.material,
                    normals: vertices.map(normal),
                    uvs: vertices.map(|vertex| uv(vertex).unwrap_or_default()),
                    colors: vertices.map(color),
                });
            }
        }
        Ok(())
    }

    fn attributes(&self, mesh: usize, at: usize, vertices: usize) -> Result<Attributes<'_>, LoadError> {
        let root = self.source.root;
        let described: &json::mesh::Primitive = &root.meshes[mesh].primitives[at];
        let from = format!("mesh {mesh}, primitive {at}");
        let read = |semantic: Semantic, shape: Option<Type>| {
            let Some(index) = described.attributes.get(&Checked::Valid(semantic)) else { return Ok(None) };
            let index = index.value();
            let is_wide =
                root.accessors.get(index).is_some_and(|accessor| accessor.type_ == Checked::Valid(Type::Vec4));
            let shape = shape.unwrap_or(if is_wide { Type::Vec4 } else { Type::Vec3 });
            let elements = self.source.numbers(index, &from, shape)?;
            if elements.count < vertices {
                let reason = format!("has {} elements for {vertices} vertices ({from})", elements.count);
                return Err(self.source.error(index, reason));
            }
            Ok(Some((elements, shape.multiplicity())))
        };
        let material = described.material.map_or(root.materials.len(), |material| material.value());
        Ok(Attributes {
            material: material as u32,
            placed: self.texture_transform(material),
            normals: read(Semantic::Normals, Some(Type::Vec3))?.map(|(elements, _)| elements),
            uvs: read(Semantic::TexCoords(self.uv_set(material)), Some(Type::Vec2))?.map(|(elements, _)| elements),
            colors: read(Semantic::Colors(0), None)?,
        })
    }

    /// The base colour's texture of a material.
    fn base_texture(&self, material: usize) -> Option<&json::texture::Info> {
        self.source.root.materials.get(material)?.pbr_metallic_roughness.base_color_texture.as_ref()
    }

    /// Which texture coordinates a material's base colour uses.
    fn uv_set(&self, material: usize) -> u32 {
        let info = self.base_texture(material);
        let given = info.and_then(transform_of).and_then(|transform| transform.tex_coord);
        given.unwrap_or(info.map_or(0, |info| info.tex_coord))
    }

    /// What a material does to them: scaled, turned, then moved (KHR_texture_transform). Positive angles turn the image
    /// clockwise, as renderers do; y of texture coordinates points down.
    fn texture_transform(&self, material: usize) -> Option<Affine2> {
        let transform = transform_of(self.base_texture(material)?)?;
        let [offset, scale] = [transform.offset.0, transform.scale.0].map(Vec2::from);
        Some(Affine2::from_scale_angle_translation(scale, -transform.rotation.0, offset))
    }

    fn material(&self, material: &json::Material) -> Result<Material, LoadError> {
        let root = self.source.root;
        let pbr = &material.pbr_metallic_roughness;
        let texture = match &pbr.base_color_texture {
            None => None,
            Some(info) => {
                let index = info.index.value();
                let missing = || self.missing("a material", "texture", index, root.textures.len());
                let texture = root.textures.get(index).ok_or_else(missing)?;
                let image = texture.source.value();
                if image >= root.images.len() {
                    return Err(self.missing(&format!("texture {index}"), "image", image, root.images.len()));
                }
                let sampler = texture.sampler.and_then(|sampler| root.samplers.get(sampler.value()));
                let wrap = |mode: Checked<WrappingMode>| match mode {
                    Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
                    Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
                    _ => Wrap::Repeat,
                };
                let (wrap, is_nearest) = match sampler {
                    Some(sampler) => {
                        let is_nearest = sampler.mag_filter == Some(Checked::Valid(MagFilter::Nearest));
                        ([wrap(sampler.wrap_s), wrap(sampler.wrap_t)], is_nearest)
                    }
                    None => ([Wrap::Repeat; 2], false),
                };
                Some(TextureUse { image, wrap, is_nearest })
            }
        };
        // Out of range or NaN, a factor would spread over the picture.
        let base_color = pbr.base_color_factor.0.map(|factor| if factor >= 0.0 { factor.min(1.0) } else { 0.0 });
        let alpha = match material.alpha_mode {
            Checked::Valid(AlphaMode::Mask) => Alpha::Mask(material.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0)),
            Checked::Valid(AlphaMode::Blend) => Alpha::Blend,
            _ => Alpha::Opaque,
        };
        Ok(Material { base_color, texture, alpha })
    }
}

fn transform_of(info: &json::texture::Info) -> Option<&json::extensions::texture::TextureTransform> {
    info.extensions.as_ref()?.texture_transform.as_ref()
}

fn encoded(root: &Root, source: &super::Source<'_>, at: usize, image: &Image, folder: Option<&Path>) -> EncodedImage {
    let name = image.name.clone().or_else(|| image.uri.clone().filter(|uri| !uri.starts_with("data:")));
    let bytes = match (&image.buffer_view, &image.uri) {
        (Some(view), _) => in_view(root, source.buffers, view.value()),
        (None, Some(uri)) => buffers::file_or_data(uri, folder),
        (None, None) => Err("has neither a buffer view nor a uri".into()),
    };
    EncodedImage { name: name.unwrap_or_else(|| format!("image {at}")), bytes }
}

fn in_view(root: &Root, buffers: &[Bytes<'_>], view: usize) -> Result<Vec<u8>, String> {
    let described = root.buffer_views.get(view).ok_or_else(|| format!("buffer view {view} does not exist"))?;
    let bytes = buffers.get(described.buffer.value()).ok_or_else(|| "its buffer does not exist".to_owned())?;
    let start = described.byte_offset.map_or(0, |offset| offset.0);
    let range = super::accessor::slice(bytes.as_slice(), start, described.byte_length.0);
    range.map(<[u8]>::to_vec).ok_or_else(|| format!("buffer view {view} reaches past its buffer"))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::tests::Glb;
    use super::*;
    use crate::{LoadOptions, Scene, load_glb_with_looks};

    fn load(glb: &Glb) -> Result<(Scene, Looks), LoadError> {
        load_glb_with_looks(&glb.bytes(), "test.glb", &LoadOptions::default().with_moving_nodes(["moves"]))
    }

    /// A triangle with everything, twice: as it is, and mirrored in x; and one that moves, without a material.
    fn painted() -> Glb {
        let mut glb = Glb::triangle();
        let floats = |numbers: &[f32]| -> Vec<u8> { numbers.iter().flat_map(|number| number.to_le_bytes()).collect() };
        let uvs = glb.view(&floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]));
        let uvs = glb.push("accessors", json!({"bufferView": uvs, "componentType": 5126, "type": "VEC2", "count": 3}));
        let tilted = glb.positions(&[[0.0, 3.0, 4.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]);
        let colors = glb.view(&[255, 0, 0, 255, 0, 255, 0, 128, 0, 0, 255, 0]);
        let colors = glb.push(
            "accessors",
            json!({"bufferView": colors, "componentType": 5121, "type": "VEC4", "count": 3, "normalized": true}),
        );
        let png = glb.view(b"PNG");
        glb.json["images"] =
            json!([{"bufferView": png, "mimeType": "image/png", "name": "skin"}, {"uri": "beside.png"}]);
        glb.json["samplers"] = json!([{"wrapS": 33071, "magFilter": 9728}]);
        glb.json["textures"] = json!([{"source": 0, "sampler": 0}]);
        glb.json["materials"] = json!([{
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 2.0, 1.0], "baseColorTexture": {"index": 0}},
            "alphaMode": "MASK", "alphaCutoff": 0.25,
        }]);
        let attributes = json!({"POSITION": 0, "NORMAL": tilted, "TEXCOORD_0": uvs, "COLOR_0": colors});
        let mesh = glb.mesh(json!([{"attributes": attributes, "material": 0}]));
        glb.root(json!({"mesh": mesh, "scale": [-1, 1, 1]}));
        glb.root(json!({"mesh": mesh, "name": "moves"}));
        glb
    }

    #[test]
    fn looks_run_beside_the_triangles() {
        let (scene, looks) = load(&painted()).unwrap();
        assert_eq!((scene.triangles().len(), looks.triangles.len()), (2, 2));
        assert_eq!((scene.objects()[0].triangles.len(), looks.objects[0].len()), (1, 1));
        let [plain, mirrored] = &looks.triangles[..] else { panic!("two triangles") };
        // Without anything: its own normal, white, and the material of those that have none.
        assert_eq!(plain.normals, [Vec3::Z; 3]);
        assert_eq!((plain.material as usize, plain.colors[1]), (looks.materials.len() - 1, [255; 4]));
        // A mirror turns the corners round, and what belongs to them.
        assert_eq!(mirrored.uvs, [Vec2::ZERO, Vec2::Y, Vec2::X]);
        assert_eq!(mirrored.colors[1], [0, 0, 255, 0]);
        assert!(mirrored.normals[0].abs_diff_eq(Vec3::new(0.0, 0.6, 0.8), 1e-6));
        // A normal without a direction is the triangle's own.
        assert_eq!(mirrored.normals[1], Vec3::Z);
        assert_eq!(looks.objects[0][0].uvs, [Vec2::ZERO, Vec2::X, Vec2::Y]);
        assert!(load_glb_with_looks(&Glb::triangle().bytes(), "test.glb", &LoadOptions::default()).is_ok());
    }

    #[test]
    fn materials_and_images_are_read_as_far_as_they_are_drawn() {
        let (_, looks) = load(&painted()).unwrap();
        let texture = TextureUse { image: 0, wrap: [Wrap::Clamp, Wrap::Repeat], is_nearest: true };
        // A factor above 1 is none.
        let expected = Material { base_color: [0.5, 0.25, 1.0, 1.0], texture: Some(texture), alpha: Alpha::Mask(0.25) };
        assert_eq!(looks.materials[0], expected);
        assert_eq!(looks.images[0].name, "skin");
        assert_eq!(looks.images[0].bytes.as_deref(), Ok(&b"PNG"[..]));
        // An image that is not there fails no load.
        assert!(looks.images[1].bytes.as_ref().is_err_and(|error| error.contains("beside.png")));
    }

    #[test]
    fn texture_coordinates_are_moved_as_the_material_says() {
        let mut glb = painted();
        let transform = json!({"offset": [0.5, 0.25], "rotation": std::f32::consts::FRAC_PI_2, "scale": [2.0, 4.0]});
        glb.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
            json!({"KHR_texture_transform": transform});
        let (_, looks) = load(&glb).unwrap();
        // Before: (0, 0), (0, 1) and (1, 0). A quarter turn takes y to x and x to -y.
        let expected = [[0.5, 0.25], [4.5, 0.25], [0.5, -1.75]];
        for (found, expected) in looks.triangles[1].uvs.iter().zip(expected) {
            assert!(found.abs_diff_eq(Vec2::from(expected), 1e-5), "{found} {expected:?}");
        }
        glb.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"]["KHR_texture_transform"] =
            json!({"texCoord": 1});
        let (_, looks) = load(&glb).unwrap();
        assert_eq!(looks.triangles[1].uvs, [Vec2::ZERO; 3], "there is no second set");
    }

    #[test]
    fn bad_looks_are_refused() {
        let refused = |change: &dyn Fn(&mut Glb), word: &str| {
            let mut glb = painted();
            change(&mut glb);
            let error = load(&glb).expect_err(word).to_string();
            assert!(error.contains(word) && error.contains("test.glb"), "{error}");
        };
        refused(&|glb| glb.json["accessors"][1]["count"] = json!(2), "3 vertices");
        refused(
            &|glb| glb.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = json!(7),
            "texture",
        );
        refused(&|glb| glb.json["textures"][0]["source"] = json!(7), "image");
        refused(&|glb| glb.json["meshes"][1]["primitives"][0]["attributes"]["NORMAL"] = json!(99), "accessor");
    }

    #[test]
    fn changed_bytes_never_panic_when_looks_are_read() {
        let mut bytes = painted().bytes();
        let options = LoadOptions::default().with_triangles_max(1_000);
        for at in 0..bytes.len() {
            let before = bytes[at];
            for changed in [!before, 0, 255, b'9', b'-', b'"', b'}', before ^ 1, before ^ 2] {
                bytes[at] = changed;
                let _ = load_glb_with_looks(&bytes, "changed", &options);
            }
            bytes[at] = before;
        }
    }
}
