//! The bytes of everything that is said, spelled out.

use eyeline_protocol::codec;
use eyeline_protocol::*;

use crate::samples::{self, Sample, bytes, control_bytes, record_bytes};

#[track_caller]
fn assert_bytes<T>(sample: &Sample<T>, encoded: &[u8]) {
    let hex: String = encoded.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(encoded, sample.bytes(), "{} is {hex}", sample.name);
}

#[test]
fn control_messages_have_these_bytes() {
    for sample in samples::client_control() {
        assert_bytes(&sample, &control_bytes(&sample.message));
        assert_eq!(codec::decode_client_control(&sample.bytes()), Ok(sample.message));
    }
    for sample in samples::server_control() {
        assert_bytes(&sample, &control_bytes(&sample.message));
        assert_eq!(codec::decode_server_control(&sample.bytes()), Ok(sample.message));
    }
}

#[test]
fn headers_have_these_bytes() {
    for sample in samples::client_headers() {
        assert_bytes(&sample, &record_bytes(&sample.message));
        assert_eq!(codec::decode_client_datagram(&sample.bytes()), Ok((sample.message, Vec::new())));
    }
    for sample in samples::server_headers() {
        assert_bytes(&sample, &record_bytes(&sample.message));
        assert_eq!(codec::decode_server_datagram(&sample.bytes()), Ok((sample.message, Vec::new())));
    }
}

#[test]
fn records_have_these_bytes() {
    let header = ClientHeader::default();
    for sample in samples::client_records() {
        assert_bytes(&sample, &record_bytes(&sample.message));
        let datagram = [record_bytes(&header), sample.bytes()].concat();
        assert_eq!(codec::decode_client_datagram(&datagram), Ok((header, vec![sample.message])));
    }
    let header = ServerHeader::default();
    for sample in samples::server_records() {
        assert_bytes(&sample, &record_bytes(&sample.message));
        let datagram = [record_bytes(&header), sample.bytes()].concat();
        assert_eq!(codec::decode_server_datagram(&datagram), Ok((header, vec![sample.message])));
    }
}

#[test]
fn a_control_message_has_its_length_before_it() {
    assert_eq!(codec::encode_control(&ClientControl::Goodbye), bytes("01000000 03"));
}

#[test]
fn a_datagram_is_its_header_and_its_records() {
    let header = samples::client_headers().swap_remove(1);
    let records = samples::client_records();
    let messages: Vec<ClientRecord> = records.iter().map(|sample| sample.message).collect();
    let mut expected = header.bytes();
    expected.extend(records.iter().flat_map(Sample::bytes));
    assert_eq!(samples::pack(&header.message, &messages), expected);
    assert_eq!(codec::decode_client_datagram(&expected), Ok((header.message, messages)));
}

/// The table in `message.rs`.
#[test]
fn sizes_are_those_of_the_table() {
    for (name, bytes) in [("pose", 20), ("request: violated", 6), ("release", 5)] {
        let sample = samples::client_records().into_iter().find(|sample| sample.name == name).unwrap();
        assert_eq!(sample.bytes().len(), bytes, "{name}");
    }
    for (name, bytes) in
        [("state", 23), ("longest state", 29), ("longest bound", 41), ("longest violation", 19), ("hidden", 4)]
    {
        let sample = samples::server_records().into_iter().find(|sample| sample.name == name).unwrap();
        assert_eq!(sample.bytes().len(), bytes, "{name}");
    }
    let client: Vec<usize> = samples::client_headers().iter().map(|sample| sample.bytes().len()).collect();
    assert_eq!((client[0], client[2]), (5, 29));
    let server: Vec<usize> = samples::server_headers().iter().map(|sample| sample.bytes().len()).collect();
    assert_eq!((server[0], server[2]), (6, 38));
    let least = WireTbv {
        centre: Position::default(),
        radius_steps: 0,
        speed_steps: 0,
        age_micros: 0,
        valid_millis: 0,
        issue: Issue(0),
    };
    assert_eq!(record_bytes(&ServerRecord::Bound { object: ObjectId(0), tbv: least }).len(), 21);
    let least = ServerRecord::Violation { object: ObjectId(0), issue: Issue(0), age_micros: 0, present: false };
    assert_eq!(record_bytes(&least).len(), 7);
    let least = ClientRecord::ViolationAck { object: ObjectId(0), issue: Issue(0) };
    assert_eq!(record_bytes(&least).len(), 5);
    let most = ClientRecord::ViolationAck { object: ObjectId::MAX, issue: Issue(u32::MAX) };
    assert_eq!(record_bytes(&most).len(), 9);
}

