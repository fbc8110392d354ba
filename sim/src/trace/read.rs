//! Reads pedestrian recordings, in the two formats in which they are published.
//!
//! | columns | format | unit | frames a second |
//! |---|---|---|---|
//! | 8 | `frame id x z y vx vz vy` (`obsmat`: BIWI, UCY) | metres | 25 |
//! | 5 | `id frame x y z` (Jülich; z is the height of the head) | centimetres | 16 |
//!
//! The number of columns of the first row decides; values are separated by blanks or tabs. Lines that are empty or begin
//! with `#` are left out, except that a comment `framerate: 25` overrides the frame rate, and `x/m` or `x/cm` the unit, as
//! Jülich's newer files have it. Windows line ends and a byte order mark are fine.
//!
//! Rows may come in any order; they are sorted by frame. Of two rows with the same person and frame the first in the file
//! counts and the other is counted as a duplicate. An id is any whole number that fits 64 bits, however large. The first
//! frame of the file becomes time 0. Velocities and heights are checked to be numbers and otherwise unused. A broken row
//! is an error that names file and line; so is a position more than 100 km away, and a step faster than 50 m/s, since
//! a file with one broken digit should not quietly become a person who jumps.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use glam::DVec2;

use super::{GAP_MAX_S, Sample, Trace, Track};

/// Greatest coordinate, in metres.
const FAR: f64 = 1e5;
/// Greatest frame number, either side of 0: over a year at 25 a second.
const FRAME_MAX: f64 = 1e9;
/// Greatest speed between two samples, in metres a second.
const SPEED_MAX: f64 = 50.0;
/// Above this an f64 no longer holds every whole number.
const WHOLE_MAX: f64 = 9_007_199_254_740_992.0;

/// The kind of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `frame id x z y vx vz vy`, metres, 25 frames a second.
    Obsmat,
    /// `id frame x y z`, centimetres, 16 frames a second.
    Juelich,
}

impl Format {
    fn columns(self) -> usize {
        match self {
            Format::Obsmat => 8,
            Format::Juelich => 5,
        }
    }

    fn layout(self) -> &'static str {
        match self {
            Format::Obsmat => "frame id x z y vx vz vy",
            Format::Juelich => "id frame x y z",
        }
    }

    fn frame_hz(self) -> f64 {
        match self {
            Format::Obsmat => 25.0,
            Format::Juelich => 16.0,
        }
    }

    fn metres_a_unit(self) -> f64 {
        match self {
            Format::Obsmat => 1.0,
            Format::Juelich => 0.01,
        }
    }
}

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TraceError {
    /// The file cannot be read.
    #[error("cannot read the trace {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A line is broken.
    #[error("{path}:{line}: {what}; {remedy}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong, with the value.
        what: String,
        /// What would be right.
        remedy: &'static str,
    },
    /// There is no row.
    #[error("{0} has no row; give a recording with 8 columns (frame id x z y vx vz vy) or 5 (id frame x y z)")]
    Empty(PathBuf),
}

/// A row, and where it stands in the file.
struct Row {
    line: usize,
    id: u64,
    frame: f64,
    position: DVec2,
}

impl Trace {
    /// Reads a recording.
    pub fn read(path: &Path) -> Result<Trace, TraceError> {
        match std::fs::read(path) {
            Ok(bytes) => Trace::parse(path, &bytes),
            Err(source) => Err(TraceError::Read { path: path.into(), source }),
        }
    }

    /// Reads a recording from memory; `path` is for errors.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Trace, TraceError> {
        let fail = |line, (what, remedy)| TraceError::Line { path: path.into(), line, what, remedy };
        let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        let mut format = None;
        let mut notes = Notes::default();
        let mut rows = Vec::new();
        for (index, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
            let number = index + 1;
            if line.trim_ascii_start().starts_with(b"#") {
                notes.read(&String::from_utf8_lossy(line));
                continue;
            }
            let text = std::str::from_utf8(line)
                .map_err(|_| fail(number, ("not text".into(), "give a text file, not a binary or compressed one")))?;
            let fields: Vec<&str> = text.split_whitespace().collect();
            if fields.is_empty() {
                continue;
            }
            rows.push(row(number, &fields, &mut format).map_err(|problem| fail(number, problem))?);
        }
        let Some(format) = format else { return Err(TraceError::Empty(path.into())) };
        let scale = notes.metres_a_unit.unwrap_or(format.metres_a_unit());
        let frame_hz = notes.frame_hz.unwrap_or(format.frame_hz());
        let (people, duplicates) = tracks(rows, scale, frame_hz).map_err(|(line, problem)| fail(line, problem))?;
        Ok(Trace::new(people, format, duplicates))
    }
}

