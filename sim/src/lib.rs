//! Scenes, motion, measurement and reports.

pub mod report;
