//! People who look like something: skins, clips, and what a body may be.

use eyeline_client::viewer::avatar::{Avatar, Bones, Motion};
use eyeline_client::viewer::gpu::Gpu;
use eyeline_client::viewer::model::{Mesh, Model};
use eyeline_client::viewer::overlay::Overlay;
use eyeline_client::viewer::picture::{FORMAT, Stage};
use eyeline_client::viewer::renderer::{Frame, Moving, Shade};
use eyeline_client::viewer::shot::looking_along;
use eyeline_client::viewer::sight::{CullerKind, Sight};
use eyeline_visibility::{LoadOptions, Resolution, View};
use glam::{DQuat, DVec3, Vec3};
use image::RgbaImage;

use crate::{given_scene, golden, gpu_or_skip, made};

const RADIUS: f64 = 0.35;
const HEIGHT: f64 = 1.75;

fn rooms() -> Model {
    Model::load_glb(&made::two_rooms(0), "two rooms", &LoadOptions::default()).unwrap()
}

/// A picture of the west room with somebody in it who looks to the right and a little towards us.
fn picture(gpu: &Gpu, model: &Model, mesh: Mesh, bones: Option<Bones>, shade: Shade, distance: f64) -> RgbaImage {
    let mut stage = Stage::new(gpu, model, &[mesh], FORMAT).unwrap();
    let feet = DVec3::new(-2.2, 0.0, 0.4);
    let eye = feet + DVec3::new(0.0, 0.9, distance);
    let orientation = looking_along(DVec3::new(0.0, -0.3, -1.0)).unwrap();
    let view = View { eye, orientation, fov_x: 1.3, resolution: Resolution::new(240, 240), near: 0.05 };
    let mut sight = Sight::new(CullerKind::Masked, &model.scene);
    let first_bone = bones.is_some().then_some(0);
    stage.renderer.bones = bones.unwrap_or_default();
    stage.renderer.shade = shade;
    let orientation = DQuat::from_rotation_y(-2.2);
    let moving = [Moving { mesh: model.objects.len(), position: feet, orientation, tint: [1.0; 3], first_bone }];
    let visible = &sight.look(&view).visible;
    stage.picture(gpu, &Frame { view, visible, moving: &moving }, &Overlay::default()).unwrap().0
}

fn posed(avatar: &Avatar, speed: f64, seconds: f64) -> Bones {
    let mut bones = Bones::default();
    assert_eq!(bones.pose(avatar, &Motion::at(avatar, speed, seconds)), 0);
    bones
}

/// Where the bones take each corner, computed here.
fn corners(avatar: &Avatar, bones: &Bones) -> Vec<Vec3> {
    let mesh = avatar.mesh();
    mesh.vertices.iter().zip(&mesh.skin).map(|(vertex, skin)| bones.carry(skin, vertex.position.into())).collect()
}

/// The shader against the processor, by depth alone: positions are the same, and so is the picture.
fn compare(gpu: &Gpu, model: &Model, avatar: &Avatar) {
    for (speed, seconds) in [(0.0, 0.0), (1.4, 0.3), (1.4, 0.55)] {
        let bones = posed(avatar, speed, seconds);
        let mut rigid = avatar.mesh().clone();
        for (vertex, place) in rigid.vertices.iter_mut().zip(corners(avatar, &bones)) {
            vertex.position = place.to_array();
        }
        rigid.skin.clear();
        let expected = picture(gpu, model, rigid, None, Shade::Depth, 1.1);
        let found = picture(gpu, model, avatar.mesh().clone(), Some(bones), Shade::Depth, 1.1);
        let share = golden::differing_share(&expected, &found);
        assert!(share < 0.001, "{speed} m/s, {seconds} s: {share}");
        let nobody = picture(gpu, model, Mesh::default(), None, Shade::Depth, 1.1);
        assert!(golden::differing_share(&expected, &nobody) > 0.003, "there is somebody to be seen");
    }
}

/// The cylinder that hides a body must hide all of it, however it stands or walks.
fn assert_fits(avatar: &Avatar) {
    let mut filled = false;
    for (speed, seconds) in [(0.0, 0.0), (0.0, 0.7), (1.4, 0.25), (1.4, 0.5), (4.0, 0.1)] {
        for place in corners(avatar, &posed(avatar, speed, seconds)) {
            let (across, up) = (f64::from(place.x.hypot(place.z)), f64::from(place.y));
            assert!(across <= 1.03 * RADIUS && (-0.03 * HEIGHT..=1.03 * HEIGHT).contains(&up), "{place}");
            filled |= across > 0.95 * RADIUS || up > 0.95 * HEIGHT;
        }
    }
    assert!(filled, "it is as large as it may be");
}

