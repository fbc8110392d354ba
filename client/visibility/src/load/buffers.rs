//! Where a file's bytes are: its own binary chunk, a `data:` URI, or a file in the same folder.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs,
    path::{Component, Path, PathBuf},
    rc::Rc,
};

use gltf::json::Root;

use super::LoadError;

/// The bytes of every buffer, each at least as long as the file says.
pub(super) fn resolve<'a>(
    root: &Root,
    binary: Option<&'a [u8]>,
    file: &str,
    folder: Option<&Path>,
) -> Result<Vec<Bytes<'a>>, LoadError> {
    // A file that names one external buffer a thousand times must not read it a thousand times.
    let mut read: BTreeMap<PathBuf, Rc<[u8]>> = BTreeMap::new();
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (index, buffer) in root.buffers.iter().enumerate() {
        let error = |reason: String| LoadError::Buffer { file: file.into(), buffer: index, reason };
        let bytes = match (&buffer.uri, folder) {
            (None, _) if index > 0 => return Err(error("no uri, which only the first buffer may lack".into())),
            (None, _) => Bytes::Borrowed(binary.ok_or_else(|| error("no uri, and no binary chunk".into()))?),
            (Some(uri), _) if uri.starts_with("data:") => Bytes::Shared(decode_data_uri(uri).map_err(error)?.into()),
            (Some(uri), None) => {
                return Err(error(format!("lies in another file, {}; load this one by path", brief(uri))));
            }
            (Some(uri), Some(folder)) => {
                let path = path_beside(uri, folder).map_err(error)?;
                match read.get(&path) {
                    Some(bytes) => Bytes::Shared(Rc::clone(bytes)),
                    None => {
                        let unreadable = |source| LoadError::Read { file: path.display().to_string(), source };
                        let bytes: Rc<[u8]> = fs::read(&path).map_err(unreadable)?.into();
                        read.insert(path, Rc::clone(&bytes));
                        Bytes::Shared(bytes)
                    }
                }
            }
        };
        let (claimed, there) = (buffer.byte_length.0, bytes.as_slice().len());
        if claimed > there as u64 {
            return Err(error(format!("says {claimed} bytes, but has {there}; the file is cut off")));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

/// The bytes that a URI stands for: its own, or those of a file in `folder`.
pub(super) fn file_or_data(uri: &str, folder: Option<&Path>) -> Result<Vec<u8>, String> {
    if uri.starts_with("data:") {
        return decode_data_uri(uri);
    }
    let folder = folder.ok_or_else(|| format!("lies in another file, {}", brief(uri)))?;
    let path = path_beside(uri, folder)?;
    fs::read(&path).map_err(|error| format!("{} cannot be read: {error}", path.display()))
}

/// Bytes of the file itself, or read for it.
pub(super) enum Bytes<'a> {
    Borrowed(&'a [u8]),
    Shared(Rc<[u8]>),
}

impl Bytes<'_> {
    pub(super) fn as_slice(&self) -> &[u8] {
        match self {
            Bytes::Borrowed(bytes) => bytes,
            Bytes::Shared(bytes) => bytes,
        }
    }
}

/// The regular file that `uri` names in `folder` or below, symbolic links followed. Anything else is refused.
fn path_beside(uri: &str, folder: &Path) -> Result<PathBuf, String> {
    let outside = || format!("{} is not a path inside the file's own folder; copy it there", brief(uri));
    let relative = percent_decoded(uri).ok_or_else(outside)?;
    // A colon would be a scheme or a drive, a backslash a separator elsewhere.
    let plain = Path::new(&relative).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if relative.is_empty() || !plain || relative.contains([':', '\\', '\0']) {
        return Err(outside());
    }
    let path = folder.join(&relative);
    let path = path.canonicalize().map_err(|e| format!("{} cannot be read: {e}", path.display()))?;
    let folder = folder.canonicalize().map_err(|e| format!("{} cannot be read: {e}", folder.display()))?;
    if !path.starts_with(&folder) {
        return Err(outside());
    }
    if !path.is_file() {
        return Err(format!("{} is not a regular file", path.display()));
    }
    Ok(path)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&byte, tail)) = rest.split_first() {
        if byte == b'%' {
            let digits = std::str::from_utf8(tail.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &tail[2..];
        } else {
            bytes.push(byte);
            rest = tail;
        }
    }
    String::from_utf8(bytes).ok()
}

/// The bytes of a `data:…;base64,…` URI.
fn decode_data_uri(uri: &str) -> Result<Vec<u8>, String> {
    let Some((_, text)) = uri.split_once(";base64,") else {
        return Err(format!("{} is a data URI, but not in base64", brief(uri)));
    };
    let text = text.trim_end_matches('=');
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut held) = (0u32, 0u32);
    for (at, digit) in text.bytes().enumerate() {
        let value = match digit {
            b'A'..=b'Z' => digit - b'A',
            b'a'..=b'z' => digit - b'a' + 26,
            b'0'..=b'9' => digit - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return Err(format!("byte {digit:#04x} at {at} is not base64")),
        };
        bits = (bits << 6 | u32::from(value)) & 0xffff;
        held += 6;
        if held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    Ok(bytes)
}

/// A URI short enough for an error message.
fn brief(uri: &str) -> Cow<'_, str> {
    match uri.char_indices().nth(60) {
        Some((end, _)) => Cow::Owned(format!("{:?}…", &uri[..end])),
        None => Cow::Owned(format!("{uri:?}")),
    }
}
