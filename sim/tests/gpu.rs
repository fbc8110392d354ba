//! `cull --gpu`: rows of a graphics adapter beside the CPU's, one line where there is none, and a build without it says which one to
//! make.

use std::path::Path;
use std::process::{Command, Output};

fn eyeline(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_eyeline-sim"));
    command.args(arguments).envs(environment.iter().copied()).output().unwrap()
}

fn cull<'a>(out: &'a str, cullers: &'a str) -> Vec<&'a str> {
    let size = ["--world", "rooms", "--views", "2", "--resolution", "64x48", "--repeats", "1"];
    [&["cull", "--gpu", "--cullers", cullers, "--out", out][..], &size[..]].concat()
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_build_without_it_names_the_feature() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let output = eyeline(&cull(&out, "cplp"), &[]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(text.contains("--features gpu") && !text.contains("panicked"), "{text}");
    assert!(!Path::new(&out).exists());
}

#[cfg(feature = "gpu")]
mod with_gpu {
    use std::io::Write as _;

    use eyeline_sim::cull::gpu::{GpuSide, SOFTWARE};
    use serde_json::Value;

    use super::*;

    fn report(out: &str) -> Value {
        serde_json::from_slice(&std::fs::read(Path::new(out).join("report.json")).unwrap()).unwrap()
    }

    #[test]
    fn its_rows_stand_beside_the_cpu_s_and_lose_nothing() {
        if let Err(error) = GpuSide::open() {
            let is_required = std::env::var_os("REQUIRE_GPU").is_some_and(|value| value == "1");
            assert!(!is_required, "needs an adapter: {error}");
            let _ = writeln!(std::io::stderr(), "skipped: its_rows_stand_beside_the_cpu_s_and_lose_nothing: {error}");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out").display().to_string();
        let output = eyeline(&cull(&out, "cplp,gpu-cplp,gpu-cplp-batches,gpu-hierarchical-z"), &[]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text} {}", String::from_utf8_lossy(&output.stderr));
        let report = report(&out);
        let rows = report["rows"].as_array().unwrap();
        // One of the CPU; seven ways of asking one by one, six in batches, and the pyramid's octree.
        assert_eq!(rows.len(), 1 + 7 + 6 + 1, "{text}");
        for row in rows {
            assert_eq!(
                (&row["ok"], &row["wrong_pixels_max"], &row["lost_visible"]),
                (&true.into(), &0.into(), &0.into())
            );
            assert!(row["kept"].as_f64() >= row["exact"].as_f64(), "{row}");
            assert!(row["rounds"].as_f64() > Some(0.0), "{row}");
        }
        let kept = |query: &str| {
            rows.iter().find(|row| row["culler"] == "gpu-cplp" && row["query"] == query).unwrap()["kept"].clone()
        };
        assert_eq!(kept("gpu-per-fragment"), kept("gpu-item-buffer"));
        let titles: Vec<&str> =
            report["plots"].as_array().unwrap().iter().map(|plot| plot["title"].as_str().unwrap()).collect();
        for title in [
            "Time per query over the size of its box",
            "Time per query over the size of the image",
            "Steps of a query by the size of its image",
        ] {
            assert!(titles.iter().any(|known| known.starts_with(title)), "{titles:?}");
        }
        // cPLP's Table 2, for each way that is taken apart, and marked where its times say nothing.
        let split: Vec<&str> = text.lines().filter(|line| line.contains("cPLP's table 2 (µs)")).collect();
        assert!(split.len() >= 3 && split[0].starts_with("gpu-item-buffer"), "{text}");
        for line in &split {
            for part in ["64x64 drawing", "512x512 drawing", "transfer", "scan", "total"] {
                assert!(line.contains(part), "{line}");
            }
            assert_eq!(
                line.contains(SOFTWARE),
                text.contains("the papers' ratios are checked on a real adapter"),
                "{line}"
            );
        }
        // What is read back: a whole image a pass, its open tiles, or a number for each box. The CPU reads nothing of an adapter.
        let of = |culler: &str, query: &str, column: &str| {
            let row = rows.iter().find(|row| row["culler"] == culler && (query.is_empty() || row["query"] == query));
            row.unwrap()[column].as_f64()
        };
        let gpu = |query: &str, column: &str| of("gpu-cplp", query, column).unwrap();
        assert_eq!(of("cplp", "", "read_back_bytes"), None);
        assert_eq!(gpu("gpu-item-buffer", "read_back"), 64.0 * 48.0 * gpu("gpu-item-buffer", "passes"));
        assert_eq!(gpu("gpu-item-buffer", "read_back_bytes"), 4.0 * gpu("gpu-item-buffer", "read_back"));
        // An image of one tile.
        assert!(gpu("gpu-item-buffer-tiled", "read_back_bytes") <= gpu("gpu-item-buffer", "read_back_bytes"));
        assert!(gpu("gpu-per-fragment", "read_back_bytes") * 10.0 < gpu("gpu-item-buffer", "read_back_bytes"));
        // Nobody is told that a processor in the place of a GPU is fast.
        let fastest = report["headline"].as_str().unwrap().split("Fastest").nth(1).unwrap();
        assert!(!(text.contains(SOFTWARE) && fastest.contains("gpu-")), "{fastest}");
        // Ratios are told of real adapters, and those only.
        assert_eq!(text.contains(SOFTWARE), !text.contains("checked:") && !text.contains("not checked:"), "{text}");
    }

    #[test]
    fn without_an_adapter_the_cpu_s_rows_still_come() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out").display().to_string();
        let nowhere = folder.path().join("none.json").display().to_string();
        let no_adapter = [("VK_ICD_FILENAMES", nowhere.as_str()), ("VK_DRIVER_FILES", nowhere.as_str())];
        let output = eyeline(&cull(&out, "cplp,gpu-cplp"), &no_adapter);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{text}");
        let told: Vec<&str> = text.lines().filter(|line| line.contains("no rows of a GPU")).collect();
        assert!(told.len() == 1 && told[0].contains("mesa-vulkan-drivers"), "{text}");
        let report = report(&out);
        let cullers: Vec<&str> =
            report["rows"].as_array().unwrap().iter().map(|row| row["culler"].as_str().unwrap()).collect();
        assert_eq!(cullers, ["cplp"]);
        assert!(
            report["notes"].as_array().unwrap().iter().any(|note| note.as_str().unwrap().contains("no rows of a GPU"))
        );
    }
}
