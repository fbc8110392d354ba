//! What do all plots have in common? A quiet style: thin grid, no frame, marks told apart by colour and by shape.
//!
//! plotters counts in whole pixels, so everything is drawn at twice its size and scaled down by the view box.
//! Its literal colours become `currentColor` and CSS variables afterwards, so that a page decides light or dark.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::report::html::escape;

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
pub(super) const INK: RGBColor = RGBColor(0x11, 0x11, 0x12);

/// Everything below is in halves of a CSS pixel.
pub(super) const WIDTH: u32 = 1520;
pub(super) const HEIGHT: u32 = 840;
pub(super) const MARGIN: i32 = 24;
pub(super) const TEXT: i32 = 25;
pub(super) const LINE: i32 = 42;
pub(super) const MARK: i32 = 10;

pub(super) type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

pub(super) fn draw_mark(root: &Canvas<'_>, (x, y): (i32, i32), series: usize, hollow: bool) -> Drawn {
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

/// The series' colour; with more than eight series, the shape of the mark tells them apart.
pub(super) fn colour(series: usize) -> RGBColor {
    PALETTE[series % PALETTE.len()]
}

pub(super) fn ink(strength: f64, anchor: HPos) -> TextStyle<'static> {
    // plotters-svg writes a font size divided by 1.24.
    let font = ("sans-serif", f64::from(TEXT) * 1.24).into_font();
    let color = INK.mix(strength).to_backend_color();
    TextStyle { font, color, pos: Pos::new(anchor, VPos::Center) }
}

/// A guess, since the reader's fonts are unknown: rather too wide.
pub(super) fn width_of(text: &str) -> i32 {
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
pub(super) fn themed(svg: &str, title: &str) -> String {
    let hex = |c: RGBColor| format!("\"#{:02X}{:02X}{:02X}\"", c.0, c.1, c.2);
    let mut text = svg.replace(&hex(INK), "\"currentColor\"");
    for (i, colour) in PALETTE.into_iter().enumerate() {
        let literal = hex(colour);
        text = text.replace(&literal, &format!("\"var(--s{i},{})\"", literal.trim_matches('"')));
    }
    let Some((head, body)) = text.split_once(">\n") else { return text };
    let view_box = head.split("viewBox=").nth(1).and_then(|rest| rest.split('"').nth(1)).unwrap_or("0 0 1520 840");
    let title = escape(title);
    format!("<svg viewBox=\"{view_box}\" role=\"img\" class=\"plot\"><title>{title}</title>\n{body}")
}
