//! `load`: how many people one server carries.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

mod children;
mod row;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context as _;
use clap::Args;
use eyeline_server::app::number;
use eyeline_server::world::Answers;
use eyeline_sim::load::echo::Traffic;
use eyeline_sim::load::process::load_average;
use eyeline_sim::report::{Report, Run, rfc3339, table};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;

use super::swarm::{CullerChoice, HOLD};
use children::{Child, Echoed, Measured, Span, Swarming};
use row::{EchoAloneRow, EchoRow, LoadRow, SoakRow};

/// Options of `load`.
#[derive(Args)]
pub struct Load {
    /// How many people; with --find-limit, how many at first: 64 unless given
    #[arg(long, value_name = "N", default_value_t = 200, default_value_if("find_limit", "true", "64"),
        value_parser = clap::value_parser!(u32).range(1..=4096))]
    clients: u32,

    /// How many of them cull for themselves; the others replay what was exposed along recorded ways
    #[arg(long, value_name = "N", default_value_t = 32)]
    culling: u32,

    /// Pixels a side of the images of those who cull
    #[arg(long, value_name = "PIXELS", default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=1024))]
    side: u32,

    /// How those who cull find out what is hidden: through doors, which is auto too, or by images
    #[arg(long, value_name = "HOW", default_value = "auto")]
    culler: CullerChoice,

    /// Half of the walk that one look through doors does for, metres: see `swarm --help`
    #[arg(long, value_name = "METRES", default_value_t = HOLD, value_parser = number(0.0..=100.0, "m"))]
    hold: f64,

    /// How long to measure, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, value_parser = number(2.0..=1e6, "s"))]
    seconds: f64,

    /// How long to wait once all are in, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = number(0.0..=1e6, "s"))]
    settle: f64,

    /// How many runs; what is reported is their median. A void one is made again, and counts for nothing; twice as many are made at
    /// most
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    repeats: u32,

    /// Rooms along each side of the world, each with four chairs: 16 make 1,024 objects
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..=64))]
    rooms: u32,

    /// When the server answers requests: on arrival, or with the tick
    #[arg(long, value_name = "WHEN", default_value_t = Answers::default())]
    answers: Answers,

    /// Decides the world and who walks where
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// More and more people, a fifth more each time, until it holds no longer, most runs are void, or not all get in
    #[arg(long, conflicts_with_all = ["echo", "churn"])]
    find_limit: bool,

    /// The world's server and a bare echo of the same datagrams in turn: what the world costs beside QUIC. Five of each
    /// unless --repeats says otherwise
    #[arg(long, conflicts_with = "churn")]
    echo: bool,

    /// A soak: so many join anew, so many come back and so many are put elsewhere each second. For three minutes unless
    /// --seconds says otherwise
    #[arg(long, value_name = "N", value_parser = number(0.01..=1000.0, "1/s"))]
    churn: Option<f64>,

    /// The server's core, and the swarm's
    #[arg(long, value_name = "CORE,CORE", default_value = "0,1", value_parser = cores)]
    cores: (usize, usize),

    /// Folder of the report and of the world
    #[arg(long, value_name = "DIR", default_value = "out/load")]
    out: PathBuf,

    /// Which part of a run this process is: it was started by another `load`
    #[arg(long, hide = true)]
    part: Option<children::Part>,

    /// With --echo: run the echo alone, without a world, and say so much each way: seconds of a tick, datagrams that a client sends
    /// in a tick, bytes of each, datagrams that it gets, bytes of each; and in how many bunches a second all that clients say arrives,
    /// unless each on its own
    #[arg(long, value_name = "S,UP,BYTES,DOWN,BYTES[,BUNCHES]", value_parser = children::traffic)]
    traffic: Option<Traffic>,
}

