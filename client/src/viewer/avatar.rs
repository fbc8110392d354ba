//! What do people look like, and how do they move? A glTF model with a skin, posed anew for each person and frame.
//!
//! The model is made to fill the cylinder that the server promises of an avatar and never to reach out of it while it stands or
//! walks: what hides the cylinder must hide the body. glTF bodies look along +Z and avatars along −Z, so it is turned round. Which
//! clip is played is told by names (idle, walk, run) and by how fast the person goes. Nothing here knows of a GPU.

use std::path::Path;

use eyeline_visibility::{
    BONES_MAX, Bone, Clip, Curve, Joint, LoadOptions, Part, Place, Rig, Track, load_rig_file, load_rig_glb,
};
use glam::{Mat4, Quat, Vec3, Vec4};

use super::model::{Mesh, Model, ModelError, SkinCorner};

/// Most triangles of a body: some tens of times what is usual.
const TRIANGLES_MAX: u32 = 200_000;

/// Metres a second up to which one stands, and from which one runs.
const STANDS: f64 = 0.15;
const RUNS: f64 = 2.6;

/// How long one clip takes to become another, seconds.
const FADE: f32 = 0.25;

/// What people look like.
#[derive(Clone, Debug)]
pub struct Avatar {
    mesh: Mesh,
    joints: Vec<Joint>,
    bones: Vec<Bone>,
    clips: Vec<Clip>,
    /// Clips for standing, walking and running.
    gaits: [Option<usize>; 3],
    /// The avatar's space from the file's: scaled, turned and put on its feet.
    fit: Mat4,
}

impl Avatar {
    /// Loads a body for avatars of a radius about their axis and from `bottom` to `top` of their reference point. Its textures
    /// join the model's, and what it lacks the model's warnings.
    ///
    /// # Errors
    /// Names the file and what is wrong with it.
    pub fn load_file(path: &Path, model: &mut Model, radius: f64, bottom: f64, top: f64) -> Result<Avatar, ModelError> {
        let rig = load_rig_file(path, &LoadOptions::default().with_triangles_max(TRIANGLES_MAX))?;
        Avatar::new(rig, &path.display().to_string(), model, [radius, bottom, top])
    }

    /// The same from a binary file's bytes; `name` stands for the file in errors.
    ///
    /// # Errors
    /// As [`Avatar::load_file`].
    pub fn load_glb(
        bytes: &[u8],
        name: &str,
        model: &mut Model,
        radius: f64,
        bottom: f64,
        top: f64,
    ) -> Result<Avatar, ModelError> {
        let rig = load_rig_glb(bytes, name, &LoadOptions::default().with_triangles_max(TRIANGLES_MAX))?;
        Avatar::new(rig, name, model, [radius, bottom, top])
    }

    fn new(rig: Rig, file: &str, model: &mut Model, extent: [f64; 3]) -> Result<Avatar, ModelError> {
        let mut mesh = model.join(&rig.triangles, &rig.looks, file)?;
        mesh.skin = rig.carried.iter().flatten().map(SkinCorner::new).collect();
        let gaits = gaits(&rig.clips);
        let Rig { joints, bones, clips, .. } = rig;
        let mut avatar = Avatar { mesh, joints, bones, clips, gaits, fit: Mat4::IDENTITY };
        avatar.fit =
            avatar.fitted(extent.map(|metres| metres as f32)).ok_or_else(|| ModelError::NoSize(file.into()))?;
        Ok(avatar)
    }

    /// Its triangles, carried by bones.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// What takes the body into a cylinder; `None` if it has no size.
    fn fitted(&self, [radius, bottom, top]: [f32; 3]) -> Option<Mat4> {
        const LOOKS: usize = 8;
        let points = |playing: Playing| {
            let mut bones = Bones::default();
            bones.pose(self, &Motion { now: playing, before: None });
            let corners = self.mesh.vertices.iter().zip(&self.mesh.skin);
            corners.map(|(vertex, skin)| bones.carry(skin, vertex.position.into())).collect::<Vec<Vec3>>()
        };
        let bounds = |points: &[Vec3]| {
            points.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)))
        };
        let [stand, walk, run] = self.gaits;
        let (low, high) = bounds(&points(Playing { clip: stand, at: 0.0 }));
        let axis = 0.5 * (low + high);
        let (mut foot, mut head, mut reach) = (low.y, high.y, 0.0f32);
        for clip in [stand, walk, run] {
            let seconds = clip.map_or(0.0, |clip| self.clips[clip].seconds);
            for look in 0..LOOKS {
                let points = points(Playing { clip, at: seconds * look as f32 / LOOKS as f32 });
                let (low, high) = bounds(&points);
                (foot, head) = (foot.min(low.y), head.max(high.y));
                reach = points.iter().map(|p| (p.x - axis.x).hypot(p.z - axis.z)).fold(reach, f32::max);
            }
        }
        let height = head - foot;
        if !(height.is_finite() && reach.is_finite() && height > 0.0 && reach > 0.0) {
            return None;
        }
        let scale = ((top - bottom) / height).min(radius / reach);
        let down = Vec3::new(-axis.x, -foot, -axis.z);
        let fit = Mat4::from_translation(Vec3::Y * bottom)
            * Mat4::from_rotation_y(std::f32::consts::PI)
            * Mat4::from_scale(Vec3::splat(scale))
            * Mat4::from_translation(down);
        (scale > 0.0 && fit.is_finite()).then_some(fit)
    }

    /// The clip for a speed, metres a second.
    fn gait(&self, speed: f64) -> Option<usize> {
        let [stand, walk, run] = self.gaits;
        // What is no number stands.
        if speed >= RUNS {
            run
        } else if speed >= STANDS {
            walk
        } else {
            stand
        }
    }

    /// Where each joint is, relative to its parent.
    fn places(&self, playing: Playing) -> Vec<Place> {
        let mut places: Vec<Place> = self.joints.iter().map(|joint| joint.rest).collect();
        let Some(clip) = playing.clip.and_then(|clip| self.clips.get(clip)) else { return places };
        for track in &clip.tracks {
            let value = sample(track, playing.at);
            let place = &mut places[track.joint];
            match track.part {
                Part::Translation => place.translation = value.truncate(),
                Part::Scale => place.scale = value.truncate(),
                Part::Rotation => place.rotation = turn(value).unwrap_or(place.rotation),
            }
        }
        places
    }
}

