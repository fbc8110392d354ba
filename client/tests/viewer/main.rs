//! What the viewer draws, on the adapter that is there: without one these tests say `skipped: NAME: reason` and pass, unless
//! `REQUIRE_GPU=1` (as in `.ci/run`), when they fail.

mod faults;
mod film;
mod golden;
mod hidden;
mod looks;
mod made;
mod people;
mod screen;
mod served;
mod session;
mod visible;
mod window;

use std::io::Write as _;
use std::path::PathBuf;

use eyeline_client::viewer::gpu::{AdapterChoice, Gpu};
use eyeline_client::viewer::model::Model;
use eyeline_client::viewer::picture::{FORMAT, Stage};

/// An adapter in software, so that pictures are the same everywhere; `None` and a line about it if there is none.
fn gpu_or_skip(test: &str) -> Option<Gpu> {
    match Gpu::offscreen(AdapterChoice::Software) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let is_required = std::env::var_os("REQUIRE_GPU").is_some_and(|value| value == "1");
            assert!(!is_required, "{test} needs an adapter: {error}");
            skip(test, &error.to_string());
            None
        }
    }
}

/// Not by `println!`, which is kept back where a test passes.
fn skip(test: &str, reason: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {test}: {reason}");
}

/// One of the scenes that nobody here made: `EYELINE_DATA`, else `shared/data` beside the workspace.
fn given_scene(test: &str, name: &str) -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from);
    let path = data.join("scenes").join(name);
    let found = path.is_file().then_some(path);
    if found.is_none() {
        skip(test, &format!("{name} is not in {}", data.display()));
    }
    found
}

fn stage(gpu: &Gpu, model: &Model) -> Stage {
    Stage::new(gpu, model, &[], FORMAT).unwrap()
}
