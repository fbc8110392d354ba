//! Keys and revocations as files: `NAME.key` signs and is its owner's alone, `NAME.pub` is what servers have, and
//! `NAME.revoked` beside it lists what is good no more.
//!
//! ```text
//! # a line for people
//! id 0123456789abcdef
//! subject 2026-01-01T00:00:00Z anna
//! ```
//!
//! A subject's line revokes what was issued to it up to that second; what is issued later is good again.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use eyeline_protocol::WorldTime;

use super::{Claims, KeyError, PublicKey, SecretKey, calendar, from_calendar};

/// Largest file of revocations, bytes: some 100,000 of them.
const REVOKED_BYTES_MAX: u64 = 4 << 20;

/// Largest file of a key, bytes.
const KEY_BYTES_MAX: u64 = 4 << 10;

/// What is wrong with a file of keys or revocations.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It can't be read or written.
    #[error("{}: {source}{}", path.display(), remedy(.source))]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is larger than any such file.
    #[error("{}: {bytes} bytes are too many for such a file; is it another?", path.display())]
    TooLarge {
        /// Which.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// It is not a key.
    #[error("{}: {source}", path.display())]
    Key {
        /// Which.
        path: PathBuf,
        /// Why.
        source: KeyError,
    },
    /// A private key that others may read.
    #[error("{}: others may read this private key (mode {mode:o}); `chmod 600` it, and make a new one if they did", path.display())]
    Open {
        /// Which.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// A line of a list that can't be understood.
    #[error("{}:{line}: '{text}' is not understood; write {usage}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What it says.
        text: String,
        /// What it should say.
        usage: &'static str,
    },
}

fn remedy(error: &std::io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::NotFound => "; make a pair of keys with `eyeline-server token key`, or name the right file",
        ErrorKind::AlreadyExists => "; it stays as it is: name another, or move it away",
        ErrorKind::PermissionDenied => "; let the user read it whom the server runs as",
        _ => "",
    }
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> FileError {
    let path = path.to_owned();
    move |source| FileError::File { path: path.clone(), source }
}

/// Text of a file of at most so many bytes.
pub(crate) fn read_text(path: &Path, bytes_max: u64) -> Result<String, FileError> {
    let bytes = std::fs::metadata(path).map_err(at(path))?.len();
    if bytes > bytes_max {
        return Err(FileError::TooLarge { path: path.to_owned(), bytes });
    }
    std::fs::read_to_string(path).map_err(at(path))
}

/// Writes beside and renames, so that who looks meanwhile finds all or nothing.
pub(crate) fn replace(path: &Path, text: &str) -> Result<(), FileError> {
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    std::fs::write(&new, text).and_then(|()| std::fs::rename(&new, path)).map_err(at(path))
}

/// The public key's file beside a private key's, or that file itself.
pub fn public_path(key: &Path) -> PathBuf {
    key.with_extension("pub")
}

/// The list of revocations beside a key's file, of either half.
pub fn revoked_path(key: &Path) -> PathBuf {
    key.with_extension("revoked")
}

/// Keeps a new pair: the private half at `path`, readable by its owner only, the public one beside it.
///
/// # Errors
/// If there is such a file already, or none can be written.
pub fn write_keys(path: &Path, secret: &SecretKey, public: &PublicKey) -> Result<PathBuf, FileError> {
    let public_path = public_path(path);
    if public_path == path || public_path.exists() {
        return Err(at(&public_path)(ErrorKind::AlreadyExists.into()));
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(at(folder))?;
    }
    crate::net::write_private(path, format!("{}\n", secret.text()).as_bytes()).map_err(at(path))?;
    std::fs::write(&public_path, format!("{}\n", public.text())).map_err(at(&public_path))?;
    Ok(public_path)
}

/// The private key in a file.
///
/// # Errors
/// If it is none, or others may read it.
pub fn read_secret(path: &Path) -> Result<SecretKey, FileError> {
    let text = read_text(path, KEY_BYTES_MAX)?;
    let secret = SecretKey::parse(&text).map_err(|source| FileError::Key { path: path.to_owned(), source })?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(path).map_err(at(path))?.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(FileError::Open { path: path.to_owned(), mode });
        }
    }
    Ok(secret)
}

/// The public key in a file.
///
/// # Errors
/// If it is none.
pub fn read_public(path: &Path) -> Result<PublicKey, FileError> {
    let text = read_text(path, KEY_BYTES_MAX)?;
    PublicKey::parse(&text).map_err(|source| FileError::Key { path: path.to_owned(), source })
}

/// What is good no more.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Revocations {
    ids: BTreeSet<String>,
    /// Up to when what was issued to a subject is revoked.
    subjects: BTreeMap<String, WorldTime>,
}