/// The greatest message that passes its own check also passes the reader's limit.
#[test]
fn whatever_is_legal_fits() {
    let name = "n".repeat(NAME_BYTES_MAX);
    let hello = ClientControl::Hello {
        version: VERSION,
        token: vec![0xff; TOKEN_BYTES_MAX],
        resolution: (u16::MAX, u16::MAX),
        interest: Interest::Frustum,
        role: Role::Actor { avatars: AVATARS_MAX as u16 },
        name: name.clone(),
        resume: Some(Resume { token: [0xff; 16], heard: Some(u32::MAX) }),
    };
    let bytes = control_bytes(&hello);
    assert!(bytes.len() <= 1321, "{}", bytes.len());
    assert_eq!(codec::decode_client_control(&bytes), Ok(hello));

    let class = Class {
        name: name.clone(),
        motion: MotionBound { speed_max: 1e6, slack: 1.0 },
        extent: Extent { radius: 1.0, bottom: -1.0, top: 1.0 },
        eye_height: 1.0,
        turn_max: Some(1.0),
    };
    let welcome = |avatars, classes| {
        ServerControl::Welcome(Box::new(Welcome {
            version: VERSION,
            client: ClientId(u32::MAX),
            avatars: vec![(ObjectId::MAX, Position::default(), Orientation::default()); avatars],
            anchor: [1e6; 3],
            tick_micros: u32::MAX,
            answer_micros: u32::MAX,
            policy: name.clone(),
            tracking: true,
            blur: 1e3,
            dead_reckoning_px: Some(1.0),
            world: WorldInfo { name: name.clone(), hash: [0xff; 32], size_bytes: u64::MAX, two_sided: true },
            classes: vec![class.clone(); classes],
            objects: u32::MAX,
            rank: Rank::Operator,
            resume: [0xff; 16],
            grace_millis: u32::MAX,
            continuity: Continuity::Kept,
        }))
    };
    let size = |avatars, classes| control_bytes(&welcome(avatars, classes)).len();
    assert_eq!(size(2, 1) - size(1, 1), 19);
    assert_eq!(size(1, 2) - size(1, 1), 315);
    let greatest = welcome(AVATARS_MAX, CLASSES_MAX);
    assert_eq!(codec::decode_server_control(&control_bytes(&greatest)), Ok(greatest));

    let tbv = WireTbv {
        centre: Position::default(),
        radius_steps: u32::MAX,
        speed_steps: u32::MAX,
        age_micros: u32::MAX,
        valid_millis: u32::MAX,
        issue: Issue(u32::MAX),
    };
    let entry = RosterEntry {
        object: ObjectId::MAX,
        class: ClassId(u16::MAX),
        name: name.clone(),
        node: name.clone(),
        bound: Some(tbv),
        issue: Issue(u32::MAX),
        present: true,
    };
    let roster = |entries| ServerControl::Roster { tick: WorldTime::MIN, entries: vec![entry.clone(); entries] };
    assert_eq!(control_bytes(&roster(2)).len() - control_bytes(&roster(1)).len(), 566);
    let greatest = roster(ServerControl::ROSTER_MAX);
    assert_eq!(codec::decode_server_control(&control_bytes(&greatest)), Ok(greatest));

    let entry = ClientEntry {
        client: ClientId(u32::MAX),
        name: name.clone(),
        subject: name.clone(),
        rank: Rank::Operator,
        avatars: u16::MAX,
        seconds: u32::MAX,
        rtt_micros: Some(u32::MAX),
        away: true,
    };
    let clients = |entries| ServerControl::Clients { entries: vec![entry.clone(); entries] };
    assert_eq!(control_bytes(&clients(2)).len() - control_bytes(&clients(1)).len(), 537);
    let greatest = clients(ServerControl::ROSTER_MAX);
    assert_eq!(codec::decode_server_control(&control_bytes(&greatest)), Ok(greatest));

    let payload = ClientControl::Payload { object: ObjectId::MAX, bytes: vec![0xff; PAYLOAD_BYTES_MAX] };
    assert_eq!(codec::decode_client_control(&control_bytes(&payload)), Ok(payload));
    let text = "t".repeat(TEXT_BYTES_MAX);
    let ban = Command::Ban { client: ClientId(u32::MAX), seconds: u32::MAX, reason: text };
    let ban = ClientControl::Command(ban);
    assert_eq!(codec::decode_client_control(&control_bytes(&ban)), Ok(ban));

    let greatest = ServerControl::Left { objects: vec![ObjectId::MAX; AVATARS_MAX] };
    assert_eq!(codec::decode_server_control(&control_bytes(&greatest)), Ok(greatest));
}
