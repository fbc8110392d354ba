//! A server and its clients, some of them hostile: bytes say who does what, in what order.
//!
//! The first client is honest: it is told only what the world says, though not all of it and not in order. Whatever the
//! others do, no bound that it believes is ever broken. The last one's server is hostile: it must not fall over.

use std::collections::VecDeque;
use std::time::Duration;

use arbitrary::{Result, Unstructured};
use eyeline_client::session::{Session, SessionConfig};
use eyeline_client::tracking::Ahead;
use eyeline_protocol::codec::{self, DatagramWriter};
use eyeline_protocol::{
    ClientControl, ClientHeader, ClientId, ClientRecord, Command, Interest, Issue, LinkHeader, LocalTime, ObjectId,
    Orientation, Position, Rank, Reason, Resume, Role, VERSION, Want, WorldInfo, WorldTime,
};
use eyeline_server::gate::{Caller, OpenGate};
use eyeline_server::policy::Visible;
use eyeline_server::spec::{ClassSpec, ObjectSpec, PathSpec, WorldSpec};
use eyeline_server::world::{SessionId, Transmit, World, WorldConfig, WorldError, WorldStats};
use eyeline_visibility::{Aabb, Bound, DynamicOctree, Occlusion};
use glam::DVec3;

/// Steps of one play at most.
const STEPS_MAX: usize = 1000;

/// What hides things: everything with x beyond a wall.
struct Wall(f64);

impl Occlusion for Wall {
    fn hides(&self, bound: &Bound) -> bool {
        match bound {
            Bound::Sphere { centre, radius } => centre.x - radius > self.0,
            Bound::Box(aabb) => aabb.min.x > self.0,
            Bound::Upright { centre, radius, .. } => centre.x - radius > self.0,
            _ => false,
        }
    }
}

