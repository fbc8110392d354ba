//! `link`: a bad path between clients and a server.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::io::{IsTerminal, Write as _};
use std::net::SocketAddr;
use std::num::NonZeroU64;
use std::time::{Duration, Instant};

use clap::Args;
use eyeline_server::app::{number, shutdown_signal};
use eyeline_sim::relay::{Relay, RelayConfig, RelayStats};
use eyeline_sim::virtual_net::{Blackout, Capacity, LinkRules};

/// Options of `link`.
#[derive(Args)]
pub struct Link {
    /// Where clients send to instead of to the server; port 0 takes a free one
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0")]
    listen: SocketAddr,

    /// The server
    #[arg(long, value_name = "ADDR")]
    to: SocketAddr,

    /// Least time under way, each way [default: 0ms]
    #[arg(long, value_name = "TIME", value_parser = time)]
    delay: Option<Duration>,

    /// Up to so much more, evenly spread; by itself it reorders what is sent closer together [default: 0ms]
    #[arg(long, value_name = "TIME", value_parser = time)]
    jitter: Option<Duration>,

    /// Share of datagrams that are lost, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = share())]
    loss: Option<f64>,

    /// Share of datagrams that arrive twice, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = share())]
    duplicate: Option<f64>,

    /// Share of datagrams that are held up and overtaken, 0 to 1 [default: 0]
    #[arg(long, value_name = "SHARE", value_parser = share())]
    reorder: Option<f64>,

    /// Bits a second that each client's path carries [default: without limit]
    #[arg(long, value_name = "RATE", value_parser = rate)]
    rate: Option<NonZeroU64>,

    /// Most bytes that wait at that rate, for each client; the rest is lost [default: 65536]
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(u32).range(1..))]
    queue: Option<u32>,

    /// When nothing gets through: FROM the start, for LENGTH
    #[arg(long, value_name = "FROM+LENGTH", value_delimiter = ',', value_parser = blackout)]
    blackout: Vec<Blackout>,

    /// Decides what is left to chance
    #[arg(long, value_name = "N", default_value_t = 7)]
    seed: u64,

    /// How long to relay, seconds [default: until Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = number(0.1..=1e6, "s"))]
    seconds: Option<f64>,

    #[command(flatten)]
    up: Up,

    #[command(flatten)]
    down: Down,
}

/// The options of one direction only, which go before those of both.
macro_rules! one_way {
    ($name:ident, $prefix:literal, $heading:literal) => {
        #[derive(Args)]
        #[command(next_help_heading = $heading)]
        struct $name {
            #[arg(id = concat!($prefix, "-delay"), long, help = "As --delay", value_name = "TIME", value_parser = time)]
            delay: Option<Duration>,
            #[arg(id = concat!($prefix, "-jitter"), long, help = "As --jitter")]
            #[arg(value_name = "TIME", value_parser = time)]
            jitter: Option<Duration>,
            #[arg(id = concat!($prefix, "-loss"), long, help = "As --loss")]
            #[arg(value_name = "SHARE", value_parser = share())]
            loss: Option<f64>,
            #[arg(id = concat!($prefix, "-duplicate"), long, help = "As --duplicate")]
            #[arg(value_name = "SHARE", value_parser = share())]
            duplicate: Option<f64>,
            #[arg(id = concat!($prefix, "-reorder"), long, help = "As --reorder")]
            #[arg(value_name = "SHARE", value_parser = share())]
            reorder: Option<f64>,
            #[arg(id = concat!($prefix, "-rate"), long, help = "As --rate", value_name = "RATE", value_parser = rate)]
            rate: Option<NonZeroU64>,
            #[arg(id = concat!($prefix, "-queue"), long, help = "As --queue")]
            #[arg(value_name = "BYTES", value_parser = clap::value_parser!(u32).range(1..))]
            queue: Option<u32>,
            #[arg(id = concat!($prefix, "-blackout"), long, help = "As --blackout", value_name = "FROM+LENGTH")]
            #[arg(value_delimiter = ',', value_parser = blackout)]
            blackout: Vec<Blackout>,
        }

        impl $name {
            fn over(&self, both: &Link) -> (LinkRules, Capacity) {
                let rules = LinkRules::default()
                    .with_delay(self.delay.or(both.delay).unwrap_or_default())
                    .with_jitter(self.jitter.or(both.jitter).unwrap_or_default())
                    .with_loss(self.loss.or(both.loss).unwrap_or_default())
                    .with_duplicate(self.duplicate.or(both.duplicate).unwrap_or_default())
                    .with_reorder(self.reorder.or(both.reorder).unwrap_or_default());
                let mut capacity = Capacity::default();
                capacity.rate = self.rate.or(both.rate);
                if let Some(queue) = self.queue.or(both.queue) {
                    capacity.queue_bytes = queue as usize;
                }
                capacity.blackouts = if self.blackout.is_empty() { &both.blackout } else { &self.blackout }.clone();
                (rules, capacity)
            }
        }
    };
}

one_way!(Up, "up", "To the server only, instead");
one_way!(Down, "down", "From the server only, instead");

pub const EXAMPLES: &str = "Examples:
  eyeline-sim link --to 127.0.0.1:4433 --delay 25ms --jitter 5ms --loss 0.02
  eyeline-sim link --listen 0.0.0.0:4434 --to 127.0.0.1:4433 --rate 2Mbit --queue 30000
  eyeline-sim link --to 127.0.0.1:4433 --delay 25ms --down-loss 0.2 --blackout 10s+1s,30s+5s

