//! One or two of everything that is said, with its bytes: a change of any of them is a new protocol version.
//!
//! The literals are split where a field ends.

use std::fmt::Debug;

use eyeline_protocol::codec::{self, DatagramWriter, DecodeError};
use eyeline_protocol::*;

/// A message and its bytes.
pub struct Sample<T> {
    pub name: &'static str,
    pub message: T,
    pub hex: &'static str,
}

impl<T> Sample<T> {
    pub fn bytes(&self) -> Vec<u8> {
        bytes(self.hex)
    }
}

/// The bytes that a literal spells; blanks are for the reader.
pub fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.chars().filter_map(|c| c.to_digit(16)).map(|digit| digit as u8).collect();
    assert!(digits.len().is_multiple_of(2), "half a byte in {hex}");
    digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect()
}

/// A control message without its length prefix.
pub fn control_bytes<M: Message>(message: &M) -> Vec<u8> {
    let framed = codec::encode_control(message);
    let length = framed.len() as u32 - 4;
    assert_eq!(framed[..4], length.to_le_bytes());
    framed[4..].to_vec()
}

/// A record as it lies in a datagram. (A record may stand where the header does.)
pub fn record_bytes<M: Message>(record: &M) -> Vec<u8> {
    DatagramWriter::new(record, codec::DATAGRAM_BYTES_MAX).finish()
}

const OBJECT: ObjectId = ObjectId(0x03_02_01);
const POSITION: Position = Position { x: 0x0102_0304, y: -1, z: 1024 };

fn half_turn() -> Orientation {
    Orientation::from_yaw(std::f64::consts::PI)
}

const WIRE_TBV: WireTbv = WireTbv {
    centre: POSITION,
    radius_steps: 250,
    speed_steps: 251,
    age_micros: 0x1_0000,
    valid_millis: 60_000,
    issue: Issue(7),
};

const WIDEST_TBV: WireTbv = WireTbv {
    centre: Position { x: i32::MIN, y: i32::MAX, z: 0 },
    radius_steps: u32::MAX,
    speed_steps: u32::MAX,
    age_micros: u32::MAX,
    valid_millis: u32::MAX,
    issue: Issue(u32::MAX),
};

pub fn client_control() -> Vec<Sample<ClientControl>> {
    vec![
        Sample {
            name: "hello of an avatar",
            message: ClientControl::Hello {
                version: VERSION,
                token: vec![0xaa, 0xbb],
                resolution: (320, 240),
                interest: Interest::Around,
                role: Role::Avatar,
                name: "Ada".into(),
                resume: Some(Resume { token: [0x11; 16], heard: Some(3) }),
            },
            hex: "00 04 02aabb fb4001 f0 00 00 03416461 01 11111111111111111111111111111111 01 03",
        },
        Sample {
            name: "hello of a replay",
            message: ClientControl::Hello {
                version: VERSION,
                token: Vec::new(),
                resolution: (0, 0),
                interest: Interest::Frustum,
                role: Role::Actor { avatars: 32 },
                name: String::new(),
                resume: None,
            },
            hex: "00 04 00 00 00 01 0120 00 00",
        },
        Sample { name: "world wanted", message: ClientControl::WorldWanted, hex: "01" },
        Sample {
            name: "place",
            message: ClientControl::Place { object: OBJECT, position: POSITION, present: true },
            hex: "02 010203 04030201 ffffffff 00040000 01",
        },
        Sample { name: "goodbye", message: ClientControl::Goodbye, hex: "03" },
        Sample { name: "take", message: ClientControl::Take { object: OBJECT }, hex: "04 010203" },
        Sample { name: "let go", message: ClientControl::LetGo { object: OBJECT }, hex: "05 010203" },
        Sample {
            name: "payload",
            message: ClientControl::Payload { object: OBJECT, bytes: vec![9, 8] },
            hex: "06 010203 020908",
        },
        Sample { name: "list", message: ClientControl::Command(Command::List), hex: "07 00" },
        Sample {
            name: "kick",
            message: ClientControl::Command(Command::Kick { client: ClientId(300), reason: "no".into() }),
            hex: "07 01 fb2c01 026e6f",
        },
        Sample {
            name: "ban",
            message: ClientControl::Command(Command::Ban { client: ClientId(1), seconds: 60, reason: String::new() }),
            hex: "07 02 01 3c 00",
        },
        Sample {
            name: "say",
            message: ClientControl::Command(Command::Say { text: "hi".into() }),
            hex: "07 03 026869",
        },
    ]
}

