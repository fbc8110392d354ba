//! Scenes that we make ourselves, as the same files that a given scene would be: a `.glb` and its `.world.toml`.
//!
//! A maker is a pure function from rules and a seed to bytes, so a scene needs no file in the repository and every process
//! of a run can rebuild what it must know (doors and obstacles for walkers) from the rules alone. [`plan`] decides where
//! everything is, [`rooms`] gives it walls, furniture and moving chairs, and [`glb`] writes it down. [`building`] is the
//! same plan at the size of the culling figures, with [`furniture`] to find; [`office`] and [`tower`] are cPLP's two models in
//! spirit, [`city`], [`engine`] and [`seminar`] are PLP's, and [`vessels`] hide nothing.

pub mod building;
pub mod city;
pub mod engine;
pub mod furniture;
pub mod glb;
pub mod made;
pub mod office;
pub mod patch;
pub mod plan;
pub mod rooms;
pub mod seminar;
pub mod tower;
pub mod vessels;