/// Clips for standing, walking and running, by their names. A body that only has a walk stands as it was modelled, and one with
/// nothing but one clip without a telling name plays that.
fn gaits(clips: &[Clip]) -> [Option<usize>; 3] {
    let named =
        |words: &[&str]| clips.iter().position(|clip| words.iter().any(|word| clip.name.to_lowercase().contains(word)));
    let (walk, run) = (named(&["walk"]), named(&["run", "jog"]));
    let stand = named(&["idle", "stand", "survey", "breath"]);
    let only = (clips.len() == 1 && walk.is_none() && run.is_none()).then_some(0);
    let stand = stand.or(only);
    [stand, walk.or(run).or(stand), run.or(walk).or(stand)]
}

/// A unit quaternion; `None` if it has no direction.
fn turn(value: Vec4) -> Option<Quat> {
    let length = value.length();
    (length.is_finite() && length > 1e-6).then(|| Quat::from_vec4(value / length))
}

/// A track's value at a time (glTF, appendix C). Before the first key it is the first's, behind the last one's.
fn sample(track: &Track, at: f32) -> Vec4 {
    let Track { times, values, curve, part, .. } = track;
    let point = |key: usize| Vec4::from(if *curve == Curve::Cubic { values[3 * key + 1] } else { values[key] });
    let after = times.partition_point(|&time| time <= at);
    if after == 0 {
        return point(0);
    }
    if after == times.len() {
        return point(times.len() - 1);
    }
    let (a, b) = (after - 1, after);
    let step = times[b] - times[a];
    let t = if step > 0.0 { (at - times[a]) / step } else { 1.0 };
    match curve {
        Curve::Step => point(a),
        Curve::Linear if *part == Part::Rotation => match (turn(point(a)), turn(point(b))) {
            (Some(from), Some(to)) => Vec4::from(from.slerp(to, t)),
            _ => point(a),
        },
        Curve::Linear => point(a).lerp(point(b), t),
        Curve::Cubic => {
            let (going, coming) = (Vec4::from(values[3 * a + 2]) * step, Vec4::from(values[3 * b]) * step);
            let (t2, t3) = (t * t, t * t * t);
            point(a) * (2.0 * t3 - 3.0 * t2 + 1.0)
                + going * (t3 - 2.0 * t2 + t)
                + point(b) * (3.0 * t2 - 2.0 * t3)
                + coming * (t3 - t2)
        }
    }
}

/// A clip and how far it has come, seconds; without one the body rests.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Playing {
    clip: Option<usize>,
    at: f32,
}

/// How somebody moves at present.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    now: Playing,
    /// What it was, and for how long it still shows.
    before: Option<(Playing, f32)>,
}

impl Motion {
    /// How somebody moves who has gone at a speed for so long.
    pub fn at(avatar: &Avatar, speed: f64, seconds: f64) -> Motion {
        let clip = avatar.gait(speed);
        let mut motion = Motion { now: Playing { clip, at: 0.0 }, before: None };
        motion.go_on(avatar, speed, seconds);
        motion
    }

    /// Goes on at a speed (metres a second) for so many seconds.
    pub fn go_on(&mut self, avatar: &Avatar, speed: f64, seconds: f64) {
        let seconds = if seconds > 0.0 && seconds.is_finite() { seconds } else { 0.0 };
        let clip = avatar.gait(speed);
        if clip != self.now.clip {
            self.before = Some((self.now, FADE));
            self.now = Playing { clip, at: 0.0 };
        }
        let advance = |playing: &mut Playing| {
            let long = playing.clip.and_then(|clip| avatar.clips.get(clip)).map_or(0.0, |clip| f64::from(clip.seconds));
            playing.at = if long > 0.0 { (f64::from(playing.at) + seconds).rem_euclid(long) as f32 } else { 0.0 };
        };
        advance(&mut self.now);
        if let Some((before, left)) = &mut self.before {
            advance(before);
            *left -= seconds as f32;
        }
        self.before = self.before.filter(|(_, left)| *left > 0.0);
    }
}