pub const EXAMPLES: &str = "Examples:
  eyeline-sim load
  eyeline-sim load --clients 200 --seconds 10 --repeats 1
  eyeline-sim load --find-limit --seconds 20 --repeats 1
  eyeline-sim load --echo --seconds 20
  eyeline-sim load --echo --traffic 0.05,1.28,50,1.01,560,3500 --clients 1000 --seconds 20
  eyeline-sim load --churn 5
  eyeline-sim load --churn 5 --seconds 3600

Server and swarm are processes on a core each (Linux). A run is void if one of a hundred of the swarm's frames began more than 5 ms
late. Exits with 1, after writing the report, if too many were; or if the server's memory grew through a soak.";

fn cores(text: &str) -> Result<(usize, usize), String> {
    let parsed = text.split_once(',').and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
    parsed.ok_or_else(|| "give two numbers, as in 0,1".to_owned())
}

/// Measures, or is a part of a measurement.
pub fn run(options: &Load) -> anyhow::Result<()> {
    if let Some(part) = options.part {
        return children::run(part, options);
    }
    anyhow::ensure!(
        options.echo || options.traffic.is_none(),
        "--traffic says what an echo is sent: give --echo, too, or leave it out"
    );
    let (began, started) = (Instant::now(), rfc3339(SystemTime::now()));
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("cannot make the folder {}", options.out.display()))?;
    let world = make_world(options)?;
    let mut run = Run::here("Eyeline load", Some(options.seed), started);
    run.notes = notes(options);
    let mut grown = None;
    let (mut report, void) = match options.churn {
        _ if options.echo => match options.traffic {
            Some(traffic) => echo_alone(options, traffic, run)?,
            None => echo(options, &world, run)?,
        },
        Some(_) => soak(options, &world, run, &mut grown)?,
        None => load(options, &world, run)?,
    };
    report.run.wall_seconds = began.elapsed().as_secs_f64();
    let written = report.write(&options.out)?;
    super::print(&table(report.rows(), &report.columns));
    super::print(&format!("\n{}\nreport: {}\n", report.headline, written.html.display()));
    // Memory is what it is however late the swarm was.
    if let Some(grown) = grown {
        anyhow::bail!(grown);
    }
    anyhow::ensure!(!void, "void: in too many runs one frame of a hundred began too late; the machine was too busy");
    Ok(())
}

fn notes(options: &Load) -> Vec<String> {
    let how = match options.culler {
        CullerChoice::Image => format!("images of {} pixels", options.side),
        CullerChoice::Auto | CullerChoice::Doors => format!("through doors, for eyes within {} m", options.hold),
    };
    let average = load_average().map_or("unknown".to_owned(), |average| format!("{average:.2}"));
    vec![
        format!(
            "server on core {}, swarm on core {}; {} of the clients cull ({how}), the others replay recorded \
             eyes and exposures through trackers of their own",
            options.cores.0, options.cores.1, options.culling
        ),
        "all but the first share a socket: the server sees two addresses; each has a connection of its own".into(),
        format!("load average of the last minute before the first run: {average}"),
    ]
}

fn make_world(options: &Load) -> anyhow::Result<PathBuf> {
    let rules = RoomsRules { columns: options.rooms, rows: options.rooms, seed: options.seed, ..RoomsRules::default() };
    let path = options.out.join("world.glb");
    rooms::make(&rules)?.write(&path)?;
    Ok(path)
}

/// Runs of one kind: so many that are not void, if they are to be had. Void ones are made again, as many as are wanted at most.
#[derive(Default)]
struct Runs {
    wanted: u32,
    made: u32,
    valid: u32,
}

impl Runs {
    fn go_on(&self) -> bool {
        self.are_void() && self.made < 2 * self.wanted
    }

    fn count(&mut self, is_void: bool) {
        self.made += 1;
        self.valid += u32::from(!is_void);
    }

    fn are_void(&self) -> bool {
        self.valid < self.wanted
    }

    fn number(&self) -> String {
        let void = self.made - self.valid;
        let again = if void > 0 { format!(" ({void} void so far)") } else { String::new() };
        format!("{} of {}{again}", self.valid + 1, self.wanted)
    }