pub fn server_control() -> Vec<Sample<ServerControl>> {
    let avatar = Class {
        name: "avatar".into(),
        motion: MotionBound { speed_max: 2.0, slack: 0.125 },
        extent: Extent { radius: 0.25, bottom: 0.0, top: 1.75 },
        eye_height: 1.5,
        turn_max: Some(4.0),
    };
    let welcome = Welcome {
        version: VERSION,
        client: ClientId(300),
        avatars: vec![(OBJECT, POSITION, half_turn())],
        anchor: [1.0, -2.0, 0.5],
        tick_micros: 50_000,
        answer_micros: 50_000,
        policy: "visible".into(),
        tracking: true,
        blur: 1.0,
        dead_reckoning_px: Some(0.5),
        world: WorldInfo { name: "rooms".into(), hash: [0x5a; 32], size_bytes: 1 << 32, two_sided: true },
        classes: vec![avatar],
        objects: 300,
        rank: Rank::Operator,
        resume: [0x22; 16],
        grace_millis: 30_000,
        continuity: Continuity::Kept,
    };
    let chair = RosterEntry {
        object: OBJECT,
        class: ClassId(1),
        name: "chair".into(),
        node: "Chair.001".into(),
        bound: Some(WIRE_TBV),
        issue: Issue(7),
        present: true,
    };
    let absent = RosterEntry {
        object: ObjectId(0),
        class: ClassId(0),
        name: String::new(),
        node: String::new(),
        bound: None,
        issue: Issue(0),
        present: false,
    };
    let refused = |refusal, reason: &str| ServerControl::Refused { refusal, reason: reason.into() };
    vec![
        Sample {
            name: "welcome",
            message: ServerControl::Welcome(Box::new(welcome)),
            hex: "00 04 fb2c01 01 010203 04030201 ffffffff 00040000 fffdf75f \
 000000000000f03f 00000000000000c0 000000000000e03f fb50c3 fb50c3 0776697369626c65 01 000000000000f03f 01000000000000e03f \
 05726f6f6d73 5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a fd0000000001000000 01 \
 01 06617661746172 0000000000000040 000000000000c03f \
 000000000000d03f 0000000000000000 000000000000fc3f 000000000000f83f 010000000000001040 fb2c01 \
 02 22222222222222222222222222222222 fb3075 02",
        },
        Sample { name: "refused: version", message: refused(Refusal::Version, "old"), hex: "01 00 036f6c64" },
        Sample { name: "refused: full", message: refused(Refusal::Full, ""), hex: "01 01 00" },
        Sample { name: "refused: protocol", message: refused(Refusal::Protocol, ""), hex: "01 02 00" },
        Sample { name: "refused: shutting down", message: refused(Refusal::ShuttingDown, "é"), hex: "01 03 02c3a9" },
        Sample { name: "refused: replaced", message: refused(Refusal::Replaced, ""), hex: "01 08 00" },
        Sample {
            name: "roster",
            message: ServerControl::Roster { tick: WorldTime::from_micros(-1), entries: vec![chair, absent] },
            hex: "02 01 02 \
 010203 01 056368616972 0943686169722e303031 01 04030201 ffffffff 00040000 fa fbfb00 fc00000100 fb60ea 07 07 01 \
 000000 00 00 00 00 00 00",
        },
        Sample {
            name: "left",
            message: ServerControl::Left { objects: vec![ObjectId(1), ObjectId::MAX] },
            hex: "03 02 010000 ffffff",
        },
        Sample {
            name: "held",
            message: ServerControl::Held { object: OBJECT, hold: Hold::TooFar },
            hex: "04 010203 03",
        },
        Sample {
            name: "payload",
            message: ServerControl::Payload { object: Some(OBJECT), bytes: vec![9, 8] },
            hex: "05 01 010203 020908",
        },
        Sample {
            name: "the server's payload",
            message: ServerControl::Payload { object: None, bytes: Vec::new() },
            hex: "05 00 00",
        },
        Sample { name: "said", message: ServerControl::Said { text: "hi".into() }, hex: "06 026869" },
        Sample {
            name: "clients",
            message: ServerControl::Clients {
                entries: vec![ClientEntry {
                    client: ClientId(300),
                    name: "Ada".into(),
                    subject: "a".into(),
                    rank: Rank::Actor,
                    avatars: 1,
                    seconds: 60,
                    rtt_micros: Some(1000),
                    away: true,
                }],
            },
            hex: "07 01 fb2c01 03416461 0161 01 01 3c 01fbe803 01",
        },
        Sample { name: "done", message: ServerControl::Done { ok: false, text: "no".into() }, hex: "08 00 026e6f" },
    ]
}

