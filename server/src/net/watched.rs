//! A file that is read again when it changes. One that is no good then changes nothing: what was read before stays.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// What tells one state of a file from another without reading it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    modified: Option<SystemTime>,
    bytes: u64,
    /// A file that was renamed into place is another one, though it may be as old and as long.
    inode: u64,
}

fn stamp(path: &Path) -> Option<Stamp> {
    let data = std::fs::metadata(path).ok()?;
    #[cfg(unix)]
    let inode = std::os::unix::fs::MetadataExt::ino(&data);
    #[cfg(not(unix))]
    let inode = 0;
    Some(Stamp { modified: data.modified().ok(), bytes: data.len(), inode })
}

/// Some files whose contents together are a `T`.
#[derive(Debug)]
pub(super) struct Watched<T> {
    paths: Vec<PathBuf>,
    stamps: Vec<Option<Stamp>>,
    value: T,
    /// Whether the files were good when they were looked at last.
    is_sound: bool,
}

impl<T> Watched<T> {
    /// Reads the files for the first time.
    pub(super) fn new<E>(paths: Vec<PathBuf>, read: impl FnOnce(&[PathBuf]) -> Result<T, E>) -> Result<Watched<T>, E> {
        let stamps = paths.iter().map(|path| stamp(path)).collect();
        let value = read(&paths)?;
        Ok(Watched { paths, stamps, value, is_sound: true })
    }

    /// What they say.
    pub(super) fn get(&self) -> &T {
        &self.value
    }

    /// The first of them.
    pub(super) fn path(&self) -> &Path {
        &self.paths[0]
    }

    /// Whether they could be read when they were looked at last: else they say something that we do not know.
    pub(super) fn is_sound(&self) -> bool {
        self.is_sound
    }

    /// We have written `value` into the files ourselves.
    pub(super) fn note_written(&mut self, value: T) {
        self.stamps = self.paths.iter().map(|path| stamp(path)).collect();
        self.value = value;
    }

    /// Reads them again if one has changed; says whether that brought something new. A state that is no good is reported
    /// once, not at each look.
    pub(super) fn look<E: std::fmt::Display>(&mut self, read: impl FnOnce(&[PathBuf]) -> Result<T, E>) -> bool {
        let stamps: Vec<_> = self.paths.iter().map(|path| stamp(path)).collect();
        if stamps == self.stamps {
            return false;
        }
        // Stamped before reading: what changes while it is read is read again.
        self.stamps = stamps;
        if let Some(gone) = self.paths.iter().zip(&self.stamps).find(|(_, stamp)| stamp.is_none()) {
            self.is_sound = true;
            tracing::warn!("{} is gone; what it said still holds until it is back", gone.0.display());
            return false;
        }
        let read = read(&self.paths);
        self.is_sound = read.is_ok();
        match read {
            Ok(value) => {
                self.value = value;
                true
            }
            Err(error) => {
                tracing::warn!("{error}; what was read before still holds");
                false
            }
        }
    }
}
