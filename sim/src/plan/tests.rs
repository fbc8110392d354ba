use super::*;

fn planner(name: &str) -> Planner {
    Planner::open(name, 2, 7, Resolution::new(64, 64)).unwrap()
}

fn rules(switch: &str) -> LiveRules {
    let switch = switch.parse().unwrap();
    LiveRules { seconds: 4.0, switch, seed: 7, ..LiveRules::default() }
}

/// A wall, and a place to stand before it.
fn wall() -> Live {
    let triangle = |z: f32| eyeline_visibility::Triangle {
        corners: [[-9.0, 0.0, z], [9.0, 0.0, z], [0.0, 9.0, z]].map(glam::Vec3::from),
        sides: eyeline_visibility::Sides::Both,
        occludes: true,
    };
    let scene = Arc::new(eyeline_visibility::Scene::from_triangles(vec![triangle(-5.0)]));
    Live::of_scene(scene, "wall", glam::DVec3::new(0.0, 1.6, 0.0))
}

#[test]
fn in_a_static_scene_no_tracker_is_made_and_no_state_is_told() {
    // One wall, and nobody but us.
    let live = wall();
    let auto = live.run(&rules("auto")).unwrap();
    assert!(!auto.has_tracker);
    assert_eq!((auto.states, auto.messages, auto.culls, auto.work), (0, 0, 0, 0));
    assert!(!auto.plan.runs(PlanStage::Tracker) && !auto.plan.runs(PlanStage::States), "{}", auto.plan);
    // Forced on it says nothing else.
    let full = live.run(&rules("full")).unwrap();
    assert!(full.has_tracker && full.culls > 50);
    assert_eq!(full.digest, auto.digest);
    // Who comes later is tracked as if a tracker had been there from the start, to the microsecond.
    let later = |switch| live.run(&LiveRules { others: 3, ..rules(switch) }).unwrap();
    let (auto, full) = (later("auto"), later("full"));
    assert!(auto.has_tracker && auto.culls < full.culls && auto.states > 0);
    assert_eq!((auto.digest, auto.picture, auto.messages), (full.digest, full.picture, full.messages));
}

#[test]
fn a_tracker_is_let_go_of_once_all_have_left_and_nobody_can_tell() {
    let live = wall();
    // They come after 12 s, leave after 15, and others come after 21.
    let run = |switch| live.run(&LiveRules { seconds: 24.0, others: 2, others_leave: true, ..rules(switch) }).unwrap();
    let (auto, full) = (run("auto"), run("full"));
    assert_eq!((auto.digest, auto.picture, auto.messages), (full.digest, full.picture, full.messages));
    assert!(auto.states > 0 && auto.has_tracker, "{auto:?}");
    // From 12 s to five after they left, and from 21 s on; the other way all the time.
    assert!((190..240).contains(&auto.tracked_frames) && full.tracked_frames > 460, "{auto:?} {full:?}");
    assert!(auto.culls < full.culls);
    // Who does not come back leaves nothing behind but counters.
    let gone = live.run(&LiveRules { seconds: 24.0, others: 0, others_leave: true, ..rules("auto") }).unwrap();
    assert_eq!((gone.tracked_frames, gone.has_tracker), (0, false));
}

