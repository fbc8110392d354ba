//! What an audit lets through, and what is told instead.

use std::sync::{Arc, Mutex};

use eyeline_protocol::{LinkHeader, Reason, Role, ServerHeader, ServerRecord};

use super::tests::{datagram, drain, join, world_of};
use super::*;
use crate::policy::{Visible, Watcher};

/// Entitles to what a switch says, and notes the eye regions.
#[derive(Clone, Default)]
struct Switch(Arc<Mutex<(bool, Vec<f64>)>>);

impl Audit for Switch {
    fn entitled(&mut self, _: &[Object], _: &Watcher, radius: f64, _: ObjectId) -> bool {
        let mut state = self.0.lock().unwrap();
        state.1.push(radius);
        state.0
    }
}

const OTHER: ObjectId = ObjectId(0);

fn audited() -> (World, SessionId, SessionId, Switch) {
    audited_by(WorldConfig::default())
}

fn audited_by(config: WorldConfig) -> (World, SessionId, SessionId, Switch) {
    let mut world = world_of(config, Box::new(Visible));
    let other = join(&mut world, Role::Avatar);
    let client = join(&mut world, Role::Avatar);
    drain(&mut world, client);
    let switch = Switch::default();
    world.set_audit(Box::new(switch.clone()));
    (world, other, client, switch)
}

/// The records of what is sent to `client`.
pub(super) fn told(world: &mut World, client: SessionId) -> (Vec<ServerRecord>, Vec<ServerHeader>) {
    let (mut records, mut headers) = (Vec::new(), Vec::new());
    for transmit in drain(world, client) {
        let Transmit::Datagram(bytes) = transmit else { continue };
        let (header, more) = codec::decode_server_datagram(&bytes).unwrap();
        headers.push(header);
        records.extend(more);
    }
    (records, headers)
}

fn request(want: Want) -> ClientRecord {
    ClientRecord::Request { object: OTHER, want, reason: Reason::Exposed }
}

/// Moves the other avatar a little, and commits it.
fn walk(world: &mut World, other: SessionId, seq: u32) {
    let at = world.objects()[OTHER.index()].position;
    let record = ClientRecord::Pose {
        object: OTHER,
        position: Position { x: at.x + 20, ..at },
        orientation: Orientation::default(),
    };
    world.handle_datagram(other, &datagram(seq, &[record]), WorldTime::ZERO);
    let due = world.poll_timeout();
    world.tick(due);
}

#[test]
fn what_a_client_may_not_see_it_is_not_told_however_it_asks() {
    let (mut world, _, client, switch) = audited();
    for (seq, want) in [(1, Want::State), (2, Want::Place)] {
        world.handle_datagram(client, &datagram(seq, &[request(want)]), WorldTime::ZERO);
        let (records, _) = told(&mut world, client);
        // Who asked for updates is told that there are none.
        let bound = if want == Want::State { &records[1..] } else { &records[..] };
        assert!(matches!(bound, [ServerRecord::Bound { object: OTHER, .. }]), "{want:?}: {records:?}");
    }
    assert_eq!((world.stats().withheld, world.stats().out.states, world.stats().out.places), (2, 0, 0));
    switch.0.lock().unwrap().0 = true;
    world.handle_datagram(client, &datagram(3, &[request(Want::Place)]), WorldTime::ZERO);
    let (records, _) = told(&mut world, client);
    assert!(matches!(records[..], [ServerRecord::State { object: OTHER, .. }]), "{records:?}");
}

#[test]
fn what_goes_out_of_sight_is_bounded_once_and_told_when_it_comes_back() {
    let (mut world, other, client, switch) = audited();
    switch.0.lock().unwrap().0 = true;
    world.handle_datagram(client, &datagram(1, &[request(Want::State)]), WorldTime::ZERO);
    assert_eq!(told(&mut world, client).0.len(), 1);
    switch.0.lock().unwrap().0 = false;
    let mut kinds = Vec::new();
    for seq in 1..=4 {
        walk(&mut world, other, seq);
        kinds.extend(told(&mut world, client).0);
    }
    assert!(
        matches!(kinds[..], [ServerRecord::Hidden { .. }, ServerRecord::Bound { .. }]),
        "one bound says it all: {kinds:?}"
    );
    // Even if it stands still by then.
    switch.0.lock().unwrap().0 = true;
    let due = world.poll_timeout();
    world.tick(due);
    let (records, _) = told(&mut world, client);
    assert!(matches!(records[..], [ServerRecord::State { .. }]), "{records:?}");
}