    /// The median of the values of valid runs; of all, if there are none.
    fn median(&self, values: impl Iterator<Item = (bool, f64)>) -> f64 {
        median(values.filter(|(is_void, _)| !is_void || self.valid == 0).map(|(_, value)| value))
    }

    fn of_what(&self) -> String {
        match (self.valid, self.made - self.valid) {
            (0, void) => format!("median of {void}, all void"),
            (valid, 0) => format!("median of {valid}"),
            (valid, void) => format!("median of {valid}, {void} more were void"),
        }
    }
}

/// Runs as asked, or with more and more clients.
fn load(options: &Load, world: &Path, run: Run) -> anyhow::Result<(Report, bool)> {
    let mut report = Report::new(run, LoadRow::columns());
    let (mut clients, mut void, mut said) = (options.clients, false, String::new());
    loop {
        let mut rows = Vec::new();
        let mut runs = Runs { wanted: options.repeats, ..Runs::default() };
        while runs.go_on() {
            super::print(&format!("{clients} clients, run {}\n", runs.number()));
            match measure(options, world, clients, options.seconds) {
                Ok(measured) => {
                    let row = LoadRow::of(clients, &measured);
                    runs.count(row.void);
                    rows.push(row);
                }
                Err(error) if options.find_limit && !said.is_empty() => {
                    report.headline = format!("{said}{clients} clients: not measured, {error:#}.");
                    return Ok((report, false));
                }
                Err(error) => return Err(error),
            }
        }
        let of = |value: fn(&LoadRow) -> f64| runs.median(rows.iter().map(|row| (row.void, value(row))));
        let p99 = of(|row| row.tick_p99_ms);
        let kb = of(|row| row.memory_kb_a_client);
        let sent = of(|row| row.sent_p99_ms);
        let is_void = if options.find_limit { runs.valid < runs.made - runs.valid } else { runs.are_void() };
        for row in &rows {
            report.push(row)?;
        }
        let half_tick = rows.first().map_or(0.0, |row| row.half_tick_ms);
        let holds = p99 < half_tick;
        said += &format!(
            "{clients} clients: p99 of tick work {p99:.2} ms ({}), all sent {sent:.2} ms after the tick was due, half a \
             tick is {half_tick} ms: {}; {kb:.1} KB a client{}. ",
            runs.of_what(),
            if holds { "holds" } else { "does not hold" },
            if is_void { " (VOID: the swarm was late)" } else { "" },
        );
        void |= is_void && !options.find_limit;
        if !options.find_limit || !holds || is_void {
            break;
        }
        clients += clients.div_ceil(5);
    }
    report.headline = said.trim_end().to_owned();
    Ok((report, void))
}

/// One run of server and swarm.
fn measure(options: &Load, world: &Path, clients: u32, seconds: f64) -> anyhow::Result<Measured> {
    let mut server = Child::server(options, world)?;
    let empty = server.usage_settled()?;
    let mut swarm = Swarming::start(options, world, &server, clients, seconds, 0.0)?;
    swarm.wait_until_all_are_in()?;
    server.reset()?;
    let span = Span::measure(&server, seconds)?;
    let told = server.report()?;
    let seen = swarm.end()?;
    server.end()?;
    Ok(Measured { empty, span, told, seen })
}

