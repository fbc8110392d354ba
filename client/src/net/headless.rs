//! The headless client: walks, looks, asks, draws nothing.

use std::future::Future;
use std::time::{Duration, Instant};

use eyeline_protocol::{LocalTime, ObjectId, Orientation, Position};
use eyeline_visibility::Occlusion;

use super::{Arrival, Connection, NetError};
use crate::session::{FrameTime, Session};
use crate::tracking::Ahead;

/// Where an avatar is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Which of the client's avatars.
    pub object: ObjectId,
    /// Its reference point, relative to the anchor.
    pub position: Position,
    /// How it is turned.
    pub orientation: Orientation,
}

/// What a frame cost, and when it was.
#[derive(Clone, Copy, Debug)]
pub struct FrameReport {
    /// Number of the frame, from 0.
    pub frame: u64,
    /// When it began, on the process's clock.
    pub began: LocalTime,
    /// The server's time as the client knew it; `None` before it knows.
    pub time: Option<FrameTime>,
    /// Time for culling.
    pub cull: Duration,
    /// Time for tracking.
    pub track: Duration,
    /// How late the frame began.
    pub late: Duration,
    /// Frames that were left out before this one because the process came late.
    pub skipped: u64,
}

/// The person in front of a headless client.
pub trait Driver {
    /// Moves on to `now` and says where the avatars are.
    fn poses(&mut self, session: &Session, now: LocalTime) -> Vec<Pose>;

    /// Culls from every eye that the present one can reach within the lead. Called once a frame, after [`Driver::poses`], but
    /// not while nothing is tracked ([`Session::tracks`]); then also when the first object is heard of between two frames.
    fn cull(&mut self, ahead: Ahead);

    /// What hides things, as of the newest [`Driver::cull`]; `None` if the client looks at nothing.
    fn occlusion(&self) -> Option<&dyn Occlusion>;

    /// A frame is done.
    fn frame_done(&mut self, session: &mut Session, report: &FrameReport);
}

/// What a headless client did.
#[derive(Clone, Copy, Debug, Default)]
pub struct Summary {
    /// Frames made.
    pub frames: u64,
    /// Frames that were left out because the process came late.
    pub skipped: u64,
    /// When the next frame is due.
    pub next: LocalTime,
}

/// Runs a client until `shutdown` is ready: a frame every `period`, the first at `first`.
///
/// # Errors
/// If the connection is lost.
pub async fn run_headless(
    connection: &mut Connection,
    driver: &mut dyn Driver,
    period: Duration,
    first: LocalTime,
    shutdown: impl Future<Output = ()>,
) -> Result<Summary, NetError> {
    tokio::pin!(shutdown);
    let clock = connection.clock();
    let mut summary = Summary { next: first, ..Summary::default() };
    // Whether the newest frame culled, and for which lead.
    let (mut has_looked, mut ahead) = (true, Ahead::default());
    loop {
        let due = summary.next;
        tokio::select! {
            biased;
            () = &mut shutdown => return Ok(summary),
            arrival = connection.arrive() => {
                let arrival = arrival?;
                if !has_looked && connection.session.tracks() {
                    // As if the frame had culled: who has just come may be in sight.
                    driver.cull(ahead);
                    has_looked = true;
                }
                match (arrival, driver.occlusion().filter(|_| has_looked)) {
                    (Arrival::Datagram(bytes), occlusion) => {
                        connection.session.handle_datagram(&bytes, occlusion, clock.now());
                    }
                    (Arrival::Control, Some(occlusion)) => connection.session.handle_news(occlusion),
                    (Arrival::Control, None) => {}
                }
                connection.flush_urgent();
            }
            () = tokio::time::sleep_until(clock.instant(due).into()) => {
                let now = clock.now();
                let late = now.since(due);
                for pose in driver.poses(&connection.session, now) {
                    connection.session.set_pose(pose.object, pose.position, pose.orientation);
                }
                let started = Instant::now();
                ahead = connection.session.ahead();
                has_looked = connection.session.tracks() || !connection.session.looks();
                if has_looked {
                    driver.cull(ahead);
                }
                let cull = started.elapsed();
                let started = Instant::now();
                let time = match has_looked {
                    true => driver.occlusion().and_then(|occlusion| connection.session.frame(ahead, occlusion, now)),
                    false => connection.session.frame_alone(ahead, now),
                };
                let Summary { frames, skipped, .. } = summary;
                let report =
                    FrameReport { frame: frames, began: now, time, cull, track: started.elapsed(), late, skipped };
                driver.frame_done(&mut connection.session, &report);
                connection.flush().await?;
                summary.frames += 1;
                summary.next = due + period;
                while summary.next + period < clock.now() {
                    summary.next = summary.next + period;
                    summary.skipped += 1;
                }
            }
        }
    }
}
