//! Visibility queries on the adapter that is there: without one these tests say `skipped: NAME: reason` and pass, unless
//! `REQUIRE_GPU=1` (as in `.ci/run`), when they fail.

mod answers;
mod bad_input;
mod cullers;
mod made;
mod pixels;

use std::io::Write as _;
use std::sync::Arc;

use eyeline_client::gpu::{AdapterChoice, Gpu, GpuError};

/// An adapter in software, so that answers are the same everywhere; `None` and a line about it if there is none.
fn gpu_or_skip(test: &str) -> Option<Arc<Gpu>> {
    or_skip(test, Gpu::offscreen(AdapterChoice::Software))
}

fn or_skip(test: &str, gpu: Result<Gpu, GpuError>) -> Option<Arc<Gpu>> {
    match gpu {
        Ok(gpu) => Some(Arc::new(gpu)),
        Err(error) => {
            let is_required = std::env::var_os("REQUIRE_GPU").is_some_and(|value| value == "1");
            assert!(!is_required, "{test} needs an adapter: {error}");
            // Not by `println!`, which is kept back where a test passes.
            let _ = writeln!(std::io::stderr(), "skipped: {test}: {error}");
            None
        }
    }
}
