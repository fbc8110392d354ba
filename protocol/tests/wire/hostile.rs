//! Bytes from a peer yield an error, never a panic and never a large allocation.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use eyeline_protocol::codec::{self, CLIENT_CONTROL_BYTES_MAX, CONTROL_BYTES_MAX, ControlReader, DecodeError};
use eyeline_protocol::*;
use proptest::prelude::*;

use crate::samples::{
    self, Case, control_cases, datagram_cases, read_client_control, read_client_datagram, read_server_control,
    read_server_datagram,
};

/// Counts what this thread holds, and the most that it held.
struct Counting;

thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
}

fn count(bytes: isize) {
    let held = HELD.get() + bytes;
    HELD.set(held);
    PEAK.set(PEAK.get().max(held));
}

// SAFETY: everything is passed on to the system's allocator; counting allocates nothing.
#[expect(unsafe_code, reason = "an allocator can't be written without")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The most bytes held by `work` beyond what was held before.
fn peak_bytes<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = HELD.get();
    PEAK.set(before);
    let result = work();
    (result, (PEAK.get() - before) as usize)
}

/// Memory that a decoder may take for this many bytes: an absent object of nine bytes is a `RosterEntry` of over a
/// hundred, lists double as they grow (old and new half exist at once), and an error has its text.
fn allowance(bytes: usize) -> usize {
    50 * bytes + 1024
}

fn all_cases() -> Vec<Case> {
    [control_cases(), datagram_cases()].concat()
}

type Decoder = fn(&[u8]) -> Result<(), DecodeError>;

/// Every decoder, without the second reading that the samples' readers do.
const DECODERS: [Decoder; 4] = [
    |bytes| codec::decode_client_control(bytes).map(drop),
    |bytes| codec::decode_server_control(bytes).map(drop),
    |bytes| codec::decode_client_datagram(bytes).map(drop),
    |bytes| codec::decode_server_datagram(bytes).map(drop),
];

#[test]
fn the_allocator_counts() {
    let (kept, peak) = peak_bytes(|| {
        drop(vec![0u8; 1 << 20]);
        vec![0u8; 1 << 10]
    });
    assert_eq!((kept.len(), peak), (1 << 10, 1 << 20));
}

#[test]
fn every_truncated_control_message_is_an_error() {
    for (name, bytes, read) in control_cases() {
        for length in 0..bytes.len() {
            assert_eq!(read(&bytes[..length]), Err(DecodeError::Truncated { bytes: length }), "{name} cut to {length}");
        }
    }
}

/// But for a cut exactly between its header and its records.
#[test]
fn every_truncated_datagram_is_an_error() {
    for header in samples::client_headers() {
        for record in samples::client_records() {
            assert_cuts(record.name, &header.bytes(), &record.bytes(), read_client_datagram);
        }
    }
    for header in samples::server_headers() {
        for record in samples::server_records() {
            assert_cuts(record.name, &header.bytes(), &record.bytes(), read_server_datagram);
        }
    }
}

fn assert_cuts(name: &str, header: &[u8], record: &[u8], read: samples::Reader) {
    let datagram = [header, record].concat();
    for length in 0..datagram.len() {
        let result = read(&datagram[..length]);
        if length == header.len() {
            assert_eq!(result, Ok(()), "{name}");
        } else {
            assert!(matches!(result, Err(DecodeError::Truncated { .. })), "{name} cut to {length}: {result:?}");
        }
    }
}

#[test]
fn any_byte_after_a_control_message_is_an_error() {
    for (name, bytes, read) in control_cases() {
        for extra in 0..=255 {
            let longer = [&bytes[..], &[extra]].concat();
            assert_eq!(read(&longer), Err(DecodeError::Extra { bytes: 1 }), "{name} and {extra}");
        }
    }
}

#[test]
fn what_follows_a_datagram_is_a_record_or_an_error() {
    for (name, bytes, read) in datagram_cases() {
        for extra in 0..=255 {
            let longer = [&bytes[..], &[extra]].concat();
            // No record is one byte long.
            assert!(read(&longer).is_err(), "{name} and {extra}");
        }
        let _ = read(&[&bytes[..], &bytes[..]].concat());
    }
    let (client, server) = (ClientHeader::default(), ServerHeader::default());
    for first in samples::client_records() {
        for second in samples::client_records() {
            let datagram = [samples::record_bytes(&client), first.bytes(), second.bytes()].concat();
            let expected = Ok((client, vec![first.message, second.message]));
            assert_eq!(codec::decode_client_datagram(&datagram), expected);
        }
    }
    for first in samples::server_records() {
        for second in samples::server_records() {
            let datagram = [samples::record_bytes(&server), first.bytes(), second.bytes()].concat();
            let expected = Ok((server, vec![first.message, second.message]));
            assert_eq!(codec::decode_server_datagram(&datagram), expected);
        }
    }
}

