//! What an application is told of what comes into view, stops, and goes.

use std::time::Duration;

use eyeline_client::session::Event;
use eyeline_tests::{HIDDEN, Pair};
use glam::DVec3;

const fn ms(millis: u64) -> Duration {
    Duration::from_millis(millis)
}

/// Beside the wall, in sight.
const BESIDE: DVec3 = DVec3::new(14.0, 0.0, -10.0);

#[test]
fn hidden_and_stopped_are_told_apart() {
    for loss in [0.0, 0.2] {
        let mut pair = Pair::builder().seed(3).latency(ms(20)).loss(loss).build();
        let object = pair.spawn_hidden();
        assert_eq!(pair.events(object), []);
        // It comes out from behind the wall, and on the way does not stand.
        pair.walk(object, BESIDE, 1.6);
        pair.run_for(ms(8_000));
        assert_eq!(pair.events(object), [Event::Revealed(object)], "loss {loss}");
        // It arrives, 14 m from where it was.
        pair.run_for(ms(1_500));
        assert_eq!(pair.events(object)[1..], [Event::Stopped(object)], "loss {loss}");
        // It stands: nothing is said any more, and it is neither gone nor has it stopped again.
        pair.run_for(ms(3_000));
        assert_eq!(pair.events(object).len(), 2, "loss {loss}");
        // It goes back; that it cannot be seen says nothing of whether it stands.
        pair.walk(object, HIDDEN, 1.6);
        pair.run_for(ms(9_000));
        // At the wall's edge it may be lost sight of twice.
        let last = &pair.events(object)[2..];
        assert_eq!(last.last(), Some(&Event::Hidden(object)), "loss {loss}");
        assert!(!last.contains(&Event::Stopped(object)), "loss {loss}: {last:?}");
        pair.truth.assert_kept("events");
    }
}

#[test]
fn what_leaves_the_world_in_sight_is_hidden_from_then_on() {
    let mut pair = Pair::builder().latency(ms(20)).build();
    let object = pair.spawn(BESIDE);
    pair.run_for(ms(1_000));
    assert_eq!(pair.events(object), [Event::Revealed(object), Event::Stopped(object)]);
    pair.place(object, BESIDE, false);
    pair.run_for(ms(500));
    assert_eq!(pair.events(object)[2..], [Event::Hidden(object)]);
}