/// Where the bones of everybody are in a frame: three rows each, the avatar's space from the mesh's.
#[derive(Clone, Debug, Default)]
pub struct Bones(pub(super) Vec<[[f32; 4]; 3]>);

impl Bones {
    /// Forgets the last frame's.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Where an only body's bones take a point that hangs on them: what the shader does.
    pub fn carry(&self, corner: &SkinCorner, point: Vec3) -> Vec3 {
        corner.carry(&self.0, point)
    }

    /// Adds an avatar's in a motion; returns the first one's number.
    pub fn pose(&mut self, avatar: &Avatar, motion: &Motion) -> u32 {
        let mut places = avatar.places(motion.now);
        if let Some((before, left)) = motion.before {
            let share = (left / FADE).clamp(0.0, 1.0);
            for (place, old) in places.iter_mut().zip(avatar.places(before)) {
                place.translation = place.translation.lerp(old.translation, share);
                place.scale = place.scale.lerp(old.scale, share);
                place.rotation = place.rotation.slerp(old.rotation, share).normalize();
            }
        }
        let mut of_joint: Vec<Mat4> = Vec::with_capacity(places.len());
        for (joint, place) in avatar.joints.iter().zip(&places) {
            let above = joint.parent.map_or(avatar.fit, |parent| of_joint[parent]);
            of_joint.push(above * place.matrix());
        }
        debug_assert!(avatar.bones.len() <= BONES_MAX, "the loader refuses more");
        let first = self.0.len() as u32;
        self.0.extend(avatar.bones.iter().map(|bone| {
            let matrix = of_joint[bone.joint] * bone.joint_from_mesh;
            [0, 1, 2].map(|row| matrix.row(row).to_array())
        }));
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(part: Part, curve: Curve, times: &[f32], values: &[[f32; 4]]) -> Track {
        Track { joint: 0, part, times: times.to_vec(), values: values.to_vec(), curve }
    }

    #[test]
    fn tracks_are_sampled_as_the_specification_says() {
        let values = [[0.0; 4], [2.0, 4.0, 6.0, 0.0]];
        let linear = track(Part::Translation, Curve::Linear, &[1.0, 3.0], &values);
        let at = |track: &Track, at: f32| sample(track, at).truncate().to_array();
        assert_eq!(at(&linear, 0.0), [0.0; 3]);
        assert_eq!(at(&linear, 1.5), [0.5, 1.0, 1.5]);
        assert_eq!(at(&linear, 9.0), [2.0, 4.0, 6.0]);
        let step = Track { curve: Curve::Step, ..linear.clone() };
        assert_eq!(at(&step, 2.9), [0.0; 3]);
        // A spline without tangents is half way at half time; with them it leaves along them.
        let [zero, one] = values;
        let cubic = track(Part::Translation, Curve::Cubic, &[1.0, 3.0], &[zero, zero, zero, zero, one, zero]);
        assert_eq!(at(&cubic, 2.0), [1.0, 2.0, 3.0]);
        let leaving = track(Part::Scale, Curve::Cubic, &[0.0, 1.0], &[zero, zero, one, zero, zero, zero]);
        let slope = (sample(&leaving, 1e-3) / 1e-3).truncate();
        assert!(slope.abs_diff_eq(Vec3::new(2.0, 4.0, 6.0), 0.05), "{slope}");
        // Rotations take the shorter way: these two are 90° apart by sign.
        let turned = Quat::from_rotation_y(1.0);
        let turns = [[0.0, 0.0, 0.0, 1.0], (-Vec4::from(turned)).to_array()];
        let found = turn(sample(&track(Part::Rotation, Curve::Linear, &[0.0, 1.0], &turns), 0.5)).unwrap();
        assert!(found.angle_between(Quat::from_rotation_y(0.5)) < 1e-3);
        assert_eq!(turn(Vec4::ZERO), None);
    }

    #[test]
    fn clips_are_chosen_by_name() {
        let clips = |names: &[&str]| -> Vec<Clip> {
            names.iter().map(|name| Clip { name: (*name).into(), seconds: 1.0, tracks: Vec::new() }).collect()
        };
        assert_eq!(gaits(&clips(&["Survey", "Walk", "Run"])), [Some(0), Some(1), Some(2)]);
        assert_eq!(gaits(&clips(&["Walking", "Armature|Idle"])), [Some(1), Some(0), Some(0)]);
        assert_eq!(gaits(&clips(&["take 1"])), [Some(0); 3]);
        assert_eq!(gaits(&clips(&["walk"])), [None, Some(0), Some(0)]);
        assert_eq!(gaits(&clips(&["dance", "wave"])), [None; 3]);
        assert_eq!(gaits(&[]), [None; 3]);
    }
}
