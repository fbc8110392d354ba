//! The processes of a `load`: this program again, each on a core of its own, told what to do over its standard input.

// These are drivers: they may read the clock.
#![expect(clippy::disallowed_methods)]

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use bytes::Bytes;
use clap::ValueEnum;
use eyeline_client::net::Fingerprint;
use eyeline_protocol::WorldTime;
use eyeline_server::net::{Handle, Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::{World, WorldConfig};
use eyeline_sim::load::echo::{self, Traffic};
use eyeline_sim::load::process::{self, Usage, pin_to};
use eyeline_sim::stage::load_model;
use serde::{Deserialize, Serialize};
use tokio::task::LocalSet;

use super::Load;
use crate::verbs::swarm::{ALL_IN, LATE_MAX};

/// What a process of a `load` is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// The world's server.
    Server,
    /// A bare echo.
    EchoServer,
    /// Its clients.
    EchoClients,
}

impl Part {
    fn name(self) -> &'static str {
        match self {
            Part::Server => "server",
            Part::EchoServer => "echo-server",
            Part::EchoClients => "echo-clients",
        }
    }
}

/// What the world's server tells of itself.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Told {
    pub tick_ms: f64,
    pub ticks: u64,
    pub missed: u64,
    pub tick_p50_ms: f64,
    pub tick_p99_ms: f64,
    pub tick_max_ms: f64,
    pub sent_p99_ms: f64,
    pub datagrams_in: u64,
    pub bytes_in: u64,
    pub datagrams_out: u64,
    pub bytes_out: u64,
    pub admitted: u64,
    pub resumed: u64,
    pub violations: u64,
}

/// What a swarm tells of itself: of its row, what is of use here.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Seen {
    pub late_p99_ms: f64,
    #[serde(default)]
    pub visible_mean: f64,
    #[serde(default)]
    pub rtt_ms: f64,
    #[serde(default)]
    pub cpu_percent: Option<f64>,
}

impl Seen {
    pub fn is_void(&self) -> bool {
        self.late_p99_ms.is_nan() || self.late_p99_ms > LATE_MAX.as_secs_f64() * 1e3
    }
}

/// What a server did while it was measured.
pub struct Span {
    pub before: Usage,
    pub after: Usage,
    pub passed: Duration,
    /// Processor time that the machine's host gave to others meanwhile, all cores together; `None` where the system does not tell.
    pub stolen: Option<Duration>,
}

impl Span {
    /// What `server` does for so long.
    pub fn measure(server: &Child, seconds: f64) -> anyhow::Result<Span> {
        let (began, before, stolen) = (Instant::now(), server.usage()?, process::stolen());
        // The end of the run is the clients' leaving, which is another work.
        std::thread::sleep(Duration::from_secs_f64((seconds - 0.5).max(0.5)));
        let (passed, after) = (began.elapsed(), server.usage()?);
        let stolen = stolen.zip(process::stolen()).map(|(before, after)| after.saturating_sub(before));
        Ok(Span { before, after, passed, stolen })
    }

    /// Share of a core that it took.
    pub fn cpu_share(&self) -> f64 {
        (self.after.cpu - self.before.cpu).as_secs_f64() / self.passed.as_secs_f64()
    }

    /// How often a second it waited for something to do.
    pub fn waits(&self) -> f64 {
        (self.after.waits - self.before.waits) as f64 / self.passed.as_secs_f64()
    }

    /// How much more memory it had at the end than when it was `empty`, KB.
    pub fn kb_more_than(&self, empty: &Usage) -> f64 {
        self.after.rss_kb() - empty.rss_kb()
    }

    /// Percentage of one core that the host took.
    pub fn stolen_percent(&self) -> Option<f64> {
        self.stolen.map(|stolen| 100.0 * stolen.as_secs_f64() / self.passed.as_secs_f64())
    }
}

/// One run of a bare echo and its clients.
pub struct Echoed {
    pub empty: Usage,
    pub span: Span,
    pub seen: Seen,
}

/// One run of the world's server and a swarm.
pub struct Measured {
    pub empty: Usage,
    pub span: Span,
    pub told: Told,
    pub seen: Seen,
}

