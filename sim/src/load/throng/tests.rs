use bytes::Bytes;
use eyeline_client::net::Fingerprint;
use eyeline_client::session::SessionConfig;
use eyeline_protocol::WorldTime;
use eyeline_server::net::{Identity, Server, WorldClock};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::{WorldConfig, WorldStats};
use eyeline_visibility::FlatIndex;

use super::*;
use crate::load::ways::{Replayer, WayRules, Ways};
use crate::scene::plan::RoomsRules;
use crate::stage::Stage;

const PERIOD: Duration = Duration::from_millis(50);

/// Lets six play for so long in a small building; what the server counted, the avatars that are left, and what became of
/// them.
fn played(churn: f64, how_long: Duration) -> (WorldStats, usize, Vec<Outcome>) {
    let stage = Stage::made(&RoomsRules { columns: 3, rows: 2, ..RoomsRules::default() }).unwrap();
    let rules = WayRules { ways: 3, frames: 20, period: PERIOD, side: 32, hold: 0.25, seed: 7 };
    let ways = Arc::new(Ways::record(&stage.ground(), stage.model.scene.bounds(), &rules).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let identity = Identity::load_or_create(folder.path()).unwrap();
    let fingerprint: Fingerprint = identity.fingerprint_hex().parse().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(tokio::task::LocalSet::new().run_until(async move {
        let clock = WorldClock::starting_at(WorldTime::from_micros(1_000_000));
        let config = WorldConfig::default().with_grid_seed(7);
        let world = stage.world(config, "visible", &PolicySettings::default(), clock.now()).unwrap();
        let any = (Ipv4Addr::LOCALHOST, 0).into();
        let server = Server::bind(any, identity, world, Bytes::new(), clock, None).unwrap();
        let (handle, address) = (server.handle(), server.local_addr().unwrap());
        let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
        let server = tokio::task::spawn_local(server.run(async move { drop(stopped.await) }));
        let clock = LocalClock::default();
        let (trust, begin) = (fingerprint.into(), clock.now());
        let rules = ThrongRules { address, trust, first: 2, end: 8, period: PERIOD, begin, churn, steady: 2, seed: 7 };
        let recruiter = move |number: usize, turn: usize| Recruit {
            session: Session::new(SessionConfig::default(), Box::new(|| Box::new(FlatIndex::default()))),
            player: Box::new(Replayer::new(ways.clone(), number + turn, 6, None)),
        };
        let mut throng = Throng::new(rules, clock, Box::new(recruiter)).unwrap();
        throng.join().await.unwrap();
        if let Ok(ended) = tokio::time::timeout(how_long, throng.play()).await {
            match ended.unwrap() {}
        }
        let outcomes = throng.leave().await;
        let (stats, avatars) = handle.with_world(|world| (*world.stats(), world.avatars()));
        drop(stop);
        server.await.unwrap();
        (stats, avatars, outcomes)
    }))
}

#[test]
fn each_plays_and_is_told_of_the_others() {
    let (stats, avatars, outcomes) = played(0.0, Duration::from_millis(800));
    assert_eq!((stats.admitted, avatars, outcomes.len()), (6, 0, 6), "{stats:?}");
    assert_eq!([stats.rejected_datagrams, stats.rejected_control, stats.forbidden], [0; 3], "{stats:?}");
    // 16 frames each, less what a busy machine leaves out.
    assert!(stats.messages_in.poses >= 6 * 8, "{} poses", stats.messages_in.poses);
    for outcome in outcomes {
        assert!(outcome.counts.0 > 0 && outcome.round_trip.is_some(), "{outcome:?}");
    }
}

#[test]
fn those_who_change_come_back_and_are_told_apart() {
    let (stats, avatars, outcomes) = played(6.0, Duration::from_millis(1500));
    assert_eq!((avatars, outcomes.len()), (0, 6), "some were not heard to leave");
    assert!(stats.admitted > 6, "nobody joined anew: {stats:?}");
    assert!(stats.resumed > 0, "nobody came back: {stats:?}");
    assert_eq!([stats.rejected_datagrams, stats.rejected_control], [0; 2], "{stats:?}");
}
