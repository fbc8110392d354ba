//! Who the server is: a certificate that clients pin by its fingerprint, or one that an authority has signed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use eyeline_protocol::WorldTime;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{ClientHello, ResolvesServerCert};
use rustls::sign::CertifiedKey;

use super::dates::Complaint;
use super::watched::Watched;
use crate::hash::sha256;

/// Largest PEM file that is read, bytes.
const PEM_BYTES_MAX: u64 = 1 << 20;

/// A certificate and its private key.
#[derive(Debug)]
pub struct Identity {
    shown: Arc<Shown>,
    /// Certificate and key, if they are in files.
    files: Option<Watched<Arc<CertifiedKey>>>,
}

/// What handshakes show now.
#[derive(Debug)]
pub(super) struct Shown {
    now: RwLock<Arc<CertifiedKey>>,
}

impl Shown {
    fn now(&self) -> Arc<CertifiedKey> {
        self.now.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl ResolvesServerCert for Shown {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.now())
    }
}

/// Why there is no identity.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file could not be read or written.
    #[error("{}: {source}; is the path right, and may the server's user read it?", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{}: not a PEM file with a {what} ({reason})", path.display())]
    Pem {
        /// Which.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// What was found, and the remedy.
        reason: String,
    },
    /// The two don't belong together.
    #[error("{}: this key does not belong to the certificate in {}; name the two files of one pair", key.display(), certificate.display())]
    Pair {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
    },
    /// TLS can't use the certificate or its key.
    #[error("{}: TLS can't use it with {}: {source}; have a certificate with an ECDSA, Ed25519 or RSA key made", certificate.display(), key.display())]
    Unusable {
        /// The certificate's file.
        certificate: PathBuf,
        /// The key's file.
        key: PathBuf,
        /// Why.
        source: rustls::Error,
    },
    /// The certificate could not be made.
    #[error("could not make a certificate: {0}")]
    Make(#[from] rcgen::Error),
    /// The certificate that was made can't be used.
    #[error("could not use the certificate that was made: {0}")]
    Made(#[from] rustls::Error),
}

impl Identity {
    /// A new self-signed Ed25519 certificate, kept nowhere.
    ///
    /// # Errors
    /// If the system has no randomness to give.
    pub fn ephemeral() -> Result<Identity, IdentityError> {
        let (certificate, key) = make()?;
        let key = PrivateKeyDer::try_from(key.serialize_der()).map_err(|_| rcgen::Error::CouldNotParseKeyPair)?;
        Identity::kept_nowhere(certificate.der().clone(), key)
    }

    /// The same identity every time, made from a key that everybody can read here: for simulations, whose handshakes are to
    /// be of the same bytes' number in every run. Never for a server that strangers can reach.
    ///
    /// # Errors
    /// If the certificate can't be made.
    pub fn simulated() -> Result<Identity, IdentityError> {
        // PKCS #8 around an Ed25519 seed (RFC 8410 §7).
        let mut pkcs8 = b"\x30\x2e\x02\x01\x00\x30\x05\x06\x03\x2b\x65\x70\x04\x22\x04\x20".to_vec();
        pkcs8.extend([0x5a; 32]);
        let key = rcgen::KeyPair::try_from(pkcs8.clone())?;
        let certificate = certificate(&key)?;
        Identity::kept_nowhere(certificate.der().clone(), PrivateKeyDer::Pkcs8(pkcs8.into()))
    }

    fn kept_nowhere(
        certificate: CertificateDer<'static>,
        key: PrivateKeyDer<'static>,
    ) -> Result<Identity, IdentityError> {
        let pair = CertifiedKey::from_der(vec![certificate], key, &default_provider())?;
        Ok(Identity { shown: Arc::new(Shown { now: RwLock::new(Arc::new(pair)) }), files: None })
    }

    /// The identity in `folder` (`certificate.pem` and `key.pem`), made on the first run. The key is readable by its
    /// owner only.
    ///
    /// # Errors
    /// Names the file and the remedy.
    pub fn load_or_create(folder: &Path) -> Result<Identity, IdentityError> {
        let certificate_path = folder.join("certificate.pem");
        let key_path = folder.join("key.pem");
        if !certificate_path.exists() && !key_path.exists() {
            let (certificate, key) = make()?;
            std::fs::create_dir_all(folder).map_err(at(folder))?;
            write_private(&key_path, key.serialize_pem().as_bytes()).map_err(at(&key_path))?;
            std::fs::write(&certificate_path, certificate.pem()).map_err(at(&certificate_path))?;
        }
        let own = |error| match error {
            IdentityError::Pem { path, what, reason } => {
                let reason = format!("{reason}; delete both files of the identity to get new ones");
                IdentityError::Pem { path, what, reason }
            }
            other => other,
        };
        Identity::from_files(&certificate_path, &key_path).map_err(own)
    }

    /// A certificate in a PEM file, the authorities in between after it, and its key in another.
    ///
    /// # Errors
    /// Names the file and the remedy.
    pub fn from_files(certificate: &Path, key: &Path) -> Result<Identity, IdentityError> {
        let files = Watched::new(vec![certificate.to_owned(), key.to_owned()], read_pair)?;
        Ok(Identity { shown: Arc::new(Shown { now: RwLock::new(files.get().clone()) }), files: Some(files) })
    }

    /// SHA-256 of the certificate: what a client pins.
    pub fn fingerprint(&self) -> [u8; 32] {
        fingerprint(&self.shown.now())
    }

    /// The fingerprint as 64 hexadecimal digits.
    pub fn fingerprint_hex(&self) -> String {
        hex(self.fingerprint())
    }

    /// What is to be said at `now` about the time for which the certificate in `file` is good, and those after it. Clients
    /// that pin a fingerprint do not mind; those that trust an authority do.
    pub fn complaints(&self, file: &Path, now: WorldTime) -> Vec<Complaint> {
        super::dates::complaints(file, &self.shown.now().cert, now)
    }

    /// What handshakes ask for the certificate.
    pub(super) fn shown(&self) -> Arc<Shown> {
        self.shown.clone()
    }

    /// What reads the files again while the server runs; nothing for an identity that is in none.
    pub fn reloader(&mut self) -> Option<Reloader> {
        self.files.take().map(|files| Reloader { shown: self.shown.clone(), files })
    }
}

/// Shows new connections what the files say now. Connections that there are go on with what they were made with.
#[derive(Debug)]
pub struct Reloader {
    shown: Arc<Shown>,
    files: Watched<Arc<CertifiedKey>>,
}

/// How often files of a certificate are looked at.
const LOOK: Duration = Duration::from_secs(2);

impl Reloader {
    /// Looks whether the files have changed. Files that are no good, or of which only one has changed yet, are reported, and
    /// the old certificate stays.
    pub fn look(&mut self) -> bool {
        let is_new = self.files.look(read_pair);
        if is_new {
            let pair = self.files.get().clone();
            tracing::info!(
                fingerprint = hex(fingerprint(&pair)),
                "new connections are shown the certificate that came"
            );
            *self.shown.now.write().unwrap_or_else(PoisonError::into_inner) = pair;
        }
        is_new
    }

    /// Looks every two seconds, and at SIGHUP where there is such a thing. Never ends.
    pub async fn run(mut self) {
        #[cfg(unix)]
        let mut hangup = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).ok();
        loop {
            #[cfg(unix)]
            let asked = async {
                match &mut hangup {
                    Some(hangup) => hangup.recv().await,
                    None => std::future::pending().await,
                }
            };
            #[cfg(not(unix))]
            let asked = std::future::pending::<()>();
            tokio::select! {
                _ = asked => {}
                () = tokio::time::sleep(LOOK) => {}
            }
            self.look();
        }
    }
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> IdentityError {
    let path = path.to_owned();
    move |source| IdentityError::File { path: path.clone(), source }
}

fn read_pair(paths: &[PathBuf]) -> Result<Arc<CertifiedKey>, IdentityError> {
    let (certificate_path, key_path) = (&paths[0], &paths[1]);
    let (certificate_pem, key_pem) = (read(certificate_path)?, read(key_path)?);
    let certificates: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&certificate_pem).collect();
    let certificates = certificates.map_err(|error| pem(certificate_path, "certificate", broken(&error)))?;
    if certificates.is_empty() {
        return Err(pem(certificate_path, "certificate", found(&certificate_pem)));
    }
    let key = PrivateKeyDer::from_pem_slice(&key_pem).map_err(|error| match error {
        rustls::pki_types::pem::Error::NoItemsFound => pem(key_path, "private key", found(&key_pem)),
        error => pem(key_path, "private key", broken(&error)),
    })?;
    let (certificate, key_file) = (certificate_path.clone(), key_path.clone());
    CertifiedKey::from_der(certificates, key, &default_provider()).map(Arc::new).map_err(|error| match error {
        rustls::Error::InconsistentKeys(_) => IdentityError::Pair { certificate, key: key_file },
        source => IdentityError::Unusable { certificate, key: key_file, source },
    })
}

