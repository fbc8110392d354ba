//! `view --record`: the way that somebody walked, as a camera path.

use std::path::Path;

use eyeline_visibility::{Camera, CameraPath, View};
use glam::DVec3;

/// Cameras a second: smooth enough to be filmed, and a thousand of a minute's few.
const HZ: f64 = 30.0;

/// Most cameras kept, as many as a path may have: nine hours.
const CAMERAS_MAX: usize = 1_000_000;

/// What one looked through: the eye in the file's metres, yaw and pitch in radians.
#[derive(Clone, Copy, Debug)]
struct Looked {
    eye: DVec3,
    yaw: f64,
    pitch: f64,
}

impl Looked {
    /// On the way to another, by the shorter turn.
    fn towards(&self, other: &Looked, share: f64) -> Camera {
        use std::f64::consts::{PI, TAU};
        let turn = (other.yaw - self.yaw + PI).rem_euclid(TAU) - PI;
        let pitch = self.pitch + (other.pitch - self.pitch) * share;
        Camera::rounded(self.eye.lerp(other.eye, share), (self.yaw + turn * share).rem_euclid(TAU), pitch)
    }
}

/// Keeps cameras at even times, whatever the frames' times are.
#[derive(Debug, Default)]
pub struct Recorder {
    cameras: Vec<Camera>,
    fov_x: f64,
    near: f64,
    resolution: [u32; 2],
    last: Option<Looked>,
    /// Time since the last camera that was kept, at the last frame; seconds.
    since: f64,
}

impl Recorder {
    /// A frame, `seconds` after the last one, looked through `view` with its eye relative to `anchor`.
    pub fn add(&mut self, view: &View, anchor: DVec3, [yaw, pitch]: [f64; 2], seconds: f64) {
        let looked = Looked { eye: view.eye + anchor, yaw, pitch };
        (self.fov_x, self.near) = (view.fov_x, view.near);
        self.resolution = [view.resolution.width, view.resolution.height];
        let Some(last) = self.last.replace(looked) else {
            self.cameras.push(looked.towards(&looked, 0.0));
            return;
        };
        // Half a minute without a frame is a machine that slept, not a way.
        if !(seconds > 0.0 && seconds < 30.0) {
            return;
        }
        let began = self.since;
        self.since += seconds;
        while self.since >= 1.0 / HZ && self.cameras.len() < CAMERAS_MAX {
            self.since -= 1.0 / HZ;
            let share = 1.0 - self.since / seconds;
            self.cameras.push(last.towards(&looked, share.clamp(0.0, 1.0)));
        }
        debug_assert!(began < 1.0 / HZ || self.cameras.len() == CAMERAS_MAX);
    }

    /// The path, if anything was seen.
    pub fn path(&self) -> Option<CameraPath> {
        let sane = self.resolution.iter().all(|pixels| (1..=8192).contains(pixels));
        let path = CameraPath {
            fov_x_degrees: (self.fov_x.to_degrees() * 1e3).round() / 1e3,
            near: self.near,
            resolution: sane.then_some(self.resolution),
            hz: Some(HZ),
            cameras: self.cameras.clone(),
        };
        (!self.cameras.is_empty()).then_some(path)
    }

    /// Writes the path; says how long it is.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, file: &Path) -> anyhow::Result<String> {
        let Some(path) = self.path() else { anyhow::bail!("nothing was seen, so that there is no path to write") };
        path.write(file)?;
        let seconds = (path.cameras.len() - 1) as f64 / HZ;
        Ok(format!("{}: {} cameras, {seconds:.1} s", file.display(), path.cameras.len()))
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::Resolution;

    use super::*;

    #[test]
    fn cameras_are_kept_at_even_times_however_frames_come() {
        let mut recorder = Recorder::default();
        let anchor = DVec3::new(100.0, 0.0, 0.0);
        let (mut x, mut time) = (0.0, 0.0);
        for number in 0..200 {
            let seconds = if number == 0 { 0.0 } else { [0.007, 0.11, 0.02][number % 3] };
            (x, time) = (x + 1.5 * seconds, time + seconds);
            let view = View::level(DVec3::new(x, 1.6, 0.0), 0.0, 1.2, Resolution::new(64, 48));
            // Turns to the left across the seam at a full turn.
            recorder.add(&view, anchor, [(6.0 + 0.1 * time).rem_euclid(std::f64::consts::TAU), 0.0], seconds);
        }
        let path = recorder.path().unwrap();
        assert_eq!((path.hz, path.resolution), (Some(30.0), Some([64, 48])));
        assert_eq!(path.cameras.len(), (time * 30.0) as usize + 1);
        for (number, camera) in path.cameras.iter().enumerate() {
            let at = number as f64 / 30.0;
            assert!((camera.eye[0] - 100.0 - 1.5 * at).abs() < 2e-4, "{number}: {:?}", camera.eye);
            let yaw = (6.0 + 0.1 * at).to_degrees().rem_euclid(360.0);
            assert!((camera.yaw_degrees - yaw).abs() < 2e-3, "{number}: {}", camera.yaw_degrees);
        }
        assert!(Recorder::default().path().is_none());
    }

    #[test]
    fn times_that_are_none_keep_nothing() {
        let mut recorder = Recorder::default();
        let view = View::level(DVec3::ZERO, 0.0, 1.2, Resolution::new(64, 48));
        for seconds in [0.0, f64::NAN, -1.0, 1e9, f64::INFINITY] {
            recorder.add(&view, DVec3::ZERO, [0.0; 2], seconds);
        }
        assert_eq!(recorder.path().unwrap().cameras.len(), 1);
    }
}
