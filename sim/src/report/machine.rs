//! Which machine, which program and which command made a report?
//!
//! Numbers without these cannot be compared. What identifies a person or a computer (paths, host and user names)
//! stays out.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

/// The computer that a report's times belong to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Operating system, as Rust names it: `linux`.
    pub os: String,
    /// Instruction set, as Rust names it: `x86_64`.
    pub arch: String,
    /// The processor's own name, where the system tells it.
    pub cpu: Option<String>,
    /// Hardware threads that this process may use.
    pub cores: usize,
    /// Main memory, where the system tells it.
    pub memory_bytes: Option<u64>,
    /// Instruction set extensions that the cullers could use.
    pub simd: Vec<String>,
}

impl Machine {
    /// This machine. Model and memory are read from `/proc`, and are unknown on systems without it.
    pub fn here() -> Self {
        Self {
            os: std::env::consts::OS.to_owned(),
            arch: std::env::consts::ARCH.to_owned(),
            cpu: fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| cpu_model(&text)),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_bytes: fs::read_to_string("/proc/meminfo").ok().and_then(|text| memory_bytes(&text)),
            simd: simd(),
        }
    }
}

fn cpu_model(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    Some(name.split_whitespace().collect::<Vec<_>>().join(" "))
}

fn memory_bytes(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find(|line| line.starts_with("MemTotal:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(target_arch = "x86_64")]
fn simd() -> Vec<String> {
    let found = [
        ("sse4.1", is_x86_feature_detected!("sse4.1")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx512bw", is_x86_feature_detected!("avx512bw")),
        ("avx512dq", is_x86_feature_detected!("avx512dq")),
        ("avx512vl", is_x86_feature_detected!("avx512vl")),
    ];
    found.iter().filter(|(_, here)| *here).map(|(name, _)| (*name).to_owned()).collect()
}

#[cfg(target_arch = "aarch64")]
fn simd() -> Vec<String> {
    if std::arch::is_aarch64_feature_detected!("neon") { vec!["neon".to_owned()] } else { Vec::new() }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn simd() -> Vec<String> {
    Vec::new()
}

/// The program that made a report.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Build {
    /// Eyeline's version.
    pub version: String,
    /// `release` or `debug`; times of a debug build mean little.
    pub profile: String,
    /// The commit checked out where the program was built, if that is a git repository and still there.
    pub commit: Option<String>,
    /// Whether tracked files there differ from that commit.
    pub modified: Option<bool>,
}

impl Build {
    /// This program. Asks git at run time, so a program older than its source tree names the tree's commit.
    pub fn here() -> Self {
        let commit = git(&["rev-parse", "HEAD"]).filter(|hash| hash.len() >= 40);
        let modified = commit
            .as_ref()
            .and_then(|_| git(&["status", "--porcelain", "--untracked-files=no"]))
            .map(|s| !s.is_empty());
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            profile: if cfg!(debug_assertions) { "debug" } else { "release" }.to_owned(),
            commit,
            modified,
        }
    }
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(env!("CARGO_MANIFEST_DIR")).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

/// The command line of this process as typed, fit to be published: see [`command_line`].
pub fn this_command() -> String {
    let here = std::env::current_dir().unwrap_or_default();
    command_line(std::env::args_os(), &here)
}

/// A command line with absolute paths made relative to `here`, or else cut to their file names, quoted for a shell.
pub fn command_line<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>, here: &Path) -> String {
    let mut words = Vec::new();
    for (i, argument) in arguments.into_iter().enumerate() {
        let text = argument.as_ref().to_string_lossy();
        words.push(quoted(&if i == 0 { file_name(Path::new(&*text)) } else { without_absolute_paths(&text, here) }));
    }
    words.join(" ")
}

/// A path fit to be published: relative to `here` if it lies within, or else only the file's name.
pub fn short_path(path: &Path, here: &Path) -> String {
    if !path.is_absolute() {
        return path.to_string_lossy().into_owned();
    }
    match path.strip_prefix(here) {
        Ok(inside) if inside.as_os_str().is_empty() => ".".to_owned(),
        Ok(inside) => inside.to_string_lossy().into_owned(),
        Err(_) => file_name(path),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.to_string_lossy(), OsStr::to_string_lossy).into_owned()
}

/// An option's value may follow `=`, and may be a list with commas.
fn without_absolute_paths(argument: &str, here: &Path) -> String {
    let (option, value) = match argument.split_once('=') {
        Some((option, value)) if option.starts_with('-') => (Some(option), value),
        _ => (None, argument),
    };
    let value = value.split(',').map(|part| short_path(Path::new(part), here)).collect::<Vec<_>>().join(",");
    option.map_or(value.clone(), |option| format!("{option}={value}"))
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./,:=+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// A time as RFC 3339 in UTC, to the second: `2026-11-22T03:42:39Z`.
///
/// The Gregorian calendar by Howard Hinnant's `civil_from_days`, for years from 1970 on; earlier times give 1970.
pub fn rfc3339(time: SystemTime) -> String {
    let seconds = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
    let (days, in_day) = (seconds / 86_400, seconds % 86_400);
    let shifted = days + 719_468; // days since 0000-03-01, so that a leap day ends its year
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    let (hour, minute, second) = (in_day / 3_600, in_day / 60 % 60, in_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_absolute_path_survives_in_a_command() {
        let arguments = [
            "/home/ann/eyeline/target/release/eyeline-sim",
            "measure",
            "--world",
            "/home/ann/eyeline/scenes/rooms.glb",
            "--out=/home/ann/eyeline",
            "--traces=/data/private/eth.txt,/home/ann/eyeline/hotel.txt",
            "/",
            "it's here",
            "",
        ];
        let command = command_line(arguments, Path::new("/home/ann/eyeline"));
        assert_eq!(
            command,
            r"eyeline-sim measure --world scenes/rooms.glb --out=. --traces=eth.txt,hotel.txt / 'it'\''s here' ''"
        );
    }

    #[test]
    fn times_follow_the_calendar() {
        let at = |seconds| rfc3339(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01T00:00:00Z");
        assert_eq!(at(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(at(1_700_000_000), "2023-11-14T22:13:20Z");
        assert_eq!(at(4_107_542_399), "2100-02-28T23:59:59Z");
        assert_eq!(at(4_107_542_400), "2100-03-01T00:00:00Z");
    }

    #[test]
    fn proc_is_read_or_ignored() {
        assert_eq!(cpu_model("processor : 0\nmodel name\t: A  Fast CPU\n").as_deref(), Some("A Fast CPU"));
        assert_eq!(cpu_model("nothing"), None);
        assert_eq!(memory_bytes("MemTotal:       1024 kB\n"), Some(1 << 20));
        assert_eq!(memory_bytes("MemTotal: many kB"), None);
        assert!(Machine::here().cores >= 1);
    }
}
