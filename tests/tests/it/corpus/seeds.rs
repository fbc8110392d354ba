//! Inputs that reach far into each target, for a fuzzer to begin from.

use eyeline_protocol::codec::{self, DatagramWriter};
use eyeline_protocol::{
    ClientControl, ClientHeader, ClientId, ClientRecord, Command, Interest, LinkHeader, ObjectId, Orientation,
    Position, Reason, Resume, Role, ServerControl, ServerHeader, ServerRecord, VERSION, Velocity, Want, WorldTime,
};
use eyeline_sim::scene::plan::RoomsRules;
use eyeline_sim::scene::rooms;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

type Seed = (&'static str, String, Vec<u8>);

/// All of them: target, name, bytes.
pub fn all() -> Vec<Seed> {
    [wire(), files(), plays()].concat()
}

fn wire() -> Vec<Seed> {
    let mut seeds = Vec::new();
    let mut add =
        |name: &str, which: u8, bytes: &[u8]| seeds.push(("wire", name.to_owned(), [&[which], bytes].concat()));
    let hello = ClientControl::Hello {
        version: VERSION,
        token: b"token".to_vec(),
        resolution: (320, 240),
        interest: Interest::Around,
        role: Role::Avatar,
        name: "Ada".into(),
        resume: Some(Resume { token: [7; 16], heard: Some(3) }),
    };
    let object = ObjectId(7);
    let (position, orientation) = (Position { x: 1000, y: 0, z: -1000 }, Orientation::from_yaw(1.0));
    let controls = [
        ("hello", hello),
        ("place", ClientControl::Place { object, position, present: true }),
        ("payload", ClientControl::Payload { object, bytes: vec![1, 2, 3] }),
        ("ban", ClientControl::Command(Command::Ban { client: ClientId(3), seconds: 60, reason: "loud".into() })),
    ];
    let mut stream = Vec::new();
    for (name, control) in &controls {
        let bytes = codec::encode_control(control);
        add(&format!("client-{name}"), 0, &bytes[4..]);
        stream.extend(bytes);
    }
    add("stream", 4, &stream);
    let said = ServerControl::Said { text: "hello".into() };
    add("server-said", 1, &codec::encode_control(&said)[4..]);
    add("server-left", 1, &codec::encode_control(&ServerControl::Left { objects: vec![object] })[4..]);
    let link = LinkHeader { seq: 9, ack: 8, ack_bits: 7, hold_micros: 100 };
    let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::from_micros(50_000) }, 1200);
    for record in [
        ClientRecord::Pose { object, position, orientation },
        ClientRecord::Request { object, want: Want::State, reason: Reason::Exposed },
        ClientRecord::Eye { position, orientation },
    ] {
        writer.push(&record);
    }
    add("client-datagram", 2, &writer.finish());
    let tick = WorldTime::from_micros(50_000);
    let mut writer = DatagramWriter::new(&ServerHeader { link, sent: tick, tick }, 1200);
    writer.push(&ServerRecord::State { object, position, orientation, velocity: Velocity { x: 1, y: 0, z: -300 } });
    writer.push(&ServerRecord::Hidden { object });
    add("server-datagram", 3, &writer.finish());
    seeds
}

fn files() -> Vec<Seed> {
    let made = rooms::make(&RoomsRules { columns: 1, rows: 1, ..RoomsRules::default() }).unwrap();
    let bare = rooms::make(&RoomsRules { columns: 1, rows: 1, furnished: false, ..RoomsRules::default() }).unwrap();
    let world = toml::to_string(&made.world).unwrap();
    let broken = world.replace("speed", "sped");
    let endless = world.replace("0.35", "inf").replace("0.95", "nan");
    let eth = "0 1 -2 0 -2 0 0 0\n50 1 0 0 -2 0 0 0\n100 1 2 0 -2 0 0 0\n";
    let csv = "frame,person,x,y\n0,1,0.5,0.5\n10,1,1.5,0.5\n0,2,9,9\n10,2,nan,1e300\n";
    vec![
        ("gltf", "rooms.glb".into(), made.glb),
        ("gltf", "bare.glb".into(), bare.glb.clone()),
        ("gltf", "cut.glb".into(), bare.glb[..bare.glb.len() / 2].to_vec()),
        ("world_toml", "rooms".into(), world.into_bytes()),
        ("world_toml", "unknown-key".into(), broken.into_bytes()),
        ("world_toml", "no-numbers".into(), endless.into_bytes()),
        ("trace", "eth".into(), eth.into()),
        ("trace", "csv".into(), csv.into()),
        ("trace", "cut".into(), eth[..20].into()),
    ]
}

/// Plays begin with hellos of all, and go on by chance, mostly with what a client does all day.
fn plays() -> Vec<Seed> {
    let play = |seed: u64| {
        let mut bytes = Vec::new();
        for client in 0..4u8 {
            // Says hello, which the world hears; the world's welcome is heard, and a tick passes.
            bytes.extend([client, 2, 255, 255]);
            for _ in 0..3 {
                bytes.extend([client, 6]);
            }
            bytes.extend([client, 0, 50]);
        }
        let mut rng = Pcg64::seed_from_u64(seed);
        for _ in 0..600 {
            let client = rng.random_range(0..4u8);
            bytes.push(client);
            let (near, far) = (rng.random_range(0..12u8), rng.random::<u8>());
            match rng.random_range(0..100) {
                0..20 => bytes.extend([0, 20 + far / 4]),
                20..45 => bytes.extend([2, 255, 255]),
                45..60 => bytes.extend([4, far]),
                60..70 => bytes.push(6),
                70..90 => bytes.extend([7, far, 32 + far / 2]),
                // A thing is taken, somebody is put somewhere.
                90..92 => bytes.extend([8, 4, near]),
                92..94 => bytes.extend([8, 3, near, 0, far, 3, 0, 0, 0, 0, far, 3, 1]),
                // A question, or a pose, of an object that may be one's own.
                94..96 => bytes.extend([9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, near, 2, far]),
                96..98 => {
                    bytes.extend([9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, near, 0, 0, far, 1, 0, 0, 0, 0, far, 1, far, 0])
                }
                _ => bytes.extend([11, 0]),
            }
        }
        ("play", format!("chance-{seed}"), bytes)
    };
    (0..8).map(play).collect()
}
