//! One client of a virtual run: its session, its clock, its links, and the person in front of it.

use std::time::Duration;

use eyeline_client::session::{Event, FrameTime, Session, SessionConfig};
use eyeline_client::tracking::Ahead;
use eyeline_protocol::{LocalTime, ObjectId, WorldTime};
use eyeline_server::world::SessionId;
use eyeline_visibility::Occlusion;
use glam::DVec3;

use super::capacity::Capacity;
use super::link::{LinkRules, VirtualLink};

pub use eyeline_client::net::Pose;

/// The person in front of a client in virtual time.
///
/// At each frame the run asks for [`ClientDriver::poses`], then calls [`ClientDriver::cull`], and hands
/// [`ClientDriver::occlusion`] to the session, then and with each datagram until the next frame.
pub trait ClientDriver {
    /// Moves on to true world time `at` and appends where the avatars are now.
    fn poses(&mut self, session: &Session, at: WorldTime, poses: &mut Vec<Pose>);

    /// Culls from every eye that the present one can reach within the lead; not while nothing is tracked.
    fn cull(&mut self, ahead: Ahead) {
        let _ = ahead;
    }

    /// What hides things, as of the newest [`ClientDriver::cull`]; `None` if the client looks at nothing.
    fn occlusion(&self) -> Option<&dyn Occlusion>;

    /// The present eye, relative to the anchor; `None` if the client looks at nothing.
    fn eye(&self) -> Option<DVec3> {
        None
    }

    /// A frame is done. `time` is `None` until the server's time is known.
    fn frame_done(&mut self, session: &mut Session, time: Option<FrameTime>, at: WorldTime) {
        let _ = (session, time, at);
    }
}

/// How a client joins a virtual run.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ClientPlan {
    /// The session's settings.
    pub session: SessionConfig,
    /// The link to the server.
    pub up: LinkRules,
    /// The link from the server.
    pub down: LinkRules,
    /// How much the link to the server carries; blackouts count from the join.
    pub up_capacity: Capacity,
    /// How much the link from the server carries.
    pub down_capacity: Capacity,
    /// Time between frames; default 50 ms. The session's tracker is to be told the same.
    pub frame: Duration,
    /// When the first frame after the join is; default by the seed, within a frame.
    pub phase: Option<Duration>,
    /// How much faster than the server's the client's clock runs, as a share; default 0. `5e-4` is 0.05 %.
    pub drift: f64,
    /// Most bytes in a datagram, in both directions; default 1150. Over QUIC the connection says.
    pub datagram_limit: usize,
}

impl ClientPlan {
    /// A client with both directions of its link alike.
    pub fn new(session: SessionConfig, link: LinkRules) -> ClientPlan {
        let frame = session.tracker.frame;
        ClientPlan {
            session,
            up: link,
            down: link,
            up_capacity: Capacity::default(),
            down_capacity: Capacity::default(),
            frame,
            phase: None,
            drift: 0.0,
            datagram_limit: 1150,
        }
    }

    /// Sets how much the link carries, each way.
    pub fn with_capacity(self, capacity: Capacity) -> ClientPlan {
        ClientPlan { up_capacity: capacity.clone(), down_capacity: capacity, ..self }
    }

    /// Sets when the first frame is, after the join.
    pub fn with_phase(self, phase: Duration) -> ClientPlan {
        ClientPlan { phase: Some(phase), ..self }
    }

    /// Sets how much faster than the server's the client's clock runs, as a share.
    pub fn with_drift(self, drift: f64) -> ClientPlan {
        ClientPlan { drift, ..self }
    }

    /// Sets the most bytes in a datagram.
    pub fn with_datagram_limit(self, datagram_limit: usize) -> ClientPlan {
        ClientPlan { datagram_limit, ..self }
    }
}

/// A client's own clock: another zero, another pace.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnClock {
    pub zero: WorldTime,
    pub base_micros: i64,
    pub drift: f64,
}

impl OwnClock {
    pub fn local(&self, at: WorldTime) -> LocalTime {
        let passed = at.micros() - self.zero.micros();
        // Rounded to the microsecond; for a drift of zero exact.
        LocalTime::from_micros(self.base_micros + passed + (passed as f64 * self.drift).round() as i64)
    }
}

/// A client in a virtual run.
pub struct Client {
    /// Its session.
    pub session: Session,
    /// The person in front of it.
    pub driver: Box<dyn ClientDriver>,
    /// The link to the server.
    pub up: VirtualLink,
    /// The link from the server.
    pub down: VirtualLink,
    pub(super) id: SessionId,
    pub(super) clock: OwnClock,
    pub(super) frame: Duration,
    pub(super) connected: bool,
    /// Whether the newest frame culled, and for which lead.
    pub(super) has_looked: bool,
    pub(super) ahead: Ahead,
    pub(super) events: Vec<Event>,
    pub(super) closed: Option<String>,
    /// Datagrams that came before the welcome.
    pub(super) early: Vec<Vec<u8>>,
}

impl Client {
    /// The connection, as the world names it.
    pub fn id(&self) -> SessionId {
        self.id
    }

    /// What its own clock shows at true world time `at`.
    pub fn local(&self, at: WorldTime) -> LocalTime {
        self.clock.local(at)
    }

    /// Time between frames.
    pub fn frame_period(&self) -> Duration {
        self.frame
    }

    /// Whether neither end has closed the connection.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    /// Its first avatar, once it is let in.
    pub fn avatar(&self) -> Option<ObjectId> {
        Some(self.session.welcome()?.avatars.first()?.0)
    }

    /// What its session told the application, in order.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Why the server closed the connection, once that is known here.
    pub fn closed(&self) -> Option<&str> {
        self.closed.as_deref()
    }
}