impl Revocations {
    /// Reads a list; one that is not there is empty.
    ///
    /// # Errors
    /// If a line is not understood: to pass over it could let in whom it was to keep out.
    pub fn read(path: &Path) -> Result<Revocations, FileError> {
        match read_text(path, REVOKED_BYTES_MAX) {
            Ok(text) => Revocations::parse(&text, path),
            Err(FileError::File { source, .. }) if source.kind() == ErrorKind::NotFound => Ok(Revocations::default()),
            Err(error) => Err(error),
        }
    }

    /// Reads the text of a list, which is called `path` in messages.
    ///
    /// # Errors
    /// If a line is not understood.
    pub fn parse(text: &str, path: &Path) -> Result<Revocations, FileError> {
        let mut revoked = Revocations::default();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            let wrong = || FileError::Line {
                path: path.to_owned(),
                line: index + 1,
                text: line.to_owned(),
                usage: "'id ID' or 'subject TIME NAME', as `eyeline-server token revoke` does",
            };
            match line.split_once(' ') {
                _ if line.is_empty() || line.starts_with('#') => {}
                Some(("id", id)) if !id.contains(' ') => {
                    revoked.ids.insert(id.to_owned());
                }
                Some(("subject", rest)) => {
                    let (until, subject) = rest.split_once(' ').ok_or_else(wrong)?;
                    revoked.revoke_subject(subject, from_calendar(until).ok_or_else(wrong)?);
                }
                _ => return Err(wrong()),
            }
        }
        Ok(revoked)
    }

    /// Writes the list.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let mut text = "# Tokens that are good no more, as `eyeline-server token revoke` writes them\n".to_owned();
        self.ids.iter().for_each(|id| text += &format!("id {id}\n"));
        self.subjects.iter().for_each(|(subject, until)| text += &format!("subject {} {subject}\n", calendar(*until)));
        replace(path, &text)
    }

    /// Revokes one token.
    pub fn revoke_id(&mut self, id: &str) {
        self.ids.insert(id.to_owned());
    }

    /// Revokes what was issued to a subject up to some time.
    pub fn revoke_subject(&mut self, subject: &str, until: WorldTime) {
        let is = self.subjects.entry(subject.to_owned()).or_insert(until);
        *is = until.max(*is);
    }

    /// Whether a token is revoked.
    pub fn covers(&self, claims: &Claims) -> bool {
        self.covers_token(&claims.id, &claims.subject, claims.issued)
    }

    /// Whether the token of this name, issued then to that subject, is revoked.
    pub fn covers_token(&self, id: &str, subject: &str, issued: WorldTime) -> bool {
        self.ids.contains(id) || self.subjects.get(subject).is_some_and(|until| issued <= *until)
    }

    /// Number of tokens and subjects on the list.
    pub fn len(&self) -> usize {
        self.ids.len() + self.subjects.len()
    }

    /// Whether nothing is revoked.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use eyeline_protocol::Rank;

    use super::*;

    #[test]
    fn a_list_of_revocations_is_read_as_it_was_written() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("tokens.revoked");
        assert!(Revocations::read(&path).unwrap().is_empty());
        let noon = from_calendar("2026-01-01T12:00:00Z").unwrap();
        let mut revoked = Revocations::default();
        revoked.revoke_id("ab12");
        revoked.revoke_subject("anna of the hill", noon);
        revoked.revoke_subject("anna of the hill", WorldTime::ZERO);
        revoked.write(&path).unwrap();
        assert_eq!(Revocations::read(&path).unwrap(), revoked);
        let claims = |id: &str, subject: &str, issued| Claims {
            audience: String::new(),
            subject: subject.into(),
            id: id.into(),
            issued,
            expires: WorldTime::MAX,
            role: Rank::Actor,
            avatars: 1,
        };
        let second = std::time::Duration::from_secs(1);
        assert!(revoked.covers(&claims("ab12", "bob", noon + second)));
        assert!(!revoked.covers(&claims("ab13", "bob", noon)));
        assert!(revoked.covers(&claims("1", "anna of the hill", noon)));
        assert!(!revoked.covers(&claims("1", "anna of the hill", noon + second)));
    }

    #[test]
    fn the_private_key_is_its_owners_alone() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("made/tokens.key");
        let (secret, public) = super::super::make_keys().unwrap();
        assert_eq!(write_keys(&path, &secret, &public).unwrap(), folder.path().join("made/tokens.pub"));
        assert_eq!(read_secret(&path).unwrap().text(), secret.text());
        assert_eq!(read_public(&public_path(&path)).unwrap().text(), public.text());
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        }
        // What there is is never written over.
        assert!(write_keys(&path, &secret, &public).unwrap_err().to_string().contains("stays as it is"));
    }
}
