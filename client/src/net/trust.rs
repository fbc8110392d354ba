//! Which servers a client believes: the one whose certificate it was told, or all that an authority has signed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::RootCertStore;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};

use super::pin::Fingerprint;

/// Which servers to believe.
#[derive(Clone, Debug)]
pub enum Trust {
    /// The one that shows this certificate, whoever signed it.
    Pinned(Fingerprint),
    /// Those whose certificate one of these authorities has signed for this name.
    Signed {
        /// The authorities.
        authorities: Arc<RootCertStore>,
        /// The server's name, or its address.
        name: String,
    },
}

impl From<Fingerprint> for Trust {
    fn from(fingerprint: Fingerprint) -> Trust {
        Trust::Pinned(fingerprint)
    }
}

/// Why authorities can't be believed.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// The file can't be read.
    #[error("{}: {source}; give --ca a PEM file with the authority's certificate", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A certificate in it is none.
    #[error("{}: certificate {number} in it can't be used ({reason}); give --ca a PEM file with the authority's certificate", path.display())]
    Certificate {
        /// Which file.
        path: PathBuf,
        /// Which certificate in it, from 1.
        number: usize,
        /// Why.
        reason: String,
    },
    /// There is none in it.
    #[error("{}: no certificate in it; give --ca a PEM file with the authority's certificate", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
    },
    /// The name is none.
    #[error(
        "'{0}' is not a server's name; give --server-name as the certificate has it, for instance world.example.org"
    )]
    Name(String),
}

impl Trust {
    /// Believes servers of this name whose certificate an authority in this PEM file has signed. Nothing is believed because
    /// the system believes it.
    ///
    /// # Errors
    /// Names the file, and what is wrong with it.
    pub fn signed(authorities: &Path, name: &str) -> Result<Trust, TrustError> {
        let path = authorities.to_owned();
        let pem = std::fs::read(authorities).map_err(|source| TrustError::File { path: path.clone(), source })?;
        let mut store = RootCertStore::empty();
        for (index, certificate) in CertificateDer::pem_slice_iter(&pem).enumerate() {
            let wrong = |reason| TrustError::Certificate { path: path.clone(), number: index + 1, reason };
            let certificate = certificate.map_err(|error| wrong(error.to_string()))?;
            store.add(certificate).map_err(|error| wrong(error.to_string()))?;
        }
        if store.is_empty() {
            return Err(TrustError::Empty { path });
        }
        if ServerName::try_from(name).is_err() {
            return Err(TrustError::Name(name.escape_debug().to_string()));
        }
        Ok(Trust::Signed { authorities: Arc::new(store), name: name.to_owned() })
    }

    /// The name that the handshake asks for. Who is pinned may have any.
    pub fn name(&self) -> &str {
        match self {
            Trust::Pinned(_) => "eyeline",
            Trust::Signed { name, .. } => name,
        }
    }
}

/// What helps against a certificate that was not believed, by what rustls says of it.
pub(super) fn remedy(reason: &str) -> &'static str {
    let remedies = [
        ("UnknownIssuer", "; no authority in --ca has signed it: give the right one, or pin it with --fingerprint"),
        ("BadSignature", "; an authority of the same name as one in --ca has signed it: give the right one"),
        ("not valid for name", "; give the name that it is for with --server-name"),
        ("NotValidForName", "; give the name that it is for with --server-name"),
        ("expired", "; the server's owner has to renew it, or our clock is wrong"),
        ("not valid yet", "; our clock is wrong, or the server's owner has put it there too early"),
        ("CaUsedAsEndEntity", "; it is an authority's own: have it sign one for the server"),
    ];
    remedies.iter().find(|(said, _)| reason.contains(said)).map_or("", |(_, remedy)| remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_not_be_believed_names_its_file_and_the_remedy() {
        let path = std::env::temp_dir().join(format!("eyeline-ca-{}.pem", std::process::id()));
        let cases = [
            ("", "no certificate in it"),
            ("-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n", "no certificate in it"),
            ("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n", "certificate 1 in it can't be used"),
            ("-----BEGIN CERTIFICATE-----\nAAAA\n", "certificate 1 in it can't be used"),
        ];
        for (pem, said) in cases {
            std::fs::write(&path, pem).unwrap();
            let error = Trust::signed(&path, "example.org").unwrap_err().to_string();
            assert!(error.contains("eyeline-ca") && error.contains(said) && error.contains("--ca"), "{error}");
        }
        std::fs::remove_file(&path).unwrap();
        let error = Trust::signed(&path, "example.org").unwrap_err().to_string();
        assert!(error.contains("No such file") && error.contains("--ca"), "{error}");
    }
}
