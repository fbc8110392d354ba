use std::fs;

use serde_json::json;

use super::*;

fn run() -> Run {
    Run {
        title: "Three policies".to_owned(),
        command: "eyeline-sim measure --seed 7".to_owned(),
        seed: Some(7),
        machine: Machine { os: "linux".to_owned(), arch: "x86_64".to_owned(), cores: 2, ..Machine::default() },
        build: Build { version: "0.1.0".to_owned(), profile: "release".to_owned(), commit: None, modified: None },
        started: "2026-11-22T03:42:39Z".to_owned(),
        wall_seconds: 12.5,
        notes: vec!["Loopback.".to_owned()],
    }
}

fn report() -> Report {
    let columns = vec![
        Column::new("policy", "", "how the server chooses"),
        Column::new("missed_px", "px", "pixels not drawn"),
        Column::new("client_frame_ms", "ms", "time per frame"),
    ];
    let mut report = Report::new(run(), columns);
    report.headline = "Sample numbers.".to_owned();
    report.push(&json!({ "policy": "visible", "client_frame_ms": 0.5, "missed_px": 0 })).unwrap();
    report.push(&json!({ "policy": "broadcast", "client_frame_ms": 0.7, "missed_px": 12.5, "late": null })).unwrap();
    report.push(&json!({ "policy": "radius", "client_frame_ms": 0.2, "missed_px": f64::NAN })).unwrap();
    report.compare(Comparison::new(&["policy"], "client_frame_ms", "missed_px"));
    let mut bars = Plot::new("Where the time goes", PlotKind::StackedBars, Axis::linear(""), Axis::linear("ms"));
    bars.series.push(Series::new("draw", vec![Point::bar("visible", 0.5), Point::bar("radius", f64::NAN)]));
    report.plots.push(bars);
    report
}

#[test]
fn json_has_the_promised_keys_and_reads_back_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let written = report().write(&folder.path().join("out/demo")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&fs::read(&written.json).unwrap()).unwrap();
    assert_eq!(json["schema"], SCHEMA);
    assert_eq!(json["seed"], 7);
    assert_eq!(json["command"], "eyeline-sim measure --seed 7");
    assert_eq!(json["machine"]["os"], "linux");
    assert_eq!(json["rows"][0]["policy"], "visible");
    assert_eq!(json["build"]["commit"], serde_json::Value::Null);

    let read = Report::read(&written.json).unwrap();
    assert_eq!(read.rows(), report().rows());
    assert_eq!(read.html(), fs::read_to_string(&written.html).unwrap(), "the JSON is all that the page needs");
}

#[test]
fn only_the_three_files_remain_in_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    for _ in 0..2 {
        report().write(folder.path()).unwrap();
    }
    let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["report.csv", "report.html", "report.json"]);
}

#[test]
fn csv_has_all_columns_in_the_order_of_the_rows() {
    let folder = tempfile::tempdir().unwrap();
    let mut report = report();
    report.push(&json!({ "policy": "says \"a, b\"", "ok": true })).unwrap();
    let written = report.write(folder.path()).unwrap();
    assert_eq!(
        fs::read_to_string(written.csv).unwrap(),
        "client_frame_ms,missed_px,policy,late,ok\n\
         0.5,0,visible,,\n0.7,12.5,broadcast,,\n0.2,,radius,,\n,,\"says \"\"a, b\"\"\",,true\n"
    );
}

#[test]
fn a_place_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let occupied = folder.path().join("occupied");
    fs::write(&occupied, "a file").unwrap();
    let error = report().write(&occupied).unwrap_err();
    assert!(matches!(error, WriteError::Folder { .. }) && error.to_string().contains("occupied"));

    fs::create_dir_all(folder.path().join("out/report.csv/x")).unwrap();
    let error = report().write(&folder.path().join("out")).unwrap_err();
    assert!(matches!(error, WriteError::File { .. }) && error.to_string().contains("report.csv"));
    let names: Vec<_> = fs::read_dir(folder.path().join("out")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(names.iter().all(|name| !name.to_string_lossy().ends_with(".tmp")), "{names:?}");
}

#[test]
fn what_is_no_report_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let read = |text: &str| {
        let path = folder.path().join("report.json");
        fs::write(&path, text).unwrap();
        Report::read(&path).unwrap_err()
    };
    assert!(matches!(read("{}"), ReadError::Json { .. }));
    assert!(matches!(read("{\"schema\": \"eyeline-report/1\"}"), ReadError::Json { .. }));
    let newer = read("{\"schema\": \"eyeline-report/9\", \"rows\": {}}").to_string();
    assert!(newer.contains("report.json has schema `eyeline-report/9`"), "{newer}");
    assert!(matches!(Report::read(&folder.path().join("absent")), Err(ReadError::File { .. })));
}