pub fn client_headers() -> Vec<Sample<ClientHeader>> {
    vec![
        Sample { name: "first client header", message: ClientHeader::default(), hex: "00 00 00 00 00" },
        Sample {
            name: "client header",
            message: ClientHeader {
                link: LinkHeader { seq: 1000, ack: 250, ack_bits: 0xffff_fffe, hold_micros: 16_000 },
                frame: WorldTime::from_micros(1_000_000),
            },
            hex: "fbe803 fa fcfeffffff fb803e fc80841e00",
        },
        Sample {
            name: "longest client header",
            message: ClientHeader {
                link: LinkHeader { seq: u32::MAX, ack: u32::MAX, ack_bits: u32::MAX, hold_micros: u32::MAX },
                frame: WorldTime::MIN,
            },
            hex: "fcffffffff fcffffffff fcffffffff fcffffffff fdffffffffffffffff",
        },
    ]
}

pub fn server_headers() -> Vec<Sample<ServerHeader>> {
    vec![
        Sample { name: "first server header", message: ServerHeader::default(), hex: "00 00 00 00 00 00" },
        Sample {
            name: "server header",
            message: ServerHeader {
                link: LinkHeader { seq: 1, ack: 2, ack_bits: 3, hold_micros: 4 },
                sent: WorldTime::from_micros(1_000_050),
                tick: WorldTime::from_micros(1_000_000),
            },
            hex: "01 02 03 04 fce4841e00 fc80841e00",
        },
        Sample {
            name: "longest server header",
            message: ServerHeader {
                link: LinkHeader { seq: u32::MAX, ack: u32::MAX, ack_bits: u32::MAX, hold_micros: u32::MAX },
                sent: WorldTime::MAX,
                tick: WorldTime::MIN,
            },
            hex: "fcffffffff fcffffffff fcffffffff fcffffffff fdfeffffffffffffff fdffffffffffffffff",
        },
    ]
}

pub fn client_records() -> Vec<Sample<ClientRecord>> {
    let request = |want, reason| ClientRecord::Request { object: OBJECT, want, reason };
    vec![
        Sample {
            name: "pose",
            message: ClientRecord::Pose { object: OBJECT, position: POSITION, orientation: half_turn() },
            hex: "00 010203 04030201 ffffffff 00040000 fffdf75f",
        },
        Sample { name: "request: unknown", message: request(Want::Bound, Reason::Unknown), hex: "01 010203 00 00" },
        Sample { name: "request: exposed", message: request(Want::State, Reason::Exposed), hex: "01 010203 01 01" },
        Sample { name: "request: expired", message: request(Want::Bound, Reason::Expired), hex: "01 010203 00 02" },
        Sample { name: "request: violated", message: request(Want::State, Reason::Violated), hex: "01 010203 01 03" },
        Sample {
            name: "release",
            message: ClientRecord::Release { object: OBJECT, want_bound: true },
            hex: "02 010203 01",
        },
        Sample {
            name: "violation ack",
            message: ClientRecord::ViolationAck { object: OBJECT, issue: Issue(251) },
            hex: "03 010203 fbfb00",
        },
        Sample {
            name: "eye",
            message: ClientRecord::Eye { position: POSITION, orientation: half_turn() },
            hex: "04 04030201 ffffffff 00040000 fffdf75f",
        },
    ]
}

