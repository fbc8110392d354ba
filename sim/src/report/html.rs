//! How does a report look? One page with everything in it: plots, then tables, then where the numbers come from.
//!
//! The page loads nothing, and its own policy forbids it to: pictures are part of it. Sorting is the only thing that its script does.

use std::fmt::Write;

use serde_json::Value;

use super::row::{number_text, printable, text_of};
use super::table::broken;
use super::{Column, Comparison, Plot, Report, Row, Run, Standing, error_against_run_time, pareto};

/// The text as HTML, in elements and in quoted attributes alike.
pub(super) fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in printable(text).chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\'' => safe.push_str("&#39;"),
            other => safe.push(other),
        }
    }
    safe
}

impl Report {
    /// The page.
    pub fn html(&self) -> String {
        let mut page = Page(String::new());
        page.head(self);
        for comparison in &self.comparisons {
            page.plot(&error_against_run_time(self.rows(), &self.columns, comparison));
        }
        for plot in &self.plots {
            page.plot(plot);
        }
        page.pictures(self);
        page.rows(self);
        for comparison in &self.comparisons {
            page.pareto(self.rows(), &self.columns, comparison);
        }
        page.definitions(self);
        if self.sources.is_empty() {
            page.line("<h2>How it was made</h2>");
            page.run(&self.run, "");
        } else {
            page.line("<h2>The runs</h2>");
            for source in &self.sources {
                page.run(source, &source.title);
            }
            page.run(&self.run, "This page");
        }
        page.line("</main>");
        page.line(&format!("<script>{}</script>", include_str!("report.js")));
        page.line("</body>\n</html>");
        page.0
    }
}

/// A page in the making. Whatever comes from outside goes through [`escape`].
struct Page(String);

impl Page {
    fn line(&mut self, html: &str) {
        self.0.push_str(html);
        self.0.push('\n');
    }

