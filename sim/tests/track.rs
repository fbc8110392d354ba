//! Trackers over cullers, with unkind motion: what is promised of pictures holds in every frame, and work follows what is
//! visible.

use eyeline_client::tracking::{TbvShape, Validity, Variant};
use eyeline_sim::cull::Registry;
use eyeline_sim::track::run::ADAPTIVE;
use eyeline_sim::track::{Chairs, EyeKind, MotionKind, RunRules, TrackRow, TrackRules, TrackSetting, TrackWorld, run};
use eyeline_visibility::Resolution;
use std::time::Duration;

fn rules(rooms: [u32; 2], chairs: Chairs) -> TrackRules {
    TrackRules { rooms, chairs, motion: MotionKind::ALL.to_vec(), eye: EyeKind::Walking, slack: 1.0, seed: 5 }
}

fn rows(world: &TrackRules, settings: &[TrackSetting], frames: u64, truth_every: u64) -> Vec<TrackRow> {
    let run_rules =
        RunRules { frames, settle: 0, resolution: Resolution::new(64, 64), truth_every, ..RunRules::default() };
    let mut world = TrackWorld::make(world).unwrap();
    run(&mut world, settings, &run_rules, &Registry::standard(), || {}).unwrap()
}

/// 1,000 frames a pair at 64²; `eyeline-sim track --sweep promise` has 20,000.
fn keeps_its_promise(culler: &str, seed: u64) {
    let settings = [Variant::EveryObject, Variant::Explicit, Variant::Implicit].map(|v| TrackSetting::new(culler, v));
    let rows = rows(&TrackRules { seed, ..rules([3, 3], Chairs::PerRoom(3)) }, &settings, 1_000, 1);
    for row in &rows {
        assert!(row.ok, "{row:?}");
        assert_eq!((row.truth_frames, row.broken_bounds, row.other_wrong_pixels_max), (1_000, 0, 0));
        assert!(row.visible > 0.5 && row.hidden > row.visible, "{row:?}");
    }
    assert_eq!((rows[0].wrong_pixels_max, rows[1].wrong_pixels_max), (0, 0));
    assert!(rows[2].absent_frames_max <= 1);
    // Both variants leave most hidden objects alone.
    assert!(rows[1].updates_per_frame * 2.0 < rows[0].updates_per_frame, "{rows:?}");
    assert!(rows[2].updates_per_frame * 2.0 < rows[0].updates_per_frame, "{rows:?}");
}

#[test]
fn hierarchical_z_keeps_its_promise_under_every_variant() {
    keeps_its_promise("hierarchical-z", 5);
}

#[test]
fn cplp_keeps_its_promise_under_every_variant() {
    keeps_its_promise("cplp", 6);
}

#[test]
fn masks_keep_their_promise_under_every_variant() {
    keeps_its_promise("masked", 7);
}

#[test]
fn large_occluders_keep_their_promise_under_every_variant() {
    keeps_its_promise("large-occluder", 8);
}

#[test]
fn implicit_updates_are_late_by_one_frame_at_times_or_the_test_above_says_nothing() {
    let settings = [TrackSetting::new("hierarchical-z", Variant::Implicit)];
    let absences: u64 = (5..9)
        .map(|seed| rows(&TrackRules { seed, ..rules([3, 3], Chairs::PerRoom(3)) }, &settings, 500, 1)[0].absences)
        .sum();
    assert!(absences > 0);
}

#[test]
fn every_shape_and_validity_shows_the_same() {
    let shapes = [
        TbvShape::SpeedSphere,
        TbvShape::AccelerationSphere,
        TbvShape::Box,
        TbvShape::Swept { pieces: 4 },
        TbvShape::Everywhere,
    ];
    let validities = [
        Validity::Fixed(Duration::ZERO),
        Validity::Fixed(Duration::from_millis(700)),
        Validity::Fixed(Duration::from_secs(86_400)),
        ADAPTIVE,
        Validity::Exact { longest: Duration::from_secs(60) },
    ];
    let settings: Vec<TrackSetting> = shapes
        .iter()
        .flat_map(|&shape| validities.map(|validity| (shape, validity)))
        .map(|(shape, validity)| TrackSetting { shape, validity, ..TrackSetting::new("cplp", Variant::Explicit) })
        .collect();
    for row in rows(&rules([3, 2], Chairs::PerRoom(4)), &settings, 120, 1) {
        assert!(row.ok && row.wrong_pixels_max == 0, "{row:?}");
    }
}

#[test]
fn fuzzy_bounds_that_break_are_reported_in_time() {
    let fuzzy = |fuzzy, violated| TrackSetting { fuzzy, violated, ..TrackSetting::new("cplp", Variant::Explicit) };
    let settings = [fuzzy(0.2, 0.0), fuzzy(0.0, 0.3)];
    let world = TrackRules { slack: 6.0, motion: vec![MotionKind::Random], ..rules([3, 3], Chairs::PerRoom(4)) };
    let rows = rows(&world, &settings, 200, 1);
    assert!(rows.iter().all(|row| row.ok && row.wrong_pixels_max == 0), "{rows:?}");
    assert!(rows[0].broken_share > 0.05, "{rows:?}");
}

#[test]
fn work_follows_what_is_visible_while_the_baseline_grows_with_what_is_hidden() {
    let at = |hidden| {
        let world = TrackRules {
            motion: vec![MotionKind::Random],
            eye: EyeKind::Still,
            ..rules([16, 16], Chairs::Split { visible: 20, hidden })
        };
        let settings = [Variant::EveryObject, Variant::Explicit, Variant::Implicit]
            .map(|variant| TrackSetting::new("hierarchical-z", variant));
        let run_rules = RunRules {
            frames: 40,
            settle: 200,
            resolution: Resolution::new(64, 64),
            truth_every: 0,
            ..RunRules::default()
        };
        let mut world = TrackWorld::make(&world).unwrap();
        run(&mut world, &settings, &run_rules, &Registry::standard(), || {}).unwrap()
    };
    let (few, many) = (at(50), at(1_500));
    let grown = |row: usize| many[row].work / few[row].work;
    assert!(grown(0) > 2.0, "every object: {}", grown(0));
    assert!(grown(1) < 1.3 && grown(2) < 1.3, "TBVe {}, TBVi {}", grown(1), grown(2));
}

#[test]
fn a_culler_that_does_not_exist_is_named() {
    let mut world = TrackWorld::make(&rules([2, 2], Chairs::PerRoom(1))).unwrap();
    let settings = [TrackSetting::new("clairvoyance", Variant::Explicit)];
    let error = run(&mut world, &settings, &RunRules::default(), &Registry::standard(), || {}).unwrap_err();
    assert!(format!("{error:#}").contains("clairvoyance"), "{error:#}");
}
