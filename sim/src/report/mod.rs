//! What does a run leave behind? One table of rows, with the machine, commit, seed and command that made it.
//!
//! Every verb fills a [`Report`] and writes it as `report.json`, `report.csv` and `report.html`. The JSON is complete:
//! the page is drawn from it alone, which is how [`Report::merged`] makes one page of many runs. The page needs no
//! network, no script and no font. Its first plot is error against run time, by [`Report::compare`].
//!
//! ```no_run
//! use eyeline_sim::report::{Column, Comparison, Report, Run, table};
//! # #[derive(serde::Serialize)] struct Measured { policy: &'static str, missed_px: f64, client_frame_ms: f64 }
//! # fn main() -> anyhow::Result<()> {
//! let mut report = Report::new(Run::here("Three policies", Some(7), "2026-11-22T03:42:39Z"), vec![
//!     Column::new("policy", "", "how the server chooses what a client is told"),
//!     Column::new("missed_px", "px", "pixels that belong to an object which the client did not draw"),
//!     Column::new("client_frame_ms", "ms", "a client's time per frame, mean"),
//! ]);
//! report.push(&Measured { policy: "visible", missed_px: 0.0, client_frame_ms: 0.4 })?;
//! report.compare(Comparison::new(&["policy"], "client_frame_ms", "missed_px"));
//! print!("{}", table(report.rows(), &report.columns));
//! report.write("out/demo".as_ref())?;
//! # Ok(())
//! # }
//! ```

mod html;
mod machine;
mod pareto;
mod plot;
mod progress;
mod row;
mod table;
mod write;

use base64::Engine as _;
use serde::{Deserialize, Serialize};

pub use machine::{Build, Machine, command_line, rfc3339, short_path, this_command};
pub use pareto::{Goal, Standing, pareto};
pub use plot::{Axis, Drawing, Plot, PlotKind, Point, Series, error_against_run_time};
pub use progress::Progress;
pub use row::{Row, RowError};
pub use table::{WIDTH, table};
pub use write::{ReadError, WriteError, Written};

/// The value of `schema` in `report.json`. It changes when a reader of the old one would misunderstand the new.
pub const SCHEMA: &str = "eyeline-report/1";

/// A table of results and where they come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Always [`SCHEMA`].
    schema: String,
    /// Title, command, seed, machine and so on, at the top level of the JSON.
    #[serde(flatten)]
    pub run: Run,
    /// What the reader should take away, in a sentence or two.
    #[serde(default)]
    pub headline: String,
    /// What the columns mean. A column of a row that is missing here is shown all the same.
    #[serde(default)]
    pub columns: Vec<Column>,
    /// Which columns are errors and which are run times. Each makes a plot and a Pareto table.
    #[serde(default)]
    pub comparisons: Vec<Comparison>,
    /// Plots beside those that `comparisons` make.
    #[serde(default)]
    pub plots: Vec<Plot>,
    /// Pictures after the plots.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<Picture>,
    rows: Vec<Row>,
    /// The runs that were merged into this report; empty if it is of one run.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<Run>,
}

/// One run of the program.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// What was asked.
    pub title: String,
    /// The command line, without absolute paths.
    pub command: String,
    /// What chance was drawn from, if it was.
    pub seed: Option<u64>,
    /// Where it ran.
    pub machine: Machine,
    /// What ran.
    pub build: Build,
    /// When, as RFC 3339; see [`rfc3339`].
    pub started: String,
    /// How long it took, all in all.
    #[serde(default)]
    pub wall_seconds: f64,
    /// What a reader must know to judge the numbers.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// What a column of the rows means.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Its name in the rows.
    pub key: String,
    /// Its unit: `ms`, `px`, `1/s`; empty for names and pure numbers.
    pub unit: String,
    /// Its meaning, in a phrase.
    pub meaning: String,
}

/// Two columns to hold against each other: what a row's answer cost, and how wrong it was. Both better when less.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Comparison {
    /// Columns whose values name a row.
    pub labels: Vec<String>,
    /// The column by which rows share a colour; without one, colour shows which rows no other row beats.
    pub series: Option<String>,
    /// The column of run times, in milliseconds.
    pub time: String,
    /// The column of errors.
    pub error: String,
}

/// A picture, whole within the report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Picture {
    /// What it shows, in a phrase.
    pub title: String,
    /// A PNG file in base64.
    png: String,
}

impl Picture {
    /// A picture from the bytes of a PNG file.
    pub fn new(title: impl Into<String>, png: &[u8]) -> Self {
        Self { title: title.into(), png: base64::engine::general_purpose::STANDARD.encode(png) }
    }
}

impl Run {
    /// A run of this process, started when the caller says; fill in `wall_seconds` and `notes` later.
    pub fn here(title: impl Into<String>, seed: Option<u64>, started: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            command: this_command(),
            seed,
            machine: Machine::here(),
            build: Build::here(),
            started: started.into(),
            ..Self::default()
        }
    }
}

