//! Who is not to come back, and until when: a bounded list, kept in a file if there is one.
//!
//! ```text
//! subject 2026-01-01T00:00:00Z anna
//! address 2026-01-01T00:00:00Z 203.0.113.7
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use eyeline_protocol::WorldTime;

use super::gate::network;
use super::watched::Watched;
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

/// Who is banned, and until when.
type List = BTreeMap<Banned, WorldTime>;

/// Who is banned.
#[derive(Debug, Default)]
pub(super) struct Bans {
    until: List,
    /// Those of `until` that are in no file: they end with the server.
    unwritten: BTreeSet<Banned>,
    /// Its lines are a person's to change while the server runs.
    file: Option<Watched<List>>,
}

impl Bans {
    /// The bans in a file, which is written at the first one if it is not there.
    pub(super) fn kept_in(path: &Path) -> Result<Bans, FileError> {
        let file = Watched::new(vec![path.to_owned()], read)?;
        Ok(Bans { until: file.get().clone(), unwritten: BTreeSet::new(), file: Some(file) })
    }

    /// Reads the file again if somebody has changed it; says whether it was. A file with a line that is not understood changes
    /// nothing.
    pub(super) fn look(&mut self) -> bool {
        let Some(file) = &mut self.file else { return false };
        if !file.look(read) {
            return false;
        }
        self.until.retain(|banned, _| self.unwritten.contains(banned));
        for (banned, &until) in file.get() {
            insert(&mut self.until, banned.clone(), until);
        }
        true
    }

    /// Until when who comes so is banned, if it is: by its name, or without one by its address.
    pub(super) fn until(&self, subject: &str, address: Option<IpAddr>, now: WorldTime) -> Option<WorldTime> {
        self.until.get(&banned(subject, address)?).copied().filter(|until| *until > now)
    }

    /// Bans somebody. Who has neither name nor address can't be told from others, and is not.
    pub(super) fn add(&mut self, subject: &str, address: Option<IpAddr>, until: WorldTime) {
        let Some(banned) = banned(subject, address) else { return };
        // What a person has written since is not to be lost.
        self.look();
        insert(&mut self.until, banned.clone(), until);
        self.unwritten.insert(banned);
        self.unwritten.retain(|banned| self.until.contains_key(banned));
        let Some(file) = &mut self.file else { return };
        if !file.is_sound() {
            return tracing::warn!("the file of bans is not good; the ban holds until the server ends");
        }
        let written: List = self
            .until
            .iter()
            .filter(|(_, until)| **until < FOREVER)
            .map(|(who, until)| (who.clone(), *until))
            .collect();
        match replace(file.path(), &text(&written)) {
            Ok(()) => {
                self.unwritten.retain(|banned| !written.contains_key(banned));
                file.note_written(written);
            }
            Err(error) => tracing::warn!("{error}; the ban holds until the server ends"),
        }
    }
}

fn insert(list: &mut List, banned: Banned, until: WorldTime) {
    let is = list.entry(banned).or_insert(until);
    *is = until.max(*is);
    if list.len() > BANS_MAX {
        let first = list.iter().min_by_key(|(_, until)| **until).map(|(banned, _)| banned.clone());
        first.map(|first| list.remove(&first));
    }
}

fn read(paths: &[PathBuf]) -> Result<List, FileError> {
    let path = &paths[0];
    let text = match read_text(path, BYTES_MAX) {
        Ok(text) => text,
        Err(FileError::File { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => return Ok(List::new()),
        Err(error) => return Err(error),
    };
    let mut list = List::new();
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
        insert(&mut list, banned, until);
    }
    Ok(list)
}

fn text(list: &List) -> String {
    let mut text = "# Who is not let in, and until when; read again when it changes\n".to_owned();
    for (banned, until) in list {
        text += &match banned {
            Banned::Subject(name) => format!("subject {} {name}\n", calendar(*until)),
            Banned::Address(address) => format!("address {} {address}\n", calendar(*until)),
        };
    }
    text
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_changes_is_read_again_and_nothing_that_was_said_in_the_meantime_is_lost() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("bans");
        let later = from_calendar("2027-01-01T00:00:00Z").unwrap();
        let mut bans = Bans::kept_in(&path).unwrap();
        let is_banned = |bans: &Bans, subject: &str| bans.until(subject, None, WorldTime::ZERO).is_some();
        assert!(!bans.look());
        bans.add("anna", None, later);
        bans.add("forever", None, WorldTime::MAX);
        assert!(!bans.look(), "what we wrote ourselves is no news");
        // A person ends one ban and begins another.
        std::fs::write(&path, "subject 2027-01-01T00:00:00Z bob\n").unwrap();
        assert!(bans.look());
        assert!(!is_banned(&bans, "anna") && is_banned(&bans, "bob") && is_banned(&bans, "forever"));
        // An operator bans before we have looked again: both hold, and both are written.
        std::fs::write(&path, "subject 2027-01-01T00:00:00Z bob\nsubject 2027-01-01T00:00:00Z carol\n").unwrap();
        bans.add("dave", None, later);
        assert!(["bob", "carol", "dave", "forever"].iter().all(|subject| is_banned(&bans, subject)));
        assert!(["bob", "carol", "dave"].iter().all(|subject| is_banned(&Bans::kept_in(&path).unwrap(), subject)));
        // What we do not understand we neither heed nor overwrite.
        std::fs::write(&path, "subject tomorrow bob\n").unwrap();
        bans.add("eve", None, later);
        assert!(["bob", "carol", "dave", "eve"].iter().all(|subject| is_banned(&bans, subject)));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "subject tomorrow bob\n");
        // Mended, it says who is banned, but for who was banned meanwhile.
        std::fs::write(&path, "subject 2027-01-01T00:00:00Z bobby\n").unwrap();
        assert!(bans.look());
        assert!(!is_banned(&bans, "bob") && is_banned(&bans, "bobby") && is_banned(&bans, "eve"));
    }

    #[test]
    fn the_list_is_bounded_and_the_ban_that_ends_first_goes_first() {
        let mut bans = Bans::default();
        let at = |index: usize| WorldTime::from_micros(1 + index as i64);
        for index in 0..BANS_MAX + 10 {
            bans.add(&format!("{index}"), None, at(index));
        }
        assert_eq!(bans.until.len(), BANS_MAX);
        assert_eq!(bans.until("9", None, WorldTime::ZERO), None);
        assert_eq!(bans.until("10", None, WorldTime::ZERO), Some(at(10)));
        // A shorter ban does not shorten one.
        bans.add("10", None, at(3));
        assert_eq!(bans.until("10", None, WorldTime::ZERO), Some(at(10)));
    }
}
