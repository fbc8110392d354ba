//! Which cullers does a graphics adapter bring, and what do its queries cost? `eyeline-sim cull --gpu`.
//!
//! The cullers are rows like all others. Their truth is the adapter's own item buffer, since two rasterisers differ at edges
//! ([`super::Candidate::own_pictures`]). Beside them the report has the time of a query against the size of its box (Staneker et al.
//! 2003, figure 1) and in images of 64² and 512² pixels, whole and step by step (Klosowski & Silva 2001, table 2). The papers' ratios are only held against
//! a real adapter; one in software says what is right and nothing about speed.
//!
//! Without the feature `gpu` there is only the message that says so.

#[cfg(feature = "gpu")]
mod candidate;
#[cfg(feature = "gpu")]
mod costs;
#[cfg(feature = "gpu")]
mod steps;

#[cfg(feature = "gpu")]
pub(super) use candidate::Uploaded;

use super::registry::Entry;
use super::run::Outcome;
use crate::report::Report;

/// Why there are no rows of a graphics adapter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoGpu {
    /// They were not built in.
    #[error(
        "this build has no query back ends on the GPU; build it with: cargo build --release -p eyeline-sim --features gpu"
    )]
    NotBuilt,
    /// There is no adapter that can be used.
    #[error("{0}")]
    NoAdapter(String),
}

/// How the names of all these cullers and query back ends begin.
pub const PREFIX: &str = "gpu-";

/// What is said of times of an adapter in software.
pub const SOFTWARE: &str = "software adapter: correctness only";

/// A graphics adapter that takes part in a comparison.
#[derive(Debug)]
pub struct GpuSide {
    #[cfg(feature = "gpu")]
    gpu: std::sync::Arc<eyeline_client::gpu::Gpu>,
    #[cfg(not(feature = "gpu"))]
    never: std::convert::Infallible,
}

impl GpuSide {
    /// Finds an adapter: a real one if there is one, else one in software.
    ///
    /// # Errors
    /// If there is none, or none can be used by this build.
    pub fn open() -> Result<GpuSide, NoGpu> {
        #[cfg(feature = "gpu")]
        {
            let gpu = eyeline_client::gpu::Gpu::offscreen(eyeline_client::gpu::AdapterChoice::Best);
            let gpu = gpu.map_err(|error| NoGpu::NoAdapter(error.to_string()))?;
            Ok(GpuSide { gpu: std::sync::Arc::new(gpu) })
        }
        #[cfg(not(feature = "gpu"))]
        Err(NoGpu::NotBuilt)
    }

    /// Its cullers.
    pub fn entries(&self) -> Vec<Entry> {
        #[cfg(feature = "gpu")]
        return candidate::entries();
        #[cfg(not(feature = "gpu"))]
        match self.never {}
    }

    /// Which adapter it is, and what its times are worth.
    pub fn notes(&self) -> Vec<String> {
        #[cfg(feature = "gpu")]
        {
            let mut notes = vec![format!("adapter: {}", self.gpu.describe())];
            if self.gpu.is_software() {
                notes.push(SOFTWARE.to_owned());
            }
            notes
        }
        #[cfg(not(feature = "gpu"))]
        match self.never {}
    }

    /// Measures single queries, and puts their costs, and the papers' ratios if they can be checked, into a report of `outcome`.
    /// Returns the lines that it adds, for the terminal.
    ///
    /// # Errors
    /// If the adapter fails.
    pub fn measure(&self, report: &mut Report, outcome: &Outcome) -> anyhow::Result<Vec<String>> {
        #[cfg(feature = "gpu")]
        return costs::add(&self.gpu, report, outcome);
        #[cfg(not(feature = "gpu"))]
        {
            let _ = (report, outcome);
            match self.never {}
        }
    }
}
