//! The viewer: draws what the core says is visible, and shows how it came to that.
//!
//! [`gpu`] finds an adapter, `model` joins a scene with its looks, `renderer` draws a visible set, `overlay` what is drawn over it,
//! `picture` puts both into an image. `sight` is the culler that decides what is drawn: the viewer never does. `avatar` is what
//! people look like. `inspect` shows cells, tiles and bounds, and `charts` numbers over time.
//!
//! `shot` makes a picture without a window and `film` many, with what `staging` puts into them. `view` opens a window: `viewing` is
//! the world as it is looked at, with a `player` who can `walk`, `online` its connection, and `record` keeps the way that was gone. `surface` says
//! what to do where a window gives no image.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

pub mod avatar;
pub mod charts;
pub mod film;
pub mod font;
pub mod inspect;
pub mod model;
pub mod online;
pub mod overlay;
pub mod picture;
mod pipelines;
pub mod player;
pub mod record;
pub mod renderer;
pub mod shot;
pub mod sight;
pub mod staging;
mod surface;
mod textures;
pub mod view;
pub mod viewing;
pub mod walk;
pub mod window;

pub use crate::gpu;
