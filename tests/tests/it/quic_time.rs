//! QUIC itself in virtual time: the same seed, the same run; and what loss and darkness do to it.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use eyeline_protocol::WorldTime;
use eyeline_sim::virtual_net::{Capacity, Direction, LinkRules, Verdict};

use crate::village::{PEOPLE, Rules, Village};

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

fn bad_link() -> LinkRules {
    LinkRules::default().with_delay(ms(25)).with_jitter(ms(8)).with_loss(0.05)
}

/// What pacing, and waiting for room in the window, may add to a datagram's way.
const QUIC_SLACK: Duration = ms(10);

/// One packet: when, whose, whither, and its bytes.
type Packet = (WorldTime, usize, Direction, Vec<u8>);

/// Has every packet noted as it leaves.
fn packets_of(village: &mut Village) -> Rc<RefCell<Vec<Packet>>> {
    let packets = Rc::new(RefCell::new(Vec::new()));
    let noted = packets.clone();
    village.run.intercept(move |packet| {
        noted.borrow_mut().push((packet.at, packet.client, packet.direction, packet.bytes.to_vec()));
        Verdict::AsRuled
    });
    packets
}

#[test]
fn the_same_seed_gives_the_same_messages_though_its_ciphertext_differs() {
    let live = |seed| {
        let mut village = Village::new(&Rules::over_quic(seed, bad_link().with_duplicate(0.02).with_reorder(0.05)));
        let packets = packets_of(&mut village);
        village.settle(ms(3_000));
        let packets = packets.take();
        let sizes: Vec<_> = packets.iter().map(|(at, client, way, bytes)| (*at, *client, *way, bytes.len())).collect();
        (village.run.digest(), village.run.messages(), sizes, packets)
    };
    let (one, again, other) = (live(3), live(3), live(4));
    assert!(one.1 > 500 && one.2.len() > 500, "{} messages in {} packets", one.1, one.2.len());
    assert_eq!((one.0, one.1), (again.0, again.1));
    assert_eq!(one.2, again.2, "times and sizes of packets");
    assert!(one.2.iter().all(|&(.., bytes)| bytes <= 1_200), "every path carries them");
    let differing = one.3.iter().zip(&again.3).filter(|(one, again)| one.3 != again.3).count();
    assert!(differing * 10 > one.3.len() * 9, "TLS has keys of its own in each run: {differing}");
    assert_ne!(one.0, other.0);
}

#[test]
fn loss_and_jitter_cost_neither_connections_nor_the_picture() {
    for seed in 0..4 {
        let mut village = Village::new(&Rules::over_quic(seed, bad_link()));
        let mut truth = village.truth(PEOPLE, QUIC_SLACK);
        village.run_for(ms(8_000), &mut truth);
        for client in village.run.clients() {
            assert!(client.is_connected() && client.session.welcome().is_some(), "seed {seed}");
        }
        truth.assert_kept(&format!("seed {seed}"));
        assert!(truth.bounds_checked > 1_000 && truth.visible_checked > 1_000 && truth.not_drawn > 0, "seed {seed}");
        let lost: u64 =
            village.run.clients().iter().map(|client| client.up.stats().lost + client.down.stats().lost).sum();
        assert!(lost > 50, "seed {seed}: {lost}");
        assert_short_waits(&village);
    }
}

#[test]
fn five_seconds_of_darkness_pass() {
    let mut rules = Rules::over_quic(2, LinkRules::default().with_delay(ms(25)));
    rules.capacity = Capacity::default().with_blackout(ms(3_000), ms(5_000));
    let mut village = Village::new(&rules);
    village.settle(ms(8_000));
    for person in PEOPLE {
        let client = &village.run.clients()[person];
        assert!(client.is_connected() && client.up.stats().dark > 20 && client.down.stats().dark > 0);
    }
    // A round trip to be heard of again, one for answers.
    village.settle(ms(1_000));
    let mut truth = village.truth(PEOPLE, QUIC_SLACK);
    village.run_for(ms(4_000), &mut truth);
    truth.assert_kept("after the darkness");
    assert!(truth.visible_checked > 500, "{}", truth.visible_checked);
    assert_short_waits(&village);
    assert!(village.run.clients().iter().all(|client| client.is_connected()));
}

