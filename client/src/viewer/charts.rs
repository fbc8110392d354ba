//! Numbers over time, drawn into a corner of the picture: messages, what is visible and hidden, and what each stage takes.
//!
//! What is measured each frame is put into bins of a quarter of a second, of which half a minute is kept. A chart goes from 0 to the
//! next round number above the greatest value that it shows, and its legend tells the newest. Nothing here reads a clock.

use std::collections::VecDeque;

use eyeline_visibility::Resolution;
use glam::Vec2;

use super::font;
use super::overlay::{Color, Overlay};

/// Length of a bin, seconds.
const BIN: f64 = 0.25;

/// Bins kept: half a minute.
const BINS: usize = 120;

/// What a frame was like.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Messages sent and received since the start; nothing without a server.
    pub messages: [u64; 2],
    /// What is visible and what is hidden: objects, or triangles without a server.
    pub counts: [f64; 2],
    /// What culling, tracking and drawing took, milliseconds.
    pub stages: [f64; 3],
}

/// Messages a second up and down; visible and hidden; ms to cull, track and draw.
type Values = [f64; 7];

#[derive(Clone, Copy, Debug, Default)]
struct Filling {
    seconds: f64,
    /// Sums, each times how long it held.
    sums: Values,
    messages: [u64; 2],
}

/// Half a minute of numbers.
#[derive(Clone, Debug, Default)]
pub struct Charts {
    bins: VecDeque<Values>,
    filling: Filling,
    /// Whether it is known where counters were.
    is_begun: bool,
}

const GREEN: Color = [0.3, 0.95, 0.4, 1.0];
const ORANGE: Color = [1.0, 0.6, 0.15, 1.0];
const BLUE: Color = [0.35, 0.65, 1.0, 1.0];

impl Charts {
    /// Adds a frame that took so many seconds from the one before.
    pub fn add(&mut self, seconds: f64, sample: &Sample) {
        let is_sane = seconds > 0.0 && seconds.is_finite();
        if !self.is_begun || !is_sane {
            // A counter that begins, or begins anew, is no flood.
            self.filling.messages = sample.messages;
            self.is_begun = true;
            return;
        }
        let filling = &mut self.filling;
        filling.seconds += seconds;
        let held = [sample.counts[0], sample.counts[1], sample.stages[0], sample.stages[1], sample.stages[2]];
        for (sum, value) in filling.sums[2..].iter_mut().zip(held) {
            *sum += if value.is_finite() { value * seconds } else { 0.0 };
        }
        if filling.seconds < BIN {
            return;
        }
        let mut bin = filling.sums.map(|sum| sum / filling.seconds);
        let totals = sample.messages.iter().zip(filling.messages);
        for (rate, (now, before)) in bin.iter_mut().zip(totals) {
            *rate = now.saturating_sub(before) as f64 / filling.seconds;
        }
        *filling = Filling { messages: sample.messages, ..Filling::default() };
        self.bins.push_back(bin);
        if self.bins.len() > BINS {
            self.bins.pop_front();
        }
    }

    /// Draws three charts above each other into the lower left corner; fewer where there is no room. Lengths go by `scale`, the
    /// pixels of a pixel of the font.
    pub fn draw(&self, overlay: &mut Overlay, resolution: Resolution, scale: f32, counted: &str) {
        let charts = [
            Chart { title: "messages/s", lines: vec![(0, "up", ORANGE), (1, "down", BLUE)] },
            Chart { title: counted, lines: vec![(2, "visible", GREEN), (3, "hidden", ORANGE)] },
            Chart { title: "ms", lines: vec![(4, "cull", ORANGE), (5, "track", BLUE), (6, "draw", GREEN)] },
        ];
        let size = Vec2::new(WIDTH, HEIGHT) * scale;
        let (width, height) = (resolution.width as f32, resolution.height as f32);
        let fits = ((height - MARGIN * scale) / (size.y + MARGIN * scale)).floor().max(0.0) as usize;
        if size.x + 2.0 * MARGIN * scale > width {
            return;
        }
        let shown = charts.len().min(fits);
        for (row, chart) in charts.iter().take(shown).enumerate() {
            let up = (shown - row) as f32 * (size.y + MARGIN * scale);
            self.chart(overlay, chart, Vec2::new(MARGIN * scale, height - up), scale);
        }
    }