#[test]
fn every_changed_byte_is_a_message_or_an_error() {
    for (_, bytes, read) in all_cases() {
        let mut changed = bytes.clone();
        for at in 0..bytes.len() {
            for flip in 1..=255 {
                changed[at] = bytes[at] ^ flip;
                let _ = read(&changed);
            }
            changed[at] = bytes[at];
        }
    }
}

/// Wherever in a message a length may stand, however much it claims.
#[test]
fn a_claimed_length_costs_nothing() {
    let claims: [&[u8]; 7] = [
        &[0xfa],
        &[0xfb, 0xff, 0xff],
        &[0xfc, 0x00, 0x00, 0x01, 0x00],
        &[0xfc, 0xff, 0xff, 0xff, 0xff],
        &[0xfd, 0x00, 0x00, 0x00, 0x80, 0x00, 0x00, 0x00, 0x00],
        &[0xfd, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f],
        &[0xfd, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff],
    ];
    for (name, bytes, _) in all_cases() {
        for at in 0..=bytes.len() {
            for claim in claims {
                for rest in [&bytes[at.min(bytes.len())..], &[]] {
                    let hostile = [&bytes[..at], claim, rest].concat();
                    for decode in DECODERS {
                        let (_, peak) = peak_bytes(|| decode(&hostile));
                        assert!(peak <= allowance(hostile.len()), "{name}: {peak} bytes at {at} for {claim:02x?}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_list_that_claims_too_much_is_an_error() {
    // Up to the length of each list and string of a message.
    let prefixes: [(&str, Decoder, &str); 20] = [
        ("token", DECODERS[0], "00 04"),
        ("name", DECODERS[0], "00 04 00 00 00 00 00"),
        ("avatars", DECODERS[1], "00 01 00"),
        ("policy", DECODERS[1], "00 01 00 00 000000000000f03f 000000000000f03f 000000000000f03f 01 00"),
        (
            "world",
            DECODERS[1],
            "00 01 00 00 000000000000f03f 000000000000f03f 000000000000f03f 01 00 00 00 000000000000f03f 00",
        ),
        (
            "classes",
            DECODERS[1],
            "00 01 00 00 000000000000f03f 000000000000f03f 000000000000f03f 01 00 00 00 000000000000f03f 00 00 \
             0000000000000000000000000000000000000000000000000000000000000000 00",
        ),
        (
            "class",
            DECODERS[1],
            "00 01 00 00 000000000000f03f 000000000000f03f 000000000000f03f 01 00 00 00 000000000000f03f 00 00 \
             0000000000000000000000000000000000000000000000000000000000000000 00 01",
        ),
        ("reason", DECODERS[1], "01 00"),
        ("entries", DECODERS[1], "02 00"),
        ("entry", DECODERS[1], "02 00 01 000000 00"),
        ("node", DECODERS[1], "02 00 01 000000 00 00"),
        ("objects", DECODERS[1], "03"),
        ("a client's payload", DECODERS[0], "06 000000"),
        ("what an operator says", DECODERS[0], "07 03"),
        ("why somebody is banned", DECODERS[0], "07 02 01 01"),
        ("payload", DECODERS[1], "05 00"),
        ("said", DECODERS[1], "06"),
        ("clients", DECODERS[1], "07"),
        ("done", DECODERS[1], "08 00"),
        ("second entry", DECODERS[1], "02 00 02 000000 00 00 00 00 00 00 000000 00 00"),
    ];
    for (field, decode, prefix) in prefixes {
        for bits in 31..=63 {
            for claim in [1u64 << bits, (1 << bits) - 1] {
                let hostile = [&samples::bytes(prefix)[..], &[0xfd], &claim.to_le_bytes(), &[0; 40]].concat();
                let (result, peak) = peak_bytes(|| decode(&hostile));
                assert!(result.is_err(), "{field} of {claim}");
                assert!(peak <= allowance(hostile.len()), "{field} of {claim}: {peak} bytes");
            }
        }
    }
}

/// The most that memory can be made to exceed the wire: a message as long as may be, of the smallest elements.
#[test]
fn a_full_message_takes_a_small_multiple_of_its_size() {
    let mut entries = vec![0x02, 0x00, 0xfc];
    let count = (CONTROL_BYTES_MAX as u32 - 7) / 9;
    entries.extend(count.to_le_bytes());
    entries.resize(7 + count as usize * 9, 0);
    let (result, peak) = peak_bytes(|| codec::decode_server_control(&entries));
    assert_eq!(result, Err(DecodeError::Field { field: "entries", limit: ServerControl::ROSTER_MAX }));
    assert!(peak <= allowance(entries.len()), "{peak} bytes for {}", entries.len());
}

#[test]
fn what_is_too_large_is_not_looked_at() {
    let huge = vec![0; CONTROL_BYTES_MAX + 1];
    for decode in DECODERS {
        let (result, peak) = peak_bytes(|| decode(&huge));
        assert!(matches!(result, Err(DecodeError::TooLarge { .. })), "{result:?}");
        assert_eq!(peak, 0);
    }
    let hello = vec![0; CLIENT_CONTROL_BYTES_MAX + 1];
    assert!(matches!(codec::decode_client_control(&hello), Err(DecodeError::TooLarge { .. })));
}

#[test]
fn impossible_values_are_refused_by_name() {
    let fault = |change: fn(&mut Welcome)| {
        let Some(ServerControl::Welcome(mut welcome)) = samples::server_control().into_iter().next().map(|s| s.message)
        else {
            panic!("the first sample is a welcome")
        };
        change(&mut welcome);
        ServerControl::Welcome(welcome).check()
    };
    let value = |field| Err(DecodeError::Value { field });
    assert_eq!(fault(|_| ()), Ok(()));
    assert_eq!(fault(|w| w.anchor[1] = f64::NAN), value("anchor"));
    assert_eq!(fault(|w| w.tick_micros = 0), value("tick"));
    assert_eq!(fault(|w| w.blur = -1.0), value("blur"));
    assert_eq!(fault(|w| w.blur = f64::NAN), value("blur"));
    assert_eq!(fault(|w| w.dead_reckoning_px = Some(f64::NAN)), value("dead reckoning"));
    assert_eq!(fault(|w| w.classes[0].turn_max = Some(-1.0)), value("turn"));
    assert_eq!(fault(|w| w.classes[0].motion.speed_max = f64::INFINITY), value("motion"));
    assert_eq!(fault(|w| w.classes[0].motion.slack = -1.0), value("motion"));
    assert_eq!(fault(|w| w.classes[0].extent.radius = f64::NAN), value("extent"));
    assert_eq!(fault(|w| w.classes[0].extent.bottom = 2.0), value("extent"));
    assert_eq!(fault(|w| w.classes[0].eye_height = f64::NAN), value("eye height"));
    let length = |field, limit| Err(DecodeError::Field { field, limit });
    assert_eq!(fault(|w| w.policy = "x".repeat(256)), length("policy", NAME_BYTES_MAX));
    assert_eq!(fault(|w| w.classes = vec![w.classes[0].clone(); 513]), length("classes", CLASSES_MAX));

    // A welcome with a tick of 0, as bytes.
    let no_tick = "00 01 00 00 000000000000f03f 000000000000f03f 000000000000f03f 00 00 00 01 000000000000f03f 00 00 \
                   0000000000000000000000000000000000000000000000000000000000000000 00 00 00 00 \
                   00 00000000000000000000000000000000 00 00";
    assert_eq!(DECODERS[1](&samples::bytes(no_tick)), value("tick"));
    // A replay of 65,535 avatars.
    let horde = samples::bytes("00 04 00 00 00 00 01fbffff 00 00");
    assert_eq!(DECODERS[0](&horde), length("avatars", AVATARS_MAX));
}

/// A newer client is told which version is missing, whatever its hello looks like.
#[test]
fn a_hello_of_another_version_is_read_up_to_its_version() {
    for rest in ["", "ff", "ffffffffffffffffffff"] {
        let hello = samples::bytes(&format!("00 fb0002 {rest}"));
        let Ok(ClientControl::Hello { version, .. }) = codec::decode_client_control(&hello) else {
            panic!("{hello:?} is a hello")
        };
        assert_eq!(version, 0x200);
    }
}

fn stream() -> (Vec<u8>, Vec<Vec<u8>>) {
    let messages: Vec<Vec<u8>> = control_cases().into_iter().map(|(_, bytes, _)| bytes).collect();
    let framed = messages.iter().flat_map(|bytes| [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat());
    (framed.collect(), messages)
}

fn drain(reader: &mut ControlReader) -> Result<Vec<Vec<u8>>, DecodeError> {
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message()? {
        messages.push(message);
    }
    Ok(messages)
}

#[test]
fn a_stream_may_be_cut_anywhere() {
    let (stream, messages) = stream();
    for at in 0..=stream.len() {
        let mut reader = ControlReader::default();
        reader.push(&stream[..at]);
        let mut read = drain(&mut reader).unwrap();
        reader.push(&stream[at..]);
        read.extend(drain(&mut reader).unwrap());
        assert_eq!(read, messages, "cut at {at}");
    }
    let mut reader = ControlReader::default();
    let mut read = Vec::new();
    for byte in stream {
        reader.push(&[byte]);
        read.extend(drain(&mut reader).unwrap());
    }
    assert_eq!(read, messages);
}

#[test]
fn a_hostile_length_ends_the_stream() {
    for length in [CONTROL_BYTES_MAX as u32 + 1, 1 << 31, u32::MAX] {
        let mut reader = ControlReader::default();
        reader.push(&length.to_le_bytes()[..3]);
        assert_eq!(reader.next_message(), Ok(None));
        reader.push(&length.to_le_bytes()[3..]);
        let error = DecodeError::TooLarge { bytes: length as usize, limit: CONTROL_BYTES_MAX };
        let (result, peak) = peak_bytes(|| reader.next_message());
        assert_eq!((result, peak), (Err(error.clone()), 0));
        reader.push(&[0; 100]);
        assert_eq!(reader.next_message(), Err(error), "the stream is useless for ever");
    }
    let mut reader = ControlReader::of_client();
    reader.push(&(CLIENT_CONTROL_BYTES_MAX as u32 + 1).to_le_bytes());
    assert!(reader.next_message().is_err());
    // A message of no bytes is one, and means nothing.
    let mut reader = ControlReader::default();
    reader.push(&[0; 9]);
    assert_eq!(drain(&mut reader), Ok(vec![Vec::new(), Vec::new()]));
    assert!(codec::decode_client_control(&[]).is_err());
}

/// A quarter of a million tiny messages in one piece must not take time quadratic in their number: moving what is
/// left after each of them would move 32 GB.
#[test]
fn many_tiny_messages_are_read_in_one_go() {
    let mut reader = ControlReader::default();
    reader.push(&[1, 0, 0, 0, 3].repeat(250_000));
    assert_eq!(drain(&mut reader).map(|messages| messages.len()), Ok(250_000));
}

proptest! {
    #[test]
    fn any_bytes_are_a_message_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = read_client_control(&bytes);
        let _ = read_server_control(&bytes);
        let _ = read_client_datagram(&bytes);
        let _ = read_server_datagram(&bytes);
    }

    /// Arbitrary bytes seldom get far. These are legal up to a point, or nearly.
    #[test]
    fn damaged_messages_are_messages_or_errors(
        which in any::<prop::sample::Index>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        tail in prop::collection::vec(any::<u8>(), 0..60),
        cut in any::<prop::sample::Index>(),
    ) {
        let cases = all_cases();
        let (_, bytes, read) = which.get(&cases);
        let mut bytes = bytes.clone();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(cut.index(2 * bytes.len()) + 1);
        bytes.extend(tail);
        let _ = read(&bytes);
    }

    /// DESIGN §6: a pose takes at most 20 bytes, whoever and wherever.
    #[test]
    fn a_pose_takes_twenty_bytes(id in 0..=ObjectId::MAX.0, x: i32, y: i32, z: i32, quat: [f64; 4]) {
        assert_pose_size(ObjectId(id), Position { x, y, z }, Orientation::from_quat(glam::DQuat::from_array(quat)));
    }
}

fn assert_pose_size(object: ObjectId, position: Position, orientation: Orientation) {
    let pose = ClientRecord::Pose { object, position, orientation };
    assert_eq!(samples::record_bytes(&pose).len(), 20);
    let state = ServerRecord::State { object, position, orientation, velocity: Velocity::ZERO };
    assert_eq!(samples::record_bytes(&state).len(), 23);
}

#[test]
fn an_extreme_pose_takes_twenty_bytes() {
    let extremes = [i32::MIN, i32::MIN + 1, -1, 0, 1, 250, 251, i32::MAX - 1, i32::MAX];
    for id in [0, 250, 251, 0xffff, 0x1_0000, ObjectId::MAX.0] {
        for x in extremes {
            for y in extremes {
                for z in extremes {
                    assert_pose_size(ObjectId(id), Position { x, y, z }, Orientation::from_yaw(f64::from(x)));
                }
            }
        }
    }
}
