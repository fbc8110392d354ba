use super::*;

fn planner(name: &str) -> Planner {
    Planner::open(name, 2, 7, Resolution::new(64, 64)).unwrap()
}

fn rules(switch: &str) -> LiveRules {
    LiveRules { seconds: 4.0, walks: false, others: 0, switch: switch.parse().unwrap(), seed: 7 }
}

#[test]
fn in_a_static_scene_no_tracker_is_made_and_no_state_is_told() {
    // One wall, and nobody but us.
    let triangle = |z: f32| eyeline_visibility::Triangle {
        corners: [[-9.0, 0.0, z], [9.0, 0.0, z], [0.0, 9.0, z]].map(glam::Vec3::from),
        sides: eyeline_visibility::Sides::Both,
        occludes: true,
    };
    let scene = Arc::new(eyeline_visibility::Scene::from_triangles(vec![triangle(-5.0)]));
    let live = Live::of_scene(scene, "wall", glam::DVec3::new(0.0, 1.6, 0.0));
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
fn each_live_stage_changes_work_and_nothing_that_is_said_or_drawn() {
    let planner = planner("rooms");
    for (stage, walks) in LIVE_STAGES {
        let run = |runs| {
            let switch = PlanSwitch::AUTO.with(stage, runs);
            planner.live.run(&LiveRules { switch, walks, others: 2, ..rules("auto") }).unwrap()
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
    assert_eq!(plan.lines.len(), 9);
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
