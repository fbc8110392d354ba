//! The comparison of cullers, end to end: it finds nothing wrong where nothing is, it must notice a broken culler, and it
//! says what is wrong with what it is given.

use std::path::Path;
use std::process::{Command, Output};

use eyeline_sim::cull::run::{Outcome, run};
use eyeline_sim::cull::{Candidate, CullConfig, CullRow, Entry, FrameRow, Registry, Sweep, World, WorldRules, row};
use eyeline_visibility::{Culled, Culler, EyeRegion, FrustumBackface, Occlusion, Resolution, Scratch, View};
use serde_json::Value;

fn world(rules: &WorldRules) -> World {
    World::open("rooms", rules).unwrap()
}

fn config(registry: &Registry, sweep: &Sweep) -> CullConfig {
    CullConfig {
        settings: registry.settings(sweep).unwrap(),
        resolutions: vec![Resolution::new(48, 32)],
        eye_radii: vec![0.0],
        eyes: 4,
        repeats: 1,
        seed: 7,
    }
}

/// Frustum culling that forgets every third primitive and hides every box.
struct Broken(FrustumBackface, Scratch);

impl Candidate for Broken {
    fn cull(&mut self, view: &View, region: EyeRegion) -> Culled {
        let mut culled = self.0.cull(view, region, &mut self.1);
        culled.visible.retain(|id| id % 3 != 0);
        culled
    }

    fn occlusion(&self) -> &dyn Occlusion {
        &HidesAll
    }
}

struct HidesAll;

impl Occlusion for HidesAll {
    fn hides(&self, _: &eyeline_visibility::Bound) -> bool {
        true
    }
}

fn with_broken() -> Registry {
    let zbuffer = *Registry::standard().entry("zbuffer").unwrap();
    Registry::standard().with(Entry {
        name: "broken",
        make: |shop, _| Box::new(Broken(FrustumBackface::new(shop.scene()), Scratch::default())),
        ..zbuffer
    })
}

/// Cullers whose rows are compared one by one.
const FEW: [&str; 3] = ["zbuffer", "frustum-backface", "cplp"];

fn few() -> Sweep {
    Sweep { cullers: FEW.map(str::to_owned).into(), ..Sweep::default() }
}

#[test]
fn a_broken_culler_is_caught_and_the_others_are_not() {
    let world = world(&WorldRules { query_objects: Some("chair.".into()), ..WorldRules::default() });
    let registry = with_broken();
    let path = world.cameras(Some(6), 7);
    for eye_radii in [vec![0.0], vec![0.2]] {
        let config = CullConfig { eye_radii, ..config(&registry, &Sweep::default()) };
        let outcome = run(&world, &path, &config, &registry, || {});
        assert_eq!(outcome.rows.len(), registry.entries().len());
        for row in outcome.rows.iter().filter(|row| row.conservative) {
            let broken = row.culler == "broken";
            assert_eq!(row.ok, !broken, "{row:?}");
            assert_eq!(row.wrong_pixels_max > 50, broken, "{row:?}");
            assert_eq!(row.lost_visible > 20, broken, "{row:?}");
            assert_eq!(row.objects_lost > 0, broken, "{row:?}");
            assert_eq!(row.visible_found < 0.9, broken, "{row:?}");
            assert!(row.exact > 10.0 && row.objects_exact.unwrap() > 0.0 && row.frames == 6, "{row:?}");
        }
        let wrong = outcome.pictures.iter().find(|shown| {
            shown.name.starts_with("wrong") && shown.setting.as_ref().is_some_and(|setting| setting.culler == "broken")
        });
        assert!(!wrong.unwrap().picture.png().is_empty());
    }
}

#[test]
fn rows_say_what_was_kept_and_what_it_took() {
    let world = world(&WorldRules::default());
    let registry = Registry::standard();
    let path = world.cameras(Some(8), 3);
    let sweep = Sweep { budgets: vec![0.into(), 1_000.into()], ..few() };
    let rows = run(&world, &path, &config(&registry, &sweep), &registry, || {}).rows;
    let [all, frustum, unguided, guided] = &rows[..] else { panic!("{} rows", rows.len()) };
    assert_eq!(all.kept, world.scene.triangles().len() as f64);
    assert!(frustum.kept < all.kept && unguided.kept < frustum.kept && unguided.kept >= unguided.exact);
    assert!(guided.kept >= unguided.kept, "{guided:?} {unguided:?}");
    assert!(rows.iter().all(|row| row.exact == all.exact && row.z_tests_per_pixel >= 1.0 && row.ok));
    assert!(unguided.z_tests_per_pixel < frustum.z_tests_per_pixel);
    assert!(guided.rounds < unguided.rounds && unguided.queries > 0.0, "{guided:?} {unguided:?}");
    assert!(rows.iter().all(|row| row.frame_ms > 0.0 && row.per_max_pass > 0.0 && row.draw_ms > 0.0));
    let budget = |row: &CullRow| row.budget.clone();
    assert_eq!((budget(unguided), budget(guided), budget(all)), (Some("0".into()), Some("1000".into()), None));
}

