//! How does a plot become SVG? Points or bars within a frame that all kinds share: grid, ticks, names and legend.
//!
//! Whatever cannot be shown is counted, and the note below the plot says so.

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::scale::{Dropped, Scale};
use super::style::{Canvas, Drawn, INK, LINE, MARGIN, MARK, TEXT, WIDTH, colour, draw_mark, ink, themed, width_of};
use super::{Drawing, Plot, PlotKind, bars, points};
use crate::report::row::printable;
use crate::report::table::cut;

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
pub(super) struct Remarks {
    not_finite: usize,
    negative: usize,
    pub(super) labels_left_out: usize,
    pub(super) names_left_out: usize,
    feet: Vec<String>,
    pub(super) texts: Vec<String>,
}

impl Remarks {
    pub(super) fn count(&mut self, dropped: Dropped) {
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
        PlotKind::Scatter | PlotKind::Line => points::draw(svg, plot, remarks),
        PlotKind::Bars | PlotKind::StackedBars => bars::draw(svg, plot, remarks),
    }
}

pub(super) fn note_foot(remarks: &mut Remarks, scale: &Scale, axis: &str) {
    if let Some(power) = scale.foot_text() {
        let text = format!("Hollow marks at the foot of the {axis} axis, below {power}, are exactly 0.");
        remarks.feet.push(text);
    }
}

pub(super) type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Scale, Scale>>;

/// Draws grid, ticks, the axes' names and the legend.
pub(super) fn frame<'a>(
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
        // An unseen tick keeps the names off their bars.
        mesh.disable_y_mesh().set_tick_mark_size(LabelAreaPosition::Left, MARK);
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
pub(super) struct Legend {
    entries: Vec<(i32, i32, String)>,
    pub(super) height: i32,
}

impl Legend {
    pub(super) fn lay_out(names: &[&str]) -> Self {
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
                let corners = [(at.0 - MARK, at.1 - MARK), (at.0 + MARK, at.1 + MARK)];
                root.draw(&Rectangle::new(corners, colour(index).filled()))?;
            } else {
                draw_mark(root, at, index, false)?;
            }
            root.draw_text(text, &ink(0.9, HPos::Left), (x + 36, y + LINE / 2))?;
        }
        Ok(())
    }
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
