//! The `eyeline-client` command: options, what it prints, and how it ends.

use std::io::{IsTerminal as _, Write as _};
use std::net::{SocketAddr, ToSocketAddrs};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{Args, Subcommand};
use eyeline_protocol::TOKEN_BYTES_MAX;
use eyeline_visibility::{Aabb, DynamicOctree};

use crate::net::{Endpoint, Fingerprint, LocalClock, ModelSource, Onlooker, Trust, run_headless};
use crate::session::{Session, SessionConfig, SessionStats};
use crate::tracking::TrackerConfig;

/// What the client can do.
#[derive(Subcommand)]
pub enum Command {
    /// Join a world without a window: stand, turn, track, and print a line a second
    #[command(after_long_help = HEADLESS_EXAMPLES)]
    Headless(Headless),
}

/// Which server.
#[derive(Args, Clone, Debug)]
pub struct Target {
    /// Address of the server, HOST:PORT
    #[arg(long, value_name = "HOST:PORT", required_unless_present = "server_file", requires = "trust")]
    pub connect: Option<String>,

    /// SHA-256 of the server's certificate, 64 hexadecimal digits: the server prints it when it starts
    #[arg(long, value_name = "HEX", requires = "connect", group = "trust")]
    pub fingerprint: Option<Fingerprint>,

    /// Instead, a PEM file with the certificates of authorities: who has one that they signed for its name is believed
    #[arg(long, value_name = "FILE", requires = "connect", group = "trust")]
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

/// Where the model comes from.
#[derive(Args, Clone, Debug)]
pub struct WorldOptions {
    /// The model, if it is here; must be the one that the server serves [default: fetched from the server]
    #[arg(long, value_name = "FILE")]
    pub world: Option<PathBuf>,

    /// Folder for fetched models, by their hash [default: eyeline in the user's cache folder]
    #[arg(long, value_name = "DIR", conflicts_with = "world")]
    pub cache: Option<PathBuf>,
}

impl WorldOptions {
    /// The source that the options mean.
    pub fn source(&self) -> ModelSource {
        if let Some(file) = &self.world {
            return ModelSource::File(file.clone());
        }
        let folder = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let usual = || folder("XDG_CACHE_HOME").or_else(|| folder("HOME").map(|home| home.join(".cache")));
        match self.cache.clone().or_else(|| usual().map(|cache| cache.join("eyeline"))) {
            Some(folder) => ModelSource::Cache(folder),
            None => ModelSource::Fetch,
        }
    }
}

/// Options of `headless`.
#[derive(Args, Clone, Debug)]
pub struct Headless {
    #[command(flatten)]
    target: Target,

    #[command(flatten)]
    world: WorldOptions,

    /// How long to stay, seconds [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = number(0.1..=1e6, "s"))]
    seconds: Option<f64>,

    /// Frames a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, value_parser = number(0.1..=240.0, "Hz"))]
    frame_hz: f64,

