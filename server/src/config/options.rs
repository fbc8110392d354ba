//! What a server can be told, option by option. Each is a flag, a key of the configuration file and an environment variable
//! at once: the flag's declaration here is all there is, so its range, its default and its words are the same everywhere.
//! An `id` with a dot puts a key into a section of the file; see [`super`].

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use eyeline_protocol::Rank;

use crate::model::POLICIES;
use crate::net::{Anonymous, ArrivalLimits, GateError, Identity, IdentityError, TokenGate};
use crate::policy::PolicySettings;
use crate::world::{Answers, Limited, Limits, Rate};

/// Everything that `eyeline-server` can be told.
#[derive(Args, Clone, Debug)]
pub struct ServerOptions {
    /// The model: a .glb, or a .gltf with its buffers beside it
    #[arg(long, value_name = "FILE")]
    pub world: Option<PathBuf>,

    /// What moves in the model, and where avatars start [default: NAME.world.toml beside the model, if there is one]
    #[arg(long, value_name = "FILE")]
    pub world_file: Option<PathBuf>,

    /// Everything but the world itself.
    #[command(flatten)]
    pub serve: ServeOptions,
}

/// Everything about serving but the world itself.
#[derive(Args, Clone, Debug)]
pub struct ServeOptions {
    /// The configuration file [default: eyeline-server.toml in the current folder, if it is there]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Whom a client is told about: `visible` (only what it could see: it holds bounds and asks), `broadcast`
    /// (everything), `oracle` (exactly what it sees; the server culls, so it costs much CPU), `radius` (what is within
    /// --radius), `grid` (what is in its own square of --cell metres and the eight around it), `pvs` (what is in a cell that
    /// may be seen from its own, by the table --pvs)
    #[arg(long, default_value = "visible", value_parser = PossibleValuesParser::new(POLICIES), hide_possible_values = true)]
    pub policy: String,

    /// For the policy `radius`: how far from the eye an object is told of, metres; a tenth farther it is withdrawn
    #[arg(long, value_name = "METRES", default_value_t = PolicySettings::default().radius, value_parser = number(0.01..=1e7, "m"))]
    pub radius: f64,

    /// For the policy `grid`: side of a square, metres
    #[arg(long, value_name = "METRES", default_value_t = PolicySettings::default().cell, value_parser = number(0.01..=1e7, "m"))]
    pub cell: f64,

    /// For the policy `pvs`: the table of potential visibility, which `eyeline-sim bake` makes for a model
    #[arg(long, value_name = "FILE")]
    pub pvs: Option<PathBuf>,

    /// UDP address and port to listen on; port 0 lets the system choose
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:4433", value_parser = address)]
    pub listen: SocketAddr,

    /// Folder of the certificate that the server makes for itself on the first run, and its key. Clients pin its fingerprint.
    /// Not looked at with --tls-certificate
    #[arg(long, value_name = "DIR", default_value = "eyeline-identity")]
    pub identity: PathBuf,

    /// Commits of the world's state a second, Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, value_parser = number(0.1..=1000.0, "Hz"))]
    pub tick_hz: f64,

    /// When requests are answered: on `arrival`, or with the `tick`, in the datagram that goes anyway. That takes less processor
    /// time, and each answer up to a tick longer
    #[arg(long, value_name = "WHEN", default_value_t = Answers::default())]
    pub answers: Answers,

