//! How are bars drawn? Lying, so that long names have room, each with its number at the end.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::draw::{Legend, Remarks, frame, note_foot};
use super::scale::{Dropped, Scale};
use super::style::{Drawn, LINE, MARGIN, MARK, WIDTH, colour, draw_mark, ink};
use super::{Axis, Plot, PlotKind};
use crate::report::row::{number_text, printable};
use crate::report::table::cut;

/// More bars than this make a page of their own; the table has them all.
const NAMES_MAX: usize = 100;

pub(super) fn draw(svg: &mut String, plot: &Plot, remarks: &mut Remarks) -> Drawn {
    let stacked = plot.kind == PlotKind::StackedBars;
    let log = plot.y.log && !stacked;
    if plot.y.log && stacked {
        remarks.texts.push("Stacked bars add up only on a linear axis, so this one is.".to_owned());
    }
    let mut names: Vec<String> = Vec::new();
    for point in plot.series.iter().flat_map(|series| &series.points) {
        if !names.contains(&point.label) {
            names.push(point.label.clone());
        }
    }
    remarks.names_left_out = names.len().saturating_sub(NAMES_MAX);
    names.truncate(NAMES_MAX);

    let bars = lay_out_bars(plot, &names, stacked, log, remarks);
    let values = Scale::new(log, bars.iter().flat_map(|bar| [bar.from, bar.to]), !log).with_room_above(0.08);
    note_foot(remarks, &values, "value");
    let short: Vec<String> = names.iter().map(|name| cut(&printable(name), 30)).collect();
    let legend = Legend::lay_out(&plot.series.iter().map(|series| series.name.as_str()).collect::<Vec<_>>());
    let lanes = if stacked { 1 } else { plot.series.len().max(1) };
    let thickness = if names.len() * lanes > 24 { 22 } else { 34 };
    let pane_height = (names.len().max(1) * (lanes * thickness + 26)) as i32;
    let height = pane_height + 2 * MARGIN + LINE + LINE + LINE + legend.height;

    let root = SVGBackend::with_string(svg, (WIDTH, height as u32)).into_drawing_area();
    let lying = Plot { x: plot.y.clone(), y: Axis::linear(""), ..plot.clone() };
    let scale_of_names = Scale::names(&short);
    let chart = frame(&root, &lying, &values, &scale_of_names, &legend)?;
    let pane = chart.plotting_area();
    for bar in &bars {
        let place = |v: f64| values.place(v).map(|(at, _)| at).unwrap_or(values.base());
        let zero = values.place(bar.to).is_ok_and(|(_, zero)| zero);
        let from = if log { values.base() } else { place(bar.from) };
        let row = -(bar.name as f64);
        let (x0, y) = pane.map_coordinate(&(from, row));
        let (x1, _) = pane.map_coordinate(&(place(bar.to), row));
        let top = y - (lanes * thickness) as i32 / 2 + (bar.lane * thickness) as i32;
        let corners = [(x0.min(x1), top + 2), (x0.max(x1), top + thickness as i32 - 2)];
        root.draw(&Rectangle::new(corners, colour(bar.series).filled()))?;
        if zero && log {
            draw_mark(&root, (x1, top + thickness as i32 / 2), bar.series, true)?;
        }
        if let Some(text) = &bar.text {
            let (anchor, x) = if bar.to < 0.0 { (HPos::Right, x0.min(x1) - 10) } else { (HPos::Left, x0.max(x1) + 10) };
            let x = if zero && log { x + MARK } else { x };
            root.draw_text(text, &ink(0.9, anchor), (x, top + thickness as i32 / 2))?;
        }
    }
    Ok(())
}

/// A bar, or a part of a stacked one.
struct Bar {
    name: usize,
    lane: usize,
    series: usize,
    from: f64,
    to: f64,
    /// What stands at its end.
    text: Option<String>,
}

fn lay_out_bars(plot: &Plot, names: &[String], stacked: bool, log: bool, remarks: &mut Remarks) -> Vec<Bar> {
    let mut bars: Vec<Bar> = Vec::new();
    let mut ends = vec![0.0; names.len()];
    for (series, data) in plot.series.iter().enumerate() {
        for point in &data.points {
            let Some(name) = names.iter().position(|name| *name == point.label) else { continue };
            if !point.y.is_finite() {
                remarks.count(Dropped::NotFinite);
            } else if point.y < 0.0 && log {
                remarks.count(Dropped::Negative);
            } else if point.y < 0.0 && stacked {
                remarks.texts.push(format!("{} of {} is negative and cannot be stacked.", data.name, point.label));
            } else if stacked {
                let from = ends[name];
                ends[name] += point.y;
                // Only the last part says how long the whole is.
                bars.iter_mut().filter(|bar| bar.name == name).for_each(|bar| bar.text = None);
                bars.push(Bar { name, lane: 0, series, from, to: ends[name], text: Some(number_text(ends[name])) });
            } else {
                // On a log axis a bar starts at the axis's end, not at zero.
                let from = if log { point.y } else { 0.0 };
                bars.push(Bar { name, lane: series, series, from, to: point.y, text: Some(number_text(point.y)) });
            }
        }
    }
    bars
}
