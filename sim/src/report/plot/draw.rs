//! How does a plot become SVG? One quiet style: thin grid, no frame, marks told apart by colour and by shape.
//!
//! plotters counts in whole pixels, so everything is drawn at twice its size and scaled down by the view box.
//! Its literal colours become `currentColor` and CSS variables afterwards, so that a page decides light or dark.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::labels::{self, Area};
use super::scale::{Dropped, Scale};
use super::{Drawing, Plot, PlotKind};
use crate::report::row::{number_text, printable};
use crate::report::table::cut;

/// Okabe and Ito's palette ("Color Universal Design", 2008) without black and with grey and a darker yellow, which
/// stands on white as well as on black.
const PALETTE: [RGBColor; 8] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x80, 0x80, 0x80),
    RGBColor(0xa8, 0x98, 0x00),
];

/// Stands for the page's text colour until the SVG is done.
const INK: RGBColor = RGBColor(0x11, 0x11, 0x12);

/// Everything below is in halves of a CSS pixel.
const WIDTH: u32 = 1520;
const HEIGHT: u32 = 840;
const MARGIN: i32 = 24;
const TEXT: i32 = 25;
const LINE: i32 = 42;
const MARK: i32 = 10;

/// More labels than this cannot be read.
const LABELS_MAX: usize = 60;
/// More bars than this make a page of their own; the table has them all.
const NAMES_MAX: usize = 100;

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

pub(super) fn draw(plot: &Plot) -> Drawing {
    let mut remarks = Remarks::default();
    let mut svg = String::new();
    if let Err(error) = draw_into(&mut svg, plot, &mut remarks) {
        remarks.texts.push(format!("The plot could not be drawn: {error}."));
    }
    let mut sentences = Vec::new();
    if !plot.note.is_empty() {
        sentences.push(plot.note.clone());
    }
    sentences.extend(remarks.into_sentences());
    Drawing { svg: themed(&svg, &plot.title), note: sentences.join(" ") }
}

/// What happened to the data on its way into the picture.
#[derive(Default)]
struct Remarks {
    not_finite: usize,
    negative: usize,
    labels_left_out: usize,
    names_left_out: usize,
    feet: Vec<String>,
    texts: Vec<String>,
}

impl Remarks {
    fn count(&mut self, dropped: Dropped) {
        match dropped {
            Dropped::NotFinite => self.not_finite += 1,
            Dropped::Negative => self.negative += 1,
        }
    }

    fn into_sentences(self) -> Vec<String> {
        let mut texts = self.feet;
        let mut counted = |count: usize, one: &str, many: &str| {
            if count > 0 {
                texts.push(format!("{count} {}.", if count == 1 { one } else { many }));
            }
        };
        counted(
            self.not_finite,
            "point is missing a finite number and is not drawn",
            "points are missing a finite number and are not drawn",
        );
        counted(
            self.negative,
            "point is negative, which a log axis cannot show",
            "points are negative, which a log axis cannot show",
        );
        counted(self.labels_left_out, "label found no room", "labels found no room");
        counted(self.names_left_out, "further bar is only in the table", "further bars are only in the table");
        texts.extend(self.texts);
        texts
    }
}

fn draw_into(svg: &mut String, plot: &Plot, remarks: &mut Remarks) -> Drawn {
    match plot.kind {
        PlotKind::Scatter | PlotKind::Line => draw_points(svg, plot, remarks),
        PlotKind::Bars | PlotKind::StackedBars => draw_bars(svg, plot, remarks),
    }
}

