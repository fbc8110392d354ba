//! Camera paths: views as a file that can be recorded, replayed and filmed, and on which cullers are compared.
//!
//! ```json
//! {"fov_x_degrees": 90.0, "near": 0.01, "cameras": [{"eye": [3.0, 1.6, 3.0], "yaw_degrees": 45.0, "pitch_degrees": 0.0}]}
//! ```
//! Eyes are in the file's space (metres), not relative to a scene's anchor, so that a path outlives a change of anchor. A
//! path may name its `resolution`, `[width, height]` in pixels; a run may choose others. One that was walked says how many cameras
//! there are to a second, `hz`.
//!
//! Made cameras are multiples of 0.1 mm and 0.001°: so few digits read back to the same f64, and a replay sees the very same
//! views.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::{Resolution, View};

/// Farthest coordinate of an eye, in metres: the width of a world (DESIGN §6).
const FAR: f64 = 2e6;

/// Most cameras of a path: what a run of a day could look through.
const CAMERAS_MAX: usize = 1_000_000;

/// Widest and narrowest angle of view, degrees.
const FOV: std::ops::RangeInclusive<f64> = 0.1..=179.0;

/// Fewest and most cameras a second.
const HZ: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Where one stands and looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// The eye in the file's space, metres.
    pub eye: [f64; 3],
    /// Turn about the vertical axis: 0 looks along −Z, positive turns left.
    pub yaw_degrees: f64,
    /// Then up from the horizon; −90 looks straight down.
    #[serde(default)]
    pub pitch_degrees: f64,
}

/// Cameras, and the angle of view that they share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPath {
    /// Full horizontal angle of view. Default 90.
    #[serde(default = "ninety")]
    pub fov_x_degrees: f64,
    /// Distance of the near plane, metres. Default 0.01.
    #[serde(default = "centimetre")]
    pub near: f64,
    /// Width and height in pixels that the path was meant for, if it says.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<[u32; 2]>,
    /// Cameras a second, if they were recorded in time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hz: Option<f64>,
    /// In the order in which they are looked through.
    pub cameras: Vec<Camera>,
}

/// Why a file is not a camera path.
#[derive(Debug, thiserror::Error)]
pub enum CameraPathError {
    /// The file cannot be read or written.
    #[error("cannot {verb} camera path {path}: {source}")]
    File {
        /// `read` or `write`.
        verb: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not JSON of the right shape.
    #[error("{path} is not a camera path: {source}")]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        source: serde_json::Error,
    },
    /// Its values cannot be used.
    #[error("{path}: {what}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Which value, and what would be right.
        what: String,
    },
}

fn ninety() -> f64 {
    90.0
}

fn centimetre() -> f64 {
    0.01
}

impl Camera {
    /// The camera with its numbers rounded so that a file keeps them: 0.1 mm and 0.001°.
    pub fn rounded(eye: DVec3, yaw: f64, pitch: f64) -> Camera {
        let degrees = |angle: f64| (angle.to_degrees() * 1e3).round() / 1e3;
        let eye = eye.to_array().map(|metres| (metres * 1e4).round() / 1e4);
        Camera { eye, yaw_degrees: degrees(yaw), pitch_degrees: degrees(pitch) }
    }
}

/// A place on a way: its share of the way, the eye (metres, in the file's space), yaw and pitch (radians).
pub type CameraStop = (f64, DVec3, f64, f64);

impl CameraPath {
    /// A path of 90° views.
    pub fn new(cameras: Vec<Camera>) -> CameraPath {
        CameraPath { fov_x_degrees: ninety(), near: centimetre(), resolution: None, hz: None, cameras }
    }

    /// `count` 90° views evenly along a way through `stops` (at least two, by their share of the way, from 0 to 1): straight from
    /// one to the next.
    pub fn through(stops: &[CameraStop], count: u32) -> CameraPath {
        let camera = |number: u32| {
            let share = f64::from(number) / f64::from(count.max(2) - 1);
            let next = stops.iter().position(|stop| stop.0 >= share).unwrap_or(stops.len() - 1).max(1);
            let (from, to) = (stops[next - 1], stops[next]);
            let t = ((share - from.0) / (to.0 - from.0)).clamp(0.0, 1.0);
            let mix = |a: f64, b: f64| a + (b - a) * t;
            Camera::rounded(from.1.lerp(to.1, t), mix(from.2, to.2), mix(from.3, to.3))
        };
        CameraPath::new((0..count).map(camera).collect())
    }

    /// The views of a scene with this anchor, at a resolution.
    pub fn views(&self, anchor: DVec3, resolution: Resolution) -> Vec<View> {
        let view = |camera: &Camera| View {
            eye: DVec3::from(camera.eye) - anchor,
            orientation: DQuat::from_rotation_y(camera.yaw_degrees.to_radians())
                * DQuat::from_rotation_x(camera.pitch_degrees.to_radians()),
            fov_x: self.fov_x_degrees.to_radians(),
            resolution,
            near: self.near,
        };
        self.cameras.iter().map(view).collect()
    }

    /// Reads and checks a file. There is at least one camera in the result.
    pub fn read(path: &Path) -> Result<CameraPath, CameraPathError> {
        let file = |source| CameraPathError::File { verb: "read", path: path.into(), source };
        let text = std::fs::read_to_string(path).map_err(file)?;
        let parsed: CameraPath =
            serde_json::from_str(&text).map_err(|source| CameraPathError::Parse { path: path.into(), source })?;
        match parsed.check() {
            Ok(()) => Ok(parsed),
            Err(what) => Err(CameraPathError::Value { path: path.into(), what }),
        }
    }

