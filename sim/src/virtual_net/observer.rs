//! Who watches a run, and what it gets to see: everything that is on its way, every commit, every frame.

use std::time::Duration;

use eyeline_client::session::{FrameTime, Session};
use eyeline_protocol::{ClientRecord, ObjectId, ServerRecord, WorldTime, codec};
use eyeline_server::world::World;
use glam::DVec3;

use super::link::{Direction, Fate, Kind};

/// Something on its way, or at its end.
#[derive(Clone, Copy, Debug)]
pub struct Passing<'a> {
    /// The client at one end, by its number in the run.
    pub client: usize,
    /// Which way it goes.
    pub direction: Direction,
    /// How it goes.
    pub kind: Kind,
    /// A datagram, or a control message without its length prefix.
    pub bytes: &'a [u8],
    /// True world time: of sending, arrival or loss, whichever is told of.
    pub at: WorldTime,
}

impl Passing<'_> {
    /// The objects that a datagram's records are about, poses apart, in order; none if its bytes make no sense.
    pub fn spoken_of(&self) -> Vec<ObjectId> {
        match self.direction {
            Direction::Up => {
                let records = codec::decode_client_datagram(self.bytes).map_or(Vec::new(), |(_, records)| records);
                let object = |record: ClientRecord| match record {
                    ClientRecord::Pose { .. } | ClientRecord::Eye { .. } => None,
                    ClientRecord::Request { object, .. }
                    | ClientRecord::Release { object, .. }
                    | ClientRecord::ViolationAck { object, .. } => Some(object),
                };
                records.into_iter().filter_map(object).collect()
            }
            Direction::Down => {
                let records = codec::decode_server_datagram(self.bytes).map_or(Vec::new(), |(_, records)| records);
                let object = |record: ServerRecord| match record {
                    ServerRecord::State { object, .. }
                    | ServerRecord::Bound { object, .. }
                    | ServerRecord::Violation { object, .. }
                    | ServerRecord::Hidden { object } => object,
                };
                records.into_iter().map(object).collect()
            }
        }
    }
}

/// What an interceptor decides about a datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The link's rules decide.
    AsRuled,
    /// This happens instead.
    Instead(Fate),
    /// It arrives twice, after these times.
    Twice(Duration, Duration),
    /// It says this instead, and the link's rules decide about that: for ends that lie.
    Rewrite(Vec<u8>),
}

/// A client's frame, after its session took it.
pub struct Framed<'a> {
    /// Which client, by its number in the run.
    pub client: usize,
    /// Its session.
    pub session: &'a Session,
    /// What the frame was made with; `None` until the client knows the server's time.
    pub time: Option<FrameTime>,
    /// Its eye, if it looks at anything.
    pub eye: Option<DVec3>,
    /// True world time.
    pub at: WorldTime,
    /// The world: the truth.
    pub world: &'a World,
}

/// Watches a run. Knows everything, changes nothing.
pub trait Observer {
    /// The world has committed a tick. `at` is true world time, later than the tick if that came late.
    fn committed(&mut self, world: &World, at: WorldTime) {
        let _ = (world, at);
    }

    /// A client has made a frame.
    fn framed(&mut self, frame: &Framed<'_>) {
        let _ = frame;
    }

    /// The server hands a datagram to the transport; nobody knows yet whether it will arrive.
    fn sent(&mut self, message: &Passing<'_>) {
        let _ = message;
    }

    /// A message arrives; its receiver has not seen it yet.
    fn arrives(&mut self, message: &Passing<'_>) {
        let _ = message;
    }

    /// A datagram gets lost for good, or a packet of a control message, which only delays that.
    fn lost(&mut self, message: &Passing<'_>) {
        let _ = message;
    }
}

/// Watches nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ignore;

impl Observer for Ignore {}
