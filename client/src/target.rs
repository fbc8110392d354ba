//! Which server, whom to believe that it is it, and who we are: the options that every client has.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use eyeline_protocol::TOKEN_BYTES_MAX;

use crate::net::{Endpoint, Fingerprint, Trust};

/// Which server.
#[derive(Args, Clone, Debug)]
pub struct Target {
    /// Address of the server, HOST:PORT
    #[arg(long, value_name = "HOST:PORT", requires = "trust")]
    pub connect: Option<String>,

    /// SHA-256 of the server's certificate, 64 hexadecimal digits: the server prints it when it starts
    #[arg(long, value_name = "HEX", requires = "connect", group = "trust")]
    pub fingerprint: Option<Fingerprint>,

    /// Instead, a PEM file with the certificates of authorities: who has one that they signed for its name is believed
    #[arg(long, value_name = "FILE", requires = "connect", conflicts_with = "server_file", group = "trust")]
    pub ca: Option<PathBuf>,

    /// With --ca, the name that the server's certificate is for [default: the host of --connect]
    #[arg(long, value_name = "NAME", requires = "ca", conflicts_with = "fingerprint")]
    pub server_name: Option<String>,

    /// Instead of both, the file that the server wrote with --ready-file; waited for up to 30 s
    #[arg(long, value_name = "FILE", conflicts_with = "connect")]
    pub server_file: Option<PathBuf>,

    /// A token that says who we are, or a file with it; others on this machine may see what is on a command line [default:
    /// the variable EYELINE_TOKEN, else none]
    #[arg(long, value_name = "TOKEN|FILE")]
    pub token: Option<String>,
}

/// How tokens begin (PASETO v4.public).
const TOKEN_PREFIX: &str = "v4.public.";

/// A token as it is given: itself, or the file that it is in.
fn read_token(given: &str) -> anyhow::Result<Vec<u8>> {
    let given = given.trim();
    if given.starts_with(TOKEN_PREFIX) {
        anyhow::ensure!(
            given.len() <= TOKEN_BYTES_MAX,
            "the token is of {} bytes, more than {TOKEN_BYTES_MAX}; is something pasted to it?",
            given.len()
        );
        return Ok(given.as_bytes().to_vec());
    }
    let shown = given.chars().take(80).collect::<String>().escape_debug().to_string();
    let text = std::fs::read_to_string(given).with_context(|| {
        format!("'{shown}' is neither a token, which begins with {TOKEN_PREFIX}, nor a file with one")
    })?;
    let text = text.trim();
    anyhow::ensure!(
        text.starts_with(TOKEN_PREFIX) && text.len() <= TOKEN_BYTES_MAX,
        "{shown}: there is no token in it, which begins with {TOKEN_PREFIX} and has at most {TOKEN_BYTES_MAX} bytes; \
         `eyeline-server token issue` prints one"
    );
    Ok(text.as_bytes().to_vec())
}

/// How long a server's file is waited for, and how often it is looked for.
const SERVER_FILE_WAIT: Duration = Duration::from_secs(30);
const SERVER_FILE_LOOK: Duration = Duration::from_millis(20);

impl Target {
    /// Whether a server is named at all. Not all commands need one, so the options do not ask for it; [`Target::resolve`] does.
    pub fn is_given(&self) -> bool {
        self.connect.is_some() || self.server_file.is_some()
    }

    /// For a command that is nothing without a server: ends the process as every wrong use of options does, with 2, if none is
    /// named.
    pub fn require(&self) {
        if !self.is_given() {
            let missing = "the following required arguments were not provided:\n  --connect <HOST:PORT> or --server-file <FILE>\n";
            clap::Error::raw(clap::error::ErrorKind::MissingRequiredArgument, missing).exit();
        }
    }

    /// The server's address and how it is trusted; waits for the server's file.
    ///
    /// # Errors
    /// Names the value or the file, and the remedy.
    pub fn resolve(&self) -> anyhow::Result<(SocketAddr, Trust)> {
        match (&self.connect, self.fingerprint, &self.ca, &self.server_file) {
            (Some(address), Some(fingerprint), ..) => Ok((resolve(address)?, fingerprint.into())),
            (Some(address), _, Some(authorities), _) => {
                let host = address.rsplit_once(':').map_or(address.as_str(), |(host, _)| host);
                // An IPv6 address is written with brackets before a port, and without in a certificate.
                let host = host.trim_start_matches('[').trim_end_matches(']');
                let name = self.server_name.as_deref().unwrap_or(host);
                Ok((resolve(address)?, Trust::signed(authorities, name)?))
            }
            (.., Some(path)) => {
                let text = wait_for(path)?;
                let mut lines = text.lines();
                let (Some(address), Some(fingerprint)) = (lines.next(), lines.next()) else {
                    anyhow::bail!("{}: not a server's file: needs an address and a fingerprint", path.display());
                };
                let name = || path.display().to_string();
                let fingerprint = fingerprint.parse::<Fingerprint>().with_context(name)?;
                Ok((resolve(address).with_context(name)?, fingerprint.into()))
            }
            _ => anyhow::bail!("which server? give --connect with --fingerprint or --ca, or --server-file"),
        }
    }