#[test]
fn budgets_may_follow_the_view_and_rows_say_what_they_were() {
    let world = world(&WorldRules::default());
    let registry = Registry::standard();
    let path = world.cameras(Some(6), 3);
    let budgets = ["1x", "4x", "auto", "60000ms"].map(|text| text.parse().unwrap()).to_vec();
    let cullers = ["zbuffer", "frustum-backface", "plp", "centroid"].map(str::to_owned).into();
    let sweep = Sweep { cullers, budgets, tessellations: vec!["octree".into()], ..Sweep::default() };
    let Outcome { rows, frames, .. } = run(&world, &path, &config(&registry, &sweep), &registry, || {});
    // What a row says of all views is made of what is said of each.
    for (row, frames) in rows.iter().zip(frames.chunks(6)) {
        let mean = |of: fn(&FrameRow) -> f64| frames.iter().map(of).sum::<f64>() / 6.0;
        assert!(frames.iter().enumerate().all(|(view, frame)| frame.view == view && frame.culler == row.culler));
        assert_eq!((mean(|frame| frame.kept as f64), mean(|frame| frame.exact as f64)), (row.kept, row.exact));
        assert!((mean(|frame| frame.visible_found) - row.visible_found_mean).abs() < 1e-9, "{row:?}");
        assert!((mean(|frame| frame.frame_ms.unwrap()) - row.frame_ms).abs() < 1e-9, "{row:?}");
        assert_eq!(frames.iter().map(|frame| frame.wrong_pixels).max(), Some(row.wrong_pixels_max));
        assert!(frames[0].drawn_churn.is_none() && frames[1..].iter().all(|frame| frame.drawn_churn.is_some()));
    }
    assert_eq!(frames.len(), 6 * rows.len());
    let [all, frustum, once, four_times, auto, unhurried, centroid, centroid_four] = &rows[..] else {
        panic!("{} rows", rows.len())
    };
    assert_eq!(once.budget_triangles, Some(once.exact.round() as usize));
    assert!(once.kept <= once.exact && four_times.kept > once.kept);
    // Each view has its own: nowhere is more drawn than that view shows.
    assert!(once.visible_found_mean > 0.25 && four_times.visible_found_mean > 0.9, "{once:?} {four_times:?}");
    assert!(four_times.visible_found_mean >= once.visible_found_mean);
    assert!(centroid.budget_triangles == once.budget_triangles && centroid_four.kept > centroid.kept);
    assert!(auto.budget_triangles.is_some_and(|budget| budget >= 1_000) && auto.visible_found_mean > 0.9);
    // A deadline that is never met draws all that is in view, and nobody knows its budget beforehand.
    assert_eq!((unhurried.budget_triangles, unhurried.visible_found_mean), (None, 1.0));
    for row in &rows {
        assert_eq!(row.overhead_ms.is_some(), row.budget.is_some(), "{row:?}");
        // Both are told over the same time of the frustum.
        if let (Some(overhead), Some(over)) = (row.overhead_ms, row.over_frustum) {
            let plain = row.frame_ms - overhead;
            assert!((over * plain - row.frame_ms).abs() < 1e-9 * row.frame_ms.max(1.0), "{row:?}");
        }
    }
    assert!((unhurried.kept, unhurried.over_frustum.is_some()) == (frustum.kept, true), "{unhurried:?} {frustum:?}");
    assert_eq!((all.drawn_churn, all.drawn_churn_p95), (0.0, 0.0));
    assert!(frustum.drawn_churn > 0.0 && frustum.drawn_churn_p95 >= frustum.drawn_churn, "{frustum:?}");
}

#[test]
fn a_ball_of_eyes_sees_more_than_its_middle() {
    let world = world(&WorldRules::default());
    let registry = Registry::standard();
    let path = world.cameras(Some(3), 3);
    let config = CullConfig { eye_radii: vec![0.0, 0.5], ..config(&registry, &few()) };
    let rows: Vec<CullRow> = run(&world, &path, &config, &registry, || {}).rows;
    assert_eq!(rows.len(), 6);
    assert!(rows[3].exact > rows[0].exact, "{:?}", rows[3]);
    assert_eq!((rows[0].eyes, rows[3].eyes), (1, 4));
    assert!(rows.iter().all(|row| row.ok));
}

fn eyeline(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_eyeline-sim")).args(arguments).output().unwrap()
}

fn rows_of(folder: &Path) -> Vec<Value> {
    let json: Value = serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap();
    json["rows"].as_array().unwrap().clone()
}

