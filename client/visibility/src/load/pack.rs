//! A `.gltf` and its buffers as one `.glb`, so that a world is one run of bytes with one hash.

use std::fs;
use std::path::Path;

use gltf::json::{self, Root};
use serde_json::{Value, json};

use super::{LoadError, buffers, split_glb};

/// Largest packed model: 1 GiB, what a client fetches at most.
const PACKED_MAX: usize = 1 << 30;

/// The bytes of a model as one binary glTF file: a `.glb` with everything in it as it is, anything else with its buffers
/// packed in. Images beside a `.gltf` stay where they are (shapes do not need them).
///
/// # Errors
/// If the file or a buffer can't be read, or is no glTF.
pub fn pack_glb(path: impl AsRef<Path>) -> Result<Vec<u8>, LoadError> {
    let path = path.as_ref();
    let file = path.display().to_string();
    let bytes = fs::read(path).map_err(|source| LoadError::Read { file: file.clone(), source })?;
    let unreadable = |source| LoadError::Json { file: file.clone(), source };
    let is_binary = bytes.starts_with(b"glTF");
    let (description, binary) = if is_binary {
        split_glb(&bytes, &file)?
    } else {
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
        if text.trim_ascii_start().first() != Some(&b'{') {
            return Err(LoadError::NotGltf { file, found: bytes.iter().copied().take(8).collect() });
        }
        (text, None)
    };
    let root: Root = json::deserialize::from_slice(description).map_err(unreadable)?;
    if is_binary && root.buffers.iter().all(|buffer| buffer.uri.is_none()) {
        return Ok(bytes);
    }
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let resolved = buffers::resolve(&root, binary, &file, Some(folder))?;
    let mut value: Value = serde_json::from_slice(description).map_err(unreadable)?;
    let mut packed = Vec::new();
    let mut starts = Vec::new();
    for (index, buffer) in resolved.iter().enumerate() {
        if packed.len() + buffer.as_slice().len() > PACKED_MAX {
            let reason = format!("all buffers together are larger than {PACKED_MAX} bytes; a world must be smaller");
            return Err(LoadError::Buffer { file, buffer: index, reason });
        }
        packed.resize(packed.len().next_multiple_of(4), 0);
        starts.push(packed.len());
        packed.extend_from_slice(buffer.as_slice());
    }
    if let Some(views) = value.get_mut("bufferViews").and_then(Value::as_array_mut) {
        for view in views {
            let buffer = view.get("buffer").and_then(Value::as_u64).unwrap_or(0) as usize;
            let offset = view.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
            let Some(&start) = starts.get(buffer) else { continue };
            // An offset that does not fit stays out of range, and is refused when the scene is loaded.
            view["byteOffset"] = json!(offset.saturating_add(start as u64));
            view["buffer"] = json!(0);
        }
    }
    if !resolved.is_empty() {
        value["buffers"] = json!([{ "byteLength": packed.len() }]);
    }
    let text = serde_json::to_vec(&value).map_err(unreadable)?;
    Ok(frame(text, packed))
}

/// The container of the glTF 2.0 specification, §4.4: header, JSON chunk padded with spaces, BIN chunk with zeros.
fn frame(mut text: Vec<u8>, mut binary: Vec<u8>) -> Vec<u8> {
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = 12 + 8 + text.len() + if binary.is_empty() { 0 } else { 8 + binary.len() };
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(b"glTF");
    let word = |bytes: &mut Vec<u8>, value: usize| bytes.extend_from_slice(&(value as u32).to_le_bytes());
    word(&mut bytes, 2);
    word(&mut bytes, length);
    word(&mut bytes, text.len());
    bytes.extend_from_slice(b"JSON");
    bytes.extend_from_slice(&text);
    if !binary.is_empty() {
        word(&mut bytes, binary.len());
        bytes.extend_from_slice(b"BIN\0");
        bytes.extend_from_slice(&binary);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LoadOptions, load_glb};

    #[test]
    fn a_gltf_and_its_buffers_become_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let positions: Vec<u8> =
            [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        fs::write(folder.path().join("a.bin"), [1u8, 2, 3]).unwrap();
        fs::write(folder.path().join("b.bin"), &positions).unwrap();
        let text = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
            "bufferViews":[{"buffer":1,"byteLength":36}],
            "buffers":[{"uri":"a.bin","byteLength":3},{"uri":"b.bin","byteLength":36}]}"#;
        let path = folder.path().join("t.gltf");
        fs::write(&path, text).unwrap();
        let packed = pack_glb(&path).unwrap();
        let scene = load_glb(&packed, "t.glb", &LoadOptions::default()).unwrap();
        assert_eq!(scene.triangles().len(), 1);
        assert_eq!(scene.bounds().max.x, 1.0);
        fs::remove_file(folder.path().join("b.bin")).unwrap();
        assert!(pack_glb(&path).unwrap_err().to_string().contains("b.bin"));
    }
}