/// What is wrong, and the remedy.
type Problem = (String, &'static str);

/// What comments may say.
#[derive(Default)]
struct Notes {
    frame_hz: Option<f64>,
    metres_a_unit: Option<f64>,
}

impl Notes {
    fn read(&mut self, comment: &str) {
        let comment = comment.to_lowercase();
        if let Some((_, rest)) = comment.split_once("framerate:") {
            let value = rest.split_whitespace().next().and_then(|value| value.parse::<f64>().ok());
            self.frame_hz = value.filter(|hz| (0.1..=1_000.0).contains(hz)).or(self.frame_hz);
        }
        for word in comment.split_whitespace() {
            match word {
                "x/m" | "x[m]" => self.metres_a_unit = Some(1.0),
                "x/cm" | "x[cm]" => self.metres_a_unit = Some(0.01),
                _ => {}
            }
        }
    }
}

fn row(line: usize, fields: &[&str], format: &mut Option<Format>) -> Result<Row, Problem> {
    let format = match *format {
        Some(format) if format.columns() == fields.len() => format,
        Some(format) => {
            let what =
                format!("{} columns where the file has {} ({})", fields.len(), format.columns(), format.layout());
            return Err((what, "complete the line, delete it, or put a # before it"));
        }
        None => {
            let known = [Format::Obsmat, Format::Juelich].into_iter().find(|format| format.columns() == fields.len());
            *format.insert(known.ok_or_else(|| {
                let what = format!("{} columns, beginning with {}", fields.len(), shown(fields[0]));
                (what, "give 8 (frame id x z y vx vz vy) or 5 (id frame x y z), and put a # before a heading")
            })?)
        }
    };
    let mut values = [0.0_f64; 8];
    for (value, text) in values.iter_mut().zip(fields) {
        *value = text.parse().map_err(|_| {
            (format!("{} is not a number", shown(text)), "correct it, delete the line, or put a # before it")
        })?;
        if !value.is_finite() {
            return Err((
                format!("{} is not finite", shown(text)),
                "correct it, delete the line, or put a # before it",
            ));
        }
    }
    let (id, frame, x, y) = match format {
        Format::Obsmat => (fields[1], values[0], values[2], values[4]),
        Format::Juelich => (fields[0], values[1], values[2], values[3]),
    };
    if frame.abs() > FRAME_MAX {
        return Err((format!("frame {frame} is absurd"), "give frame numbers of at most 1000000000"));
    }
    Ok(Row { line, id: whole(id)?, frame, position: DVec2::new(x, y) })
}

/// An id: a whole number of up to 64 bits, or in scientific notation one that an f64 holds exactly.
fn whole(text: &str) -> Result<u64, Problem> {
    if let Ok(id) = text.parse() {
        return Ok(id);
    }
    match text.parse::<f64>() {
        Ok(id) if id.fract() == 0.0 && (0.0..=WHOLE_MAX).contains(&id) => Ok(id as u64),
        _ => Err((format!("{} is no person's id", shown(text)), "give a whole number, 0 or more, that fits 64 bits")),
    }
}

/// People in no order, and the number of duplicate rows.
fn tracks(rows: Vec<Row>, scale: f64, frame_hz: f64) -> Result<(Vec<Track>, usize), (usize, Problem)> {
    let first_frame = rows.iter().map(|row| row.frame).fold(f64::INFINITY, f64::min);
    let mut duplicates = 0;
    // By person, then time; times are 0 or more and finite, so their bits are in their order.
    let mut people: BTreeMap<u64, BTreeMap<u64, (usize, Sample)>> = BTreeMap::new();
    for Row { line, id, frame, position } in rows {
        let position = position * scale;
        if position.abs().max_element() > FAR {
            let what = format!("position ({} m, {} m) is absurd", position.x, position.y);
            return Err((line, (what, "correct it; a recording may reach 100 km from its origin")));
        }
        let time_s = (frame - first_frame) / frame_hz;
        match people.entry(id).or_default().entry(time_s.to_bits()) {
            Entry::Vacant(entry) => {
                entry.insert((line, Sample { time_s, position, facing: 0.0 }));
            }
            Entry::Occupied(_) => duplicates += 1,
        }
    }
    let mut tracks = Vec::with_capacity(people.len());
    for (id, samples) in people {
        let mut run: Vec<Sample> = Vec::with_capacity(samples.len());
        for (line, sample) in samples.into_values() {
            if let Some(last) = run.last() {
                let elapsed_s = sample.time_s - last.time_s;
                if elapsed_s > GAP_MAX_S {
                    tracks.push(Track::new(id, std::mem::take(&mut run)));
                } else if last.position.distance(sample.position) > SPEED_MAX * elapsed_s {
                    let metres = last.position.distance(sample.position);
                    let what =
                        format!("person {id} moves {metres:.1} m in {elapsed_s:.3} s, faster than {SPEED_MAX} m/s");
                    return Err((line, (what, "correct or delete this line or the one a frame before it")));
                }
            }
            run.push(sample);
        }
        tracks.push(Track::new(id, run));
    }
    Ok((tracks, duplicates))
}

/// A value as an error shows it: in quotes, escaped and not too long.
fn shown(text: &str) -> String {
    const SHOWN_MAX: usize = 40;
    let more = if text.chars().count() > SHOWN_MAX { "…" } else { "" };
    format!("{:?}{more}", text.chars().take(SHOWN_MAX).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &[u8]) -> Result<Trace, String> {
        Trace::parse(Path::new("walk.txt"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn both_formats_are_told_by_their_columns() {
        let trace = parse(b" 1.0e+00 7.0e+00 1.5e0 9 -2.5 0 0 0\n 1.1e1 7 2.5 9 -2.5 0 0 0\n").unwrap();
        assert_eq!((trace.format, trace.people[0].id), (Format::Obsmat, 7));
        assert_eq!(trace.position_at(0, 0.0), Some((1.5, -2.5)));
        assert_eq!(trace.position_at(0, 0.4), Some((2.5, -2.5)));

        let trace = parse(b"7 218 150 -250 155\n7\t234\t250\t-250\t155").unwrap();
        assert_eq!(trace.format, Format::Juelich);
        assert_eq!(trace.position_at(0, 0.5), Some((2.0, -2.5)));
        assert_eq!(trace.span_s(), 1.0);
    }

    #[test]
    fn comments_blank_lines_and_windows_line_ends_are_fine() {
        let trace = parse(b"\xEF\xBB\xBF# id frame x y z\r\n\r\n1 0 0 0 170\r\n   \r\n  # m\xFCde\n1 16 100 0 170\r\n")
            .unwrap();
        assert_eq!(trace.position_at(0, 1.0), Some((1.0, 0.0)));
        // What Jülich's newer files say of themselves.
        let trace = parse(b"# framerate: 25.00 fps\n# id frame x/m y/m z/m\n1 0 0 0 1.7\n1 25 1 0 1.7\n").unwrap();
        assert_eq!(trace.position_at(0, 1.0), Some((1.0, 0.0)));
    }

    #[test]
    fn unsorted_double_and_huge_numbered_rows_are_sorted_out() {
        let trace = parse(
            b"18446744073709551615 16 100 0 0\n18446744073709551615 0 0 0 0\n2 8 5 5 0\n18446744073709551615 16 900 0 0\n",
        );
        let trace = trace.unwrap();
        assert_eq!((trace.people[0].id, trace.people.len(), trace.duplicates), (u64::MAX, 2, 1));
        assert_eq!(trace.position_at(0, 1.0), Some((1.0, 0.0)));
    }

    #[test]
    fn broken_lines_are_named_with_value_and_remedy() {
        for (text, parts) in [
            (&b"1 0 0 0 170\n1 1 0 0\n"[..], ["walk.txt:2:", "4 columns where the file has 5", "complete"]),
            (b"# c\n\n1 0 0 0 170\n1 1 x1 0 170\n", ["walk.txt:4:", "\"x1\" is not a number", "correct it"]),
            (b"id frame x y z\n", ["walk.txt:1:", "\"id\" is not a number", "# before it"]),
            (b"1 0 nan 0 170\n", ["walk.txt:1:", "\"nan\" is not finite", "correct it"]),
            (b"1 0 0 0 1e400\n", ["walk.txt:1:", "\"1e400\" is not finite", "correct it"]),
            (b"1 0 0 1e12 170\n", ["walk.txt:1:", "10000000000 m) is absurd", "100 km"]),
            (b"1 1e30 0 0 170\n", ["walk.txt:1:", "is absurd", "frame numbers"]),
            (b"1.5 0 0 0 170\n", ["walk.txt:1:", "\"1.5\" is no person's id", "whole number"]),
            (b"-1 0 0 0 170\n", ["walk.txt:1:", "\"-1\" is no person's id", "whole number"]),
            (b"1 0 0 0 170\n1 2 0 0 170\n1 1 90000 0 170\n", ["walk.txt:3:", "900.0 m", "correct or delete"]),
            (b"1,0,0,0,170\n", ["walk.txt:1:", "1 columns, beginning with \"1,0,0,0,170\"", "give 8"]),
            (b"1 0 0 0 170\n\xFF\xFE\n", ["walk.txt:2:", "not text", "give a text file"]),
            (b"", ["walk.txt", "has no row", "8 columns"]),
            (b"# only words\n", ["walk.txt", "has no row", "5 (id"]),
        ] {
            let error = parse(text).unwrap_err();
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        let long = parse(&[b'z'; 10_000]).unwrap_err();
        assert!(long.len() < 300, "{long}");
        let missing = Trace::read(Path::new("no/such.txt")).unwrap_err().to_string();
        assert!(missing.contains("no/such.txt"));
    }
}