#[test]
fn who_stays_in_the_dark_is_let_go_by_both_ends() {
    let mut rules = Rules::over_quic(2, LinkRules::default().with_delay(ms(25)));
    rules.capacity = Capacity::default().with_blackout(ms(2_000), Duration::from_secs(3_600));
    let mut village = Village::new(&rules);
    village.settle(ms(2_000));
    assert_eq!(village.run.world().sessions(), 5);
    village.settle(ms(12_000));
    assert_eq!(village.run.world().sessions(), 1, "the crowd has light");
    for person in PEOPLE {
        let client = &village.run.clients()[person];
        assert!(!client.is_connected() && client.closed().is_some_and(|why| why.contains("timed out")));
    }
}

#[test]
fn who_leaves_is_let_go_at_once_and_who_is_refused_hears_why() {
    let mut village = Village::new(&Rules::over_quic(5, LinkRules::default().with_delay(ms(25))));
    village.settle(ms(1_000));
    village.run.cut(2);
    village.settle(ms(200));
    assert_eq!(village.run.world().sessions(), 4);
    // A second hello makes no sense.
    village.run.send_raw(
        3,
        eyeline_sim::virtual_net::Kind::Control,
        vec![0xff; 8],
        &mut eyeline_sim::virtual_net::Ignore,
    );
    village.settle(ms(400));
    assert_eq!(village.run.world().sessions(), 3);
    assert_eq!(village.run.world().stats().rejected_control, 1);
    let client = &village.run.clients()[3];
    assert!(
        !client.is_connected() && format!("{:?}", client.events()).contains("control message"),
        "{:?}",
        client.events()
    );
}

#[test]
fn a_narrow_path_delays_what_is_said_but_loses_no_connection() {
    let live = |bits: u64| {
        let mut rules = Rules::over_quic(6, LinkRules::default().with_delay(ms(25)));
        let rate = std::num::NonZeroU64::new(bits).expect("not zero");
        rules.capacity = Capacity::default().with_rate(rate).with_queue_bytes(3_000);
        let mut village = Village::new(&rules);
        village.settle(ms(15_000));
        let mut overflowed = 0;
        for person in PEOPLE {
            let client = &village.run.clients()[person];
            assert!(client.is_connected() && client.session.welcome().is_some(), "{person}: {:?}", client.closed());
            overflowed += client.up.stats().overflowed + client.down.stats().overflowed;
        }
        (village, overflowed)
    };
    let (village, overflowed) = live(200_000);
    assert_eq!(overflowed, 0, "it was narrow");
    assert_short_waits(&village);
    // Less than they would say: quinn's windows and our own leases must cope.
    let (village, overflowed) = live(12_000);
    assert!(overflowed > 10, "{overflowed}: it was not narrow");
    // The server builds no more than leaves within a tick as the path has been, and nothing while something older waits. What
    // is in quinn's buffer when a whole window gets lost waits there until quinn probes the path, which nobody can hurry.
    let waited = PEOPLE.map(|person| village.run.waited_max(person, Direction::Down)).max();
    assert!(village.run.world().stats().held_back > 10);
    assert!(waited.is_some_and(|waited| waited < ms(2_000)), "{waited:?}");
}

/// Where the path carries what is said, quinn's buffers hold no pose older than two ticks.
#[track_caller]
fn assert_short_waits(village: &Village) {
    for person in PEOPLE {
        let [up, down] = [Direction::Up, Direction::Down].map(|way| village.run.waited_max(person, way));
        assert!(up.max(down) <= ms(100), "{person}: {up:?} up, {down:?} down");
    }
}