impl Measured {
    /// What was said each way.
    pub fn traffic(&self, clients: u32) -> Traffic {
        let told = &self.told;
        let rounds = (told.ticks.max(1) * u64::from(clients)) as f64;
        let mean = |bytes: u64, datagrams: u64| (bytes / datagrams.max(1)) as usize;
        Traffic {
            period: Duration::from_secs_f64(told.tick_ms * 1e-3),
            up: told.datagrams_in as f64 / rounds,
            up_bytes: mean(told.bytes_in, told.datagrams_in),
            down: told.datagrams_out as f64 / rounds,
            down_bytes: mean(told.bytes_out, told.datagrams_out),
            bunches: Some(self.span.waits().max(1.0)),
        }
    }
}

/// A process, told what to do and asked what it knows. Killed if it is dropped.
pub struct Child {
    process: std::process::Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    ready: PathBuf,
}

/// This program once more.
fn command(arguments: &[String]) -> anyhow::Result<Command> {
    let program = std::env::current_exe().context("cannot find this program")?;
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
    Ok(command)
}

fn words<const N: usize>(words: [&str; N]) -> Vec<String> {
    words.map(str::to_owned).to_vec()
}

impl Child {
    fn start(command: &mut Command, ready: PathBuf) -> anyhow::Result<Child> {
        let mut process = command.spawn().context("cannot start this program again")?;
        let (Some(input), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            bail!("a process without its pipes")
        };
        Ok(Child { process, input, output: BufReader::new(output), ready })
    }

    /// The world's server, once it listens.
    pub fn server(options: &Load, world: &Path) -> anyhow::Result<Child> {
        let mut arguments = part(options, Part::Server);
        arguments.extend(words(["--seed", &options.seed.to_string(), "--answers", options.answers.name()]));
        let mut server = Child::start(&mut command(&arguments)?, world.with_extension("ready"))?;
        server.expect("listening")?;
        Ok(server)
    }

    /// A bare echo of this traffic, once it listens.
    pub fn echo_server(options: &Load, traffic: Traffic) -> anyhow::Result<Child> {
        let mut arguments = part(options, Part::EchoServer);
        arguments.extend(words(["--traffic", &traffic_text(traffic)]));
        let mut server = Child::start(&mut command(&arguments)?, options.out.join("echo.ready"))?;
        server.expect("listening")?;
        Ok(server)
    }

    /// Reads lines until one is `wanted`.
    fn expect(&mut self, wanted: &str) -> anyhow::Result<()> {
        loop {
            let mut line = String::new();
            let read = self.output.read_line(&mut line)?;
            if read == 0 {
                let status = self.process.wait()?;
                bail!("a part of the run ended before it said '{wanted}' ({status}); it has said why above");
            }
            if line.trim_end() == wanted.trim_end() {
                return Ok(());
            }
            if !line.trim().is_empty() {
                crate::verbs::print(&format!("  {line}"));
            }
        }
    }

    fn tell(&mut self, word: &str) -> anyhow::Result<()> {
        writeln!(self.input, "{word}").and_then(|()| self.input.flush()).context("a part of the run has gone")
    }

    /// Forgets what was counted so far.
    pub fn reset(&mut self) -> anyhow::Result<()> {
        self.tell("reset")?;
        self.expect("reset")
    }

    /// What was counted since.
    pub fn report(&mut self) -> anyhow::Result<Told> {
        self.tell("report")?;
        let mut line = String::new();
        self.output.read_line(&mut line)?;
        serde_json::from_str(&line).with_context(|| format!("the server said '{}'", line.trim()))
    }

    /// What it has used so far.
    pub fn usage(&self) -> anyhow::Result<Usage> {
        Usage::of(self.process.id())
    }

    /// The same, a second from now: what it needed to start has been given back.
    pub fn usage_settled(&self) -> anyhow::Result<Usage> {
        std::thread::sleep(Duration::from_secs(1));
        self.usage()
    }