fn read(path: &Path) -> Result<Vec<u8>, IdentityError> {
    let bytes = std::fs::metadata(path).map_err(at(path))?.len();
    if bytes > PEM_BYTES_MAX {
        return Err(pem(
            path,
            "certificate or key",
            format!("{bytes} bytes are too many for one; is it another file?"),
        ));
    }
    std::fs::read(path).map_err(at(path))
}

fn pem(path: &Path, what: &'static str, reason: String) -> IdentityError {
    IdentityError::Pem { path: path.to_owned(), what, reason }
}

/// What is wrong with a PEM file, with the remedy.
fn broken(error: &rustls::pki_types::pem::Error) -> String {
    match error {
        rustls::pki_types::pem::Error::MissingSectionEnd { .. } => {
            "it was cut off: a -----END line is missing; copy it again".to_owned()
        }
        error => format!("{error}; copy it again"),
    }
}

/// What is in a file in which the right thing is not, with the remedy.
fn found(pem: &[u8]) -> String {
    let text = String::from_utf8_lossy(pem);
    let found = if text.contains("-----BEGIN ENCRYPTED PRIVATE KEY") || text.contains("Proc-Type: 4,ENCRYPTED") {
        "it holds an encrypted key; decrypt it, for instance with `openssl pkey -in KEY -out PLAIN`"
    } else if text.contains("PRIVATE KEY-----") {
        "it holds a private key; are the two files swapped?"
    } else if text.contains("-----BEGIN CERTIFICATE-----") {
        "it holds a certificate; are the two files swapped?"
    } else if text.contains("-----BEGIN") {
        "it holds something else"
    } else if text.trim().is_empty() {
        "it is empty"
    } else {
        "it has no line that begins with -----BEGIN; convert it, for instance with `openssl x509 -inform der`"
    };
    found.to_owned()
}