    fn chart(&self, overlay: &mut Overlay, chart: &Chart<'_>, at: Vec2, scale: f32) {
        let size = Vec2::new(WIDTH, HEIGHT) * scale;
        overlay.rectangle(at, at + size, [0.02, 0.02, 0.04, 0.8]);
        let of = |line: usize| self.bins.iter().map(move |bin| bin[line]);
        let most = chart.lines.iter().flat_map(|(line, ..)| of(*line)).fold(0.0, f64::max);
        let top = round_above(most);
        // The title, the scale, and a legend that tells the newest of each.
        let pad = 3.0 * scale;
        overlay.text(chart.title, at + pad, scale, [0.8, 0.8, 0.8, 1.0]);
        let label = short(top);
        let right = Vec2::new(size.x - pad - font::size(&label).x * scale, pad);
        overlay.text(&label, at + right, scale, [0.6, 0.6, 0.6, 1.0]);
        let mut legend = at + Vec2::new(pad, pad + 10.0 * scale);
        for (line, name, color) in &chart.lines {
            let newest = self.bins.back().map_or("-".to_owned(), |bin| short(bin[*line]));
            let text = format!("{name} {newest}");
            overlay.text(&text, legend, scale, *color);
            legend.x += (font::size(&text).x + 8.0) * scale;
        }
        let (low, high) = (at.y + size.y - pad, at.y + pad + 21.0 * scale);
        let (left, width) = (at.x + pad, size.x - 2.0 * pad);
        for share in [0.0, 0.5, 1.0] {
            let y = low + (high - low) * share;
            overlay.flat_line(Vec2::new(left, y), Vec2::new(left + width, y), 0.5 * scale, [1.0, 1.0, 1.0, 0.12]);
        }
        for (line, _, color) in &chart.lines {
            // The newest is at the right edge, however few there are.
            let first = BINS - self.bins.len();
            let point = |(bin, value): (usize, f64)| {
                let x = left + width * (first + bin) as f32 / (BINS - 1) as f32;
                Vec2::new(x, low + (high - low) * (value / top).clamp(0.0, 1.0) as f32)
            };
            let points: Vec<Vec2> = of(*line).enumerate().map(point).collect();
            points.windows(2).for_each(|ends| overlay.flat_line(ends[0], ends[1], scale, *color));
        }
    }
}

struct Chart<'a> {
    title: &'a str,
    /// Index into the values, name, colour.
    lines: Vec<(usize, &'a str, Color)>,
}

/// Size of a chart, and what is between them, in pixels of the font.
const WIDTH: f32 = 190.0;
const HEIGHT: f32 = 54.0;
const MARGIN: f32 = 4.0;

/// The next of 1, 2 and 5 times a power of ten; at least 1.
fn round_above(value: f64) -> f64 {
    if !(value > 1.0 && value.is_finite()) {
        return 1.0;
    }
    let power = 10f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    steps.into_iter().find(|step| *step >= value).unwrap_or(steps[3])
}

/// A number in few letters.
fn short(value: f64) -> String {
    match value {
        value if value >= 1e6 => format!("{:.1}m", value / 1e6),
        value if value >= 1e4 => format!("{:.0}k", value / 1e3),
        value if value >= 100.0 => format!("{value:.0}"),
        value if value >= 10.0 => format!("{value:.1}"),
        value => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_means_and_rates() {
        let mut charts = Charts::default();
        // The first frame only says where counters are.
        charts.add(0.1, &Sample { messages: [1_000, 5_000], ..Sample::default() });
        for frame in 1..=100u64 {
            // 10 messages up and 40 down a second; counts alternate.
            let messages = [1_000 + frame, 5_000 + 4 * frame];
            let counts = [if frame % 2 == 0 { 10.0 } else { 20.0 }, 7.0];
            charts.add(0.125, &Sample { messages: messages.map(|sum| sum * 5 / 4), counts, stages: [1.0, 2.0, 3.0] });
        }
        assert_eq!(charts.bins.len(), 50);
        let bin = charts.bins[20];
        assert!((bin[0] - 10.0).abs() <= 4.0 && (bin[1] - 40.0).abs() <= 4.0, "{bin:?}");
        assert_eq!(bin[2..], [15.0, 7.0, 1.0, 2.0, 3.0]);
    }

    #[test]
    fn half_a_minute_is_kept_and_bad_times_are_not() {
        let mut charts = Charts::default();
        for seconds in [f64::NAN, 0.0, -1.0, f64::INFINITY, 0.3] {
            charts.add(seconds, &Sample { stages: [f64::NAN; 3], ..Sample::default() });
        }
        assert_eq!(charts.bins.len(), 1);
        assert!(charts.bins[0].iter().all(|value| value.is_finite()));
        // A counter that begins anew is no negative rate.
        charts.add(0.3, &Sample { messages: [9, 9], ..Sample::default() });
        charts.add(0.3, &Sample::default());
        assert_eq!(charts.bins[2][0], 0.0);
        (0..500).for_each(|_| charts.add(0.3, &Sample::default()));
        assert_eq!(charts.bins.len(), BINS);
    }

    #[test]
    fn scales_are_round_and_numbers_short() {
        let tops = [0.0, 0.3, 1.0, 1.2, 4.9, 5.0, 99.0, 1_200.0, f64::NAN, f64::INFINITY].map(round_above);
        assert_eq!(tops, [1.0, 1.0, 1.0, 2.0, 5.0, 5.0, 100.0, 2_000.0, 1.0, 1.0]);
        assert_eq!([0.5, 12.34, 432.1, 56_789.0, 4.2e6].map(short), ["0.50", "12.3", "432", "57k", "4.2m"]);
    }

    #[test]
    fn what_has_no_room_is_left_out() {
        let charts = Charts::default();
        let drawn = |width, height, scale| {
            let mut overlay = Overlay::default();
            charts.draw(&mut overlay, Resolution::new(width, height), scale, "objects");
            !overlay.is_empty()
        };
        assert!(drawn(400, 300, 1.0) && drawn(400, 70, 1.0));
        assert!(!drawn(400, 40, 1.0) && !drawn(150, 300, 1.0) && !drawn(1, 1, 1.0) && !drawn(350, 300, 2.0));
    }
}