#[test]
fn the_page_shows_plots_first_and_loads_nothing() {
    let html = report().html();
    let place = |what: &str| html.find(what).unwrap_or_else(|| panic!("no {what}"));
    let order = [
        "<h1>Three policies",
        "Sample numbers.",
        "Error against run time: missed_px over client_frame_ms",
        "Where the time goes",
        "All rows",
        "Worth having: missed_px and client_frame_ms",
        "What the columns mean",
        "eyeline-sim measure --seed 7",
        "Loopback.",
    ];
    for pair in order.windows(2) {
        assert!(place(pair[0]) < place(pair[1]), "{} before {}", pair[0], pair[1]);
    }
    for outside in ["http://", "https://", "src=", "href=", "url(", "@import", "<link", "<iframe", "<img"] {
        assert!(!html.contains(outside), "{outside}");
    }
    assert!(html.contains("● not dominated") && html.contains("dominated by visible"));
    assert!(html.contains("1 without both numbers left out"));
    assert!(html.contains("1 point is missing a finite number"));
    assert!(html.contains("<td><code>late</code></td><td></td><td>not described</td>"));
}

#[test]
fn nothing_from_outside_becomes_markup() {
    let evil = "<img src=x onerror=alert(1)>'\"&\u{0}</title></style></script>";
    let mut report = report();
    report.headline = evil.to_owned();
    report.run = Run { title: evil.into(), command: evil.into(), started: evil.into(), ..run() };
    report.run.notes.push(evil.to_owned());
    report.run.machine.cpu = Some(evil.to_owned());
    report.run.build.commit = Some(evil.to_owned());
    report.columns.push(Column::new(evil, evil, evil));
    report.push(&json!({ "policy": evil, evil: evil, "client_frame_ms": 1, "missed_px": 2 })).unwrap();
    report.compare(Comparison::new(&[evil], "client_frame_ms", evil));
    let mut plot = Plot::new(evil, PlotKind::Bars, Axis::log(evil), Axis::log(evil)).with_note(evil);
    plot.series.push(Series::new(evil, vec![Point::bar(evil, 1.0)]));
    report.plots.push(plot);
    report.sources = vec![report.run.clone()];
    let html = report.html();
    assert!(!html.contains("<img") && !html.contains('\u{0}'));
    let count = |tag: &str| html.matches(tag).count();
    assert_eq!((count("</title></"), count("</style>"), count("</script>")), (0, 1, 1));
}

#[test]
fn an_empty_report_is_still_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let mut report = Report::new(Run::default(), Vec::new());
    report.compare(Comparison::new(&[], "ms", "error"));
    let written = report.write(folder.path()).unwrap();
    assert_eq!(fs::read_to_string(written.csv).unwrap(), "");
    assert!(Report::read(&written.json).unwrap().html().contains("0 rows"));
}

#[test]
fn merged_runs_share_one_comparison_and_keep_their_origins() {
    let (a, mut b) = (report(), report());
    b.run.seed = Some(8);
    let merged = Report::merged(run(), &[("one".to_owned(), a.clone()), ("two".to_owned(), b)]);
    assert_eq!(merged.rows().len(), 6);
    assert_eq!(merged.rows()[3].text("run"), "two");
    assert_eq!(merged.comparisons.len(), 1);
    assert_eq!(merged.comparisons[0].labels, ["run", "policy"]);
    assert_eq!(merged.run.seed, None, "the seeds differ");
    assert_eq!(merged.sources.len(), 2);
    assert_eq!(Report::merged(run(), &[("one".to_owned(), a)]).run.seed, Some(7));

    let folder = tempfile::tempdir().unwrap();
    let read = Report::read(&merged.write(folder.path()).unwrap().json).unwrap();
    assert_eq!(read.html(), merged.html());
    let again = Report::merged(run(), &[("all".to_owned(), read)]);
    assert_eq!(again.sources.len(), 2);
    assert_eq!(again.comparisons[0].labels, ["run", "policy"]);
}

#[test]
fn error_against_run_time_has_one_labelled_point_per_row() {
    let report = report();
    let plot = error_against_run_time(report.rows(), &report.columns, &report.comparisons[0]);
    assert_eq!(plot.x, Axis::log("client_frame_ms (ms)"));
    assert_eq!(plot.y, Axis::log("missed_px (px)"));
    let points: Vec<_> = plot.series.iter().flat_map(|series| &series.points).collect();
    assert_eq!(points.len(), 3);
    assert_eq!((points[0].label.as_str(), points[0].x, points[0].y), ("visible", 0.5, 0.0));
    let by_policy = report.comparisons[0].clone().by_series("policy");
    assert_eq!(error_against_run_time(report.rows(), &report.columns, &by_policy).series.len(), 3);
}