    /// Least radius within which a hidden object's place is kept uncertain, metres; more hides more and costs messages
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = number(0.0..=1000.0, "m"))]
    pub blur: f64,

    /// Seed of the secret grid that hides places; only for tests, since who knows it knows more [default: random]
    #[arg(long, value_name = "N", value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: Option<u64>,

    /// Most avatars in the world at once
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = whole::<u32>(1..=1_000_000))]
    pub max_avatars: u32,

    /// Greatest speed of an avatar, m/s; faster ones are held back [default: the world file's, else 2]
    #[arg(long, value_name = "M/S", value_parser = number(0.0..=1e6, "m/s"))]
    pub avatar_speed: Option<f64>,

    /// Look for oneself whether a client may see what it asks the place of, and answer with a bound if not. Costs CPU
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true", default_value = "false", hide_possible_values = true, action = clap::ArgAction::Set)]
    pub audit: bool,

    /// Tell a state only when a client would otherwise draw something wrong by more than so many of its pixels [default: at
    /// each change]
    #[arg(long, value_name = "PX", value_parser = number(0.0..=1000.0, "px"))]
    pub dead_reckoning: Option<f64>,

    /// Most bytes a second to one client; what is largest and oldest goes first [default: no limit]
    #[arg(long, value_name = "N", value_parser = whole::<u32>(1000..=u64::from(u32::MAX)))]
    pub bytes_per_second: Option<u32>,

    /// For how long the avatars of a client whose connection was lost wait for it, seconds; 0 does without
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = number(0.0..=3600.0, "s"))]
    pub resume_seconds: f64,

    /// Once listening, write the address and the fingerprint into this file, a line each, for scripts and
    /// `--server-file`; it is removed at the end
    #[arg(long, value_name = "FILE")]
    pub ready_file: Option<PathBuf>,

    /// A certificate of one's own.
    #[command(flatten)]
    pub tls: TlsOptions,

    /// Who is let in.
    #[command(flatten)]
    pub gate: GateOptions,

    /// How the server is watched and stopped.
    #[command(flatten)]
    pub watch: WatchOptions,

    /// What one client or address may cost.
    #[command(flatten)]
    pub limits: LimitOptions,
}

/// The section `[tls]`: a certificate that clients need not pin.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "TLS: a certificate of one's own")]
pub struct TlsOptions {
    /// Certificate in a PEM file, the authorities in between after it, instead of the one in --identity. Read again when the
    /// file changes and at SIGHUP; one that can't be used is reported and the old one stays
    #[arg(id = "tls.certificate", long = "tls-certificate", value_name = "FILE")]
    pub certificate: Option<PathBuf>,

    /// The certificate's private key in a PEM file, not encrypted
    #[arg(id = "tls.key", long = "tls-key", value_name = "FILE")]
    pub key: Option<PathBuf>,
}

impl ServeOptions {
    /// The certificate that they mean: that of `[tls]`, else the server's own.
    ///
    /// # Errors
    /// Names the file that is not what it should be, and the remedy.
    pub fn certificate(&self) -> Result<Identity, IdentityError> {
        match (&self.tls.certificate, &self.tls.key) {
            (Some(certificate), Some(key)) => Identity::from_files(certificate, key),
            _ => Identity::load_or_create(&self.identity),
        }
    }
}

/// The section `[gate]`: who is let in, and as what.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Gate: who is let in")]
pub struct GateOptions {
    /// Public keys whose tokens are good here, as `eyeline-server token key` makes them. Revoked tokens are listed in
    /// NAME.revoked beside each. Both are read again when they change
    #[arg(id = "gate.keys", long = "token-keys", value_name = "FILE", value_delimiter = ',')]
    pub keys: Vec<PathBuf>,

    /// The server's name in tokens: one that was issued for another name is not good here. Give each of several servers
    /// that share a key its own
    #[arg(id = "gate.audience", long = "token-audience", value_name = "NAME", default_value = "eyeline", value_parser = audience)]
    pub audience: String,

    /// Who may come without a token: clients on this machine, clients from anywhere, or nobody
    #[arg(id = "gate.anonymous", long = "anonymous", value_name = "WHENCE", default_value = "loopback")]
    pub anonymous: Anonymous,

    /// What who comes without a token may be
    #[arg(id = "gate.anonymous_role", long = "anonymous-role", value_name = "ROLE", default_value = "actor", value_parser = role(&[Rank::Viewer, Rank::Actor]))]
    pub anonymous_role: Rank,

    /// Most avatars of one connection without a token
    #[arg(id = "gate.anonymous_avatars", long = "anonymous-avatars", value_name = "N", default_value_t = 4096, value_parser = whole::<u16>(1..=4096))]
    pub anonymous_avatars: u16,

    /// Where bans are kept, so that they outlast the server [default: nowhere]
    #[arg(id = "gate.bans", long = "bans", value_name = "FILE")]
    pub bans: Option<PathBuf>,
}

impl GateOptions {
    /// The gate that they mean.
    ///
    /// # Errors
    /// Names the file that is not what it should be, and the remedy.
    pub fn gate(&self) -> Result<TokenGate, GateError> {
        let gate = TokenGate::new(&self.keys, &self.audience)?;
        let gate = gate.with_anonymous(self.anonymous, self.anonymous_role, self.anonymous_avatars);
        match &self.bans {
            Some(path) => gate.with_bans(path),
            None => Ok(gate),
        }
    }
}