/// A world of what a file says.
///
/// # Errors
/// If it contradicts itself.
pub fn world(spec: WorldSpec) -> std::result::Result<World, WorldError> {
    let info = WorldInfo { name: "fuzz".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    World::new(WorldConfig::default(), spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO)
}

fn furnished() -> WorldSpec {
    let class = ClassSpec { name: "chair".into(), radius: 0.4, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let chair = |number: u32| ObjectSpec {
        name: format!("chair {number}"),
        class: "chair".into(),
        node: None,
        position: [f64::from(number) - 1.0, 0.0, 0.0],
        heading: 0.0,
        takeable: number.is_multiple_of(2),
        path: (number == 3).then(|| PathSpec {
            points: vec![[2.0, 0.0, 0.0], [2.0, 0.0, 3.0]],
            speed: 0.5,
            pause: 0.2,
            phase: 0.0,
            wobble: 0.0,
            wobble_per_metre: 0.0,
            spring: None,
        }),
    };
    WorldSpec { classes: vec![class], objects: (0..6).map(chair).collect(), ..WorldSpec::default() }
}

/// A connection and who is behind it.
struct Client {
    id: SessionId,
    seq: u32,
    session: Session,
    /// What the world said to it and it has not heard.
    control: VecDeque<Vec<u8>>,
    datagrams: VecDeque<Vec<u8>>,
}

impl Client {
    fn new(world: &mut World, number: u8, now: WorldTime) -> Client {
        let caller = Caller { address: None, resume: [number + 1; 16] };
        let session =
            Session::new(SessionConfig::default().with_watch(), Box::new(|| Box::new(DynamicOctree::new(Aabb::EMPTY))));
        let id = world.connect_from(now, caller);
        Client { id, seq: 0, session, control: VecDeque::new(), datagrams: VecDeque::new() }
    }
}

/// Plays what the bytes say.
pub fn play(bytes: &[u8]) {
    play_to_the_end(bytes);
}

/// Plays what the bytes say, and tells what came of it.
pub fn play_to_the_end(bytes: &[u8]) -> WorldStats {
    let Ok(mut world) = world(furnished()) else { unreachable!("the furniture is well made") };
    world.set_gate(Box::new(OpenGate { rank: Rank::Operator }));
    // Bytes that end early end the play.
    let _ = steps(&mut world, &mut Unstructured::new(bytes));
    *world.stats()
}

fn steps(world: &mut World, bytes: &mut Unstructured<'_>) -> Result<()> {
    let mut now = WorldTime::ZERO;
    let mut clients: Vec<Client> = (0..4).map(|number| Client::new(world, number, now)).collect();
    for _ in 0..STEPS_MAX {
        if bytes.is_empty() {
            break;
        }
        let which = usize::from(bytes.arbitrary::<u8>()?) % clients.len();
        let kind = bytes.arbitrary::<u8>()? % 12;
        let local = LocalTime::from_micros(now.micros());
        let client = &mut clients[which];
        // The first is honest: of it only what its session says is heard, and it hears nothing but the world.
        match kind {
            0 | 1 => {
                now = now + Duration::from_millis(u64::from(bytes.arbitrary::<u8>()?));
                world.tick(now);
            }
            2 | 3 => deliver(world, client, now, bytes.arbitrary()?),
            4 | 5 => {
                let wall = Wall(f64::from(bytes.arbitrary::<i8>()?) * 0.1);
                client.session.frame(Ahead::default(), &wall, local);
            }
            6 => {
                if let Some(control) = client.control.pop_front() {
                    client.session.handle_control(&control);
                }
            }
            7 => {
                let wall = Wall(f64::from(bytes.arbitrary::<i8>()?) * 0.1);
                if let Some(datagram) = client.datagrams.pop_front() {
                    let is_lost = bytes.arbitrary::<u8>()? < 32;
                    if !is_lost {
                        client.session.handle_datagram(&datagram, Some(&wall), local);
                    }
                }
            }
            8 if which != 0 => {
                let control = codec::encode_control(&control(bytes)?);
                world.handle_control(client.id, &control[4..], now);
            }
            9 if which != 0 => {
                let datagram = datagram(bytes, &mut client.seq)?;
                world.handle_datagram(client.id, &datagram, now);
            }
            10 if which != 0 => {
                let length = usize::from(bytes.arbitrary::<u8>()?) % 64;
                let raw = bytes.bytes(length.min(bytes.len()))?;
                world.handle_datagram(client.id, raw, now);
                if which == 3 {
                    world.handle_control(client.id, raw, now);
                    client.session.handle_control(raw);
                    client.session.handle_datagram(raw, None, local);
                }
            }
            11 => {
                // Cut off, and back again.
                world.disconnect(client.id);
                let caller =
                    Caller { address: None, resume: [(which as u8).wrapping_add(bytes.arbitrary::<u8>()?).max(1); 16] };
                client.id = world.connect_from(now, caller);
                client.seq = 0;
                client.session.reconnect();
                client.control.clear();
                client.datagrams.clear();
            }
            _ => {}
        }
        drain(world, &mut clients, now);
        // Whatever happens, one's beliefs hold if one was told by the world only.
        let broken = clients[0].session.tracker_stats().broken_bounds;
        assert_eq!(broken, 0, "a bound that was told did not hold");
        for client in &mut clients {
            while client.session.poll_event().is_some() {}
        }
    }
    Ok(())
}

/// Hands the world what the client has to say.
fn deliver(world: &mut World, client: &mut Client, now: WorldTime, limit: u16) {
    while let Some(control) = client.session.poll_control() {
        world.handle_control(client.id, &control[4..], now);
    }
    let limit = usize::from(limit).clamp(100, 1400);
    if let Some(datagram) = client.session.poll_datagram(limit, LocalTime::from_micros(now.micros())) {
        world.handle_datagram(client.id, &datagram, now);
    }
}

/// Takes all that the world has to say; it must come to an end.
fn drain(world: &mut World, clients: &mut [Client], now: WorldTime) {
    for round in 0.. {
        assert!(round < 100_000, "the world has no end of things to say");
        let Some((id, transmit)) = world.poll_transmit(now) else { return };
        let Some(client) = clients.iter_mut().find(|client| client.id == id) else { continue };
        match transmit {
            Transmit::Control(bytes) => client.control.push_back(bytes[4..].to_vec()),
            Transmit::Datagram(bytes) => client.datagrams.push_back(bytes),
            Transmit::WorldBytes | Transmit::Close(_) => {}
        }
        // What is not heard is lost, the oldest first, as in a real buffer.
        while client.datagrams.len() > 16 {
            client.datagrams.pop_front();
        }
    }
}

fn object(bytes: &mut Unstructured<'_>) -> Result<ObjectId> {
    let id = bytes.arbitrary::<u8>()?;
    Ok(if id < 240 { ObjectId(u32::from(id) % 16) } else { ObjectId(bytes.arbitrary::<u32>()? & 0x00ff_ffff) })
}

fn position(bytes: &mut Unstructured<'_>) -> Result<Position> {
    let mut steps = || -> Result<i32> {
        let is_near = bytes.arbitrary::<u8>()? < 200;
        Ok(if is_near { i32::from(bytes.arbitrary::<i16>()?) / 4 } else { bytes.arbitrary()? })
    };
    Ok(Position { x: steps()?, y: steps()?, z: steps()? })
}

fn orientation(bytes: &mut Unstructured<'_>) -> Result<Orientation> {
    Ok(Orientation::from_yaw(f64::from(bytes.arbitrary::<i16>()?) / 5000.0))
}

fn control(bytes: &mut Unstructured<'_>) -> Result<ClientControl> {
    let (kind, object) = (bytes.arbitrary::<u8>()? % 10, object(bytes)?);
    Ok(match kind {
        0 | 1 => {
            let role = match bytes.arbitrary::<u8>()? % 3 {
                0 => Role::Avatar,
                1 => Role::Actor { avatars: u16::from(bytes.arbitrary::<u8>()? % 20) },
                _ => Role::Viewer,
            };
            let token = [bytes.arbitrary::<u8>()? % 6; 16];
            let heard = bytes.arbitrary::<Option<u8>>()?.map(u32::from);
            let resume = bytes.arbitrary::<bool>()?.then_some(Resume { token, heard });
            let interest = if bytes.arbitrary()? { Interest::Around } else { Interest::Frustum };
            let (version, token, name) = (VERSION, Vec::new(), "fuzz".to_owned());
            ClientControl::Hello { version, token, resolution: bytes.arbitrary()?, interest, role, name, resume }
        }
        2 => ClientControl::WorldWanted,
        3 => ClientControl::Place { object, position: position(bytes)?, present: bytes.arbitrary()? },
        4 => ClientControl::Take { object },
        5 => ClientControl::LetGo { object },
        6 => ClientControl::Payload { object, bytes: bytes.arbitrary::<[u8; 3]>()?.to_vec() },
        7 => ClientControl::Command(Command::List),
        8 => {
            let (client, seconds) = (ClientId(u32::from(bytes.arbitrary::<u8>()?)), bytes.arbitrary()?);
            ClientControl::Command(Command::Ban { client, seconds, reason: String::new() })
        }
        _ => ClientControl::Goodbye,
    })
}

fn datagram(bytes: &mut Unstructured<'_>, seq: &mut u32) -> Result<Vec<u8>> {
    *seq = if bytes.arbitrary::<u8>()? < 240 { seq.wrapping_add(1) } else { bytes.arbitrary()? };
    let (ack, ack_bits, hold_micros) = (bytes.arbitrary::<u8>()?.into(), bytes.arbitrary()?, bytes.arbitrary()?);
    let link = LinkHeader { seq: *seq, ack, ack_bits, hold_micros };
    let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::ZERO }, 1200);
    for _ in 0..bytes.arbitrary::<u8>()? % 8 {
        let object = object(bytes)?;
        let record = match bytes.arbitrary::<u8>()? % 6 {
            0 | 1 => ClientRecord::Pose { object, position: position(bytes)?, orientation: orientation(bytes)? },
            2 => {
                let want = [Want::Bound, Want::State, Want::Place][usize::from(bytes.arbitrary::<u8>()? % 3)];
                ClientRecord::Request { object, want, reason: Reason::Exposed }
            }
            3 => ClientRecord::Release { object, want_bound: bytes.arbitrary()? },
            4 => ClientRecord::ViolationAck { object, issue: Issue(bytes.arbitrary()?) },
            _ => ClientRecord::Eye { position: position(bytes)?, orientation: orientation(bytes)? },
        };
        writer.push(&record);
    }
    Ok(writer.finish())
}
