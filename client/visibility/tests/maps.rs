//! Which share of (viewer, avatar) pairs of the game maps can an image tell to be hidden? FACTS.md has the figures of the
//! best conservative CPU culler (MOC) and of exact visibility, with the same boxes and eye height.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use eyeline_visibility::{
    Aabb, Bound, ItemBuffer, LoadOptions, MaskedCplp, MaskedCplpScratch, Occlusion, Scene, Sides, Triangle, View,
    load_file,
};
use glam::{DQuat, DVec3};

const AVATAR: DVec3 = DVec3::new(0.9375, 1.75, 0.9375);
const EYE_HEIGHT: f64 = 1.4375;

/// A map and its places, relative to the scene's anchor; `None` if there are none here.
fn map(name: &str) -> Option<(Scene, Vec<DVec3>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("EYELINE_DATA").map_or(root.join("../shared/data"), PathBuf::from);
    let file = data.join("scenes").join(name).with_extension("glb");
    if !file.exists() {
        eprintln!("skipped: no {} (set EYELINE_DATA)", file.display());
        return None;
    }
    let all = load_file(&file, &LoadOptions::default()).unwrap();
    let doors = all.nodes().iter().map(|node| node.name.clone()).filter(|name| name.starts_with("door"));
    let options = LoadOptions::default().with_moving_nodes(doors).with_two_sided(true);
    let scene = load_file(&file, &options).unwrap();
    let text = std::fs::read(file.with_extension("places.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let places = json["places"].as_array().unwrap().iter();
    let places = places.map(|place| DVec3::from_array([0, 1, 2].map(|i| place["position"][i].as_f64().unwrap())));
    let places = places.map(|feet| feet - scene.anchor()).collect();
    Some((scene, places))
}

/// The twelve triangles of a box.
fn triangles(aabb: &Aabb) -> Vec<Triangle> {
    let corner = aabb.corners();
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
        .into_iter()
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
        .map(|corners| Triangle { corners: corners.map(|i| corner[i].as_vec3()), sides: Sides::Both, occludes: true })
        .collect()
}

/// Shares of pairs that may be seen and that are: of every `step`th viewer, four level views of 90° by 90°.
fn shares(name: &str, step: usize) -> Option<[f64; 2]> {
    let (scene, places) = map(name)?;
    let scene = Arc::new(scene);
    let culler = MaskedCplp::build(scene.clone());
    let mut scratch = MaskedCplpScratch::default();
    let (mut pairs, mut kept, mut seen) = (0_usize, 0_usize, 0_usize);
    for (viewer, feet) in places.iter().enumerate().step_by(step) {
        let avatars: Vec<Aabb> = (places.iter().enumerate())
            .filter(|&(other, _)| other != viewer)
            .map(|(_, feet)| Aabb::around(*feet + DVec3::Y * AVATAR.y * 0.5, AVATAR * 0.5))
            .collect();
        let (mut hidden, mut shown) = (vec![true; avatars.len()], vec![false; avatars.len()]);
        for quarter in 0..4 {
            let view = View {
                orientation: DQuat::from_rotation_y(f64::from(quarter) * std::f64::consts::FRAC_PI_2),
                ..View::cube(*feet + DVec3::Y * EYE_HEIGHT, 512)[0]
            };
            culler.walk(&view, &mut scratch);
            let mut picture = ItemBuffer::new(&view);
            picture.draw_all(&scene);
            for (i, avatar) in avatars.iter().enumerate() {
                hidden[i] &= scratch.image().hides(&Bound::Box(*avatar));
                // What is out of view cannot be shown, and drawing is slow.
                if !shown[i] && scratch.image().in_view(avatar) {
                    let mut with = picture.clone();
                    let id = ItemBuffer::NONE - 1;
                    triangles(avatar).iter().for_each(|t| with.draw_triangle(id, t, DVec3::ZERO));
                    shown[i] = with.ids().contains(&id);
                }
            }
        }
        pairs += avatars.len();
        kept += hidden.iter().filter(|&&hidden| !hidden).count();
        seen += shown.iter().filter(|&&shown| shown).count();
        let lost = hidden.iter().zip(&shown).filter(|&(&hidden, &shown)| hidden && shown).count();
        assert_eq!(lost, 0, "{name}: an avatar that owns a pixel counts as hidden");
    }
    let share = |count: usize| 100.0 * count as f64 / pairs as f64;
    eprintln!("{name}: {pairs} pairs; kept {:.2} %, exactly visible {:.2} %", share(kept), share(seen));
    Some([share(kept), share(seen)])
}

/// Name, MOC's share and the exact share in percent.
const MAPS: [(&str, f64, f64); 3] = [("oa_dm2", 8.8, 7.3), ("oa_koth1", 12.9, 12.0), ("ctf_compromise", 9.3, 8.7)];

#[test]
fn no_avatar_of_a_map_is_lost() {
    for (name, ..) in MAPS {
        shares(name, 11);
    }
}

#[test]
#[ignore = "takes a minute; run with --release"]
fn fewer_pairs_are_kept_than_by_masked_occlusion_culling() {
    for (name, moc, exact) in MAPS {
        let Some([kept, seen]) = shares(name, 1) else { continue };
        assert!((seen - exact).abs() < 0.5, "{name}: the figures of FACTS.md are of something else");
        assert!(kept <= moc, "{name}: {kept:.2} % of pairs are kept, MOC keeps {moc} %");
    }
}