#[test]
fn a_body_bends_as_its_bones_do() {
    let Some(gpu) = gpu_or_skip("a_body_bends_as_its_bones_do") else { return };
    let mut model = rooms();
    let avatar = Avatar::load_glb(&made::body(), "body.glb", &mut model, RADIUS, 0.0, HEIGHT).unwrap();
    assert_fits(&avatar);
    compare(&gpu, &model, &avatar);
    let stands = picture(&gpu, &model, avatar.mesh().clone(), Some(posed(&avatar, 0.0, 0.4)), Shade::Lit, 1.1);
    let walks = picture(&gpu, &model, avatar.mesh().clone(), Some(posed(&avatar, 1.4, 0.4)), Shade::Lit, 1.1);
    golden::check("avatar-stands", &stands);
    golden::check("avatar-walks", &walks);
    assert!(golden::differing_share(&stands, &walks) > 0.01);
}

#[test]
fn one_clip_becomes_the_other_little_by_little() {
    let mut model = rooms();
    let avatar = Avatar::load_glb(&made::body(), "body.glb", &mut model, RADIUS, 0.0, HEIGHT).unwrap();
    let head = |motion: &Motion| {
        let mut bones = Bones::default();
        bones.pose(&avatar, motion);
        corners(&avatar, &bones).into_iter().map(|place| place.y).fold(0.0, f32::max)
    };
    let mut motion = Motion::at(&avatar, 1.4, 0.5);
    let bowed = head(&motion);
    motion.go_on(&avatar, 0.0, 0.0);
    let mut before = head(&motion);
    assert!((before - bowed).abs() < 1e-3, "{before} {bowed}");
    for _ in 0..10 {
        motion.go_on(&avatar, 0.0, 0.03);
        let now = head(&motion);
        assert!(now >= before - 0.02 && now - before < 0.4, "{before} {now}");
        before = now;
    }
    assert!((before - head(&Motion::at(&avatar, 0.0, 0.0))).abs() < 1e-5);
    // Speeds and times that are none stand still.
    for bad in [f64::NAN, -1.0] {
        motion.go_on(&avatar, bad, bad);
        assert_eq!(head(&motion), before);
    }
}

#[test]
fn a_file_that_is_no_body_is_refused_by_name() {
    let mut model = rooms();
    let textures = model.textures.len();
    let mut refused = |bytes: &[u8]| {
        let error = Avatar::load_glb(bytes, "body.glb", &mut model, RADIUS, 0.0, HEIGHT).unwrap_err().to_string();
        assert!(error.contains("body.glb"), "{error}");
        error
    };
    refused(b"");
    refused(b"glTF");
    refused(&made::body()[..2_000]);
    // A body of no size: a joint shrinks it to a point.
    assert!(refused(&made::body_with(r#","scale":[0,0,0]"#)).contains("no size"));
    assert_eq!(model.textures.len(), textures, "what is refused leaves nothing behind");
}

#[test]
fn a_fox_walks() {
    let Some(path) = given_scene("a_fox_walks", "Fox.glb") else { return };
    let Some(gpu) = gpu_or_skip("a_fox_walks") else { return };
    let mut model = rooms();
    let avatar = Avatar::load_file(&path, &mut model, RADIUS, 0.0, HEIGHT).unwrap();
    assert_fits(&avatar);
    compare(&gpu, &model, &avatar);
    let walks = picture(&gpu, &model, avatar.mesh().clone(), Some(posed(&avatar, 1.4, 0.2)), Shade::Lit, 0.8);
    golden::check("avatar-fox", &walks);
}

#[test]
fn a_robot_stands() {
    let Some(path) = given_scene("a_robot_stands", "HubsDefaultAvatar.glb") else { return };
    let Some(gpu) = gpu_or_skip("a_robot_stands") else { return };
    let mut model = rooms();
    let avatar = Avatar::load_file(&path, &mut model, RADIUS, 0.0, HEIGHT).unwrap();
    assert_fits(&avatar);
    compare(&gpu, &model, &avatar);
    let stands = picture(&gpu, &model, avatar.mesh().clone(), Some(posed(&avatar, 0.0, 0.2)), Shade::Lit, 1.1);
    golden::check("avatar-hubs", &stands);
}
