//! Every file that the gate and TLS read, wrong in every way that we know: does the error name the file and the remedy?

use std::path::Path;

use tempfile::TempDir;

use super::{Identity, TokenGate};
use crate::token::files::{read_public, read_secret, revoked_path, write_keys};
use crate::token::make_keys;

/// A self-signed pair in PEM.
fn pair() -> (String, String) {
    let key = rcgen::KeyPair::generate().unwrap();
    let certificate = rcgen::CertificateParams::new(vec!["localhost".into()]).unwrap().self_signed(&key).unwrap();
    (certificate.pem(), key.serialize_pem())
}

fn cut(pem: &str) -> String {
    pem[..pem.len() / 2].to_owned()
}

#[test]
fn a_wrong_certificate_or_key_names_its_file_and_the_remedy() {
    let folder = TempDir::new().unwrap();
    let (certificate_path, key_path) = (folder.path().join("c.pem"), folder.path().join("k.pem"));
    let (certificate, key) = pair();
    let (_, other_key) = pair();
    let encrypted =
        key.replace("BEGIN PRIVATE", "BEGIN ENCRYPTED PRIVATE").replace("END PRIVATE", "END ENCRYPTED PRIVATE");
    let unknown =
        key.lines().enumerate().map(|(n, line)| if n == 1 { "AAAA" } else { line }).collect::<Vec<_>>().join("\n");
    let damaged = certificate.replacen("\nMI", "\n!!", 1);
    let not_der = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n".to_owned();
    let cases: [(&str, &str, &str, &str); 14] = [
        (&key, &certificate, "c.pem", "are the two files swapped?"),
        (&certificate, &certificate, "k.pem", "it holds a certificate; are the two files swapped?"),
        (&key, &key, "c.pem", "it holds a private key; are the two files swapped?"),
        (&certificate, &other_key, "k.pem", "does not belong to the certificate in"),
        (&certificate, &encrypted, "k.pem", "openssl pkey"),
        (&certificate, &unknown, "c.pem", "have a certificate with an ECDSA, Ed25519 or RSA key made"),
        (&cut(&certificate), &key, "c.pem", "it was cut off: a -----END line is missing"),
        (&certificate, &cut(&key), "k.pem", "it was cut off: a -----END line is missing"),
        (&damaged, &key, "c.pem", "copy it again"),
        (&not_der, &key, "c.pem", "TLS can't use it"),
        ("", &key, "c.pem", "it is empty"),
        (&certificate, " \n", "k.pem", "it is empty"),
        ("\u{30}\u{82} DER", &key, "c.pem", "openssl x509 -inform der"),
        ("-----BEGIN X509 CRL-----\nAAAA\n-----END X509 CRL-----\n", &key, "c.pem", "it holds something else"),
    ];
    for (certificate, key, file, said) in cases {
        std::fs::write(&certificate_path, certificate).unwrap();
        std::fs::write(&key_path, key).unwrap();
        let error = Identity::from_files(&certificate_path, &key_path).unwrap_err().to_string();
        assert!(error.contains(file) && error.contains(said), "{said}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
    std::fs::write(&key_path, &key).unwrap();
    std::fs::write(&certificate_path, &certificate).unwrap();
    assert!(Identity::from_files(&certificate_path, &key_path).is_ok());
    std::fs::write(&key_path, vec![b'-'; (1 << 20) + 1]).unwrap();
    let error = Identity::from_files(&certificate_path, &key_path).unwrap_err().to_string();
    assert!(error.contains("k.pem") && error.contains("too many"), "{error}");
    std::fs::remove_file(&key_path).unwrap();
    let error = Identity::from_files(&certificate_path, &key_path).unwrap_err().to_string();
    assert!(error.contains("k.pem") && error.contains("is the path right"), "{error}");
}

/// Reads a file; what is wrong with it.
type Read = fn(&Path) -> Option<String>;

#[test]
fn a_wrong_key_or_list_of_tokens_names_its_file_and_the_remedy() {
    let folder = TempDir::new().unwrap();
    let (secret, public) = make_keys().unwrap();
    let key = folder.path().join("t.key");
    let public_path = write_keys(&key, &secret, &public).unwrap();
    let gate: Read = |path| TokenGate::new(&[path.to_owned()], "hall").err().map(|error| error.to_string());
    let signs: Read = |path| read_secret(path).err().map(|error| error.to_string());
    let checks: Read = |path| read_public(path).err().map(|error| error.to_string());
    assert!(gate(&public_path).is_none() && signs(&key).is_none() && checks(&public_path).is_none());

    let (secret, public) = (secret.text(), public.text());
    let file = folder.path().join("wrong.pub");
    let cases: [(Read, &str, &str); 8] = [
        (checks, &secret, "this is a private key, and a public one is wanted"),
        (signs, &public, "this is a public key, and a private one is wanted"),
        (gate, &secret, "name the other file of the pair"),
        (checks, &public[..30], "this is not a public key, which begins with k4.public."),
        (signs, &secret[..30], "this is not a private key, which begins with k4.secret."),
        (gate, "", "make a pair with `eyeline-server token key`"),
        (signs, "-----BEGIN PRIVATE KEY-----", "make a pair with `eyeline-server token key`"),
        (gate, "k4.public.AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA", "this is not a public key"),
    ];
    for (read, text, said) in cases {
        std::fs::write(&file, text).unwrap();
        private(&file);
        let error = read(&file).unwrap_or_else(|| panic!("{said}: no error"));
        assert!(error.contains("wrong.pub") && error.contains(said), "{said}: {error}");
        assert!(text.len() < 20 || !error.contains(&text[12..20]), "a key is not to be shown: {error}");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(&key, PermissionsExt::from_mode(0o644)).unwrap();
        assert!(signs(&key).unwrap().contains("t.key: others may read this private key (mode 644); `chmod 600` it"));
    }
    let missing = gate(&folder.path().join("none.pub")).unwrap();
    assert!(missing.contains("none.pub") && missing.contains("make a pair of keys"), "{missing}");
    std::fs::write(&file, vec![b'k'; 5_000]).unwrap();
    assert!(gate(&file).unwrap().contains("wrong.pub: 5000 bytes are too many"));

    let lines =
        ["id", "id ", "id a b", "subject anna", "subject tomorrow anna", "subject 2026-01-01 anna", "anna", "ids 1"];
    for line in lines {
        std::fs::write(revoked_path(&public_path), format!("# good\n\nid 1\n{line}\n")).unwrap();
        let error = gate(&public_path).unwrap_or_else(|| panic!("{line}: no error"));
        assert!(error.contains("t.revoked:4: ") && error.contains("'id ID' or 'subject TIME NAME'"), "{error}");
    }
}

fn private(path: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, PermissionsExt::from_mode(0o600)).unwrap();
    }
    #[cfg(not(unix))]
    let _ = path;
}