/// The section `[watch]`: how the server is watched and stopped.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Watch: how the server is watched and stopped")]
pub struct WatchOptions {
    /// Address for Prometheus metrics, /healthz and /readyz over HTTP, which is for this machine only [default: none]
    #[arg(id = "watch.metrics", long = "metrics", value_name = "IP:PORT", value_parser = address)]
    pub metrics: Option<SocketAddr>,

    /// Let --metrics be an address that others can reach too. Nobody is asked who they are
    #[arg(id = "watch.metrics_anywhere", long = "metrics-anywhere", value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true", default_value = "false", hide_possible_values = true, action = clap::ArgAction::Set)]
    pub metrics_anywhere: bool,

    /// How logs are written to standard error
    #[arg(id = "watch.log", long = "log", value_name = "FORMAT", default_value = "text")]
    pub log: LogFormat,

    /// For how long clients are waited for when the server ends, seconds
    #[arg(id = "watch.drain_seconds", long = "drain-seconds", value_name = "SECONDS", default_value_t = 2.0, value_parser = number(0.1..=3600.0, "s"))]
    pub drain_seconds: f64,
}

/// How logs are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The section `[limits]`: what one client or address may cost. What is over a limit is dropped and counted. There is no
/// value for "no limit": a server that people can reach needs each of them.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Limits: what one client or address may cost")]
pub struct LimitOptions {
    /// Most connections at once
    #[arg(id = "limits.connections_max", long = "limit-connections", value_name = "N", default_value_t = 4352, value_parser = limit, hide_short_help = true)]
    pub connections_max: u32,

    /// Most connections at once from one address; those of this machine share what all may have
    #[arg(id = "limits.connections_per_address", long = "limit-connections-per-address", value_name = "N", default_value_t = 128, value_parser = limit, hide_short_help = true)]
    pub connections_per_address: u32,

    /// Most handshakes a second from one address, in the long run
    #[arg(id = "limits.handshakes_per_second_per_address", long = "limit-handshakes-per-second", value_name = "N", default_value_t = 4, value_parser = limit, hide_short_help = true)]
    pub handshakes_per_second_per_address: u32,

    /// Most handshakes at once from one address before that holds
    #[arg(id = "limits.handshakes_burst", long = "limit-handshakes-burst", value_name = "N", default_value_t = 64, value_parser = limit, hide_short_help = true)]
    pub handshakes_burst: u32,

    /// Most requests a second of one client in an empty world, twice as many at once; each object in it adds a 512th
    #[arg(id = "limits.requests_per_second", long = "limit-requests-per-second", value_name = "N", default_value_t = 2_048, value_parser = limit, hide_short_help = true)]
    pub requests_per_second: u32,

    /// Most poses a second of each avatar of a client, twice as many at once
    #[arg(id = "limits.poses_per_second", long = "limit-poses-per-second", value_name = "N", default_value_t = 240, value_parser = limit, hide_short_help = true)]
    pub poses_per_second: u32,

    /// Most bytes a second from one client, twice as many at once; each avatar but its first adds a 30th
    #[arg(id = "limits.bytes_per_second_in", long = "limit-bytes-per-second-in", value_name = "N", default_value_t = 262_144, value_parser = limit, hide_short_help = true)]
    pub bytes_per_second_in: u32,
}

impl LimitOptions {
    /// What one client may ask for.
    pub fn of_a_client(&self) -> Limits {
        let rate = |kind: Limited, per_second: u32| {
            let per_second = f64::from(per_second);
            Rate { per_second, burst: 2.0 * per_second, ..Limits::default().rate(kind) }
        };
        let requests = rate(Limited::Requests, self.requests_per_second);
        Limits::default()
            .with_rate(Limited::Requests, requests)
            .with_rate(Limited::Resends, requests)
            .with_rate(Limited::Poses, rate(Limited::Poses, self.poses_per_second))
            .with_rate(Limited::Bytes, rate(Limited::Bytes, self.bytes_per_second_in))
    }

    /// Who may begin to connect.
    pub fn of_arrivals(&self) -> ArrivalLimits {
        let (per_second, burst) = (self.handshakes_per_second_per_address, self.handshakes_burst);
        ArrivalLimits::default()
            .with_connections(self.connections_max as usize, self.connections_per_address as usize)
            .with_handshakes_per_address(f64::from(per_second), f64::from(burst))
    }
}