    fn head(&mut self, report: &Report) {
        let title = escape(&report.run.title);
        self.line("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">");
        self.line("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">");
        self.line(
            "<meta http-equiv=\"Content-Security-Policy\" \
             content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\">",
        );
        self.line(&format!("<title>{title}</title>\n<style>{}</style>\n</head>", include_str!("report.css")));
        self.line(&format!("<body>\n<main>\n<header>\n<h1>{title}</h1>"));
        if !report.headline.is_empty() {
            self.line(&format!("<p class=\"headline\">{}</p>", escape(&report.headline)));
        }
        let mut facts = vec![report.run.started.clone()];
        facts.extend(report.run.machine.cpu.clone());
        facts.extend(report.run.seed.map(|seed| format!("seed {seed}")));
        facts.extend(commit(&report.run).map(|commit| format!("commit {commit}")));
        facts.retain(|fact| !fact.is_empty());
        self.line(&format!("<p class=\"facts\">{}</p>\n</header>", escape(&facts.join(" · "))));
    }

    fn plot(&mut self, plot: &Plot) {
        let drawing = plot.draw();
        self.line(&format!("<figure>\n<h2>{}</h2>\n{}", escape(&plot.title), drawing.svg));
        if !drawing.note.is_empty() {
            self.line(&format!("<figcaption>{}</figcaption>", escape(&drawing.note)));
        }
        self.line("</figure>");
    }

    fn pictures(&mut self, report: &Report) {
        if report.pictures.is_empty() {
            return;
        }
        self.line("<h2>Pictures</h2>\n<div class=\"pictures\">");
        for picture in &report.pictures {
            let (title, png) = (escape(&picture.title), escape(&picture.png));
            self.line(&format!("<figure><img alt=\"{title}\" src=\"data:image/png;base64,{png}\">"));
            self.line(&format!("<figcaption>{title}</figcaption></figure>"));
        }
        self.line("</div>");
    }

    fn rows(&mut self, report: &Report) {
        let keys = report.keys();
        let (count, s) = (report.rows().len(), if report.rows().len() == 1 { "" } else { "s" });
        self.line(&format!("<h2>All rows</h2>\n<p class=\"hint\">{count} row{s}.</p>"));
        self.line("<div class=\"wide\"><table class=\"sortable\">\n<thead><tr>");
        for key in &keys {
            let numbers = report.rows().iter().any(|row| row.number(key).is_some());
            self.header(key, &report.columns, numbers);
        }
        self.line("</tr></thead>\n<tbody>");
        for row in report.rows() {
            self.0.push_str("<tr>");
            for key in &keys {
                self.cell(key, row.value(key).unwrap_or(&Value::Null));
            }
            self.line("</tr>");
        }
        self.line("</tbody></table></div>");
    }

    fn header(&mut self, key: &str, columns: &[Column], numbers: bool) {
        let column = columns.iter().find(|column| column.key == key);
        let meaning = column.map_or(String::new(), |column| format!(" title=\"{}\"", escape(&column.meaning)));
        let unit = column.filter(|column| !column.unit.is_empty());
        let unit = unit.map_or(String::new(), |column| format!(" <small>{}</small>", escape(&column.unit)));
        let name = broken(key).iter().map(|line| escape(line)).collect::<Vec<_>>().join("<br>");
        let class = if numbers { " class=\"n\"" } else { "" };
        self.line(&format!("<th scope=\"col\"{class}{meaning}>{name}{unit}</th>"));
    }

    fn cell(&mut self, key: &str, value: &Value) {
        let text = escape(&text_of(value));
        let cell = match value {
            // The full number for sorting and for those who point at it.
            Value::Number(n) => format!("<td class=\"n\" data-v=\"{n}\" title=\"{n}\">{text}</td>"),
            Value::Bool(false) if key == "ok" => format!("<td class=\"bad\">{text}</td>"),
            Value::Null => format!("<td class=\"none\">{text}</td>"),
            _ => format!("<td>{text}</td>"),
        };
        self.0.push_str(&cell);
    }

    fn pareto(&mut self, rows: &[Row], columns: &[Column], comparison: &Comparison) {
        let standing = pareto(rows, &comparison.goals());
        let by_time = |i: &usize| rows[*i].number(&comparison.time).unwrap_or(f64::INFINITY);
        let mut order: Vec<usize> = (0..rows.len()).filter(|i| standing[*i] != Standing::Incomparable).collect();
        order.sort_by(|a, b| by_time(a).total_cmp(&by_time(b)));
        let left_out = rows.len() - order.len();

        let (time, error) = (Column::title(columns, &comparison.time), Column::title(columns, &comparison.error));
        let heading = format!("Worth having: {} and {}", comparison.error, comparison.time);
        self.line(&format!("<h2>{}</h2>", escape(&heading)));
        let mut hint =
            "Marked rows are not dominated: no other row is as fast and as right, and better in one.".to_owned();
        if left_out > 0 {
            write!(hint, " {left_out} without both numbers left out.").ok();
        }
        self.line(&format!("<p class=\"hint\">{hint}</p>"));
        self.line("<div class=\"wide\"><table class=\"sortable\">\n<thead><tr><th scope=\"col\">row</th>");
        self.line(&format!(
            "<th scope=\"col\" class=\"n\">{}</th><th scope=\"col\" class=\"n\">{}</th>",
            escape(&time),
            escape(&error)
        ));
        self.line("<th scope=\"col\">standing</th></tr></thead>\n<tbody>");
        for i in order {
            let (class, verdict) = match standing[i] {
                Standing::DominatedBy(by) => ("", format!("dominated by {}", comparison.label_of(&rows[by]))),
                _ => (" class=\"front\"", "● not dominated".to_owned()),
            };
            self.0.push_str(&format!("<tr{class}><td>{}</td>", escape(&comparison.label_of(&rows[i]))));
            for key in [&comparison.time, &comparison.error] {
                self.cell(key, rows[i].value(key).unwrap_or(&Value::Null));
            }
            self.line(&format!("<td>{}</td></tr>", escape(&verdict)));
        }
        self.line("</tbody></table></div>");
    }

    fn definitions(&mut self, report: &Report) {
        self.line("<h2>What the columns mean</h2>");
        self.line("<div class=\"wide\"><table class=\"words\">\n<thead><tr><th scope=\"col\">column</th>");
        self.line("<th scope=\"col\">unit</th><th scope=\"col\">meaning</th></tr></thead>\n<tbody>");
        for key in report.keys() {
            let column = report.columns.iter().find(|column| column.key == key);
            let unit = column.map_or("", |column| &column.unit);
            let meaning = column.map_or("not described", |column| &column.meaning);
            let (key, unit, meaning) = (escape(key), escape(unit), escape(meaning));
            self.line(&format!("<tr><td><code>{key}</code></td><td>{unit}</td><td>{meaning}</td></tr>"));
        }
        self.line("</tbody></table></div>");
    }

    fn run(&mut self, run: &Run, heading: &str) {
        if !heading.is_empty() {
            self.line(&format!("<h3>{}</h3>", escape(heading)));
        }
        self.line(&format!("<pre><code>{}</code></pre>\n<dl>", escape(&run.command)));
        let machine = &run.machine;
        let cpu = machine.cpu.as_deref().unwrap_or("unknown processor");
        let memory = machine.memory_bytes.map_or(String::new(), |bytes| {
            format!(", {} GiB of memory", number_text((bytes as f64 / f64::from(1 << 30) * 10.0).round() / 10.0))
        });
        let simd = if machine.simd.is_empty() { "none known".to_owned() } else { machine.simd.join(", ") };
        let threads = if machine.cores == 1 { "hardware thread" } else { "hardware threads" };
        let facts = [
            ("Seed", run.seed.map_or("none".to_owned(), |seed| seed.to_string())),
            ("Commit", commit(run).unwrap_or("unknown".to_owned())),
            ("Program", format!("Eyeline {}, {} build", run.build.version, run.build.profile)),
            ("Machine", format!("{cpu}, {} {threads}{memory}, {} {}", machine.cores, machine.os, machine.arch)),
            ("SIMD", simd),
            ("Started", run.started.clone()),
            ("Took", format!("{} s", number_text(run.wall_seconds))),
        ];
        for (name, fact) in facts {
            self.line(&format!("<dt>{name}</dt><dd>{}</dd>", escape(&fact)));
        }
        self.line("</dl>");
        if !run.notes.is_empty() {
            self.line("<ul class=\"notes\">");
            for note in &run.notes {
                self.line(&format!("<li>{}</li>", escape(note)));
            }
            self.line("</ul>");
        }
    }
}

fn commit(run: &Run) -> Option<String> {
    let commit = run.build.commit.as_ref()?;
    let changed = if run.build.modified == Some(true) { " with changes" } else { "" };
    Some(format!("{}{changed}", commit.chars().take(12).collect::<String>()))
}