    /// A socket for connections to the server, and its address. Needs a tokio runtime around it.
    ///
    /// # Errors
    /// As [`Target::resolve`], or if there is no socket to be had.
    pub fn endpoint(&self) -> anyhow::Result<(Endpoint, SocketAddr)> {
        let (address, trust) = self.resolve()?;
        Ok((Endpoint::new(trust, address)?, address))
    }

    /// The token to show; empty without one.
    ///
    /// # Errors
    /// Says what it is instead of a token, and the remedy.
    pub fn token(&self) -> anyhow::Result<Vec<u8>> {
        if let Some(given) = &self.token {
            return read_token(given).context("--token");
        }
        match std::env::var("EYELINE_TOKEN") {
            Ok(given) if !given.trim().is_empty() => read_token(&given).context("EYELINE_TOKEN"),
            Ok(_) | Err(std::env::VarError::NotPresent) => Ok(Vec::new()),
            Err(error) => Err(error).context("EYELINE_TOKEN"),
        }
    }
}

fn resolve(address: &str) -> anyhow::Result<SocketAddr> {
    let mut found = address
        .to_socket_addrs()
        .with_context(|| format!("'{address}' is no address; give HOST:PORT, for instance 127.0.0.1:4433"))?;
    found.next().with_context(|| format!("'{address}' has no address"))
}

fn wait_for(path: &Path) -> anyhow::Result<String> {
    let waiting = now();
    loop {
        match std::fs::read_to_string(path) {
            Ok(text) => return Ok(text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound && waiting.elapsed() < SERVER_FILE_WAIT => {
                std::thread::sleep(SERVER_FILE_LOOK);
            }
            Err(error) => {
                let path = path.display();
                return Err(error)
                    .with_context(|| format!("no server has written {path}; start one with --ready-file"));
            }
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "a driver: it waits for a file")]
fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        target: Target,
    }

    fn target(args: &[&str]) -> Result<Target, clap::Error> {
        Options::try_parse_from(std::iter::once("client").chain(args.iter().copied())).map(|options| options.target)
    }

    #[test]
    fn a_server_is_pinned_or_signed_for_but_not_both() {
        let pin = "11".repeat(32);
        let pinned = target(&["--connect", "127.0.0.1:1", "--fingerprint", &pin]).unwrap().resolve().unwrap();
        assert!(matches!(pinned.1, Trust::Pinned(_)));
        for bad in [
            &["--connect", "127.0.0.1:1"][..],
            &["--connect", "127.0.0.1:1", "--fingerprint", &pin, "--ca", "a.pem"],
            &["--connect", "127.0.0.1:1", "--fingerprint", &pin, "--server-name", "a"],
            &["--ca", "a.pem"],
            &["--server-file", "a", "--ca", "a.pem"],
        ] {
            assert!(target(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn no_server_is_an_error_where_one_is_needed() {
        let none = target(&[]).unwrap();
        assert!(!none.is_given());
        assert!(none.resolve().unwrap_err().to_string().contains("give --connect"));
        assert!(target(&["--server-file", "a"]).unwrap().is_given());
    }

    #[test]
    fn a_token_is_given_as_it_is_or_in_a_file() {
        let path = std::env::temp_dir().join(format!("eyeline-token-{}", std::process::id()));
        let given = path.to_str().unwrap();
        let token = |given: &str| {
            let target = target(&["--server-file", "none", "--token", given]).unwrap();
            target.token().map_err(|error| crate::app::one_line(&error))
        };
        assert_eq!(token(" v4.public.abc\n"), Ok(b"v4.public.abc".to_vec()));
        std::fs::write(&path, "v4.public.def\n").unwrap();
        assert_eq!(token(given), Ok(b"v4.public.def".to_vec()));
        std::fs::write(&path, "k4.secret.def\n").unwrap();
        let error = token(given).unwrap_err();
        assert!(error.contains("there is no token in it") && !error.contains("secret"), "{error}");
        std::fs::remove_file(&path).unwrap();
        let error = token(given).unwrap_err();
        assert!(error.starts_with("--token: ") && error.contains("neither a token"), "{error}");
        let long = format!("v4.public.{}", "A".repeat(1_015));
        assert!(token(&long).unwrap_err().contains("1025 bytes, more than 1024"));
    }
}
