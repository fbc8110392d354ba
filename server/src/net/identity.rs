//! Who the server is: a certificate, and its fingerprint that clients pin.

use std::path::{Path, PathBuf};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

use crate::hash::sha256;

/// A certificate and its private key.
pub struct Identity {
    pub(super) certificate: CertificateDer<'static>,
    pub(super) key: PrivateKeyDer<'static>,
}

/// Why there is no identity.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{}: not a PEM file with a {what} ({reason}); delete both files of the identity to get new ones", path.display())]
    Pem {
        /// Which.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// What was found.
        reason: String,
    },
    /// The certificate could not be made.
    #[error("could not make a certificate: {0}")]
    Make(#[from] rcgen::Error),
}

impl Identity {
    /// A new self-signed Ed25519 certificate, kept nowhere.
    ///
    /// # Errors
    /// If the system has no randomness to give.
    pub fn ephemeral() -> Result<Identity, IdentityError> {
        let (certificate, key) = make()?;
        let key = PrivateKeyDer::try_from(key.serialize_der()).map_err(|_| rcgen::Error::CouldNotParseKeyPair)?;
        Ok(Identity { certificate: certificate.der().clone(), key })
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
        let key = PrivateKeyDer::Pkcs8(pkcs8.into());
        Ok(Identity { certificate: certificate.der().clone(), key })
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
            let at = |path: &Path| {
                let path = path.to_owned();
                move |source| IdentityError::File { path, source }
            };
            std::fs::create_dir_all(folder).map_err(at(folder))?;
            write_private(&key_path, key.serialize_pem().as_bytes()).map_err(at(&key_path))?;
            std::fs::write(&certificate_path, certificate.pem()).map_err(at(&certificate_path))?;
        }
        let read =
            |path: &Path| std::fs::read(path).map_err(|source| IdentityError::File { path: path.to_owned(), source });
        let bad = |path: &Path, what| {
            let path = path.to_owned();
            move |error: rustls::pki_types::pem::Error| IdentityError::Pem { path, what, reason: error.to_string() }
        };
        let certificate =
            CertificateDer::from_pem_slice(&read(&certificate_path)?).map_err(bad(&certificate_path, "certificate"))?;
        let key = PrivateKeyDer::from_pem_slice(&read(&key_path)?).map_err(bad(&key_path, "private key"))?;
        Ok(Identity { certificate, key })
    }

    /// SHA-256 of the certificate: what a client pins.
    pub fn fingerprint(&self) -> [u8; 32] {
        sha256(&self.certificate)
    }

    /// The fingerprint as 64 hexadecimal digits.
    pub fn fingerprint_hex(&self) -> String {
        self.fingerprint().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

fn make() -> Result<(rcgen::Certificate, rcgen::KeyPair), rcgen::Error> {
    // Ed25519 keeps the handshake's size fixed, which simulations like.
    let key = rcgen::KeyPair::generate_for(&rcgen::PKCS_ED25519)?;
    Ok((certificate(&key)?, key))
}

fn certificate(key: &rcgen::KeyPair) -> Result<rcgen::Certificate, rcgen::Error> {
    rcgen::CertificateParams::new(vec!["eyeline".to_owned()])?.self_signed(key)
}

fn write_private(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
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
}
