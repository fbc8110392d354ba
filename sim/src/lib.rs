//! Scenes, motion, measurement and reports.
