//! `world.toml`: what moves in a world, and where avatars may stand.
//!
//! The file lies beside the model and has its name with the ending `.world.toml` (`rooms.glb`, `rooms.world.toml`), or
//! is named outright. Without it everything is static and avatars spawn at the middle of the scene.

use serde::{Deserialize, Serialize};

/// The whole file. All lengths in metres, speeds in metres a second, angles in radians, times in seconds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSpec {
    /// A name for people.
    pub name: String,
    /// Whether every face of the model has two sides, whatever its material says: for game maps.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub two_sided: bool,
    /// What an avatar is like.
    pub avatar: AvatarSpec,
    /// Where avatars start.
    #[serde(rename = "spawn")]
    pub spawns: Vec<SpawnSpec>,
    /// Kinds of moving things, named by `objects`.
    #[serde(rename = "class")]
    pub classes: Vec<ClassSpec>,
    /// Things that move, or can be moved.
    #[serde(rename = "object")]
    pub objects: Vec<ObjectSpec>,
}

/// An avatar: an upright cylinder around its feet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AvatarSpec {
    /// Radius of the cylinder around the vertical axis through the feet.
    pub radius: f64,
    /// Height of the cylinder above the feet.
    pub height: f64,
    /// Height of the eye above the feet.
    pub eye_height: f64,
    /// Greatest speed.
    pub speed_max: f64,
    /// Greatest rate of turn about the vertical. 2π by default: a natural turn of the head peaks at about a turn a second,
    /// while one flick of a mouse may be faster and then is committed over a few ticks. `inf` for no bound; `interest =
    /// frustum` needs one.
    pub turn_max: f64,
}

impl Default for AvatarSpec {
    fn default() -> AvatarSpec {
        AvatarSpec { radius: 0.3, height: 1.75, eye_height: 1.6, speed_max: 2.0, turn_max: std::f64::consts::TAU }
    }
}

/// A place for an avatar to start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpawnSpec {
    /// The feet.
    pub position: [f64; 3],
    /// Turn about +Y; 0 looks along −Z.
    #[serde(default)]
    pub heading: f64,
}

/// A kind of moving thing: an upright cylinder around its reference point that contains its mesh at every turn about
/// the vertical axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassSpec {
    /// Name, used by objects.
    pub name: String,
    /// Radius around the vertical axis through the reference point.
    pub radius: f64,
    /// Lowest point relative to the reference point.
    #[serde(default)]
    pub bottom: f64,
    /// Highest point relative to the reference point.
    pub top: f64,
    /// Greatest speed of the reference point.
    pub speed_max: f64,
}

/// A thing that moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// A name for people, and the name of its node in the model unless `node` says another.
    pub name: String,
    /// Name of its [`ClassSpec`].
    pub class: String,
    /// The model's node that holds its mesh; the node's origin is the reference point. That node and its children are
    /// then not part of the static scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// Reference point at rest.
    pub position: [f64; 3],
    /// Turn about +Y at rest.
    #[serde(default)]
    pub heading: f64,
    /// Whether people may take it and move it; held to its class's speed. What was taken no longer follows its path.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub takeable: bool,
    /// How it moves by itself, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathSpec>,
}

/// Motion along a preset path, there and back for ever (S&G Fig. 4: chairs to and from a table).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathSpec {
    /// Corners of the path, at least two.
    pub points: Vec<[f64; 3]>,
    /// Speed along the path, wobble apart.
    pub speed: f64,
    /// Rest at each end.
    #[serde(default)]
    pub pause: f64,
    /// How much of the cycle has passed at time 0, as a share of it: 0 to 1.
    #[serde(default)]
    pub phase: f64,
    /// Sideways swing while moving: amplitude.
    #[serde(default)]
    pub wobble: f64,
    /// Swings a metre of path.
    #[serde(default)]
    pub wobble_per_metre: f64,
    /// By what it hangs on its path, if it does not follow it to the point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spring: Option<SpringSpec>,
}

/// A spring and a damper between a thing and its path: it is drawn to where the path has it, and no faster than its class.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpringSpec {
    /// 1/ω: the shorter, the stiffer. 1e-9 to 1e9 seconds; whatever it is, steps of any length are stable.
    pub time_constant: f64,
    /// ζ: 1, the default, comes to rest soonest without swinging; less swings, 0 for ever.
    #[serde(default = "critical")]
    pub damping: f64,
    /// A wall that it stops at, wherever its path goes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<WallSpec>,
}

fn critical() -> f64 {
    1.0
}

/// A wall: a half-space that a thing's reference point does not enter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallSpec {
    /// Any point of its face.
    pub point: [f64; 3],
    /// Away from the wall, of any length.
    pub normal: [f64; 3],
    /// The share of its speed that a bounce keeps: 0, the default, to 1.
    #[serde(default)]
    pub restitution: f64,
}