    /// Pixels a side of the six images that decide what is hidden; more hides more and costs time
    #[arg(long, value_name = "PIXELS", default_value_t = 128, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// A name for people
    #[arg(long, default_value = "headless")]
    name: String,
}

const HEADLESS_EXAMPLES: &str = "Examples:
  eyeline-client headless --connect 127.0.0.1:4433 --fingerprint 11c4…d6b9 --seconds 10
  eyeline-client headless --connect example.org:4433 --ca authority.pem --token anna.token --cache /tmp/models
  eyeline-client headless --server-file ready.txt --world rooms.glb --frame-hz 10";

/// Runs `headless`.
///
/// # Errors
/// If there is no such server, it does not let us in, its world can't be had, or the connection is lost.
pub fn headless(options: &Headless) -> anyhow::Result<()> {
    let (address, trust) = options.target.resolve()?;
    let token = options.target.token()?;
    let period = Duration::from_secs_f64(1.0 / options.frame_hz);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let shutdown = shutdown_signal()?;
        let endpoint = Endpoint::new(trust, address)?;
        let config = SessionConfig::default()
            .with_name(options.name.clone())
            .with_token(token)
            .with_tracker(TrackerConfig::default().with_frame(period));
        // How large the world is will be known later.
        let session = Session::new(config, Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
        let scene = connection.scene(&options.world.source()).await?;
        let welcome = connection.session.welcome().context("no welcome")?;
        print(&format!(
            "{} at {address}: policy {}, {} triangles, {} objects, tick {} ms\n",
            welcome.world.name,
            welcome.policy,
            scene.triangles().len(),
            welcome.objects,
            f64::from(welcome.tick_micros) / 1e3,
        ));
        let mut second = Second::default();
        let on_frame = Box::new(|session: &mut Session, report: &crate::net::FrameReport| {
            second.add(report.cull + report.track);
            // A frame count, not a clock: a line stands for a second's frames.
            if second.frames >= options.frame_hz.ceil() as u32 {
                print(&second.line(session));
            }
        });
        let mut onlooker =
            Onlooker::new(&scene, welcome, options.side, on_frame).context("the server gave us no avatar")?;
        let end = async {
            match options.seconds {
                Some(seconds) => tokio::time::sleep(Duration::from_secs_f64(seconds)).await,
                None => std::future::pending().await,
            }
        };
        let end = async {
            tokio::select! {
                () = end => {}
                () = shutdown => {}
            }
        };
        let first = connection.clock().now();
        let ran = run_headless(&mut connection, &mut onlooker, period, first, end).await;
        let stats = *connection.session.stats();
        let (sent, sent_bytes, received, received_bytes) = connection.udp();
        let skipped = ran.as_ref().map_or(0, |summary| summary.skipped);
        let frames = connection.session.tracker().map_or(0, |tracker| tracker.stats().frames);
        let rtt = connection.session.round_trip().map_or("unknown".to_owned(), |(rtt, _)| format!("{rtt:.1?}"));
        print(&format!(
            "{frames} frames, {skipped} skipped; {} messages in, {} out; UDP {received} datagrams and \
             {received_bytes} bytes in, {sent} and {sent_bytes} out; round trip {rtt}; {} datagrams refused\n",
            stats.records_in, stats.records_out, stats.rejected,
        ));
        connection.close().await;
        endpoint.wait_idle().await;
        Ok(ran.map(drop)?)
    })
}

/// What is collected for one line of output.
#[derive(Default)]
struct Second {
    number: u32,
    frames: u32,
    work: Duration,
    /// The session's counters at the last line.
    before: SessionStats,
}

impl Second {
    fn add(&mut self, work: Duration) {
        self.frames += 1;
        self.work += work;
    }

    fn line(&mut self, session: &Session) -> String {
        self.number += 1;
        let (visible, hidden, asked) = session.tracker().map_or((0, 0, 0), |tracker| tracker.counts());
        let stats = *session.stats();
        let line = format!(
            "{:>4} s  {visible} visible, {hidden} hidden, {asked} asked for; {} messages in, {} out; {:.2} ms a frame\n",
            self.number,
            stats.records_in - self.before.records_in,
            stats.records_out - self.before.records_out,
            self.work.as_secs_f64() * 1e3 / f64::from(self.frames.max(1)),
        );
        *self = Second { number: self.number, before: stats, ..Second::default() };
        line
    }
}

/// A number on the command line, held to a range.
pub fn number(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number from {} to {} {unit}", range.start(), range.end())),
    }
}

/// Writes to standard output at once. Who has closed it does not want to read, which is no reason to end.
fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Ready when the process is asked to end: Ctrl-C, or SIGTERM where there is such a thing. Listens from the call on.
fn shutdown_signal() -> anyhow::Result<impl Future<Output = ()>> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
        let mut terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
        Ok(async move {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
        })
    }
    #[cfg(not(unix))]
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

/// An error and its causes in one line. Some name their cause themselves, which is then not said again.
pub fn one_line(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

/// Logs to standard error what `RUST_LOG` asks for; without it, warnings, and what Eyeline itself has to tell.
pub fn init_logs() {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| "warn,eyeline_client=info".into());
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(colours).with_writer(std::io::stderr).init();
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
    fn a_token_is_given_as_it_is_or_in_a_file() {
        let path = std::env::temp_dir().join(format!("eyeline-token-{}", std::process::id()));
        let given = path.to_str().unwrap();
        let token = |given: &str| {
            let target = target(&["--server-file", "none", "--token", given]).unwrap();
            target.token().map_err(|error| one_line(&error))
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
