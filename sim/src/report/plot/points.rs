//! How are points drawn? Marks where they belong, lines that break where a point is missing, labels where there is
//! room.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::draw::{Legend, Remarks, frame, note_foot};
use super::labels::{self, Area, Wanted};
use super::scale::Scale;
use super::style::{Canvas, Drawn, HEIGHT, INK, MARGIN, MARK, TEXT, WIDTH, colour, draw_mark, ink, width_of};
use super::{Plot, PlotKind};
use crate::report::row::printable;
use crate::report::table::cut;

/// More labels than this cannot be read.
const LABELS_MAX: usize = 60;

/// More marks per line than this hide the line.
const MARKS_MAX: usize = 40;

pub(super) fn draw(svg: &mut String, plot: &Plot, remarks: &mut Remarks) -> Drawn {
    let points = || plot.series.iter().flat_map(|series| &series.points);
    // A point takes part in the axes only if both of its numbers can be shown.
    let showable = |log: bool, v: f64| v.is_finite() && !(log && v < 0.0);
    let shown = || points().filter(|p| showable(plot.x.log, p.x) && showable(plot.y.log, p.y));
    let xs = Scale::new(plot.x.log, shown().map(|p| p.x), false).with_margin(0.02);
    let ys = Scale::new(plot.y.log, shown().map(|p| p.y), false).with_margin(0.03);
    note_foot(remarks, &xs, "x");
    note_foot(remarks, &ys, "y");

    let names: Vec<&str> = plot.series.iter().map(|series| series.name.as_str()).collect();
    let legend = Legend::lay_out(&names);
    let root = SVGBackend::with_string(svg, (WIDTH, HEIGHT + legend.height as u32)).into_drawing_area();
    let chart = frame(&root, plot, &xs, &ys, &legend)?;
    let pane = chart.plotting_area();

    let mut marks = Vec::new();
    let mut wanted = Vec::new();
    for (index, series) in plot.series.iter().enumerate() {
        let mut run: Vec<(i32, i32)> = Vec::new();
        let mut runs = Vec::new();
        for point in &series.points {
            match (xs.place(point.x), ys.place(point.y)) {
                (Ok((x, x_zero)), Ok((y, y_zero))) => {
                    let at = pane.map_coordinate(&(x, y));
                    run.push(at);
                    marks.push((at, index, x_zero || y_zero));
                    if !point.label.is_empty() {
                        wanted.push((at, cut(&printable(&point.label), 40)));
                    }
                }
                (Err(dropped), _) | (_, Err(dropped)) => {
                    remarks.count(dropped);
                    runs.push(std::mem::take(&mut run));
                }
            }
        }
        runs.push(run);
        if plot.kind == PlotKind::Line {
            for run in runs.into_iter().filter(|run| run.len() > 1) {
                root.draw(&PathElement::new(run, colour(index).stroke_width(4)))?;
            }
        }
    }

    let quiet = plot.kind == PlotKind::Line && marks.len() > MARKS_MAX * plot.series.len();
    for &(at, index, hollow) in &marks {
        if hollow || !quiet {
            draw_mark(&root, at, index, hollow)?;
        }
    }
    remarks.labels_left_out += wanted.len().saturating_sub(LABELS_MAX);
    wanted.truncate(LABELS_MAX);
    let (width, height) = pane.dim_in_pixel();
    let (left, top) = pane.get_base_pixel();
    let inside = Area { left, top, right: left + width as i32 + MARGIN / 2, bottom: top + height as i32 };
    draw_labels(&root, &wanted, &marks, inside, remarks)
}

fn draw_labels(
    root: &Canvas<'_>,
    wanted: &[((i32, i32), String)],
    marks: &[((i32, i32), usize, bool)],
    inside: Area,
    remarks: &mut Remarks,
) -> Drawn {
    let sizes: Vec<_> =
        wanted.iter().map(|(at, text)| Wanted { at: *at, size: (width_of(text), TEXT * 5 / 4) }).collect();
    let taken: Vec<Area> = marks.iter().map(|((x, y), ..)| Area::around(*x, *y, MARK)).collect();
    for (((x, y), text), spot) in wanted.iter().zip(labels::place(&sizes, &taken, inside, MARK + 6)) {
        let Some(spot) = spot else {
            remarks.labels_left_out += 1;
            continue;
        };
        let Area { left, top, right, bottom } = spot.area;
        if spot.leader {
            let end = ((*x).clamp(left, right), (*y).clamp(top, bottom));
            root.draw(&PathElement::new(vec![(*x, *y), end], INK.mix(0.35).stroke_width(1)))?;
        }
        // Text hugs the side towards its point, since its true width is only guessed.
        let (anchor, from) = if right <= *x { (HPos::Right, right) } else { (HPos::Left, left) };
        root.draw_text(text, &ink(0.9, anchor), (from, (top + bottom) / 2))?;
    }
    Ok(())
}
