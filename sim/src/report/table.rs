//! How do rows look in a terminal? Aligned, with units in the headers, and never wider than a page.

use serde_json::Value;

use super::row::{DASH, printable, text_of};
use super::{Column, Row};

/// The widest line that [`table`] writes, in characters.
pub const WIDTH: usize = 120;

/// The longest text in a cell; what is longer ends in "…".
const CELL_WIDTH: usize = 32;

/// The longest line in a header before it breaks at an underscore.
const HEADER_WIDTH: usize = 12;

/// Lays out the given columns of the rows, numbers to the right.
///
/// Long names break at their underscores. Columns that do not fit go into a further block below, which repeats the
/// first column.
pub fn table(rows: &[Row], columns: &[Column]) -> String {
    let laid: Vec<Laid> = columns.iter().map(|column| Laid::new(column, rows)).collect();
    let Some((first, others)) = laid.split_first() else { return String::new() };
    let mut text = String::new();
    let mut rest = others;
    loop {
        let mut width = first.width;
        let fits = rest.iter().take_while(|column| {
            width += GAP.len() + column.width;
            width <= WIDTH
        });
        let (now, later) = rest.split_at(fits.count());
        write_block(&mut text, first, now, rows.len());
        rest = later;
        if rest.is_empty() {
            return text;
        }
        text.push('\n');
    }
}

const GAP: &str = "  ";

struct Laid {
    /// Name, broken, and unit.
    header: Vec<String>,
    cells: Vec<String>,
    width: usize,
    right: bool,
}

impl Laid {
    fn new(column: &Column, rows: &[Row]) -> Self {
        let values: Vec<&Value> = rows.iter().map(|row| row.value(&column.key).unwrap_or(&Value::Null)).collect();
        let cells: Vec<String> = values.iter().map(|value| cut(&text_of(value), CELL_WIDTH)).collect();
        let mut header = broken(&printable(&column.key));
        if !column.unit.is_empty() {
            header.push(cut(&format!("[{}]", printable(&column.unit)), CELL_WIDTH));
        }
        let width = header.iter().chain(&cells).map(|text| text.chars().count()).max().unwrap_or(0);
        let right = values.iter().any(|v| v.is_number()) && values.iter().all(|v| v.is_number() || v.is_null());
        Self { header, cells, width, right }
    }

    fn line(&self, text: &str) -> String {
        let width = self.width;
        if self.right { format!("{text:>width$}") } else { format!("{text:<width$}") }
    }
}

fn write_block(text: &mut String, first: &Laid, others: &[Laid], rows: usize) {
    let columns: Vec<&Laid> = std::iter::once(first).chain(others).collect();
    let height = columns.iter().map(|column| column.header.len()).max().unwrap_or(0);
    let mut write = |cell: &dyn Fn(&Laid) -> String| {
        let cells: Vec<String> = columns.iter().map(|column| column.line(&cell(column))).collect();
        text.push_str(cells.join(GAP).trim_end());
        text.push('\n');
    };
    for line in 0..height {
        // Headers stand on the line above the values, whatever their height.
        write(&|c| (line + c.header.len()).checked_sub(height).map_or(String::new(), |i| c.header[i].clone()));
    }
    write(&|c| "─".repeat(c.width));
    for row in 0..rows {
        write(&|c| c.cells.get(row).map_or(DASH.to_owned(), String::clone));
    }
}

/// A column's name in short lines, broken after underscores.
pub(super) fn broken(name: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in name.split_inclusive('_') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() <= HEADER_WIDTH => line.push_str(word),
            _ => lines.push(cut(word, CELL_WIDTH)),
        }
    }
    lines
}

/// The text, or its start and "…" if it has more than `most` characters.
pub(super) fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn numbers_stand_to_the_right_under_their_unit() {
        let rows: Vec<Row> = [
            json!({ "policy": "visible", "hidden_caused_per_client_s": 1.25, "ok": true }),
            json!({ "policy": "broadcast", "hidden_caused_per_client_s": 812, "ok": false }),
            json!({ "policy": "oracle" }),
        ]
        .iter()
        .map(|row| Row::of(row).unwrap())
        .collect();
        let columns = [
            Column::new("policy", "", "who"),
            Column::new("hidden_caused_per_client_s", "1/s", "how many"),
            Column::new("ok", "", "verdict"),
        ];
        let expected = [
            "               hidden_",
            "           caused_per_",
            "              client_s",
            "policy           [1/s]  ok",
            "─────────  ───────────  ───",
            "visible           1.25  yes",
            "broadcast          812  no",
            "oracle               –  –",
            "",
        ];
        assert_eq!(table(&rows, &columns), expected.join("\n"));
    }

    #[test]
    fn many_columns_wrap_into_blocks_that_repeat_the_first() {
        let columns: Vec<Column> = (0..40).map(|i| Column::new(format!("column_{i}"), "ms", "")).collect();
        let row: serde_json::Map<_, _> = (0..40).map(|i| (format!("column_{i}"), json!(i))).collect();
        let text = table(&[Row::of(&row).unwrap()], &columns);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
        assert!(text.matches("column_0").count() > 1 && text.contains("column_39"));
    }

    #[test]
    fn long_and_hostile_text_is_cut_and_made_harmless() {
        let row = Row::of(&json!({ "policy": format!("\u{1b}]0;title\u{7}{}", "x".repeat(500)) })).unwrap();
        let text = table(&[row], &[Column::new("policy", "", "")]);
        assert!(text.lines().all(|line| line.chars().count() <= CELL_WIDTH) && text.contains('…'));
        assert!(!text.contains('\u{1b}') && !text.contains('\u{7}'));
        assert_eq!(table(&[], &[]), "");
    }
}
