//! What must not fall over, whatever bytes it gets: one function per fuzz target.
//!
//! `fuzz/` gives them to libFuzzer (cargo-fuzz, nightly Rust); `tests/it/corpus.rs` replays the corpus in `fuzz/corpus` on
//! stable Rust, and mutates it a little. A function returns if all is well, and panics if not.

use std::path::Path;

use eyeline_protocol::codec::{self, ControlReader};
use eyeline_visibility::{LoadOptions, load_glb};

pub mod play;

/// A fuzz target: name, and what it does.
pub type Target = (&'static str, fn(&[u8]));

/// All targets, by the names of their folders in the corpus.
pub const TARGETS: [Target; 5] =
    [("wire", wire), ("gltf", gltf), ("world_toml", world_toml), ("trace", trace), ("play", play::play)];

/// Every decoder of the wire. What decodes is legal, and says the same when it is encoded again.
pub fn wire(bytes: &[u8]) {
    let Some((&which, bytes)) = bytes.split_first() else { return };
    match which % 5 {
        0 => {
            if let Ok(message) = codec::decode_client_control(bytes) {
                let again = codec::encode_control(&message);
                assert_eq!(codec::decode_client_control(&again[4..]), Ok(message));
            }
        }
        1 => {
            if let Ok(message) = codec::decode_server_control(bytes) {
                let again = codec::encode_control(&message);
                // Numbers that are none are refused, so that equality means something.
                assert_eq!(codec::decode_server_control(&again[4..]), Ok(message));
            }
        }
        2 => drop(codec::decode_client_datagram(bytes)),
        3 => {
            if let Ok((header, records)) = codec::decode_server_datagram(bytes) {
                for record in records {
                    if let eyeline_protocol::ServerRecord::Bound { tbv, .. } = record {
                        let tbv = tbv.tbv(header.tick);
                        assert!(tbv.issued <= tbv.expires && tbv.radius_at(header.tick).is_finite());
                    }
                }
            }
        }
        _ => {
            let mut reader = ControlReader::of_client();
            for piece in bytes.chunks(7) {
                reader.push(piece);
                while let Ok(Some(message)) = reader.next_message() {
                    drop(codec::decode_client_control(&message));
                }
            }
        }
    }
}

/// A model. One that loads has finite corners.
pub fn gltf(bytes: &[u8]) {
    let options = LoadOptions::default().with_triangles_max(100_000);
    if let Ok(scene) = load_glb(bytes, "fuzz.glb", &options) {
        let is_finite =
            |triangle: &eyeline_visibility::Triangle| triangle.corners.iter().all(|corner| corner.is_finite());
        assert!(scene.triangles().iter().all(is_finite));
    }
}

/// A world file: one that parses makes a world, or says why not.
pub fn world_toml(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(spec) = toml::from_str::<eyeline_server::spec::WorldSpec>(text) else { return };
    if spec.objects.len() + spec.classes.len() + spec.spawns.len() > 1000 {
        return;
    }
    let made = play::world(spec);
    if let Ok(mut world) = made {
        for _ in 0..3 {
            let due = world.poll_timeout();
            world.tick(due);
        }
    }
}

/// A trace of people.
pub fn trace(bytes: &[u8]) {
    for name in ["trace.txt", "trace.csv", "trace.vsp"] {
        if let Ok(trace) = eyeline_sim::trace::Trace::parse(Path::new(name), bytes) {
            let middle = 0.5 * trace.span_s();
            for person in 0..trace.slots_at(middle).len().min(100) {
                let place = trace.position_at(person, middle);
                assert!(place.is_none_or(|(x, y)| x.is_finite() && y.is_finite()));
            }
        }
    }
}
