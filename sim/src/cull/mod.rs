//! What do cullers cost, and what do they get wrong? The library part of `eyeline-sim cull`.
//!
//! [`path`] says from where one looks.

pub mod path;

pub use path::{Camera, CameraPath, PathError};