    /// Ends it, and waits until it has.
    pub fn end(mut self) -> anyhow::Result<()> {
        self.tell("end")?;
        let status = self.process.wait()?;
        anyhow::ensure!(status.success(), "a part of the run failed: {status}");
        Ok(())
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn part(options: &Load, part: Part) -> Vec<String> {
    let mut arguments = words(["load", "--part", part.name(), "--out", &options.out.display().to_string()]);
    arguments.extend(words(["--cores", &format!("{},{}", options.cores.0, options.cores.1)]));
    arguments
}

/// A swarm, or the clients of an echo.
pub struct Swarming {
    child: Child,
    row: PathBuf,
    began: Option<(Instant, Usage)>,
}

impl Swarming {
    pub fn start(
        options: &Load,
        world: &Path,
        server: &Child,
        clients: u32,
        seconds: f64,
        churn: f64,
    ) -> anyhow::Result<Swarming> {
        let row = options.out.join("swarm.json");
        let _ = std::fs::remove_file(&row);
        let path = |path: &Path| path.display().to_string();
        let mut arguments =
            words(["swarm", "--late-ok", "--server-file", &path(&server.ready), "--world", &path(world)]);
        for (name, value) in [
            ("--clients", clients.to_string()),
            ("--culling", options.culling.to_string()),
            ("--side", options.side.to_string()),
            ("--culler", options.culler.name().to_owned()),
            ("--hold", options.hold.to_string()),
            ("--seconds", seconds.to_string()),
            ("--settle", options.settle.to_string()),
            ("--seed", options.seed.to_string()),
            ("--churn", churn.to_string()),
            ("--core", options.cores.1.to_string()),
            ("--row", path(&row)),
        ] {
            arguments.extend([name.to_owned(), value]);
        }
        let mut command = command(&arguments)?;
        command.stderr(Stdio::inherit());
        Ok(Swarming { child: Child::start(&mut command, PathBuf::new())?, row, began: None })
    }

    /// The clients of an echo.
    pub fn echo(options: &Load, server: &Child, traffic: Traffic) -> anyhow::Result<Swarming> {
        let row = options.out.join("swarm.json");
        let _ = std::fs::remove_file(&row);
        std::fs::copy(&server.ready, options.out.join("world.ready"))?;
        let mut arguments = part(options, Part::EchoClients);
        for (name, value) in [
            ("--traffic", traffic_text(traffic)),
            ("--clients", options.clients.to_string()),
            ("--seconds", options.seconds.to_string()),
            ("--settle", options.settle.to_string()),
        ] {
            arguments.extend([name.to_owned(), value]);
        }
        Ok(Swarming { child: Child::start(&mut command(&arguments)?, PathBuf::new())?, row, began: None })
    }

    pub fn wait_until_all_are_in(&mut self) -> anyhow::Result<()> {
        self.child.expect(ALL_IN)?;
        self.began = Some((Instant::now(), self.child.usage()?));
        Ok(())
    }

    /// Waits for its end, and for its row.
    pub fn end(mut self) -> anyhow::Result<Seen> {
        let cpu_percent = self.began.map(|(at, before)| {
            let used = self.child.usage().map_or(Duration::ZERO, |now| now.cpu.saturating_sub(before.cpu));
            100.0 * used.as_secs_f64() / at.elapsed().as_secs_f64()
        });
        let status = self.child.process.wait()?;
        anyhow::ensure!(status.success(), "the swarm failed: {status}");
        let text = std::fs::read_to_string(&self.row).context("the swarm has left no row")?;
        let seen: Seen = serde_json::from_str(&text).with_context(|| format!("the swarm's row is '{text}'"))?;
        Ok(Seen { cpu_percent, ..seen })
    }
}

/// As it goes from process to process.
fn traffic_text(traffic: Traffic) -> String {
    let Traffic { period, up, up_bytes, down, down_bytes, bunches } = traffic;
    let bunches = bunches.map_or(String::new(), |bunches| format!(",{bunches}"));
    format!("{},{up},{up_bytes},{down},{down_bytes}{bunches}", period.as_secs_f64())
}

/// The reverse of [`traffic_text`].
pub fn traffic(text: &str) -> Result<Traffic, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let (period_s, up, up_bytes, down, down_bytes, bunches) = match numbers.as_deref() {
        Some(&[period_s, up, up_bytes, down, down_bytes]) => (period_s, up, up_bytes, down, down_bytes, None),
        Some(&[period_s, up, up_bytes, down, down_bytes, bunches]) => {
            (period_s, up, up_bytes, down, down_bytes, Some(bunches))
        }
        _ => {
            let wanted = "five numbers: seconds, datagrams up, their bytes, datagrams down, their bytes";
            return Err(format!(
                "give {wanted}; and a sixth if you like: in how many bunches a second those up arrive"
            ));
        }
    };
    for (what, value, range) in [
        ("seconds of a tick", period_s, 0.001..=10.0),
        ("datagrams up in a tick", up, 0.001..=100.0),
        ("bytes of a datagram up", up_bytes, 1.0..=1150.0),
        ("datagrams down in a tick", down, 0.001..=100.0),
        ("bytes of a datagram down", down_bytes, 1.0..=1150.0),
        ("bunches a second", bunches.unwrap_or(1.0), 1.0..=1e6),
    ] {
        if !range.contains(&value) {
            return Err(format!("{value} {what}: give {} to {}", range.start(), range.end()));
        }
    }
    let (up_bytes, down_bytes) = (up_bytes as usize, down_bytes as usize);
    Ok(Traffic { period: Duration::from_secs_f64(period_s), up, up_bytes, down, down_bytes, bunches })
}

/// Is a part of a run.
pub fn run(part: Part, options: &Load) -> anyhow::Result<()> {
    pin_to(if part == Part::EchoClients { options.cores.1 } else { options.cores.0 })?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let local = LocalSet::new();
    match part {
        Part::Server => runtime.block_on(serve(options)),
        Part::EchoServer => runtime.block_on(local.run_until(serve_echo(options))),
        Part::EchoClients => runtime.block_on(local.run_until(play_echo(options))),
    }
}

const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

fn identity(options: &Load) -> anyhow::Result<Identity> {
    Ok(Identity::load_or_create(&options.out.join("identity"))?)
}

fn write_ready(path: &Path, address: SocketAddr, fingerprint: &str) -> anyhow::Result<()> {
    std::fs::write(path, format!("{address}\n{fingerprint}\n"))?;
    crate::verbs::print("listening\n");
    Ok(())
}

/// When each tick's datagrams had all left, in milliseconds after it was due.
type Sent = Arc<Mutex<Vec<f64>>>;

async fn serve(options: &Load) -> anyhow::Result<()> {
    let path = options.out.join("world.glb");
    let (model, ..) = load_model(&path, None)?;
    let clock = WorldClock::starting_at(WorldTime::from_micros(1_000_000));
    let config =
        WorldConfig::default().with_grid_seed(options.seed).with_answers(options.answers).with_avatars_max(65_536);
    let world = model.world(config, "visible", &PolicySettings::default(), clock.now())?;
    let identity = identity(options)?;
    let fingerprint = identity.fingerprint_hex();
    let sent = Sent::default();
    let noted = sent.clone();
    // A tick wakes each connection's task, which sends what it was handed. A task that is made now comes after all of them.
    let hook = move |world: &World| {
        let (due, noted) = (clock.instant(world.committed_at()), noted.clone());
        tokio::spawn(async move {
            let mut noted = noted.lock().unwrap_or_else(PoisonError::into_inner);
            noted.push(Instant::now().saturating_duration_since(due).as_secs_f64() * 1e3);
        });
    };
    let bytes = Bytes::from_owner(model.bytes.clone());
    let server = Server::bind(ANY, identity, world, bytes, clock, Some(Box::new(hook)))?;
    let handle = server.handle();
    write_ready(&path.with_extension("ready"), server.local_addr()?, &fingerprint)?;
    drop(model);
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    std::thread::spawn(move || {
        listen(&handle, &sent);
        drop(stop);
    });
    server.run(async move { drop(stopped.await) }).await;
    Ok(())
}

/// Does what standard input says, until it ends or says so.
fn listen(handle: &Handle, sent: &Sent) {
    let counted = |handle: &Handle| handle.with_world(|world| (*world.stats(), world.tick_period()));
    let (mut before, _) = counted(handle);
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        match line.as_str() {
            "reset" => {
                handle.reset_stats();
                sent.lock().unwrap_or_else(PoisonError::into_inner).clear();
                (before, _) = counted(handle);
                crate::verbs::print("reset\n");
            }
            "report" => {
                let (now, period) = counted(handle);
                let mut ticks: Vec<f64> = handle.stats().tick_micros.iter().map(|&m| f64::from(m) * 1e-3).collect();
                ticks.sort_unstable_by(f64::total_cmp);
                let mut sent = sent.lock().unwrap_or_else(PoisonError::into_inner).clone();
                sent.sort_unstable_by(f64::total_cmp);
                let told = Told {
                    tick_ms: period.as_secs_f64() * 1e3,
                    ticks: now.ticks - before.ticks,
                    missed: now.ticks_missed - before.ticks_missed,
                    tick_p50_ms: at_share(&ticks, 0.5),
                    tick_p99_ms: at_share(&ticks, 0.99),
                    tick_max_ms: at_share(&ticks, 1.0),
                    sent_p99_ms: at_share(&sent, 0.99),
                    datagrams_in: now.datagrams_in - before.datagrams_in,
                    bytes_in: now.datagram_bytes_in - before.datagram_bytes_in,
                    datagrams_out: now.datagrams_out - before.datagrams_out,
                    bytes_out: now.datagram_bytes_out - before.datagram_bytes_out,
                    admitted: now.admitted,
                    resumed: now.resumed,
                    violations: now.violations,
                };
                crate::verbs::print(&(serde_json::to_string(&told).unwrap_or_default() + "\n"));
            }
            _ => return,
        }
    }
}

