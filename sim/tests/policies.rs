//! The policies that decide by distance, by squares and by a table: at the settings that are found for them they show what
//! broadcast shows, and say less.

use std::sync::Arc;
use std::time::Duration;

use eyeline_server::policy::PolicySettings;
use eyeline_sim::bake::{BakeConfig, bake};
use eyeline_sim::measure::{MeasureConfig, MeasureRow, Net, fit, measure};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;
use eyeline_sim::virtual_net::LinkRules;
use eyeline_visibility::Resolution;

fn stage() -> Stage {
    Stage::made(&RoomsRules { columns: 6, rows: 6, seed: 11, ..RoomsRules::default() }).unwrap()
}

fn config() -> MeasureConfig {
    MeasureConfig {
        clients: 6,
        seed: 11,
        warm_up: Duration::from_secs(1),
        window: Duration::from_secs(2),
        truth_share: 0.3,
        burst_frames: 10,
        resolution: Resolution::new(120, 90),
        side: 64,
        ..MeasureConfig::default()
    }
}

fn run(stage: &Stage, policy: &str, settings: PolicySettings, net: &Net) -> MeasureRow {
    let config = MeasureConfig { policy: settings, ..config() };
    measure(stage, None, &config, net, policy).unwrap()
}

fn near() -> Net {
    Net::Sim(LinkRules::default().with_delay(Duration::from_micros(300)))
}

#[test]
fn at_the_settings_that_are_found_nobody_is_missed_and_below_them_somebody_is() {
    let (stage, net) = (stage(), near());
    let found = fit(&stage, None, &config(), &net).unwrap();
    assert!(found.frames >= 6 * 40, "every frame of so short a run: {found:?}");
    let table = bake(&stage, &BakeConfig::default()).unwrap();
    let settings = PolicySettings::default().with_radius(found.radius).with_cell(found.cell).with_pvs(Arc::new(table));
    let row = |policy: &str| run(&stage, policy, settings.clone(), &net);
    let [broadcast, radius, grid, pvs] = ["broadcast", "radius", "grid", "pvs"].map(row);
    assert!(broadcast.truth_visible_object_ms > 0.0);
    for row in [&radius, &grid] {
        assert_eq!(row.truth_visible_object_ms, broadcast.truth_visible_object_ms, "motion is the same");
        assert_eq!(row.missed_object_ms, broadcast.missed_object_ms, "{found:?} {row:?}");
        assert_eq!(row.late_over_bound, broadcast.late_over_bound, "{row:?}");
        assert!(row.messages_per_client_s < broadcast.messages_per_client_s * 0.95, "{found:?} {row:?}");
        assert!(!row.setting.is_empty());
    }
    let small = settings.clone().with_radius(found.radius * 0.5).with_cell(found.cell * 0.3);
    for policy in ["radius", "grid"] {
        let row = run(&stage, policy, small.clone(), &net);
        assert!(row.missed_object_ms > broadcast.missed_object_ms, "{row:?}");
    }
    // Eyes were sampled, so something may be missed, but not much.
    assert!(pvs.missed_percent < 2.0, "{pvs:?}");
    assert!(pvs.messages_per_client_s < radius.messages_per_client_s, "{pvs:?} {radius:?}");
    assert!(pvs.setting.contains("sampled"), "{}", pvs.setting);
}

#[test]
fn what_telling_takes_is_part_of_the_settings() {
    let link = LinkRules::default().with_delay(Duration::from_millis(60)).with_jitter(Duration::from_millis(10));
    let (stage, net) = (stage(), Net::Sim(link.with_loss(0.02)));
    let found = fit(&stage, None, &config(), &net).unwrap();
    assert!(found.wait > Duration::from_millis(220), "a round trip and two ticks at least: {found:?}");
    let settings = PolicySettings::default().with_radius(found.radius).with_cell(found.cell);
    let [broadcast, radius, grid] =
        ["broadcast", "radius", "grid"].map(|policy| run(&stage, policy, settings.clone(), &net));
    for row in [&radius, &grid] {
        assert_eq!(row.missed_object_ms, broadcast.missed_object_ms, "{found:?} {row:?}");
    }
}

#[test]
fn a_table_of_another_world_starts_no_run() {
    let stage = stage();
    let other = Stage::made(&RoomsRules { columns: 2, rows: 2, seed: 12, ..RoomsRules::default() }).unwrap();
    let table = bake(&other, &BakeConfig { samples: 1, ..BakeConfig::default() }).unwrap();
    let policy = PolicySettings::default().with_pvs(Arc::new(table));
    let error = measure(&stage, None, &MeasureConfig { policy, ..config() }, &near(), "pvs").unwrap_err().to_string();
    assert!(error.contains("baked for the model"), "{error}");
}