/// Two closed rooms side by side along x, of 6 m each, with a post in the middle of each. One stands and sways in the
/// first.
fn two_closed_rooms() -> Live {
    use eyeline_server::spec::{ClassSpec, ObjectSpec, SpawnSpec, WorldSpec};
    let mut triangles = Vec::new();
    let mut wall = |axis: usize, at: f32, low: [f32; 2], high: [f32; 2]| {
        let corner = |u: f32, v: f32| {
            let mut corner = glam::Vec3::splat(at);
            (corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (u, v);
            corner
        };
        let [a, b] = [corner(low[0], low[1]), corner(high[0], low[1])];
        let [c, d] = [corner(high[0], high[1]), corner(low[0], high[1])];
        let sides = eyeline_visibility::Sides::Both;
        let triangle = |corners| eyeline_visibility::Triangle { corners, sides, occludes: true };
        triangles.extend([[a, b, c], [a, c, d]].map(triangle));
    };
    for room in 0..2 {
        let [from, to] = [6.0 * room as f32, 6.0 * (room + 1) as f32];
        [0.0, 3.0].into_iter().for_each(|y| wall(1, y, [0.0, from], [6.0, to]));
        [0.0, 6.0].into_iter().for_each(|z| wall(2, z, [from, 0.0], [to, 3.0]));
    }
    [0.0, 6.0, 12.0].into_iter().for_each(|x| wall(0, x, [0.0, 0.0], [3.0, 6.0]));
    let class = ClassSpec { name: "post".into(), radius: 0.2, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let post = |x: f64| ObjectSpec {
        name: format!("post {x}"),
        class: "post".into(),
        node: None,
        position: [x, 0.5, 3.0],
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let spec = WorldSpec {
        name: "closed".into(),
        classes: vec![class],
        objects: vec![post(4.0), post(9.5)],
        spawns: vec![SpawnSpec { position: [2.5, 0.1, 2.0], heading: 0.0 }],
        ..WorldSpec::default()
    };
    Live::of_spec(Arc::new(eyeline_visibility::Scene::from_triangles(triangles)), spec).with_sway(1.0)
}

#[test]
fn what_walls_seal_off_from_an_eye_that_moves_costs_no_work_and_changes_nothing() {
    let live = two_closed_rooms();
    let run = |switch| live.run(&LiveRules { seconds: 10.0, ..rules(switch) }).unwrap();
    let (on, off) = (run("auto"), run("sealed=off"));
    assert_eq!((on.digest, on.picture, on.messages), (off.digest, off.picture, off.messages));
    assert!(on.sealed > 0 && off.sealed == 0 && on.states > 0, "{on:?}");
    assert!(on.work < off.work, "{} {}", on.work, off.work);
    let line = on.plan.line(PlanStage::Sealed).unwrap();
    assert!(line.runs && line.evidence.contains("1 of 1 hidden object "), "{}", on.plan);
    assert!(!off.plan.runs(PlanStage::Sealed));
}

#[test]
fn each_live_stage_changes_work_and_nothing_that_is_said_or_drawn() {
    let planner = planner("rooms");
    for LiveStage { stage, walks, policy } in LIVE_STAGES {
        let run = |runs| {
            let switch = PlanSwitch::AUTO.with(stage, runs);
            planner.live.run(&LiveRules { switch, walks, policy, others: 2, ..rules("auto") }).unwrap()
        };
        if matches!(stage, PlanStage::Swept) {
            // Bounds on the wire are others then: what is drawn is the same, and more is asked.
            let (on, off) = (run(true), run(false));
            assert_eq!(on.picture, off.picture);
            assert!(on.messages < off.messages, "{} {}", on.messages, off.messages);
            continue;
        }
        if matches!(stage, PlanStage::Tracker) {
            assert_eq!(run(true).digest, planner.live.run(&LiveRules { others: 2, ..rules("auto") }).unwrap().digest);
            continue;
        }
        let (on, off) = (run(true), run(false));
        assert_eq!((on.digest, on.picture), (off.digest, off.picture), "{stage}");
        if matches!(stage, PlanStage::Exact) {
            assert!(on.work < off.work, "{} {}", on.work, off.work);
        }
    }
}

#[test]
fn a_plan_says_what_was_counted() {
    let plan = planner("room").plan(PlanSwitch::AUTO, 7).unwrap();
    assert!(!plan.runs(PlanStage::Frustum) && !plan.runs(PlanStage::Occlusion), "{plan}");
    assert!(plan.runs(PlanStage::Tracker), "chairs move: {plan}");
    assert_eq!(plan.lines.len(), 10);
    // Each line is two sentences or more.
    for line in &plan.lines {
        for text in [&line.evidence, &line.change] {
            assert!(text.ends_with('.') && text.starts_with(char::is_uppercase), "{text}");
        }
    }
    let rooms = planner("rooms").plan("occlusion=off".parse().unwrap(), 7).unwrap();
    assert_eq!(rooms.line(PlanStage::Occlusion).unwrap().verdict(), "forced off");
    assert!(rooms.runs(PlanStage::Frustum), "{rooms}");
    assert_eq!(rooms, planner("rooms").plan("occlusion=off".parse().unwrap(), 7).unwrap());
}

#[test]
fn every_way_to_draw_makes_the_same_picture_and_is_a_row() {
    let config = cost::CostConfig { repeats: 1, seconds: 1.0, seed: 7, switch: PlanSwitch::AUTO };
    let rows = cost::drawing(&planner("room"), &config, || ()).unwrap();
    assert_eq!(rows.len(), 5);
    assert!(rows.iter().all(|row| row.same && row.frame_ms > 0.0));
}
