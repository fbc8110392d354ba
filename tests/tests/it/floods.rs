//! Limits, in virtual time: floods reach nobody else's answers by a microsecond, and nobody honest meets a limit.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use eyeline_client::session::SessionConfig;
use eyeline_client::tracking::TrackerConfig;
use eyeline_protocol::codec::DatagramWriter;
use eyeline_protocol::{ClientHeader, ClientRecord, LinkHeader, ObjectId, Reason, Want, WorldInfo, WorldTime};
use eyeline_server::policy::Visible;
use eyeline_server::spec::{ClassSpec, ObjectSpec, WorldSpec};
use eyeline_server::world::{Limited, World, WorldConfig};
use eyeline_sim::soak::{IndexView, Standing, Wall, Walls};
use eyeline_sim::virtual_net::{ClientPlan, Ignore, Kind, LinkRules, VirtualRun};
use glam::DVec3;

use crate::village::{PEOPLE, Rules, Village};

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Who floods.
const VILLAIN: usize = 1;

#[test]
fn a_flood_of_requests_delays_no_answer_of_others_and_ends() {
    let mut village = Village::new(&Rules::new(1, LinkRules::default().with_delay(ms(30))));
    let mut truth = village.truth(PEOPLE.filter(|&person| person != VILLAIN), Duration::ZERO);
    village.run_for(ms(1_500), &mut truth);
    let before = *village.run.world().stats();
    let objects = village.run.world().objects().len() as u32;
    let mut seq = 1_000_000;
    // A thousand datagrams a second, full of requests; the limits bear two seconds of it.
    for _ in 0..600 {
        for _ in 0..5 {
            seq += 1;
            let link = LinkHeader { seq, ..LinkHeader::default() };
            let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::ZERO }, 1_150);
            let ask = |n: u32| ClientRecord::Request {
                object: ObjectId(n % objects),
                want: Want::State,
                reason: Reason::Exposed,
            };
            let _full = (0..).all(|n| writer.push(&ask(n)));
            village.run.send_raw(VILLAIN, Kind::Datagram, writer.finish(), &mut truth);
        }
        village.run_for(ms(5), &mut truth);
    }
    truth.assert_kept("beside a flood");
    assert!(truth.visible_checked > 500 && truth.bounds_checked > 500);
    let stats = village.run.world().stats();
    assert_eq!((stats.busy, before.limited.total()), (1, 0));
    assert!(stats.limited.of(Limited::Requests) > 100_000, "{:?}", stats.limited);
    let answered = stats.messages_in.requests() - before.messages_in.requests();
    assert!(answered < 30_000, "{answered}");
    for person in PEOPLE {
        assert_eq!(village.run.clients()[person].is_connected(), person != VILLAIN, "{person}");
    }
}

#[test]
fn a_thousand_things_that_come_into_view_at_once_are_within_every_limit() {
    // A wall hides them until the client stands beyond it, all at once. A fifth of what is said gets lost.
    let walls = Arc::new(Walls { walls: vec![Wall::new(-500.0, -5.1, 500.0, -4.9)] });
    let class = ClassSpec { name: "chair".into(), radius: 0.3, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let chair = |index: usize| ObjectSpec {
        name: format!("chair {index}"),
        class: "chair".into(),
        node: None,
        position: [(index % 40) as f64 - 20.0, 0.0, -20.0 - (index / 40) as f64],
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let spec = WorldSpec { classes: vec![class], objects: (0..1_000).map(chair).collect(), ..WorldSpec::default() };
    let info = WorldInfo { name: "chairs".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    let start = WorldTime::ZERO;
    let world = World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), start).unwrap();
    let mut run = VirtualRun::new(world, 1, start);
    let place = Arc::new(Mutex::new(DVec3::ZERO));
    let link = LinkRules { loss: 0.2, ..LinkRules::default().with_delay(ms(40)) };
    let tracker = TrackerConfig::default().with_frame(Duration::from_micros(16_667));
    let session = SessionConfig::default().with_tracker(tracker);
    let plan = ClientPlan::new(session, link);
    run.join(plan, Box::new(Standing::new(walls, place.clone())), IndexView::default().maker());
    run.run_for(ms(2_000), &mut Ignore);
    let before = run.world().census();
    for beyond in [true, false, true] {
        let z = if beyond { -10.0 } else { 0.0 };
        *place.lock().unwrap() = DVec3::new(0.0, 0.0, z);
        run.run_for(ms(2_000), &mut Ignore);
    }
    assert_eq!((before.visible.sum(), run.world().census().visible.sum()), (0.0, 1_000.0));
    let stats = run.world().stats();
    assert!(stats.messages_in.requests() > 2_500, "{:?}", stats.messages_in);
    assert_eq!((stats.limited.total(), stats.busy), (0, 0), "{:?}", stats.limited);
}