impl Column {
    /// Says what a column means.
    pub fn new(key: impl Into<String>, unit: impl Into<String>, meaning: impl Into<String>) -> Self {
        Self { key: key.into(), unit: unit.into(), meaning: meaning.into() }
    }

    /// A column's name and unit: "frame_ms (ms)".
    fn title(columns: &[Self], key: &str) -> String {
        match columns.iter().find(|column| column.key == key) {
            Some(column) if !column.unit.is_empty() => format!("{key} ({})", column.unit),
            _ => key.to_owned(),
        }
    }
}

impl Comparison {
    /// Compares rows named by the values of `labels`.
    pub fn new(labels: &[&str], time: impl Into<String>, error: impl Into<String>) -> Self {
        let labels = labels.iter().map(|label| (*label).to_owned()).collect();
        Self { labels, series: None, time: time.into(), error: error.into() }
    }

    /// Rows with the same value in this column share a colour.
    pub fn by_series(mut self, key: impl Into<String>) -> Self {
        self.series = Some(key.into());
        self
    }

    /// Both columns, for [`pareto()`].
    fn goals(&self) -> [(&str, Goal); 2] {
        [(&self.time, Goal::Minimise), (&self.error, Goal::Minimise)]
    }

    /// What names a row.
    fn label_of(&self, row: &Row) -> String {
        let known = self.labels.iter().filter(|key| row.value(key).is_some_and(|value| !value.is_null()));
        known.map(|key| row.text(key)).collect::<Vec<_>>().join(" · ")
    }
}

impl Report {
    /// A report without rows.
    pub fn new(run: Run, columns: Vec<Column>) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            run,
            headline: String::new(),
            columns,
            comparisons: Vec::new(),
            plots: Vec::new(),
            pictures: Vec::new(),
            rows: Vec::new(),
            sources: Vec::new(),
        }
    }

    /// Adds a row: any struct or map whose values are flat.
    pub fn push<T: Serialize + ?Sized>(&mut self, row: &T) -> Result<(), RowError> {
        self.rows.push(Row::of(row)?);
        Ok(())
    }

    /// The rows so far.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Shows error against run time of all rows, in a plot and a Pareto table before everything else.
    pub fn compare(&mut self, comparison: Comparison) {
        self.comparisons.push(comparison);
    }

    /// The names of all columns that any row has, in the order of their first appearance.
    fn keys(&self) -> Vec<&str> {
        let mut keys: Vec<&str> = Vec::new();
        for row in &self.rows {
            keys.extend(row.iter().map(|(key, _)| key).filter(|key| !keys.contains(key)).collect::<Vec<_>>());
        }
        keys
    }

    /// The rows of several reports in one, each with the name of its run in a first column `run`.
    ///
    /// Comparisons of the same two columns become one over all runs. `run` describes the merging itself; its seed is
    /// that of all runs if they agree.
    pub fn merged(mut run: Run, parts: &[(String, Self)]) -> Self {
        let seeds: Vec<Option<u64>> = parts.iter().map(|(_, part)| part.run.seed).collect();
        run.seed = seeds.first().copied().flatten().filter(|seed| seeds.iter().all(|other| *other == Some(*seed)));
        let mut merged = Self::new(run, vec![Column::new("run", "", "the run that a row comes from")]);
        for (name, part) in parts {
            for column in &part.columns {
                if !merged.columns.iter().any(|known| known.key == column.key) {
                    merged.columns.push(column.clone());
                }
            }
            for comparison in &part.comparisons {
                let same = |known: &&mut Comparison| known.time == comparison.time && known.error == comparison.error;
                let labels = comparison.labels.iter().filter(|label| *label != "run");
                match merged.comparisons.iter_mut().find(same) {
                    Some(known) => {
                        let new: Vec<_> = labels.filter(|label| !known.labels.contains(label)).cloned().collect();
                        known.labels.extend(new);
                    }
                    None => {
                        let labels = std::iter::once("run".to_owned()).chain(labels.cloned()).collect();
                        merged.comparisons.push(Comparison {
                            labels,
                            series: Some("run".to_owned()),
                            ..comparison.clone()
                        });
                    }
                }
            }
            let named = |plot: &Plot| Plot { title: format!("{name}: {}", plot.title), ..plot.clone() };
            merged.plots.extend(part.plots.iter().map(named));
            let named = |picture: &Picture| Picture { title: format!("{name}: {}", picture.title), ..picture.clone() };
            merged.pictures.extend(part.pictures.iter().map(named));
            merged.rows.extend(part.rows.iter().map(|row| row.clone().with_first("run", name.as_str())));
            // A merged report may be merged again; its sources stay the runs that measured.
            let own = if part.sources.is_empty() { std::slice::from_ref(&part.run) } else { &part.sources };
            let called = |run: &Run| Run { title: format!("{name}: {}", run.title), ..run.clone() };
            merged.sources.extend(own.iter().map(called));
        }
        merged
    }
}

#[cfg(test)]
mod tests;
