//! The `eyeline-server` command: options, what it prints, and how it ends. `eyeline-sim serve` is the same.

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use bytes::Bytes;
use eyeline_protocol::WorldTime;

use crate::config::check;
pub use crate::config::options::{LogFormat, ServeOptions, number};
use crate::model::Model;
use crate::net::{Anonymous, Handle, Server, ShellConfig, Watch, WorldClock};
use crate::policy::{PolicySettings, PvsTable};
use crate::stop;
pub use crate::stop::signal as shutdown_signal;
use crate::world::WorldConfig;

/// Serves `model` until Ctrl-C or SIGTERM. `notes` are what a reader should know about how it was loaded.
///
/// # Errors
/// If the world contradicts itself, the identity can't be used, or the address can't be listened on.
pub fn serve(options: &ServeOptions, mut model: Model, notes: &[String]) -> anyhow::Result<()> {
    if let Some((_, wrong)) = check::contradictions(options).into_iter().next() {
        anyhow::bail!(wrong);
    }
    init_logs_as(options.watch.log);
    // Before anything that takes long: it is alive, and says that it is not ready.
    let watch = options.watch.metrics.map(|at| Watch::start(at, options.watch.metrics_anywhere)).transpose()?;
    let ready_file = options.ready_file.clone();
    let shutdown = stop::signals(move || drop(ready_file.map(std::fs::remove_file)))?;
    if let Some(speed) = options.avatar_speed {
        model.spec.avatar.speed_max = speed;
    }
    let grid_seed = match options.seed {
        Some(seed) => seed,
        None => random()?,
    };
    let config = WorldConfig::default()
        .with_tick(Duration::from_secs_f64(1.0 / options.tick_hz))
        .with_answers(options.answers)
        .with_blur(options.blur)
        .with_grid_seed(grid_seed)
        .with_dead_reckoning_px(options.dead_reckoning)
        .with_bytes_per_second(options.bytes_per_second)
        .with_resume_grace(Duration::from_secs_f64(options.resume_seconds))
        .with_limits(options.limits.of_a_client())
        .with_avatars_max(options.max_avatars as usize);
    let clock = WorldClock::starting_at(unix_time());
    let mut settings = PolicySettings::default().with_radius(options.radius).with_cell(options.cell);
    if let Some(path) = &options.pvs {
        settings = settings.with_pvs(Arc::new(PvsTable::read(path)?));
    }
    let mut world = model.world(config, &options.policy, &settings, clock.now())?;
    if options.audit {
        let audit = model.audit(world.classes());
        world.set_audit(audit);
    }
    let gate = options.gate.gate()?;
    let checks = gate.checks();
    world.set_gate(Box::new(gate));
    let mut identity = options.certificate()?;
    for complaint in options.tls.certificate.iter().flat_map(|file| identity.complaints(file, clock.now())) {
        tracing::warn!("{}", complaint.text);
    }
    let reloader = identity.reloader();
    let fingerprint = identity.fingerprint_hex();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let summary = runtime.block_on(async {
        let bytes = Bytes::from_owner(model.bytes.clone());
        if let Some(reloader) = reloader {
            tokio::spawn(reloader.run());
        }
        let server = Server::bind(options.listen, identity, world, bytes, clock, None)?
            .with_config(shell_config(options))
            .with_token_checks(checks);
        let address = server.local_addr()?;
        let mut text = describe(options, &model, &settings, notes);
        let _ = writeln!(text, "listening    {address} (QUIC over UDP); Ctrl-C ends it");
        let _ = writeln!(text, "fingerprint  {fingerprint}");
        let handle = server.handle();
        let plan = handle.with_world(|world| crate::plan::plan(world));
        for line in &plan.lines {
            tracing::info!(stage = line.stage.name(), "{}: {}", line.verdict(), line.evidence);
        }
        if let Some(watch) = &watch {
            watch.attach(&handle);
            let _ = writeln!(text, "watched      http://{}/metrics, /healthz, /readyz", watch.local_addr());
        }
        print(&text);
        let _ready =
            options.ready_file.as_deref().map(|path| ReadyFile::write(path, address, &fingerprint)).transpose()?;
        server.run(shutdown).await;
        anyhow::Ok(summary(&handle))
    })?;
    print(&summary);
    Ok(())
}

fn shell_config(options: &ServeOptions) -> ShellConfig {
    let drain = Duration::from_secs_f64(options.watch.drain_seconds);
    ShellConfig::default().with_arrivals(options.limits.of_arrivals()).with_drain(drain)
}