pub fn server_records() -> Vec<Sample<ServerRecord>> {
    vec![
        Sample {
            name: "state",
            message: ServerRecord::State {
                object: OBJECT,
                position: POSITION,
                orientation: Orientation::default(),
                velocity: Velocity { x: 1, y: -1, z: 0 },
            },
            hex: "00 010203 04030201 ffffffff 00040000 00000000 02 01 00",
        },
        Sample {
            name: "longest state",
            message: ServerRecord::State {
                object: OBJECT,
                position: POSITION,
                orientation: Orientation::default(),
                velocity: Velocity { x: i16::MAX, y: i16::MIN, z: 256 },
            },
            hex: "00 010203 04030201 ffffffff 00040000 00000000 fbfeff fbffff fb0002",
        },
        Sample {
            name: "bound",
            message: ServerRecord::Bound { object: OBJECT, tbv: WIRE_TBV },
            hex: "01 010203 04030201 ffffffff 00040000 fa fbfb00 fc00000100 fb60ea 07",
        },
        Sample {
            name: "longest bound",
            message: ServerRecord::Bound { object: OBJECT, tbv: WIDEST_TBV },
            hex: "01 010203 00000080 ffffff7f 00000000 fcffffffff fcffffffff fcffffffff fcffffffff fcffffffff",
        },
        Sample {
            name: "violation",
            message: ServerRecord::Violation { object: OBJECT, issue: Issue(8), age_micros: 50_000, present: false },
            hex: "02 010203 08 fb50c3 00",
        },
        Sample {
            name: "longest violation",
            message: ServerRecord::Violation {
                object: OBJECT,
                issue: Issue(u32::MAX),
                age_micros: u64::MAX,
                present: true,
            },
            hex: "02 010203 fcffffffff fdffffffffffffffff 01",
        },
        Sample { name: "hidden", message: ServerRecord::Hidden { object: OBJECT }, hex: "03 010203" },
    ]
}

/// A sample's bytes, and the decoder that they are for as one that only says whether they mean something, and that
/// what they mean survives being written and read again.
pub type Case = (&'static str, Vec<u8>, Reader);

/// Decodes, and checks that what was decoded means the same when it is written again.
pub type Reader = fn(&[u8]) -> Result<(), DecodeError>;

pub fn read_client_control(bytes: &[u8]) -> Result<(), DecodeError> {
    let message = codec::decode_client_control(bytes)?;
    assert_same(codec::decode_client_control(&control_bytes(&message)), &message);
    Ok(())
}

pub fn read_server_control(bytes: &[u8]) -> Result<(), DecodeError> {
    let message = codec::decode_server_control(bytes)?;
    assert_same(codec::decode_server_control(&control_bytes(&message)), &message);
    Ok(())
}

pub fn read_client_datagram(bytes: &[u8]) -> Result<(), DecodeError> {
    let datagram = codec::decode_client_datagram(bytes)?;
    assert_same(codec::decode_client_datagram(&pack(&datagram.0, &datagram.1)), &datagram);
    Ok(())
}

pub fn read_server_datagram(bytes: &[u8]) -> Result<(), DecodeError> {
    let datagram = codec::decode_server_datagram(bytes)?;
    assert_same(codec::decode_server_datagram(&pack(&datagram.0, &datagram.1)), &datagram);
    Ok(())
}

fn assert_same<T: PartialEq + Debug>(again: Result<T, DecodeError>, first: &T) {
    assert_eq!(again.as_ref(), Ok(first));
}

/// One datagram of these.
pub fn pack<H: Message, R: Message>(header: &H, records: &[R]) -> Vec<u8> {
    let mut writer = DatagramWriter::new(header, codec::DATAGRAM_BYTES_MAX);
    for record in records {
        assert!(writer.push(record));
    }
    writer.finish()
}

/// Each control message.
pub fn control_cases() -> Vec<Case> {
    let client = client_control().into_iter().map(|s| (s.name, s.bytes(), read_client_control as Reader));
    let server = server_control().into_iter().map(|s| (s.name, s.bytes(), read_server_control as Reader));
    client.chain(server).collect()
}

/// Each header alone, and each record behind each header.
pub fn datagram_cases() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    for header in client_headers() {
        cases.push((header.name, header.bytes(), read_client_datagram));
        for record in client_records() {
            cases.push((record.name, [header.bytes(), record.bytes()].concat(), read_client_datagram));
        }
    }
    for header in server_headers() {
        cases.push((header.name, header.bytes(), read_server_datagram));
        for record in server_records() {
            cases.push((record.name, [header.bytes(), record.bytes()].concat(), read_server_datagram));
        }
    }
    cases
}
