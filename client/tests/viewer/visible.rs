//! The picture of the visible set is the picture of everything, on the same adapter.

use eyeline_client::viewer::model::Model;
use eyeline_client::viewer::overlay::Overlay;
use eyeline_client::viewer::renderer::Frame;
use eyeline_client::viewer::sight::{CullerKind, Sight};
use eyeline_visibility::{LoadOptions, Resolution, View};
use glam::DVec3;
use rand::{RngExt as _, SeedableRng as _};

use crate::{given_scene, gpu_or_skip, made, stage};

/// Compares the two pictures from some places and returns what was drawn: triangles of the visible sets, and of the scene.
fn compare(test: &str, model: &Model, cullers: &[CullerKind], eyes: &[DVec3]) -> Option<(usize, usize)> {
    let gpu = gpu_or_skip(test)?;
    let mut stage = stage(&gpu, model);
    let mut sights: Vec<_> = cullers.iter().map(|&kind| (kind, Sight::new(kind, &model.scene))).collect();
    let everything: Vec<u32> = (0..model.scene.triangles().len() as u32).collect();
    let (mut drawn, mut all) = (0, 0);
    for (at, &eye) in eyes.iter().enumerate() {
        let view = View::level(eye, at as f64 * 1.1, 1.4, Resolution::new(240, 135));
        let mut picture = |visible: &[u32]| {
            let frame = Frame { view, visible, moving: &[] };
            stage.picture(&gpu, &frame, &Overlay::default()).unwrap().0
        };
        let whole = picture(&everything);
        for (kind, sight) in &mut sights {
            let visible = &sight.look(&view).visible;
            let seen = picture(visible);
            let wrong = whole.pixels().zip(seen.pixels()).filter(|(a, b)| a != b).count();
            assert_eq!(wrong, 0, "{kind:?} from {eye}: so many pixels differ");
            drawn += visible.len();
            all += everything.len();
        }
    }
    Some((drawn, all))
}

/// Places of a given scene, at eye height.
fn given(test: &str, name: &str, cullers: &[CullerKind]) {
    let Some(path) = given_scene(test, &format!("{name}.glb")) else { return };
    let model = Model::load_file(&path, &LoadOptions::default().with_two_sided(true)).unwrap();
    let bounds = model.scene.bounds();
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(8);
    // Anywhere in the box, some of it in walls: what is hidden there must be hidden in the picture too.
    let eye = |rng: &mut rand_pcg::Pcg64Mcg| {
        DVec3::from_array(std::array::from_fn(|axis| rng.random_range(bounds.min[axis]..bounds.max[axis])))
    };
    let eyes: Vec<_> = (0..10).map(|_| eye(&mut rng)).collect();
    compare(test, &model, cullers, &eyes);
}

#[test]
fn made_rooms_look_the_same() {
    let model = Model::load_glb(&made::two_rooms(64), "two rooms", &LoadOptions::default()).unwrap();
    assert_eq!(model.warnings, [""; 0]);
    let eyes = [[-3.0, 1.6, 1.8], [-1.0, 1.6, 0.5], [0.05, 1.5, 0.5], [3.0, 0.3, -1.0], [0.0, 9.0, 0.0]];
    let eyes = eyes.map(DVec3::from_array);
    let cullers = [CullerKind::Masked, CullerKind::Cplp, CullerKind::Region, CullerKind::Frustum];
    compare("made_rooms_look_the_same", &model, &cullers, &eyes);
}

/// That the comparison can fail: without some of what is visible the picture is another.
#[test]
fn what_is_left_out_is_missed() {
    let Some(gpu) = gpu_or_skip("what_is_left_out_is_missed") else { return };
    let model = Model::load_glb(&made::two_rooms(8), "two rooms", &LoadOptions::default()).unwrap();
    let mut stage = stage(&gpu, &model);
    let view = View::level(DVec3::new(-3.0, 1.6, 1.8), 0.3, 1.4, Resolution::new(240, 135));
    let mut sight = Sight::new(CullerKind::Masked, &model.scene);
    let visible = sight.look(&view).visible.clone();
    let some: Vec<u32> = visible.iter().copied().filter(|id| id % 2 == 0).collect();
    let mut picture =
        |visible: &[u32]| stage.picture(&gpu, &Frame { view, visible, moving: &[] }, &Overlay::default()).unwrap().0;
    assert!(some.len() < visible.len());
    assert!(picture(&visible) != picture(&some), "half of each wall is nowhere to be seen");
}

#[test]
fn oa_dm2_looks_the_same() {
    given("oa_dm2_looks_the_same", "oa_dm2", &[CullerKind::Masked, CullerKind::Region]);
}

#[test]
fn oa_koth1_looks_the_same() {
    given("oa_koth1_looks_the_same", "oa_koth1", &[CullerKind::Masked, CullerKind::Cplp]);
}

#[test]
fn a_real_building_looks_the_same() {
    given("a_real_building_looks_the_same", "large_building", &[CullerKind::Masked]);
}

/// Issue 8's bar: primitives, and draw calls, follow the visible set; flat while hidden objects grow from 100 to 10,000.
#[test]
fn what_is_drawn_does_not_grow_with_what_is_hidden() {
    let Some(gpu) = gpu_or_skip("what_is_drawn_does_not_grow_with_what_is_hidden") else { return };
    // Towards the wall between the rooms, beyond which the hidden ones are; none of them is seen through the door.
    let eye = DVec3::new(-3.0, 1.6, -1.2);
    let view = View::level(eye, -std::f64::consts::FRAC_PI_2, 1.4, Resolution::new(240, 135));
    let drawn = [100, 1_000, 10_000].map(|hidden| {
        let model = Model::load_glb(&made::two_rooms(hidden), "two rooms", &LoadOptions::default()).unwrap();
        assert!(model.scene.triangles().len() > 12 * hidden);
        let mut stage = stage(&gpu, &model);
        let visible = &Sight::new(CullerKind::Masked, &model.scene).look(&view).visible.clone();
        stage.picture(&gpu, &Frame { view, visible, moving: &[] }, &Overlay::default()).unwrap()
    });
    let [(picture, few), (_, some), (same, many)] = &drawn;
    assert_eq!((few.primitives, few.draws), (some.primitives, some.draws));
    assert_eq!((few.primitives, few.draws), (many.primitives, many.draws));
    assert!(few.primitives > 20, "{few:?}");
    assert_eq!(picture, same);
}