/// World, echo, world, echo.
fn echo(options: &Load, world: &Path, run: Run) -> anyhow::Result<(Report, bool)> {
    let mut report = Report::new(run, EchoRow::columns());
    let repeats = if options.repeats == 3 { 5 } else { options.repeats };
    let mut rows = Vec::new();
    let mut runs = Runs { wanted: repeats, ..Runs::default() };
    // To make the world, to let all in and to leave.
    let pair_s = 2.0 * (options.settle + options.seconds) + 10.0;
    while runs.go_on() {
        super::print(&format!("world and echo, pair {}, about {pair_s:.0} s each\n", runs.number()));
        let measured = measure(options, world, options.clients, options.seconds)?;
        let traffic = measured.traffic(options.clients);
        let echoed = measure_echo(options, traffic)?;
        let row = EchoRow::of(options.clients, &measured, traffic, &echoed);
        report.push(&row)?;
        runs.count(row.void);
        rows.push(row);
    }
    let ratio = runs.median(rows.iter().map(|row| (row.void, row.ratio)));
    report.headline = format!(
        "{} clients: the world's server takes {ratio:.3} times the processor time of a bare echo of the same datagrams \
         ({}); at most 1.3 is asked for",
        options.clients,
        runs.of_what()
    );
    Ok((report, runs.are_void()))
}

/// An echo and nothing else.
fn echo_alone(options: &Load, traffic: Traffic, run: Run) -> anyhow::Result<(Report, bool)> {
    let mut report = Report::new(run, EchoAloneRow::columns());
    let mut rows = Vec::new();
    let mut runs = Runs { wanted: options.repeats, ..Runs::default() };
    while runs.go_on() {
        super::print(&format!("{} connections of an echo, run {}\n", options.clients, runs.number()));
        let row = EchoAloneRow::of(options.clients, &measure_echo(options, traffic)?);
        report.push(&row)?;
        runs.count(row.void);
        rows.push(row);
    }
    let of = |value: fn(&EchoAloneRow) -> f64| runs.median(rows.iter().map(|row| (row.void, value(row))));
    report.headline = format!(
        "{} connections: a bare echo takes {:.1} % of its core, its clients {:.1} % of theirs, and it keeps {:.1} KB for each ({})",
        options.clients,
        of(|row| row.echo_cpu_percent),
        of(|row| row.swarm_cpu_percent.unwrap_or(f64::NAN)),
        of(|row| row.memory_kb_a_client),
        runs.of_what()
    );
    Ok((report, runs.are_void()))
}

/// One run of an echo and its clients.
fn measure_echo(options: &Load, traffic: Traffic) -> anyhow::Result<Echoed> {
    let server = Child::echo_server(options, traffic)?;
    let empty = server.usage_settled()?;
    let mut clients = Swarming::echo(options, &server, traffic)?;
    clients.wait_until_all_are_in()?;
    let span = Span::measure(&server, options.seconds)?;
    let seen = clients.end()?;
    server.end()?;
    Ok(Echoed { empty, span, seen })
}

/// A long run with churn: does memory grow?
fn soak(options: &Load, world: &Path, run: Run, grown: &mut Option<String>) -> anyhow::Result<(Report, bool)> {
    let mut report = Report::new(run, SoakRow::columns());
    let seconds = if options.seconds == 60.0 { 180.0 } else { options.seconds };
    let mut server = Child::server(options, world)?;
    let mut swarm =
        Swarming::start(options, world, &server, options.clients, seconds, options.churn.unwrap_or_default())?;
    swarm.wait_until_all_are_in()?;
    let began = Instant::now();
    let mut samples = Vec::new();
    while began.elapsed().as_secs_f64() < seconds - 1.0 {
        let usage = server.usage()?;
        samples.push((began.elapsed().as_secs_f64(), usage.rss_kb()));
        std::thread::sleep(Duration::from_secs_f64((seconds / 180.0).max(1.0)));
    }
    let told = server.report()?;
    let seen = swarm.end()?;
    server.end()?;
    for &(second, rss_kb) in &samples {
        report.push(&SoakRow { second, rss_kb })?;
    }
    // The first third is warm-up: what a client has not met yet is new to the server, too.
    let steady: Vec<(f64, f64)> = samples.iter().filter(|(second, _)| *second >= seconds / 3.0).copied().collect();
    let slope = slope(&steady);
    let verdict = growth(&steady);
    *grown = verdict
        .map(|kb| format!("the server's memory grows: by {kb:.0} KB after the first third, at {slope:.2} KB a second"));
    let last = steady.last().map_or(0.0, |sample| sample.1);
    report.headline = format!(
        "{} clients for {seconds} s, {} changes of each of three kinds a second ({} joined, {} came back, {} bounds broken): \
         memory {:.0} KB at the end, growing by {:.2} KB a second after the first third ({:.2} % a minute): {}",
        options.clients,
        options.churn.unwrap_or_default(),
        told.admitted,
        told.resumed,
        told.violations,
        last,
        slope,
        if last > 0.0 { 6000.0 * slope / last } else { 0.0 },
        if grown.is_some() { "it GROWS" } else { "flat" },
    );
    Ok((report, seen.late_p99_ms > super::swarm::LATE_MAX.as_secs_f64() * 1e3))
}

