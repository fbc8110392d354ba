//! The verbs `stability` and `report` as processes: what they leave, and what they say of what is wrong.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn sim(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_eyeline-sim")).args(arguments).output().unwrap()
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("stability").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

fn report(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap()
}

#[test]
fn a_run_leaves_its_table_and_the_integrators_and_two_runs_make_a_page() {
    let (first, page) = (folder("first"), folder("page"));
    let ran = sim(&["stability", "--groups", "clock,stiff", "--out", first.to_str().unwrap()]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let cases = report(&first);
    let rows = cases["rows"].as_array().unwrap();
    assert!(rows.len() > 40, "{} rows", rows.len());
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} of {row}"));
        assert!(number("error") <= number("bound") && number("run_ms") >= 0.0, "{row}");
        assert_eq!((row["ok"].as_bool(), row["case"].is_string()), (Some(true), true), "{row}");
        assert!(["clock", "stiff"].contains(&row["group"].as_str().unwrap()));
    }
    let beside = report(&first.join("integrators"));
    let blown = |name: &str| {
        let rows = beside["rows"].as_array().unwrap().iter();
        rows.filter(|row| row["integrator"] == name && row["bounded"] == false).count()
    };
    assert_eq!(blown("exact (ours)"), 0);
    assert!(blown("explicit Euler") > 10);

    let again = format!("again={}", first.join("report.json").display());
    let merged = sim(&["report", first.to_str().unwrap(), &again, "--out", page.to_str().unwrap()]);
    assert!(merged.status.success(), "{}", String::from_utf8_lossy(&merged.stderr));
    let merged = report(&page);
    assert_eq!(merged["rows"].as_array().unwrap().len(), 2 * rows.len());
    assert_eq!(merged["sources"].as_array().unwrap().len(), 2);
    let html = std::fs::read_to_string(page.join("report.html")).unwrap();
    assert!(html.contains("again") && html.contains("Eyeline stability"));
}

#[test]
fn what_is_wrong_is_named() {
    let says = |arguments: &[&str]| {
        let ran = sim(arguments);
        assert_eq!(ran.status.code(), Some(1), "{arguments:?}");
        String::from_utf8(ran.stderr).unwrap()
    };
    let text = says(&["stability", "--groups", "stif"]);
    assert!(text.contains("`stif`") && text.contains("stiff"), "{text}");
    let text = says(&["report", "nowhere/at/all"]);
    assert!(text.contains("nowhere/at/all"), "{text}");
    let folder = folder("bad");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("report.json"), r#"{"schema": "eyeline-report/0"}"#).unwrap();
    let text = says(&["report", folder.to_str().unwrap()]);
    assert!(text.contains("eyeline-report/0") && text.contains("eyeline-report/1"), "{text}");
}
