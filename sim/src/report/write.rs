//! How does a report reach the disk? Whole or not at all: each file is written beside its place and then renamed.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::{Report, SCHEMA};

/// Where a report was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// Complete; [`Report::read`] reads it.
    pub json: PathBuf,
    /// The rows alone.
    pub csv: PathBuf,
    /// The page for people.
    pub html: PathBuf,
}

/// Why a report was not written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// The folder is not there and cannot be made.
    #[error("cannot create folder {path}")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file cannot be written or renamed to its place.
    #[error("cannot write {path}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// Why a file is not a report.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error("cannot read {path}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Not a report's JSON.
    #[error("{path} is not a report")]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        source: serde_json::Error,
    },
    /// A report, but of another version.
    #[error("{path} has schema `{found}`, this program reads `{SCHEMA}`")]
    Schema {
        /// The file.
        path: PathBuf,
        /// Its schema.
        found: String,
    },
}

impl Report {
    /// Writes `report.json`, `report.csv` and `report.html` into a folder, which is made if need be.
    pub fn write(&self, folder: &Path) -> Result<Written, WriteError> {
        fs::create_dir_all(folder).map_err(|source| WriteError::Folder { path: folder.to_owned(), source })?;
        let write = |name: &str, content: io::Result<Vec<u8>>| {
            let path = folder.join(name);
            match content.and_then(|content| replace(&path, &content)) {
                Ok(()) => Ok(path),
                Err(source) => Err(WriteError::File { path, source }),
            }
        };
        Ok(Written {
            json: write("report.json", self.json().map_err(io::Error::from))?,
            csv: write("report.csv", self.csv())?,
            html: write("report.html", Ok(self.html().into_bytes()))?,
        })
    }

    /// Reads a `report.json`.
    pub fn read(path: &Path) -> Result<Self, ReadError> {
        #[derive(serde::Deserialize)]
        struct Header {
            schema: String,
        }
        let json_error = |source| ReadError::Json { path: path.to_owned(), source };
        let bytes = fs::read(path).map_err(|source| ReadError::File { path: path.to_owned(), source })?;
        // The schema first: another version may differ in anything else.
        let Header { schema: found } = serde_json::from_slice(&bytes).map_err(json_error)?;
        if found != SCHEMA {
            return Err(ReadError::Schema { path: path.to_owned(), found });
        }
        serde_json::from_slice(&bytes).map_err(json_error)
    }

    fn json(&self) -> serde_json::Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec_pretty(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }

    /// All columns that any row has; an empty field where a row has no value.
    fn csv(&self) -> io::Result<Vec<u8>> {
        let keys = self.keys();
        let mut writer = csv::Writer::from_writer(Vec::new());
        if !keys.is_empty() {
            writer.write_record(&keys)?;
        }
        for row in self.rows() {
            let fields = keys.iter().map(|key| match row.value(key) {
                None | Some(serde_json::Value::Null) => String::new(),
                Some(serde_json::Value::String(text)) => text.clone(),
                Some(value) => value.to_string(),
            });
            if !keys.is_empty() {
                writer.write_record(fields)?;
            }
        }
        writer.into_inner().map_err(|error| error.into_error())
    }
}

fn replace(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let beside = path.with_file_name(name);
    let written = File::create(&beside)
        .and_then(|mut file| file.write_all(content).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&beside, path));
    if written.is_err() {
        // The first error is the one to report; a leftover is only untidy.
        fs::remove_file(&beside).ok();
    }
    written
}