fn fingerprint(pair: &CertifiedKey) -> [u8; 32] {
    // A pair without a certificate is never made.
    pair.end_entity_cert().map_or([0; 32], |certificate| sha256(certificate))
}

fn hex(bytes: [u8; 32]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn make() -> Result<(rcgen::Certificate, rcgen::KeyPair), rcgen::Error> {
    // Ed25519 keeps the handshake's size fixed, which simulations like.
    let key = rcgen::KeyPair::generate_for(&rcgen::PKCS_ED25519)?;
    Ok((certificate(&key)?, key))
}

fn certificate(key: &rcgen::KeyPair) -> Result<rcgen::Certificate, rcgen::Error> {
    rcgen::CertificateParams::new(vec!["eyeline".to_owned()])?.self_signed(key)
}

/// Writes a file that only its owner may read, and only if there is none.
pub(crate) fn write_private(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    use std::io::Write;
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.mode(0o600);
    }
    options.open(path)?.write_all(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_simulated_identity_is_always_the_same_and_no_other_is() {
        let fingerprint = || Identity::simulated().unwrap().fingerprint();
        assert_eq!(fingerprint(), fingerprint());
        assert_ne!(Identity::ephemeral().unwrap().fingerprint(), fingerprint());
    }

    #[test]
    fn new_files_are_shown_and_bad_ones_keep_the_old_certificate() {
        let folder = tempfile::TempDir::new().unwrap();
        let mut identity = Identity::load_or_create(folder.path()).unwrap();
        let first = identity.fingerprint();
        let mut reloader = identity.reloader().unwrap();
        assert!(!reloader.look());
        let (certificate, key) = make().unwrap();
        // Only one of the two has been exchanged so far.
        std::fs::write(folder.path().join("certificate.pem"), certificate.pem()).unwrap();
        assert!(!reloader.look());
        assert_eq!(identity.fingerprint(), first);
        std::fs::write(folder.path().join("key.pem"), key.serialize_pem()).unwrap();
        assert!(reloader.look());
        assert_eq!(identity.fingerprint(), sha256(certificate.der()));
        std::fs::remove_file(folder.path().join("key.pem")).unwrap();
        assert!(!reloader.look());
        assert_eq!(identity.fingerprint(), sha256(certificate.der()));
        assert!(Identity::ephemeral().unwrap().reloader().is_none());
    }
}
