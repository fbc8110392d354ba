//! What a process uses: memory and processor time, and which core it may use. Linux's `/proc` tells.

use std::time::Duration;

use anyhow::Context as _;

/// What a process has used so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Memory that it holds now: RSS, bytes.
    pub rss_bytes: u64,
    /// Processor time, of its own and of the system for it.
    pub cpu: Duration,
    /// How often its first thread has waited for something to do.
    pub waits: u64,
}

impl Usage {
    /// Memory, in units of 1,024 bytes.
    pub fn rss_kb(&self) -> f64 {
        self.rss_bytes as f64 / 1024.0
    }

    /// Of the process with this number.
    ///
    /// # Errors
    /// If there is no such process, or no `/proc`.
    pub fn of(pid: u32) -> anyhow::Result<Usage> {
        let read = |file: &str| {
            let path = format!("/proc/{pid}/{file}");
            std::fs::read_to_string(&path)
                .with_context(|| format!("cannot read {path}; loads are measured on Linux only"))
        };
        parse(&read("status")?, &read("stat")?).with_context(|| format!("/proc tells nothing of process {pid}"))
    }
}

/// `/proc/PID/stat` counts in hundredths of a second, whatever the kernel's own tick (`USER_HZ`).
const STAT_HZ: f64 = 100.0;

fn parse(status: &str, stat: &str) -> Option<Usage> {
    let rss = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let rss_kib: u64 = rss.trim().strip_suffix("kB")?.trim().parse().ok()?;
    let waits = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"))?.trim().parse().ok()?;
    // The name, in brackets, may hold anything; user and system time are the 12th and 13th field after it.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut times = fields.split_whitespace().skip(11).map(|field| field.parse::<u64>());
    let ticks = times.next()?.ok()? + times.next()?.ok()?;
    Some(Usage { rss_bytes: rss_kib * 1024, cpu: Duration::from_secs_f64(ticks as f64 / STAT_HZ), waits })
}

/// Keeps this process, from now on, on one core.
///
/// # Errors
/// If there is no such core, or the system knows no such thing.
pub fn pin_to(core: usize) -> anyhow::Result<()> {
    #[cfg(target_os = "linux")]
    {
        let mut set = rustix::thread::CpuSet::new();
        anyhow::ensure!(core < rustix::thread::CpuSet::MAX_CPU, "there is no core {core}");
        set.set(core);
        rustix::thread::sched_setaffinity(None, &set)
            .with_context(|| format!("cannot keep to core {core}; choose one that this machine has"))
    }
    #[cfg(not(target_os = "linux"))]
    anyhow::bail!("cannot keep to core {core} on this system")
}

/// Running and waiting processes of the last minute, as `uptime` tells; `None` where the system does not.
pub fn load_average() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}

/// Processor time that this machine's host has given to others so far, all cores together; `None` where the system does not tell.
pub fn stolen() -> Option<Duration> {
    parse_stolen(&std::fs::read_to_string("/proc/stat").ok()?)
}

/// The eighth number of the first line, in hundredths of a second, too.
fn parse_stolen(stat: &str) -> Option<Duration> {
    let ticks: u64 =
        stat.lines().find_map(|line| line.strip_prefix("cpu "))?.split_whitespace().nth(7)?.parse().ok()?;
    Some(Duration::from_secs_f64(ticks as f64 / STAT_HZ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_may_be_called_anything() {
        let status = "Name:\tx\nVmRSS:\t   2048 kB\nThreads:\t1\nvoluntary_ctxt_switches:\t12\n";
        let stat = "7 (a) 1 2) b) S 1 2 3 4 5 6 7 8 9 10 250 50 0 0 20 0";
        let usage = Usage { rss_bytes: 2 << 20, cpu: Duration::from_secs(3), waits: 12 };
        assert_eq!(parse(status, stat), Some(usage));
        for (status, stat) in
            [("", stat), (status, ""), (status, "7 (x) S 1 2"), ("VmRSS: many kB\n", stat), ("VmRSS: 1 kB\n", stat)]
        {
            assert_eq!(parse(status, stat), None);
        }
    }

    #[test]
    fn stolen_time_is_one_of_many() {
        let stat = "cpu  1 2 3 4 5 6 7 250 9 10\ncpu0 1 2 3 4 5 6 7 8 9 10\n";
        assert_eq!(parse_stolen(stat), Some(Duration::from_millis(2500)));
        for stat in ["", "cpu0 1 2 3 4 5 6 7 8\n", "cpu  1 2 3\n", "cpu  1 2 3 4 5 6 7 many\n"] {
            assert_eq!(parse_stolen(stat), None);
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_process_uses_something_and_no_process_0_is_told_of() {
        assert!(Usage::of(std::process::id()).unwrap().rss_bytes > 1 << 16);
        assert!(Usage::of(0).is_err());
    }
}
