//! Who is not to come back, and until when: a bounded list, kept in a file if there is one.
//!
//! ```text
//! subject 2026-01-01T00:00:00Z anna
//! address 2026-01-01T00:00:00Z 203.0.113.7
//! ```

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use eyeline_protocol::WorldTime;

use super::gate::network;
use crate::token::files::{FileError, read_text, replace};
use crate::token::{calendar, from_calendar};

/// Most bans at once. With more, the one that would end first ends.
pub const BANS_MAX: usize = 4096;

/// Largest file of bans, bytes.
const BYTES_MAX: u64 = 2 << 20;

/// Later than anything that the calendar can write: a ban until the server ends, which no file keeps.
const FOREVER: WorldTime = WorldTime::from_micros(253_402_300_799_000_000);

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Banned {
    Subject(String),
    Address(IpAddr),
}

/// Who is banned.
#[derive(Debug, Default)]
pub(super) struct Bans {
    until: BTreeMap<Banned, WorldTime>,
    file: Option<PathBuf>,
}

impl Bans {
    /// The bans in a file, which is written at the first one if it is not there.
    pub(super) fn kept_in(path: &Path) -> Result<Bans, FileError> {
        let mut bans = Bans { until: BTreeMap::new(), file: Some(path.to_owned()) };
        let text = match read_text(path, BYTES_MAX) {
            Ok(text) => text,
            Err(FileError::File { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => return Ok(bans),
            Err(error) => return Err(error),
        };
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (banned, until) = parse(line).ok_or_else(|| FileError::Line {
                path: path.to_owned(),
                line: index + 1,
                text: line.to_owned(),
                usage: "'subject TIME NAME' or 'address TIME IP', or delete the line to end the ban",
            })?;
            bans.insert(banned, until);
        }
        Ok(bans)
    }

    /// Until when who comes so is banned, if it is: by its name, or without one by its address.
    pub(super) fn until(&self, subject: &str, address: Option<IpAddr>, now: WorldTime) -> Option<WorldTime> {
        self.until.get(&banned(subject, address)?).copied().filter(|until| *until > now)
    }

    /// Bans somebody. Who has neither name nor address can't be told from others, and is not.
    pub(super) fn add(&mut self, subject: &str, address: Option<IpAddr>, until: WorldTime) {
        let Some(banned) = banned(subject, address) else { return };
        self.insert(banned, until);
        if let Some(path) = &self.file
            && let Err(error) = replace(path, &self.text())
        {
            tracing::warn!("{error}; the ban holds until the server ends");
        }
    }

    fn insert(&mut self, banned: Banned, until: WorldTime) {
        let is = self.until.entry(banned).or_insert(until);
        *is = until.max(*is);
        if self.until.len() > BANS_MAX {
            let first = self.until.iter().min_by_key(|(_, until)| **until).map(|(banned, _)| banned.clone());
            first.map(|first| self.until.remove(&first));
        }
    }

    fn text(&self) -> String {
        let mut text = "# Who is not let in, and until when; read when the server starts\n".to_owned();
        for (banned, until) in self.until.iter().filter(|(_, until)| **until < FOREVER) {
            text += &match banned {
                Banned::Subject(name) => format!("subject {} {name}\n", calendar(*until)),
                Banned::Address(address) => format!("address {} {address}\n", calendar(*until)),
            };
        }
        text
    }
}

fn banned(subject: &str, address: Option<IpAddr>) -> Option<Banned> {
    match (subject, address) {
        ("", address) => address.map(|address| Banned::Address(network(address))),
        (subject, _) => Some(Banned::Subject(subject.to_owned())),
    }
}

fn parse(line: &str) -> Option<(Banned, WorldTime)> {
    let (kind, rest) = line.split_once(' ')?;
    let (until, who) = rest.split_once(' ')?;
    let banned = match kind {
        "subject" => Banned::Subject(who.to_owned()),
        "address" => Banned::Address(network(who.parse().ok()?)),
        _ => return None,
    };
    Some((banned, from_calendar(until)?))
}

/// What is said to who is banned.
pub(super) fn reason(until: WorldTime) -> String {
    let when = if until < FOREVER { format!(" before {}", calendar(until)) } else { String::new() };
    format!("you are not let in{when}; ask who runs this server")
}