/// By how much memory grows through these samples (seconds, KB), if it does: if the line through them rises by more than a
/// twentieth of their level and by more than a megabyte, and the second half still rises. Memory that goes up and down with who is here,
/// or has found its level late, does not.
fn growth(samples: &[(f64, f64)]) -> Option<f64> {
    let (&(begin, level), &(end, _)) = (samples.first()?, samples.last()?);
    let rise = |samples: &[(f64, f64)]| slope(samples) * (end - begin);
    let least = (0.05 * level).max(1024.0);
    let (all, late) = (rise(samples), rise(&samples[samples.len() / 2..]));
    (all > least && late > least / 2.0).then_some(all)
}

/// Slope of the line with the least squares through these points; 0 through fewer than two.
fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let mean = |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / count.max(1.0);
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let (mut above, mut below) = (0.0, 0.0);
    for point in points {
        above += (point.0 - x) * (point.1 - y);
        below += (point.0 - x) * (point.0 - x);
    }
    if below > 0.0 { above / below } else { 0.0 }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_goes_up_and_down_does_not_grow_and_a_leak_does() {
        let samples = |kb: fn(f64) -> f64| (60..180).map(|s| (f64::from(s), kb(f64::from(s)))).collect::<Vec<_>>();
        assert_eq!(growth(&samples(|_| 20_000.0)), None);
        assert_eq!(growth(&samples(|s| 20_000.0 + 3_000.0 * (s / 7.0).sin())), None);
        assert_eq!(
            growth(&samples(|s| if s < 90.0 { 20_000.0 } else { 23_000.0 })),
            None,
            "a level that was found late"
        );
        assert_eq!(growth(&samples(|s| 20_000.0 - 30.0 * s)), None);
        let leak = growth(&samples(|s| 20_000.0 + 25.0 * s + 500.0 * (s / 7.0).sin())).unwrap();
        assert!((2_500.0..3_500.0).contains(&leak), "{leak}");
        assert_eq!(growth(&[]), None);
    }

    #[test]
    fn a_void_run_is_made_again_and_counts_for_nothing() {
        let mut runs = Runs { wanted: 2, ..Runs::default() };
        let values = [(true, 9.0), (false, 1.0), (true, 8.0), (true, 7.0)];
        for (number, (is_void, _)) in values.iter().enumerate() {
            assert!(runs.go_on(), "{number}");
            runs.count(*is_void);
        }
        assert!(!runs.go_on() && runs.are_void(), "twice as many are enough");
        assert_eq!((runs.median(values.into_iter()), runs.of_what().as_str()), (1.0, "median of 1, 3 more were void"));
        let mut runs = Runs { wanted: 1, ..Runs::default() };
        (0..2).for_each(|_| runs.count(true));
        assert!(!runs.go_on());
        assert_eq!(runs.median([(true, 3.0), (true, 5.0)].into_iter()), 5.0);
    }

    #[test]
    fn medians_and_slopes() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), 2.0);
        assert!(median(std::iter::empty()).is_nan());
        assert_eq!(slope(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]), 2.0);
        assert_eq!([slope(&[]), slope(&[(1.0, 1.0)])], [0.0, 0.0]);
    }
}