The first line says where it listens: 'listening ADDR'. Clients connect there with the server's own fingerprint.";

fn share() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number(0.0..=1.0, "")
}

/// Longest time that is taken: a day.
const TIME_MAX_S: f64 = 86_400.0;

/// A time with its unit.
fn time(text: &str) -> Result<Duration, String> {
    let units = [("us", 1e-6), ("ms", 1e-3), ("min", 60.0), ("s", 1.0)];
    let seconds =
        units.iter().find_map(|(unit, seconds)| Some(text.strip_suffix(unit)?.parse::<f64>().ok()? * seconds));
    let wrong = || "give a time up to a day with its unit (us, ms, s or min), as in 25ms or 1.5s".to_owned();
    seconds.filter(|seconds| (0.0..=TIME_MAX_S).contains(seconds)).map(Duration::from_secs_f64).ok_or_else(wrong)
}

/// Bits a second with their unit.
fn rate(text: &str) -> Result<NonZeroU64, String> {
    let units = [("kbit", 1e3), ("Mbit", 1e6), ("Gbit", 1e9), ("bit", 1.0)];
    let bits = units.iter().find_map(|(unit, bits)| Some(text.strip_suffix(unit)?.parse::<f64>().ok()? * bits));
    let bits = bits.filter(|bits| (1.0..=1e12).contains(bits)).and_then(|bits| NonZeroU64::new(bits as u64));
    bits.ok_or_else(|| "give bits a second, 1 to 10^12, with their unit, as in 500kbit, 2Mbit or 1Gbit".to_owned())
}

fn blackout(text: &str) -> Result<Blackout, String> {
    let wrong = |why: &str| format!("give FROM+LENGTH, as in 10s+500ms{why}");
    let (from, length) = text.split_once('+').ok_or_else(|| wrong(""))?;
    let part = |text: &str| time(text.trim()).map_err(|why| wrong(&format!(": {why}")));
    Ok(Blackout { from: part(from)?, length: part(length)? })
}

/// Relays.
pub fn run(options: &Link) -> anyhow::Result<()> {
    let mut config = RelayConfig::new(options.listen, options.to).with_seed(options.seed);
    (config.up, config.up_capacity) = options.up.over(options);
    (config.down, config.down_capacity) = options.down.over(options);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let shutdown = shutdown_signal()?;
        let relay = Relay::bind(config)?;
        super::print(&format!("listening {}\nto {}, seed {}\n", relay.local_addr()?, options.to, options.seed));
        let over = async {
            match options.seconds {
                Some(seconds) => tokio::time::sleep(Duration::from_secs_f64(seconds)).await,
                None => std::future::pending().await,
            }
        };
        let end = async {
            tokio::select! {
                () = shutdown => {}
                () = over => {}
            }
        };
        let started = Instant::now();
        let mut is_shown = false;
        let stats = relay
            .run(end, |stats| {
                is_shown = true;
                show(stats, started.elapsed());
            })
            .await;
        if is_shown && std::io::stderr().is_terminal() {
            eprintln!();
        }
        super::print(&format!("{stats}\n"));
        Ok(())
    })
}

/// The progress line: in a terminal always the same one, in a log one every ten seconds.
fn show(stats: &RelayStats, elapsed: Duration) {
    let (up, down) = (&stats.up, &stats.down);
    let text = format!(
        "{:.0} s: {} clients; up {} in, {} out; down {} in, {} out; {} B under way",
        elapsed.as_secs_f64(),
        stats.clients,
        up.received,
        up.sent,
        down.received,
        down.sent,
        stats.queued_bytes
    );
    let mut error = std::io::stderr().lock();
    // Who has closed it does not want to read.
    let _ = if error.is_terminal() {
        write!(error, "\r{text}\x1b[K").and_then(|()| error.flush())
    } else if elapsed.as_secs().is_multiple_of(10) {
        writeln!(error, "{text}")
    } else {
        Ok(())
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_rates_need_their_unit() {
        assert_eq!(time("25ms"), Ok(Duration::from_millis(25)));
        assert_eq!(time("1.5s"), Ok(Duration::from_millis(1_500)));
        assert_eq!(time("2min"), Ok(Duration::from_secs(120)));
        for bad in ["25", "ms", "-1ms", "nans", "infs", "2h", "1e9s", ""] {
            assert!(time(bad).is_err_and(|why| why.contains("25ms")), "{bad}");
        }
        assert_eq!(rate("2Mbit").map(NonZeroU64::get), Ok(2_000_000));
        assert_eq!(rate("1.5kbit").map(NonZeroU64::get), Ok(1_500));
        assert_eq!(rate("9600bit").map(NonZeroU64::get), Ok(9_600));
        for bad in ["2", "0bit", "2MB", "nanbit", "-1Mbit", "1e9Gbit"] {
            assert!(rate(bad).is_err_and(|why| why.contains("2Mbit")), "{bad}");
        }
        let (from, length) = (Duration::from_secs(10), Duration::from_millis(500));
        assert_eq!(blackout("10s+500ms"), Ok(Blackout { from, length }));
        for bad in ["10s", "10+5", "10s+", "+1s"] {
            assert!(blackout(bad).is_err_and(|why| why.contains("10s+500ms")), "{bad}");
        }
    }
}