/// The value that this share of all, ascending, are at most.
fn at_share(ascending: &[f64], share: f64) -> f64 {
    let index = ((ascending.len() as f64 * share).ceil() as usize).clamp(1, ascending.len().max(1)) - 1;
    ascending.get(index).copied().unwrap_or(f64::NAN)
}

async fn serve_echo(options: &Load) -> anyhow::Result<()> {
    let traffic = options.traffic.context("an echo of what? --traffic is missing")?;
    let identity = identity(options)?;
    let fingerprint = identity.fingerprint_hex();
    let ready = |address| write_ready(&options.out.join("echo.ready"), address, &fingerprint);
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    std::thread::spawn(move || {
        let _ = std::io::stdin().lock().lines().map_while(Result::ok).next();
        drop(stop);
    });
    let stopped = async move { drop(stopped.await) };
    echo::serve(ANY, identity, traffic, ready, stopped).await
}

async fn play_echo(options: &Load) -> anyhow::Result<()> {
    let traffic = options.traffic.context("an echo of what? --traffic is missing")?;
    let ready = std::fs::read_to_string(options.out.join("echo.ready"))?;
    let (address, fingerprint) = ready.trim().split_once('\n').context("no address in echo.ready")?;
    let fingerprint: Fingerprint = fingerprint.parse()?;
    let times = (Duration::from_secs_f64(options.settle), Duration::from_secs_f64(options.seconds));
    let played =
        echo::play(address.parse()?, fingerprint, options.clients, traffic, times, || crate::verbs::print(ALL_IN))
            .await?;
    let mut late: Vec<f64> = played.late.iter().map(|late| late.as_secs_f64() * 1e3).collect();
    late.sort_unstable_by(f64::total_cmp);
    let seen = Seen { late_p99_ms: at_share(&late, 0.99), ..Seen::default() };
    std::fs::write(options.out.join("swarm.json"), serde_json::to_string(&seen)?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traffic_goes_from_process_to_process() {
        let period = Duration::from_millis(50);
        for bunches in [None, Some(1234.5)] {
            let said = Traffic { period, up: 1.46, up_bytes: 47, down: 2.35, down_bytes: 160, bunches };
            assert_eq!(traffic(&traffic_text(said)), Ok(said));
        }
        for bad in ["", "1,2,3", "0,1,1,1,1", "nan,1,1,1,1", "1,0,1,1,1", "1,1,1,1,inf", "1,1,1,1,1,0", "1,1,1,1,1,1,1"]
        {
            assert!(traffic(bad).is_err(), "{bad}");
        }
        let error = traffic("0.05,1.3,70,1,9000").unwrap_err();
        assert!(["9000", "bytes of a datagram down", "1150"].iter().all(|part| error.contains(part)), "{error}");
    }

    #[test]
    fn shares_of_nothing_are_no_number() {
        assert_eq!(at_share(&[1.0, 2.0, 3.0, 4.0], 0.5), 2.0);
        assert_eq!(at_share(&[1.0, 2.0], 1.0), 2.0);
        assert!(at_share(&[], 0.99).is_nan() && Seen { late_p99_ms: f64::NAN, ..Seen::default() }.is_void());
    }
}
