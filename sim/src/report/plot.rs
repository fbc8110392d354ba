//! What does a plot show? Named series of points and two axes, as data that `report.json` keeps.
//!
//! A caller says what to show, never how: colours, ticks, marks and the place of labels are decided in one place,
//! so that the plots of all verbs look and read alike.

mod bars;
mod draw;
mod labels;
mod points;
mod scale;
mod style;

use serde::{Deserialize, Deserializer, Serialize};

use super::{Column, Comparison, Row, Standing, pareto};

/// A plot, as data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plot {
    /// What the plot shows, as a line above it.
    pub title: String,
    /// The horizontal axis. Bars take their names from their labels, and `x` only names those.
    pub x: Axis,
    /// The vertical axis; for bars, which lie, the axis of values.
    pub y: Axis,
    /// How points are drawn.
    pub kind: PlotKind,
    /// What is drawn, in the order of the legend.
    pub series: Vec<Series>,
    /// What a reader should know, below the plot; may be empty.
    pub note: String,
}

/// An axis.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Axis {
    /// Quantity and unit: "client time per frame (ms)".
    pub label: String,
    /// Whether powers of ten are equally far apart.
    pub log: bool,
}

/// How points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlotKind {
    /// A mark per point, labelled where the point has a label.
    Scatter,
    /// Marks joined in the order given.
    Line,
    /// Lying bars, one per label, side by side where there are several series.
    Bars,
    /// Lying bars, one per label, in which the series follow each other.
    StackedBars,
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// The legend's entry.
    pub name: String,
    /// The points.
    pub points: Vec<Point>,
}

/// A point, or a bar of length `y`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Along the horizontal axis; bars ignore it.
    #[serde(deserialize_with = "number_or_null")]
    pub x: f64,
    /// Along the axis of values.
    #[serde(deserialize_with = "number_or_null")]
    pub y: f64,
    /// Written beside the point, or the bar's name; may be empty.
    pub label: String,
}

/// JSON has no NaN and writes null.
fn number_or_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// A plot as a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    /// An `<svg>` element to put into a page. Its colours follow the page's: see `report.css`.
    pub svg: String,
    /// The plot's note and what drawing added: points dropped, zeros at the foot of a log axis.
    pub note: String,
}

impl Axis {
    /// An axis with equal steps.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: false }
    }

    /// An axis with equal ratios. Zeros are drawn at its foot and marked, negative numbers not at all.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), log: true }
    }
}

impl Series {
    /// Points under a name.
    pub fn new(name: impl Into<String>, points: Vec<Point>) -> Self {
        Self { name: name.into(), points }
    }
}

impl Point {
    /// A point without a label.
    pub fn new(x: f64, y: f64) -> Self {
        Self { x, y, label: String::new() }
    }

    /// A point with its label beside it.
    pub fn labelled(x: f64, y: f64, label: impl Into<String>) -> Self {
        Self { x, y, label: label.into() }
    }

    /// A bar of the given name and length.
    pub fn bar(name: impl Into<String>, length: f64) -> Self {
        Self { x: 0.0, y: length, label: name.into() }
    }
}

impl Plot {
    /// A plot without points or note.
    pub fn new(title: impl Into<String>, kind: PlotKind, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, kind, series: Vec::new(), note: String::new() }
    }

    /// The plot with a further series.
    pub fn with_series(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// The plot with a note.
    pub fn with_note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }

    /// Draws the plot. Anything can be drawn, if need be as an empty frame.
    pub fn draw(&self) -> Drawing {
        draw::draw(self)
    }
}

/// The first plot of every verb: one labelled point per row, run time across and error up, both as powers of ten,
/// with rows that made no error at the foot.
///
/// Colour tells apart what the comparison's `series` says, or else which rows no other row beats. Rows that lack a
/// number are counted in the note. `columns` give the axes their units.
pub fn error_against_run_time(rows: &[Row], columns: &[Column], comparison: &Comparison) -> Plot {
    let standing = pareto(rows, &comparison.goals());
    let mut series: Vec<Series> = Vec::new();
    for (row, standing) in rows.iter().zip(standing) {
        let name = match (&comparison.series, standing) {
            (Some(key), _) => row.text(key),
            (None, Standing::DominatedBy(_)) => "dominated".to_owned(),
            (None, _) => "not dominated".to_owned(),
        };
        let point = Point::labelled(
            row.number(&comparison.time).unwrap_or(f64::NAN),
            row.number(&comparison.error).unwrap_or(f64::NAN),
            comparison.label_of(row),
        );
        match series.iter_mut().find(|known| known.name == name) {
            Some(known) => known.points.push(point),
            None => series.push(Series::new(name, vec![point])),
        }
    }
    series.sort_by_key(|series| comparison.series.is_none() && series.name != "not dominated");
    let title = format!("Error against run time: {} over {}", comparison.error, comparison.time);
    let axis = |key: &str| Axis::log(Column::title(columns, key));
    Plot { series, ..Plot::new(title, PlotKind::Scatter, axis(&comparison.time), axis(&comparison.error)) }
}