fn draw_points(svg: &mut String, plot: &Plot, remarks: &mut Remarks) -> Drawn {
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

    let quiet = plot.kind == PlotKind::Line && marks.len() > 40 * plot.series.len();
    if !quiet {
        for &(at, index, hollow) in &marks {
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
    let sizes: Vec<_> = wanted.iter().map(|(at, text)| (*at, (width_of(text), TEXT * 5 / 4))).collect();
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

fn draw_bars(svg: &mut String, plot: &Plot, remarks: &mut Remarks) -> Drawn {
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
    let lying = Plot { x: plot.y.clone(), y: super::Axis::linear(""), ..plot.clone() };
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

fn note_foot(remarks: &mut Remarks, scale: &Scale, axis: &str) {
    if let Some(power) = scale.foot_text() {
        let text = format!("Hollow marks at the foot of the {axis} axis, below {power}, are exactly 0.");
        remarks.feet.push(text);
    }
}

type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Scale, Scale>>;

/// Draws grid, ticks, the axes' names and the legend.
fn frame<'a>(
    root: &Canvas<'a>,
    plot: &Plot,
    xs: &Scale,
    ys: &Scale,
    legend: &Legend,
) -> Result<Chart<'a>, Box<dyn std::error::Error>> {
    let lying = matches!(plot.kind, PlotKind::Bars | PlotKind::StackedBars);
    let tick_width = ys.ticks().iter().map(|(_, text)| width_of(text)).max().unwrap_or(0);
    let above = if plot.y.label.is_empty() { MARGIN } else { MARGIN + LINE };
    let mut chart = ChartBuilder::on(root)
        .margin_top(above + legend.height)
        .margin_right(MARGIN + 16)
        .margin_bottom(MARGIN / 2 + LINE)
        .margin_left(MARGIN / 2)
        .set_label_area_size(LabelAreaPosition::Left, tick_width + 30)
        .set_label_area_size(LabelAreaPosition::Bottom, LINE)
        .build_cartesian_2d(xs.clone(), ys.clone())?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(INK.mix(0.13).stroke_width(1))
        .axis_style(INK.mix(0.0))
        .set_all_tick_mark_size(0)
        .label_style(ink(0.72, HPos::Left));
    if lying {
        mesh.disable_y_mesh();
    }
    mesh.draw()?;

    let (left, _) = chart.plotting_area().get_base_pixel();
    let (width, height) = root.dim_in_pixel();
    if !plot.y.label.is_empty() {
        let at = (MARGIN, legend.height + MARGIN + TEXT / 2);
        root.draw_text(&cut(&printable(&plot.y.label), 90), &ink(0.9, HPos::Left), at)?;
    }
    let middle = (left + width as i32 - MARGIN) / 2;
    let at = (middle, height as i32 - MARGIN / 2 - TEXT / 2);
    root.draw_text(&cut(&printable(&plot.x.label), 90), &ink(0.9, HPos::Center), at)?;
    legend.draw(root, lying)?;
    Ok(chart)
}

/// Names of series in rows above the plot; none for a single series.
struct Legend {
    entries: Vec<(i32, i32, String)>,
    height: i32,
}

impl Legend {
    fn lay_out(names: &[&str]) -> Self {
        let mut entries = Vec::new();
        if names.len() < 2 {
            return Self { entries, height: 0 };
        }
        let (mut x, mut y) = (MARGIN, MARGIN / 2);
        for name in names {
            let text = cut(&printable(name), 48);
            let width = 36 + width_of(&text) + 32;
            if x + width > WIDTH as i32 && x > MARGIN {
                (x, y) = (MARGIN, y + LINE);
            }
            entries.push((x, y, text));
            x += width;
        }
        Self { entries, height: y + LINE }
    }

    fn draw(&self, root: &Canvas<'_>, square: bool) -> Drawn {
        for (index, (x, y, text)) in self.entries.iter().enumerate() {
            let at = (x + MARK, y + LINE / 2);
            if square {
                root.draw(&Rectangle::new(around(at, MARK), colour(index).filled()))?;
            } else {
                draw_mark(root, at, index, false)?;
            }
            root.draw_text(text, &ink(0.9, HPos::Left), (x + 36, y + LINE / 2))?;
        }
        Ok(())
    }
}

fn draw_mark(root: &Canvas<'_>, (x, y): (i32, i32), series: usize, hollow: bool) -> Drawn {
    let colour = colour(series);
    let style = if hollow { colour.stroke_width(4) } else { colour.mix(0.9).filled() };
    // A further shape with each turn of the palette, so that no two of the first 32 series are alike.
    let corners = match (series + series / PALETTE.len()) % 4 {
        0 => {
            root.draw(&Circle::new((x, y), MARK, style))?;
            return Ok(());
        }
        1 => vec![(x - 9, y - 9), (x + 9, y - 9), (x + 9, y + 9), (x - 9, y + 9), (x - 9, y - 9)],
        2 => vec![(x, y - 12), (x + 11, y + 8), (x - 11, y + 8), (x, y - 12)],
        _ => vec![(x, y - 13), (x + 13, y), (x, y + 13), (x - 13, y), (x, y - 13)],
    };
    if hollow {
        root.draw(&PathElement::new(corners, style))?;
    } else {
        root.draw(&Polygon::new(corners, style))?;
    }
    Ok(())
}

fn around((x, y): (i32, i32), reach: i32) -> [(i32, i32); 2] {
    [(x - reach, y - reach), (x + reach, y + reach)]
}

fn colour(series: usize) -> RGBColor {
    PALETTE[series % PALETTE.len()]
}

fn ink(strength: f64, anchor: HPos) -> TextStyle<'static> {
    // plotters-svg writes a font size divided by 1.24.
    let font = ("sans-serif", f64::from(TEXT) * 1.24).into_font();
    let color = INK.mix(strength).to_backend_color();
    TextStyle { font, color, pos: Pos::new(anchor, VPos::Center) }
}

/// A guess, since the reader's fonts are unknown: rather too wide.
fn width_of(text: &str) -> i32 {
    let ems = |c: char| match c {
        'i' | 'j' | 'l' | 'f' | 't' | '.' | ',' | '\'' | ':' | '|' | ' ' => 0.34,
        'm' | 'w' | 'M' | 'W' | '%' | '@' => 0.92,
        c if c.is_ascii_uppercase() => 0.7,
        c if (c as u32) < 0x2e80 => 0.58,
        _ => 1.0,
    };
    (text.chars().map(ems).sum::<f64>() * f64::from(TEXT)).ceil() as i32
}

/// Scales by the view box, lets CSS choose the colours, and names the picture for those who cannot see it.
///
/// Only attributes change: in text, plotters-svg writes a quotation mark as `&quot;`.
fn themed(svg: &str, title: &str) -> String {
    let hex = |c: RGBColor| format!("\"#{:02X}{:02X}{:02X}\"", c.0, c.1, c.2);
    let mut text = svg.replace(&hex(INK), "\"currentColor\"");
    for (i, colour) in PALETTE.into_iter().enumerate() {
        let literal = hex(colour);
        text = text.replace(&literal, &format!("\"var(--s{i},{})\"", literal.trim_matches('"')));
    }
    let Some((head, body)) = text.split_once(">\n") else { return text };
    let view_box = head.split("viewBox=").nth(1).and_then(|rest| rest.split('"').nth(1)).unwrap_or("0 0 1520 840");
    let title = super::super::html::escape(title);
    format!("<svg viewBox=\"{view_box}\" role=\"img\" class=\"plot\"><title>{title}</title>\n{body}")
}

#[cfg(test)]
mod tests {
    use super::super::{Axis, Point, Series};
    use super::*;

    fn scatter(points: Vec<Point>) -> Plot {
        Plot::new("t", PlotKind::Scatter, Axis::log("ms"), Axis::log("px")).with_series(Series::new("a", points))
    }

    fn count(drawing: &Drawing, tag: &str) -> usize {
        drawing.svg.matches(&format!("<{tag} ")).count()
    }

    #[test]
    fn each_row_is_one_labelled_mark() {
        let drawing = scatter(vec![
            Point::labelled(1.0, 2.0, "visible"),
            Point::labelled(3.0, 0.5, "broadcast"),
            Point::labelled(10.0, 40.0, "oracle"),
        ])
        .draw();
        assert_eq!(count(&drawing, "circle"), 3);
        assert!(["visible", "broadcast", "oracle"].iter().all(|name| drawing.svg.contains(name)));
        assert_eq!(drawing.note, "");
        assert!(drawing.svg.trim_end().ends_with("</svg>"));
    }

    #[test]
    fn a_zero_on_a_log_axis_is_hollow_and_said() {
        let drawing = scatter(vec![Point::new(1.0, 0.0), Point::new(2.0, 30.0)]).draw();
        assert_eq!(drawing.svg.matches("fill=\"none\" stroke=\"var(--s0").count(), 1);
        assert!(drawing.svg.contains("\n0\n"), "the foot has its own tick");
        assert_eq!(drawing.note, "Hollow marks at the foot of the y axis, below 10, are exactly 0.");
    }

    #[test]
    fn what_cannot_be_drawn_is_counted() {
        let points = vec![
            Point::new(f64::NAN, 1.0),
            Point::new(1.0, f64::INFINITY),
            Point::new(1.0, -1.0),
            Point::new(1.0, 1.0),
        ];
        let drawing = scatter(points).with_note("Sample.").draw();
        assert_eq!(count(&drawing, "circle"), 1);
        assert_eq!(
            drawing.note,
            "Sample. 2 points are missing a finite number and are not drawn. \
             1 point is negative, which a log axis cannot show."
        );
    }

    #[test]
    fn a_line_breaks_where_a_point_is_missing() {
        let y = [1.0, 2.0, f64::NAN, 3.0, 4.0, 5.0];
        let points = y.iter().enumerate().map(|(x, y)| Point::new(x as f64, *y)).collect();
        let plot = Plot::new("t", PlotKind::Line, Axis::linear("s"), Axis::linear("m"));
        let drawing = plot.with_series(Series::new("a", points)).draw();
        assert_eq!(drawing.svg.matches("stroke=\"var(--s0").count(), 2);
    }

    #[test]
    fn bars_have_one_rectangle_each_and_say_their_length() {
        let series = |name: &str, a: f64, b: f64| Series::new(name, vec![Point::bar("one", a), Point::bar("two", b)]);
        for (kind, totals) in [(PlotKind::Bars, ["1.5", "3", "2", "4"]), (PlotKind::StackedBars, ["3.5", "7", "", ""])]
        {
            let drawing = Plot::new("t", kind, Axis::linear(""), Axis::linear("ms"))
                .with_series(series("draw", 1.5, 3.0))
                .with_series(series("test", 2.0, 4.0))
                .draw();
            assert_eq!(count(&drawing, "rect"), 4 + 2, "bars and legend");
            assert!(totals.iter().all(|total| drawing.svg.contains(&format!("\n{total}\n")) || total.is_empty()));
        }
    }

    #[test]
    fn nothing_at_all_still_gives_a_frame() {
        for kind in [PlotKind::Scatter, PlotKind::Line, PlotKind::Bars, PlotKind::StackedBars] {
            for log in [false, true] {
                let axis = Axis { label: String::new(), log };
                let empty = Plot::new("", kind, axis.clone(), axis.clone());
                for points in [
                    vec![],
                    vec![Point::new(f64::NAN, f64::NAN)],
                    vec![Point::new(0.0, 0.0)],
                    vec![Point::new(f64::MIN, f64::MAX), Point::new(f64::MAX, f64::MIN)],
                ] {
                    let drawing = empty.clone().with_series(Series::new("", points)).draw();
                    assert!(drawing.svg.starts_with("<svg viewBox=") && !drawing.svg.contains("NaN"));
                    assert!(!drawing.note.contains("could not"), "{}", drawing.note);
                }
                assert!(empty.draw().svg.ends_with("</svg>\n"));
            }
        }
    }

    #[test]
    fn hostile_names_stay_text() {
        let evil = "</svg><script>alert(1)</script>\" fill=\"#0072B2\u{1b}";
        let mut plot = scatter(vec![Point::labelled(1.0, 1.0, evil)]);
        plot.title = evil.to_owned();
        plot.series.push(Series::new(evil, vec![]));
        plot.x.label = evil.to_owned();
        let drawing = plot.draw();
        assert!(!drawing.svg.contains("<script") && !drawing.svg.contains('\u{1b}'));
        assert_eq!(drawing.svg.matches("</svg>").count(), 1);
    }

    #[test]
    fn many_series_get_a_legend_that_makes_the_picture_taller() {
        let mut plot = scatter(vec![Point::new(1.0, 1.0)]);
        for i in 0..20 {
            plot.series.push(Series::new(format!("a series with a rather long name {i}"), vec![Point::new(2.0, 3.0)]));
        }
        let drawing = plot.draw();
        assert!(drawing.svg.contains("a rather long name 19"));
        assert!(!drawing.svg.contains("viewBox=\"0 0 1520 840\""));
    }
}