/// What is served, and how: the lines that a server begins with.
fn describe(options: &ServeOptions, model: &Model, settings: &PolicySettings, notes: &[String]) -> String {
    let spec = &model.spec;
    let hash: String = model.info.hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    let moving = spec.objects.iter().filter(|object| object.path.is_some()).count();
    let mut text = String::new();
    let _ = writeln!(text, "world        {} ({} bytes, SHA-256 {hash}…)", model.info.name, model.info.size_bytes);
    let _ = writeln!(text, "triangles    {} static", model.scene.triangles().len());
    let _ = writeln!(text, "objects      {}, of which {moving} have a path", spec.objects.len());
    let (spawns, speed) = (spec.spawns.len(), spec.avatar.speed_max);
    let _ = writeln!(text, "avatars      at most {}, {speed} m/s, {spawns} spawn points", options.max_avatars);
    for note in notes {
        let _ = writeln!(text, "note         {note}");
    }
    let gate = &options.gate;
    let without = match gate.anonymous {
        Anonymous::Loopback => format!("{} from this machine, nobody from elsewhere", gate.anonymous_role),
        Anonymous::Anywhere => format!("{} from anywhere", gate.anonymous_role),
        Anonymous::Never => "nobody".to_owned(),
    };
    let _ = writeln!(
        text,
        "gate         {} keys for tokens of '{}'; without a token: {without}",
        gate.keys.len(),
        gate.audience
    );
    if gate.keys.is_empty() && gate.anonymous == Anonymous::Loopback && !options.listen.ip().is_loopback() {
        let _ = writeln!(
            text,
            "note         listens to all, and lets in nobody from elsewhere: make a key with `eyeline-server token key` and \
             name it with --token-keys, or give --anonymous anywhere"
        );
    }
    let how = match options.policy.as_str() {
        "visible" => "clients hold bounds of what is hidden, and ask for what is exposed",
        "broadcast" => "every client is told everything",
        "radius" => "a client is told of what is near it",
        "grid" => "a client is told of what is in its square of the plan and the eight around it",
        "pvs" => "a client is told of what is in a cell that may be seen from its own, as far as eyes were sampled",
        _ => "the server culls, and tells each client exactly what it sees",
    };
    let setting = settings.describe(&options.policy);
    let setting = if setting.is_empty() { setting } else { format!(" ({setting})") };
    let reckoning = options.dead_reckoning.map_or(String::new(), |px| format!("; dead reckoning within {px} px"));
    let cap = options.bytes_per_second.map_or(String::new(), |bytes| format!("; at most {bytes} B/s a client"));
    let tick_ms = 1e3 / options.tick_hz;
    let (policy, blur) = (&options.policy, options.blur);
    let audit = if options.audit { "; places are told only after an audit" } else { "" };
    let _ = writeln!(
        text,
        "plan         {policy}: {how}{setting}{audit}{reckoning}{cap}; tick {tick_ms} ms, blur {blur} m"
    );
    text
}

/// What happened: the line that a server ends with.
fn summary(handle: &Handle) -> String {
    let stats = handle.with_world(|world| *world.stats());
    let (shell, arrivals) = (handle.stats(), handle.arrival_counts());
    format!(
        "ended        {} clients admitted, {} refused; rejected {} control messages, {} datagrams; {} messages in, \
         {} out; {} poses and {} turns held back; {} places withheld; {} states capped, {} of them late; {} ticks, {} missed; {} slow readers; \
         {} things asked for beyond limits, {} sent away for it; {} handshakes declined\n",
        stats.admitted,
        stats.refused,
        stats.rejected_control,
        stats.rejected_datagrams,
        stats.messages_in.total(),
        stats.out.total(),
        stats.poses_clamped,
        stats.turns_clamped,
        stats.withheld,
        stats.capped,
        stats.capped_late,
        stats.ticks,
        stats.ticks_missed,
        shell.slow_readers,
        stats.limited.total(),
        stats.busy,
        arrivals.declined_in_all(),
    )
}

/// Writes to standard output at once. Who has closed it does not want to read, which is no reason to end.
pub fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// A file that is there while the server listens.
struct ReadyFile<'a> {
    path: &'a Path,
}

impl ReadyFile<'_> {
    /// Written beside and renamed, so that nobody reads half of it. An address that means "all" is written as the
    /// loopback address, since one can't connect to "all".
    fn write<'a>(path: &'a Path, mut address: SocketAddr, fingerprint: &str) -> anyhow::Result<ReadyFile<'a>> {
        match address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
            IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
            _ => {}
        }
        let mut new = path.as_os_str().to_owned();
        new.push(".new");
        std::fs::write(&new, format!("{address}\n{fingerprint}\n"))
            .and_then(|()| std::fs::rename(&new, path))
            .with_context(|| format!("cannot write the ready file {}", path.display()))?;
        Ok(ReadyFile { path })
    }
}

impl Drop for ReadyFile<'_> {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(self.path);
    }
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
    init_logs_as(LogFormat::Text);
}

/// The same in a given format. Only the first call of a process counts.
pub fn init_logs_as(format: LogFormat) {
    use tracing_subscriber::EnvFilter;
    let default = || "warn,eyeline_server=info,eyeline_client=info,eyeline_sim=info".into();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| default());
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    let _ = match format {
        LogFormat::Text => logs.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => logs.json().flatten_event(true).with_current_span(false).with_span_list(false).try_init(),
    };
}

/// Chance from the system.
pub(crate) fn random() -> anyhow::Result<u64> {
    use ring::rand::SecureRandom;
    let mut bytes = [0; 8];
    let filled = ring::rand::SystemRandom::new().fill(&mut bytes);
    filled.map_err(|_| anyhow::anyhow!("the system gives no random numbers; name a seed with --seed"))?;
    Ok(u64::from_le_bytes(bytes))
}

/// World time is the calendar's, so that it goes on after a restart.
#[expect(clippy::disallowed_methods, reason = "a driver: it sets the world's clock")]
pub fn unix_time() -> WorldTime {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    WorldTime::ZERO + since
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_line_and_says_nothing_twice() {
        let inner = anyhow::anyhow!("line 1\n  | \nno such key");
        assert_eq!(
            one_line(&inner.context("a.toml").context("loading a.toml")),
            "loading a.toml: line 1 | no such key"
        );
    }

    #[test]
    fn a_ready_file_is_there_while_it_is_held() {
        let path = std::env::temp_dir().join(format!("eyeline-ready-{}", std::process::id()));
        let ready = ReadyFile::write(&path, "0.0.0.0:77".parse().unwrap(), "abcd").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "127.0.0.1:77\nabcd\n");
        drop(ready);
        assert!(!path.exists());
    }
}
