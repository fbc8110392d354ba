//! Who comes and goes leaves nothing behind: thousands of joins, returns and leaves, and the world is as large as before.
//! `eyeline-sim load --churn` looks at the memory of a whole server.

use std::time::Duration;

use eyeline_protocol::codec::encode_control;
use eyeline_protocol::{Continuity, Interest, Reason, Resume, Role, ServerControl, VERSION};

use super::tests::{datagram, world_of};
use super::*;
use crate::gate::Caller;
use crate::policy::Visible;

/// Most clients at once.
const PLACES: usize = 8;

struct Guest {
    id: SessionId,
    resume: [u8; 16],
    seq: u32,
}

/// What a world keeps, in numbers of things.
fn sizes(world: &World) -> [usize; 7] {
    let held: usize = world.objects.iter().filter(|object| object.alive).count();
    [
        world.objects.len(),
        held + world.free.len(),
        world.slots,
        world.sessions.len(),
        world.out.len(),
        world.awake.len(),
        world.announcements.kept(),
    ]
}

fn come(world: &mut World, number: u32, resume: Option<[u8; 16]>) -> (Guest, Continuity) {
    let mut token = [0; 16];
    token[..4].copy_from_slice(&(number + 1).to_le_bytes());
    let id = world.connect_from(world.committed_at(), Caller { address: None, resume: token });
    let hello = ClientControl::Hello {
        version: VERSION,
        token: Vec::new(),
        resolution: (320, 240),
        interest: Interest::Around,
        role: Role::Avatar,
        name: format!("guest {number}"),
        resume: resume.map(|token| Resume { token, heard: None }),
    };
    world.handle_control(id, &encode_control(&hello)[4..], world.committed_at());
    let mut continuity = None;
    while let Some((to, transmit)) = world.poll_transmit(world.committed_at()) {
        if to == id
            && let Transmit::Control(bytes) = transmit
            && let Ok(ServerControl::Welcome(welcome)) = codec::decode_server_control(&bytes[4..])
        {
            continuity = Some(welcome.continuity);
        }
    }
    (Guest { id, resume: token, seq: 0 }, continuity.expect("everybody is let in"))
}

#[test]
fn a_world_through_which_thousands_have_gone_is_as_large_as_one_through_which_hundreds_have() {
    let grace = Duration::from_millis(200);
    let mut world = world_of(WorldConfig::default().with_resume_grace(grace), Box::new(Visible));
    let mut guests: Vec<Guest> = Vec::new();
    let (mut number, mut returned) = (0, 0);
    let mut after = Vec::new();
    for round in 1..=4_000u32 {
        match round % 5 {
            _ if guests.len() < PLACES => {
                guests.push(come(&mut world, number, None).0);
                number += 1;
            }
            // One says goodbye, one is lost for good, one comes back, one is put elsewhere.
            0 | 1 => {
                let guest = guests.remove(round as usize % PLACES);
                if round % 5 == 0 {
                    world.handle_control(guest.id, &encode_control(&ClientControl::Goodbye)[4..], world.committed_at());
                }
                world.disconnect(guest.id);
            }
            2 => {
                let index = round as usize % PLACES;
                world.disconnect(guests[index].id);
                let (guest, continuity) = come(&mut world, number, Some(guests[index].resume));
                returned += u32::from(continuity != Continuity::New);
                guests[index] = guest;
                number += 1;
            }
            _ => {
                let x = i32::try_from(round % 64).unwrap() * 1_000;
                world.teleport(ObjectId(round % PLACES as u32), Position { x, y: 0, z: 0 });
            }
        }
        let objects = world.objects.len() as u32;
        for (index, guest) in guests.iter_mut().enumerate() {
            guest.seq += 1;
            let object = ObjectId((round + index as u32) % objects);
            let record = match round % 3 {
                0 => ClientRecord::Release { object, want_bound: true },
                _ => ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed },
            };
            world.handle_datagram(guest.id, &datagram(guest.seq, &[record]), world.committed_at());
        }
        world.tick(world.poll_timeout());
        while world.poll_transmit(world.committed_at()).is_some() {}
        for session in world.sessions.values() {
            assert!(session.visible() <= world.objects.len(), "of each object it is told once");
        }
        if round == 400 || round == 4_000 {
            after.push(sizes(&world));
        }
    }
    assert!(number > 1_500 && returned > 500, "{number} came and {returned} came back");
    // Those who are lost for good wait for their grace, four ticks: two more at most.
    let most = [PLACES + 4, PLACES + 4, PLACES + 4, PLACES + 4, 0, 0, 1_024];
    for sizes in &after {
        assert!(sizes.iter().zip(most).all(|(is, most)| *is <= most), "{after:?}, at most {most:?}");
    }
}