#[test]
fn a_recorded_path_replays_to_the_same_rows() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let model = at("small.glb");
    assert!(eyeline(&["scene", "rooms", "--columns", "3", "--rows", "2", "--out", &model]).status.success());
    let cullers = FEW.join(",");
    let common = ["cull", "--world", &model, "--cullers", &cullers, "--resolution", "64x48", "--repeats", "1"];
    let (walk, a, b) = (at("walk.json"), at("a"), at("b"));
    let record = [&common[..], &["--views", "5", "--seed", "9", "--record", &walk, "--out", &a]].concat();
    let output = eyeline(&record);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // Another seed: the views come from the file.
    let replay = [&common[..], &["--seed", "1", "--path", &walk, "--out", &b]].concat();
    assert!(eyeline(&replay).status.success());
    let timeless = |folder: &str| -> Vec<Value> {
        let mut rows = rows_of(Path::new(folder));
        for row in &mut rows {
            let row = row.as_object_mut().unwrap();
            for &time in &row::TIMES {
                // Overhead is told only of budgets that promise nothing, and of maps where there are some.
                let value = row.remove(time);
                let is_told = !["overhead_ms", "over_frustum", "over_unmapped"].contains(&time);
                assert!(value.is_some_and(|value| value.is_number() || !is_told), "{time}");
            }
        }
        rows
    };
    let (a, b) = (timeless(&a), timeless(&b));
    assert_eq!(a, b);
    assert_eq!(a.len(), 3);
    for key in [
        "culler",
        "tessellation",
        "query",
        "budget",
        "resolution",
        "eye_radius",
        "frames",
        "wrong_pixels_max",
        "wrong_pixels_mean",
        "lost_visible",
        "visible_found",
        "kept",
        "exact",
        "rounds",
        "z_tests_per_pixel",
    ] {
        assert!(a.iter().all(|row| row.get(key).is_some()), "no column {key}");
    }
    assert_eq!(a[0]["frames"], 5);
    let frames = std::fs::read_to_string(folder.path().join("a/frames.csv")).unwrap();
    assert!(frames.starts_with("culler,tessellation,query,budget,resolution,eye_radius,view,exact,found,"), "{frames}");
    assert_eq!(frames.lines().count(), 1 + 3 * 5);
    let page = std::fs::read_to_string(folder.path().join("a/report.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && page.contains("wrong_pixels_mean over frame_ms"));
    let pictures = std::fs::read_dir(folder.path().join("a")).unwrap();
    let pictures = pictures.filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|end| end == "png"));
    // What all share, what each got right and wrong, and two fronts of one.
    assert_eq!(pictures.count(), 2 + 2 * 3 + 2);
}

#[test]
fn what_cannot_be_run_is_said_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    std::fs::write(folder.path().join("bad.json"), "{\"cameras\": [{\"eye\": [0, 0, NaN]}]}").unwrap();
    std::fs::write(folder.path().join("bad.glb"), "no model").unwrap();
    let (json, glb, missing) = (at("bad.json"), at("bad.glb"), at("missing.glb"));
    for (arguments, parts) in [
        (
            vec!["--cullers", "cplp,magic"],
            vec!["no culler `magic`", "zbuffer, frustum-backface, frustum, large-occluder, planned, masked, cplp"],
        ),
        (vec!["--tessellation", "bsp"], vec!["no tessellation `bsp`", "octree"]),
        (vec!["--query", "gpu"], vec!["no query `gpu`", "sampled"]),
        (vec!["--world", "castle"], vec!["`castle`", "building, city, engine, office, seminar, tower, vessels, rooms"]),
        (vec!["--world", &missing], vec!["missing.glb"]),
        (vec!["--world", &glb], vec!["bad.glb"]),
        (
            vec!["--world", &glb, "--scene-seed", "2"],
            vec!["--scene-seed", "building, city, engine, office, seminar, tower, vessels, rooms"],
        ),
        (vec!["--world", "rooms", "--objects-per-room", "9"], vec!["--objects-per-room", "`rooms`"]),
        (vec!["--path", &json], vec!["bad.json", "line 1"]),
        (vec!["--resolution", "0x64"], vec!["from 1 to 8192"]),
        (vec!["--resolution", "64"], vec!["as in 320x240"]),
        (vec!["--eye-radius", "NaN"], vec!["--eye-radius"]),
        (vec!["--eye-radius", "0,-1"], vec!["--eye-radius"]),
        (vec!["--views", "0"], vec!["--views"]),
        (vec!["--budgets", "-1"], vec!["--budgets"]),
        (vec!["--world", "rooms", "--query-objects", "cow"], vec!["begins with `cow`"]),
    ] {
        let out = at("out");
        let output = eyeline(&[&["cull", "--out", &out][..], &arguments[..]].concat());
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{arguments:?}");
        assert!(parts.iter().all(|part| text.contains(part)) && !text.contains("panicked"), "{arguments:?}: {text}");
    }
    let help = eyeline(&["cull", "--help"]);
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(help.contains("Examples:") && help.contains("--eye-radius") && help.contains("The figures to beat"));
}