/// A number on the command line, held to a range; its unit may follow it.
pub fn number(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.strip_suffix(unit).unwrap_or(text).trim_end().parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number from {} to {} {unit}", range.start(), range.end())),
    }
}

/// A whole number, held to a range.
fn whole<T: TryFrom<u64> + Clone + Send + Sync + 'static>(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let value = text.parse().ok().filter(|value| range.contains(value)).and_then(|value| T::try_from(value).ok());
        value.ok_or_else(|| format!("give a whole number from {} to {}", range.start(), range.end()))
    }
}

/// A limit: a whole number that is not 0, which would shut everybody out.
fn limit(text: &str) -> Result<u32, String> {
    whole(1..=1_000_000_000)(text)
}

/// An address to listen on.
fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| "give IP:PORT, for instance 127.0.0.1:4433 or [::]:4433".to_owned())
}

/// One of some roles, by its name.
pub fn role(roles: &'static [Rank]) -> impl TypedValueParser<Value = Rank> {
    let names = PossibleValuesParser::new(roles.iter().map(|role| role.name()));
    names.map(|name| Rank::ALL.into_iter().find(|rank| rank.name() == name).unwrap_or(Rank::Viewer))
}

/// Longest name of a server in tokens, bytes: what is left for a long subject in a token's bytes.
pub const AUDIENCE_BYTES_MAX: usize = 64;

/// A server's name in tokens.
///
/// # Errors
/// If it is empty, too long or more than a line.
pub fn audience(text: &str) -> Result<String, String> {
    if text.is_empty() || text.len() > AUDIENCE_BYTES_MAX || text.chars().any(char::is_control) {
        return Err(format!("give a name of 1 to {AUDIENCE_BYTES_MAX} bytes without line breaks"));
    }
    Ok(text.to_owned())
}

/// A span of time with its unit: `90s`, `30m`, `8h` or `7d`, at least a second.
pub fn span(most: Duration) -> impl Fn(&str) -> Result<Duration, String> + Clone + Send + Sync + 'static {
    move |text| {
        let units = [("s", 1), ("m", 60), ("h", 3_600), ("d", 86_400)];
        let parsed = units.iter().find_map(|(unit, seconds)| {
            let number: u64 = text.strip_suffix(unit)?.trim_end().parse().ok()?;
            number.checked_mul(*seconds).map(Duration::from_secs)
        });
        match parsed {
            Some(span) if span >= Duration::from_secs(1) && span <= most => Ok(span),
            _ => Err(format!("give a time from 1s to {}d, with its unit: 90s, 30m, 8h, 7d", most.as_secs() / 86_400)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_held_to_their_range() {
        let hz = number(0.1..=1000.0, "Hz");
        assert_eq!([hz("20"), hz("20Hz"), hz("20 Hz")], [Ok(20.0), Ok(20.0), Ok(20.0)]);
        for bad in ["", "0", "-1", "nan", "inf", "1001", "20ms", "Hz"] {
            assert_eq!(hz(bad).unwrap_err(), "give a number from 0.1 to 1000 Hz", "{bad}");
        }
    }

    #[test]
    fn unless_told_otherwise_limits_are_those_that_nobody_honest_meets() {
        use clap::Parser;
        #[derive(Parser)]
        struct Only {
            #[command(flatten)]
            limits: LimitOptions,
        }
        let limits = Only::parse_from(["x"]).limits;
        assert_eq!(limits.of_a_client(), Limits::default());
        assert_eq!(limits.of_arrivals(), ArrivalLimits::default());
        let limits = Only::parse_from(["x", "--limit-requests-per-second", "7"]).limits;
        assert_eq!(limits.of_a_client().rate(Limited::Requests).burst, 14.0);
    }

    #[test]
    fn spans_have_units_and_a_range() {
        let span = span(Duration::from_secs(30 * 86_400));
        let hours = |hours: u64| Ok(Duration::from_secs(hours * 3_600));
        assert_eq!(
            [span("8h"), span("480 m"), span("28800s"), span("30d")],
            [hours(8), hours(8), hours(8), hours(720)]
        );
        for bad in
            ["", "8", "h", "0s", "-1h", "31d", "1.5h", "99999999999999999999d", "18446744073709551615d", "8 hours"]
        {
            assert!(span(bad).unwrap_err().contains("1s to 30d"), "{bad}");
        }
    }
}
