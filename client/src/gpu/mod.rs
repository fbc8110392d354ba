//! Visibility queries on a graphics adapter, behind cPLP's interface: submit, then poll.
//!
//! [`Gpu`] is an adapter and what went wrong with it. [`GpuScene`] holds a scene's triangles there, [`GpuImage`] the depths of what was
//! drawn of them in a view. [`GpuQuery`] asks which boxes can be seen past these, by one of the ways of [`GpuQueryKind`] (Klosowski &
//! Silva 2001, §3; Greene et al. 1993), and is a [`eyeline_visibility::QueryBackEnd`] like the CPU's, so that occupancy maps arrange
//! its batches too. [`GpuCuller`] is a culler over it.
//!
//! **What is promised.** A GPU rasterises with its own arithmetic, so the truth for it is its own item buffer of everything
//! ([`GpuPicture`]): nothing that owns a pixel there is lost. Boxes are drawn a little larger than they are ([`boxes`]) to keep that.
//! What is not answered, or not in time, counts as visible; so does everything once the adapter is lost, and [`GpuQuery::check`]
//! says so.

mod adapter;
pub mod boxes;
mod buffers;
mod culler;
mod image;
mod kind;
mod picture;
mod pyramid;
mod query;
mod scene;
mod tiles;
mod ways;

pub use adapter::{AdapterChoice, Gpu, GpuError, instance};
pub use culler::GpuCuller;
pub use image::GpuImage;
pub use kind::{GpuQueryKind, GpuStep};
pub use picture::GpuPicture;
pub use query::{GpuQuery, GpuQueryStats};
pub use scene::GpuScene;