    /// The cameras beside a model (`building.glb`, `building.cameras.json`); `None` if there is no such file.
    pub fn beside(model: &Path) -> Result<Option<CameraPath>, CameraPathError> {
        match CameraPath::read(&model.with_extension("cameras.json")) {
            Err(CameraPathError::File { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
            result => result.map(Some),
        }
    }

    /// Writes a file that [`CameraPath::read`] reads.
    pub fn write(&self, path: &Path) -> Result<(), CameraPathError> {
        let file = |source| CameraPathError::File { verb: "write", path: path.into(), source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(file)?;
        }
        std::fs::write(path, self.json()).map_err(file)
    }

    /// The file's bytes: one camera a line, so that a difference of two paths can be read.
    pub fn json(&self) -> Vec<u8> {
        let head = CameraPath { cameras: Vec::new(), ..self.clone() };
        let head = serde_json::to_string(&head).unwrap_or_default();
        let cameras: Vec<String> =
            self.cameras.iter().map(|camera| serde_json::to_string(camera).unwrap_or_default()).collect();
        let head = head.trim_end_matches("]}");
        format!("{head}\n{}\n]}}\n", cameras.join(",\n")).into_bytes()
    }

    fn check(&self) -> Result<(), String> {
        if !FOV.contains(&self.fov_x_degrees) {
            return Err(format!("`fov_x_degrees` is {}; give 0.1 to 179", self.fov_x_degrees));
        }
        if !(1e-6..=1e3).contains(&self.near) {
            return Err(format!("`near` is {}; give 1e-6 to 1000 metres", self.near));
        }
        if self.resolution.is_some_and(|size| size.iter().any(|pixels| !(1..=8192).contains(pixels))) {
            return Err("`resolution` must be 1 to 8192 pixels each way".into());
        }
        if self.hz.is_some_and(|hz| !HZ.contains(&hz)) {
            return Err("`hz` must be 0.001 to 1000 cameras a second".into());
        }
        if self.cameras.is_empty() || self.cameras.len() > CAMERAS_MAX {
            return Err(format!("`cameras` has {} entries; give 1 to {CAMERAS_MAX}", self.cameras.len()));
        }
        for (number, camera) in self.cameras.iter().enumerate() {
            if let Some(metres) = camera.eye.iter().find(|metres| !(-FAR..=FAR).contains(*metres)) {
                return Err(format!("cameras[{number}] has an eye at {metres}; give metres, at most {FAR}"));
            }
            let angles = [camera.yaw_degrees, camera.pitch_degrees];
            if let Some(degrees) = angles.iter().find(|degrees| !(-3600.0..=3600.0).contains(*degrees)) {
                return Err(format!("cameras[{number}] has an angle of {degrees}°; give -3600 to 3600"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    #[test]
    fn made_cameras_read_back_bit_for_bit() {
        let mut chance = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let cameras: Vec<Camera> = (0..2_000)
            .map(|_| {
                let eye = DVec3::from_array(std::array::from_fn(|_| chance.random_range(-200.0..200.0)));
                Camera::rounded(eye, chance.random_range(-7.0..7.0), chance.random_range(-1.5..1.5))
            })
            .collect();
        let path = CameraPath { resolution: Some([1024, 512]), hz: Some(30.0), ..CameraPath::new(cameras) };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("deep/path.json");
        path.write(&file).unwrap();
        assert_eq!(CameraPath::read(&file).unwrap(), path);
        assert_eq!(std::fs::read_to_string(&file).unwrap().lines().count(), 2_002);
    }

    #[test]
    fn views_look_where_the_camera_says() {
        let camera = Camera { eye: [1.0, 2.0, 3.0], yaw_degrees: 90.0, pitch_degrees: -90.0 };
        let path = CameraPath::new(vec![Camera { pitch_degrees: 0.0, ..camera }, camera]);
        let views = path.views(DVec3::ONE, Resolution::new(4, 2));
        assert_eq!(views[0].eye, DVec3::new(0.0, 1.0, 2.0));
        assert!((views[0].orientation * DVec3::NEG_Z).distance(DVec3::NEG_X) < 1e-12);
        assert!((views[1].orientation * DVec3::NEG_Z).distance(DVec3::NEG_Y) < 1e-12);
        assert_eq!(views[0].fov_x, std::f64::consts::FRAC_PI_2);
    }

    #[test]
    fn bad_files_are_named_with_value_and_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("walk.json");
        for (text, part) in [
            ("", "EOF"),
            ("{\"cameras\": []}", "0 entries"),
            ("{\"cameras\": [{\"eye\": [0, 0, NaN], \"yaw_degrees\": 0}]}", "line 1"),
            ("{\"cameras\": [{\"eye\": [0, 0, 1e7], \"yaw_degrees\": 0}]}", "cameras[0] has an eye at 10000000"),
            ("{\"cameras\": [{\"eye\": [0, 0, 0], \"yaw_degrees\": 1e6}]}", "angle of 1000000°"),
            ("{\"fov_x_degrees\": 180, \"cameras\": []}", "`fov_x_degrees` is 180"),
            ("{\"near\": 0, \"cameras\": []}", "`near` is 0"),
            ("{\"resolution\": [0, 5], \"cameras\": []}", "`resolution`"),
            ("{\"hz\": 0, \"cameras\": []}", "`hz`"),
            ("{\"camera\": []}", "unknown field"),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = CameraPath::read(&file).unwrap_err().to_string();
            assert!(error.contains("walk.json") && error.contains(part), "{error}");
        }
        assert!(CameraPath::beside(&folder.path().join("no.glb")).unwrap().is_none());
    }
}
