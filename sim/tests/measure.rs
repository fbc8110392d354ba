//! The measurement itself: it finds nothing wrong where nothing is, and it must notice deliberate damage.

use std::time::Duration;

use eyeline_client::tracking::{Growth, Sabotage};
use eyeline_sim::measure::{MeasureConfig, MeasureRow, Net, measure};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::stage::Stage;
use eyeline_sim::virtual_net::LinkRules;

fn stage() -> Stage {
    Stage::made(&RoomsRules { columns: 4, rows: 4, seed: 11, ..RoomsRules::default() }).unwrap()
}

fn config() -> MeasureConfig {
    MeasureConfig {
        clients: 8,
        seed: 11,
        warm_up: Duration::from_secs(1),
        window: Duration::from_secs(5),
        truth_share: 1.0,
        side: 64,
        ..MeasureConfig::default()
    }
}

fn link() -> Net {
    Net::Sim(LinkRules::default().with_delay(Duration::from_micros(300)))
}

fn run(config: &MeasureConfig, policy: &str) -> MeasureRow {
    measure(&stage(), None, config, &link(), policy).unwrap()
}

#[test]
fn visible_is_never_late_and_says_far_less_than_broadcast() {
    let visible = run(&config(), "visible");
    assert!(visible.truth_visible_object_ms > 0.0 && visible.reveals > 10, "the truth must not be empty: {visible:?}");
    assert_eq!(visible.late_over_bound, 0, "{visible:?}");
    assert_eq!(visible.pixels_differing, 0, "rays see what the item buffer shows: {visible:?}");
    let broadcast = run(&config(), "broadcast");
    assert_eq!(broadcast.unknown_object_ms, 0.0, "{broadcast:?}");
    assert!(visible.messages_per_client_s * 2.0 < broadcast.messages_per_client_s, "{visible:?} {broadcast:?}");
    assert!(visible.overdisclosed_per_client_s * 4.0 < broadcast.overdisclosed_per_client_s);
}

#[test]
fn the_papers_fixed_bounds_are_never_late_either() {
    let growth = Growth::FixedPeriod(Duration::from_millis(500));
    let row = run(&MeasureConfig { growth, swept: false, ..config() }, "visible");
    assert!(row.reveals > 10 && row.late_over_bound == 0, "{row:?}");
}

#[test]
fn dropped_exposures_are_noticed() {
    let row = run(&MeasureConfig { sabotage: Some(Sabotage::DropExposures), ..config() }, "visible");
    assert!(row.late_over_bound > 0 && row.missed_object_ms > 0.0, "{row:?}");
}

#[test]
fn questions_a_frame_late_are_noticed() {
    let row = run(&MeasureConfig { sabotage: Some(Sabotage::LateOneTick), ..config() }, "visible");
    assert!(row.late_over_bound > 0 && row.missed_object_ms > 0.0, "{row:?}");
}

#[test]
fn a_frozen_clock_is_noticed() {
    // Without swept bounds, so that what bounds rest on is the clock.
    let row = run(&MeasureConfig { sabotage: Some(Sabotage::FreezeClock), swept: false, ..config() }, "visible");
    assert!(row.late_over_bound > 0 && row.missed_object_ms > 0.0, "{row:?}");
}

#[test]
fn the_same_seed_gives_the_same_messages() {
    let config = MeasureConfig { window: Duration::from_secs(2), truth_share: 0.1, ..config() };
    let net = Net::Sim(
        LinkRules::default()
            .with_delay(Duration::from_millis(20))
            .with_jitter(Duration::from_millis(5))
            .with_loss(0.05),
    );
    let digest = |seed| measure(&stage(), None, &MeasureConfig { seed, ..config.clone() }, &net, "visible").unwrap();
    let (one, again, other) = (digest(1), digest(1), digest(2));
    assert!(!one.message_digest.is_empty());
    assert_eq!(one.message_digest, again.message_digest);
    assert_eq!(one.missed_object_ms, again.missed_object_ms);
    assert_ne!(one.message_digest, other.message_digest);
}

#[test]
fn quic_itself_changes_hardly_what_is_said() {
    let config = MeasureConfig { window: Duration::from_secs(2), truth_share: 0.1, ..config() };
    let rules = LinkRules::default().with_delay(Duration::from_millis(20)).with_jitter(Duration::from_millis(2));
    let live = |net| measure(&stage(), None, &config, &net, "visible").unwrap();
    let (plain, quic) = (live(Net::Sim(rules)), live(Net::SimQuic(rules)));
    assert_eq!((plain.net, quic.net), ("sim", "sim-quic"));
    let ratio = quic.messages_per_client_s / plain.messages_per_client_s;
    assert!((0.95..1.05).contains(&ratio), "{ratio}: {quic:?} {plain:?}");
    assert_eq!(quic.late_over_bound, 0, "{quic:?}");
    // Headers, tags and acknowledgements are counted where there are any.
    assert!(quic.udp_bytes_per_client_s > plain.udp_bytes_per_client_s * 1.1, "{quic:?} {plain:?}");
    assert_eq!(quic.message_digest, live(Net::SimQuic(rules)).message_digest);
}

#[test]
fn a_relay_before_real_quic_delays_what_is_said() {
    let config = MeasureConfig {
        clients: 2,
        warm_up: Duration::from_millis(500),
        window: Duration::from_secs(1),
        truth_share: 0.0,
        ..config()
    };
    let link = LinkRules::default().with_delay(Duration::from_millis(15)).with_loss(0.01);
    let row = measure(&stage(), None, &config, &Net::QuicOver(link), "visible").unwrap();
    assert!(row.net == "quic" && row.rtt_ms >= 30.0 && row.poses_per_client_s > 5.0, "{row:?}");
}
