//! What a run leaves behind: every committed position, what every client believed, and what was counted.

use std::time::Duration;

use eyeline_client::tracking::{Ahead, TrackerStats};
use eyeline_protocol::{Class, ClassId, ObjectId, Orientation, Position, WorldTime};
use eyeline_server::world::{MessageCounts, Object, World};
use glam::DVec3;

/// What does not change about an object.
#[derive(Clone, Debug)]
pub struct ObjectInfo {
    /// Its kind.
    pub class: ClassId,
    /// Node of the model with its mesh; empty for an avatar.
    pub node: String,
}

impl ObjectInfo {
    /// Every object of a world, by id.
    pub fn all(world: &World) -> Vec<ObjectInfo> {
        let info = |object: &Object| ObjectInfo { class: object.class, node: object.node.clone() };
        world.objects().iter().map(info).collect()
    }
}

/// One committed state of the world.
#[derive(Clone, Debug)]
pub struct Commit {
    /// World time.
    pub at: WorldTime,
    /// By object id: where it is and how it is turned; `None` if it is not in the world.
    pub places: Vec<Option<(Position, Orientation)>>,
}

impl Commit {
    /// The newest state of a world.
    pub fn of(world: &World) -> Commit {
        let place = |object: &Object| (object.alive && object.present).then_some((object.position, object.orientation));
        Commit { at: world.committed_at(), places: world.objects().iter().map(place).collect() }
    }
}

/// An object whose place a client knew in a frame.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// Which.
    pub object: ObjectId,
    /// Where the client had it.
    pub position: Position,
    /// Whether it was drawn.
    pub is_drawn: bool,
}

/// One frame of a client.
#[derive(Clone, Debug)]
pub struct FrameLog {
    /// The server's true time when the frame began.
    pub at: WorldTime,
    /// The eye, relative to the anchor, metres.
    pub eye: DVec3,
    /// Turn about +Y, radians.
    pub yaw: f64,
    /// Time for culling and for tracking.
    pub cull: Duration,
    /// Time for tracking.
    pub track: Duration,
    /// How late the frame began.
    pub late: Duration,
    /// Greatest round trip of the last 5 s.
    pub round_trip_max: Duration,
    /// Smoothed round trip.
    pub round_trip: Duration,
    /// What it looked ahead for.
    pub ahead: Ahead,
    /// After what time without an answer it asks again.
    pub retry_after: Duration,
    /// What the client knew, in the frames that truth is computed for.
    pub known: Option<Vec<Known>>,
    /// Objects whose states arrived since the frame before.
    pub received: Vec<ObjectId>,
}

/// Everything about one client.
#[derive(Clone, Debug, Default)]
pub struct ClientLog {
    /// Its avatar.
    pub avatar: ObjectId,
    /// Its frames within the measured time.
    pub frames: Vec<FrameLog>,
    /// UDP datagrams and bytes sent and received within the measured time.
    pub udp: [u64; 4],
    /// Frames left out because the process came late.
    pub skipped: u64,
    /// Requests sent again.
    pub resent: u64,
    /// Time for which it believed bounds that had been broken, summed over objects.
    pub broken_believed: Duration,
    /// In virtual time: objects that a lost datagram spoke of, and when it was lost; ascending.
    pub lost: Vec<(WorldTime, ObjectId)>,
    /// Messages that it sent within the measured time, whether or not they arrived.
    pub sent: u64,
}

impl ClientLog {
    /// Takes what its tracker counted within the measured time.
    pub fn note(&mut self, before: &TrackerStats, after: &TrackerStats) {
        self.resent = after.resent - before.resent;
        self.broken_believed = Duration::from_micros(after.broken_believed_micros - before.broken_believed_micros);
    }
}

/// Everything about one run.
#[derive(Clone, Debug)]
pub struct RunLog {
    /// Policy.
    pub policy: String,
    /// `quic` or `sim`.
    pub net: &'static str,
    /// Measured time.
    pub window: Duration,
    /// Committed states, ascending; from some time before the window to its end.
    pub commits: Vec<Commit>,
    /// Kinds of objects.
    pub classes: Vec<Class>,
    /// Objects by id.
    pub objects: Vec<ObjectInfo>,
    /// The watching clients.
    pub clients: Vec<ClientLog>,
    /// Messages from watching clients within the window.
    pub up: MessageCounts,
    /// Messages to clients within the window.
    pub down: MessageCounts,
    /// The server's own work within the window.
    pub server_work: Duration,
    /// Its longest piece: how long an answer may have waited.
    pub turnaround: Duration,
    /// Work of each tick, microseconds, ascending.
    pub tick_micros: Vec<u32>,
    /// Poses that were held back to their motion bound.
    pub poses_clamped: u64,
    /// Bounds broken on purpose.
    pub violations: u64,
    /// In virtual time, a digest of every message that arrived, with its time.
    pub digest: Option<u64>,
}

impl RunLog {
    /// The state that was committed at `at`, or the oldest one there is.
    pub fn commit_at(&self, at: WorldTime) -> &Commit {
        let index = self.commits.partition_point(|commit| commit.at <= at);
        &self.commits[index.saturating_sub(1)]
    }
}

/// Which frames truth is computed for: bursts of consecutive frames, spread over each client's time.
#[derive(Clone, Copy, Debug)]
pub struct Bursts {
    /// Frames in a burst, at least 2.
    pub frames: u64,
    /// Frames from one burst's start to the next's.
    pub period: u64,
    /// By how many frames the first is shifted.
    pub shift: u64,
}

impl Bursts {
    /// Bursts of `frames` frames that make up about `share` of all; `number` shifts each client's differently.
    pub fn new(frames: u64, share: f64, number: u64) -> Bursts {
        let frames = frames.max(2);
        let period = ((frames as f64 / share.clamp(1e-6, 1.0)).round() as u64).max(frames);
        // The golden ratio spreads shifts evenly however many clients there are.
        let shift = ((number as f64 * 0.618_033_988_75).fract() * (period - frames + 1) as f64) as u64;
        Bursts { frames, period, shift }
    }

    /// Whether a frame is in a burst.
    pub fn contain(&self, frame: u64) -> bool {
        frame >= self.shift && (frame - self.shift) % self.period < self.frames
    }
}