/// A bound has taken the place of what was drawn, though that is right again.
#[test]
fn what_comes_back_to_where_it_was_drawn_is_told_in_spite_of_dead_reckoning() {
    let (mut world, other, client, switch) = audited_by(WorldConfig::default().with_dead_reckoning_px(Some(1.0)));
    switch.0.lock().unwrap().0 = true;
    world.handle_datagram(client, &datagram(1, &[request(Want::State)]), WorldTime::ZERO);
    assert_eq!(told(&mut world, client).0.len(), 1);
    let Object { position: at, orientation, .. } = world.objects()[OTHER.index()];
    let mut go = |position: Position, seq: u32, entitled: bool| {
        switch.0.lock().unwrap().0 = entitled;
        let record = ClientRecord::Pose { object: OTHER, position, orientation };
        world.handle_datagram(other, &datagram(seq, &[record]), WorldTime::ZERO);
        let due = world.poll_timeout();
        world.tick(due);
        told(&mut world, client).0
    };
    let away = go(Position { x: at.x + 100, ..at }, 1, false);
    assert!(matches!(away[..], [ServerRecord::Hidden { .. }, ServerRecord::Bound { .. }]), "{away:?}");
    let back = go(at, 2, true);
    assert!(matches!(back[..], [ServerRecord::State { position, .. }] if position == at), "{back:?}");
}

#[test]
fn a_bound_in_place_of_a_push_is_told_again_if_it_gets_lost() {
    let (mut world, other, client, switch) = audited();
    switch.0.lock().unwrap().0 = true;
    world.handle_datagram(client, &datagram(1, &[request(Want::State)]), WorldTime::ZERO);
    told(&mut world, client);
    switch.0.lock().unwrap().0 = false;
    walk(&mut world, other, 1);
    assert_eq!(told(&mut world, client).0.len(), 2);
    // Nothing is acknowledged for longer than the time-out of a link without a round trip.
    world.tick(WorldTime::from_micros(1_500_000));
    let (records, _) = told(&mut world, client);
    assert!(matches!(records[..], [ServerRecord::Hidden { .. }, ServerRecord::Bound { .. }]), "{records:?}");
}

#[test]
fn the_eye_region_is_what_the_round_trip_allows_and_never_more_than_the_cap() {
    let (mut world, _, client, switch) = audited();
    world.handle_datagram(client, &datagram(1, &[request(Want::Place)]), WorldTime::ZERO);
    let (_, headers) = told(&mut world, client);
    // Not measured yet: the cap. Then a round trip of 100 ms: 2 m/s for 2·100 + 3·50 ms, and the slack of 60 ms.
    let reply = LinkHeader { seq: 2, ack: headers[0].link.seq, ack_bits: 0, hold_micros: 0 };
    let mut writer =
        codec::DatagramWriter::new(&eyeline_protocol::ClientHeader { link: reply, frame: WorldTime::ZERO }, 1200);
    assert!(writer.push(&request(Want::Place)));
    world.handle_datagram(client, &writer.finish(), WorldTime::from_micros(100_000));
    told(&mut world, client);
    let radii = switch.0.lock().unwrap().1.clone();
    assert_eq!(radii[0], 2.0);
    let last = *radii.last().unwrap();
    assert!((last - (2.0 * 0.35 + 2.0 * 0.06)).abs() < 2e-3, "{last}");
    assert!(eye_region(&WorldConfig::default(), world.classes()[0].motion, Some(Duration::from_secs(5))) <= 2.0);
}
