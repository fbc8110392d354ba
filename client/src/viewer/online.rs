//! The connected half of the viewer: a thread that has the connection, culls all round and tracks, and a place where it and the
//! window leave things for each other.
//!
//! Frames of the tracker come at their own pace, so that a slow picture makes nobody late. The window draws each object where
//! dead reckoning has it between two such frames, and lets it glide where it was wrong.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use eyeline_protocol::{LocalTime, ObjectId, Orientation, PlanSwitch, Position, Role, Stage, Welcome, WorldTime};
use eyeline_visibility::{AllRound, AllRoundScratch, Bound, DynamicOctree, EyeRegion, Occlusion, Scene};
use glam::{DQuat, DVec3};

use super::model::Model;
use crate::net::parts::PartsLater;
use crate::net::{Driver, FrameReport, LocalClock, ModelSource, Pose, ServedModel, run_resuming};
use crate::session::{Named, Session, SessionConfig};
use crate::target::Target;
use crate::tracking::{Ahead, BeliefKind, TrackerConfig};
use crate::world;

/// How to connect.
#[derive(Clone, Debug)]
pub struct OnlineOptions {
    /// Which server, and who we are.
    pub target: Target,
    /// Where the model comes from.
    pub source: ModelSource,
    /// A name for people.
    pub name: String,
    /// From where to look without an avatar, in the model's metres, for whom the server lets fly.
    pub fly: Option<DVec3>,
    /// Tracker frames a second.
    pub frame_hz: f64,
    /// Pixels a side of the six images that decide what is hidden.
    pub side: u32,
    /// What is asked of the plan.
    pub plan: PlanSwitch,
}

/// An object in sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Which.
    pub object: ObjectId,
    /// Where it was at the tracker's newest frame, relative to the anchor.
    pub position: DVec3,
    /// How it moves on, metres a second.
    pub velocity: DVec3,
    /// How it is turned.
    pub orientation: DQuat,
}

/// A bound of something hidden.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenBound {
    /// Middle of the ball, relative to the anchor.
    pub centre: DVec3,
    /// Its radius now, metres.
    pub radius: f64,
    /// How large it will be when it expires, if it does.
    pub radius_in_the_end: f64,
    /// What is tested: the ball and what reaches out of it.
    pub tested: Option<Bound>,
    /// How long it holds yet, seconds; below 0 it has expired, infinite if it never does.
    pub left: f64,
}

/// Numbers of the newest tracker frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Numbers {
    /// Objects in sight, held hidden, and asked about.
    pub counts: (usize, usize, usize),
    /// Messages in and out since the start.
    pub messages: (u64, u64),
    /// Time for culling all round, and for tracking.
    pub took: (Duration, Duration),
    /// Smoothed round trip, if known.
    pub round_trip: Option<Duration>,
    /// Radius of the eye region.
    pub eye_radius: f64,
}

/// What the thread leaves for the window.
#[derive(Clone, Debug, Default)]
pub struct News {
    /// What is in sight.
    pub seen: Vec<Seen>,
    /// Names of what is, or was, in sight.
    pub names: BTreeMap<ObjectId, Named>,
    /// Bounds of what is hidden, if they are wanted.
    pub hidden: Vec<HiddenBound>,
    /// Numbers for people.
    pub numbers: Numbers,
    /// When all this was.
    pub at: Option<Instant>,
    /// Why the connection is over.
    pub ended: Option<String>,
}

/// What the window leaves for the thread.
#[derive(Clone, Copy, Debug)]
struct Wish {
    eye: DVec3,
    yaw: f64,
    wants_hidden: bool,
}

struct Shared {
    wish: Wish,
    news: News,
}

/// A connection in its thread. Dropping it says goodbye.
pub struct Online {
    shared: Arc<Mutex<Shared>>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// What a connection begins with.
pub struct Joined {
    /// The connection.
    pub online: Online,
    /// The world.
    pub model: Model,
    /// What the server said when it let us in.
    pub welcome: Welcome,
    /// Where our eye is, relative to the anchor.
    pub eye: DVec3,
    /// Where we look, radians.
    pub yaw: f64,
}

impl Online {
    /// Connects, fetches the world, and goes on in a thread of its own.
    ///
    /// # Errors
    /// If there is no such server, it does not let us in, or its world can't be had.
    pub fn join(options: OnlineOptions) -> anyhow::Result<Joined> {
        let (told, joined) = std::sync::mpsc::channel();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let thread = std::thread::Builder::new().name("network".into()).spawn(move || {
            let ran = run(&options, &told, stopped);
            // Before it has joined, whoever waits hears of it; afterwards the window does.
            if let Err(error) = ran {
                let _ = told.send(Err(error));
            }
        })?;
        let Ready { model, welcome, eye, yaw, shared } = joined.recv().context("the network thread ended")??;
        let online = Online { shared, stop: Some(stop), thread: Some(thread) };
        Ok(Joined { online, model, welcome, eye, yaw })
    }

    /// Says where we are and look, and whether bounds of hidden objects are wanted; takes what there is.
    pub fn exchange(&self, eye: DVec3, yaw: f64, wants_hidden: bool) -> News {
        let mut shared = lock(&self.shared);
        shared.wish = Wish { eye, yaw, wants_hidden };
        shared.news.clone()
    }
}

impl Drop for Online {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn lock(shared: &Mutex<Shared>) -> MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the thread tells once it has joined.
struct Ready {
    model: Model,
    welcome: Welcome,
    eye: DVec3,
    yaw: f64,
    shared: Arc<Mutex<Shared>>,
}

type Told = std::sync::mpsc::Sender<anyhow::Result<Ready>>;

/// The thread: joins, tells of it, and runs frames until it is stopped. An error is of joining only.
fn run(options: &OnlineOptions, told: &Told, stopped: tokio::sync::oneshot::Receiver<()>) -> anyhow::Result<()> {
    let period = Duration::from_secs_f64(1.0 / options.frame_hz);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let (endpoint, address) = options.target.endpoint()?;
        let config = SessionConfig::default()
            .with_name(options.name.clone())
            .with_token(options.target.token()?)
            .with_names()
            .with_plan(options.plan)
            .with_tracker(TrackerConfig::default().with_frame(period));
        let config = if options.fly.is_some() { config.with_role(Role::Viewer) } else { config };
        let everywhere = || Box::new(DynamicOctree::new(eyeline_visibility::Aabb::EMPTY)) as _;
        let session = Session::new(config, Box::new(everywhere));
        let mut connection = endpoint.connect(address, session, LocalClock::default()).await?;
        let ServedModel { bytes, name, welcome, moving_nodes } = connection.model(&options.source).await?;
        let served = welcome.clone();
        // Off this thread, which has the connection to keep alive.
        let loading = tokio::task::spawn_blocking(move || -> anyhow::Result<_> {
            let model = Model::load_glb(&bytes, &name, &world::options(&served, &moving_nodes))?;
            world::check_anchor(&model.scene, &name, &served)?;
            let all_round = AllRound::new(&model.scene);
            Ok((model, all_round))
        });
        let (model, all_round) = loading.await??;
        connection.session.use_index(Box::new(DynamicOctree::new(model.scene.bounds())));
        let me = Me::new(&welcome, options.fly, &model.scene)?;
        let (eye, yaw) = (me.eye, me.yaw);
        let wish = Wish { eye, yaw, wants_hidden: false };
        let shared = Arc::new(Mutex::new(Shared { wish, news: News::default() }));
        let scratch = all_round.scratch(options.side);
        let mut eyes = Eyes {
            me,
            all_round,
            scratch,
            ahead: Ahead::default(),
            is_culled: false,
            looks_again: options.plan.runs(Stage::LookAgain, false),
            parts: PartsLater::new(Arc::clone(&model.scene)),
            shared: Arc::clone(&shared),
        };
        if told.send(Ok(Ready { model, welcome, eye, yaw, shared: Arc::clone(&shared) })).is_err() {
            return Ok(());
        }
        let first = connection.clock().now();
        let stopped = async {
            let _ = stopped.await;
        };
        let ran = run_resuming(&endpoint, address, &mut connection, &mut eyes, period, first, stopped).await;
        if let Err(error) = ran {
            lock(&shared).news.ended = Some(error.to_string());
        }
        connection.close().await;
        endpoint.wait_idle().await;
        Ok(())
    })
}

/// Who we are in the world.
struct Me {
    /// Our avatar; none if we fly.
    avatar: Option<ObjectId>,
    /// Of the eye above the avatar's reference point.
    eye_height: f64,
    eye: DVec3,
    yaw: f64,
}

impl Me {
    fn new(welcome: &Welcome, fly: Option<DVec3>, scene: &Scene) -> anyhow::Result<Me> {
        // Avatars are the first class.
        let eye_height = welcome.classes.first().map_or(0.0, |class| class.eye_height);
        if let Some(eye) = fly {
            return Ok(Me { avatar: None, eye_height, eye: eye - scene.anchor(), yaw: 0.0 });
        }
        let &(avatar, position, orientation) = welcome.avatars.first().context("the server gave us no avatar")?;
        let eye = position.metres() + DVec3::Y * eye_height;
        Ok(Me { avatar: Some(avatar), eye_height, eye, yaw: orientation.yaw() })
    }
}

/// What the connection asks of whoever looks.
struct Eyes {
    me: Me,
    all_round: AllRound,
    scratch: AllRoundScratch,
    ahead: Ahead,
    is_culled: bool,
    looks_again: bool,
    parts: PartsLater,
    shared: Arc<Mutex<Shared>>,
}

impl Driver for Eyes {
    fn poses(&mut self, session: &Session, _: LocalTime) -> Vec<Pose> {
        if let Some(parts) = self.parts.poll(session) {
            self.all_round = self.all_round.with_parts(parts);
        }
        let Wish { eye, yaw, .. } = lock(&self.shared).wish;
        (self.me.eye, self.me.yaw) = (eye, yaw);
        let position = Position::from_metres(eye - DVec3::Y * self.me.eye_height);
        // Beyond the world there is no pose; we stay where we were.
        let pose = self.me.avatar.zip(position.ok());
        let orientation = Orientation::from_yaw(yaw);
        pose.map(|(object, position)| Pose { object, position, orientation }).into_iter().collect()
    }

    fn cull(&mut self, ahead: Ahead) {
        self.ahead = ahead;
        let region = EyeRegion { centre: self.me.eye, radius: ahead.eye_radius };
        self.is_culled = match self.looks_again {
            true => self.all_round.cull(region, &mut self.scratch).is_ok(),
            false => self.all_round.look(region, &mut self.scratch).is_ok(),
        };
    }

    fn occlusion(&self) -> Option<&dyn Occlusion> {
        self.is_culled.then(|| self.scratch.occlusion() as &dyn Occlusion)
    }

    fn frame_done(&mut self, session: &mut Session, report: &FrameReport) {
        if self.me.avatar.is_none()
            && let Ok(eye) = Position::from_metres(self.me.eye)
        {
            session.set_eye(eye, Orientation::from_yaw(self.me.yaw));
        }
        // Events are of no use here, and would pile up.
        while session.poll_event().is_some() {}
        let Some(time) = report.time else { return };
        let tracker = session.tracker();
        let mut shared = lock(&self.shared);
        let wants_hidden = shared.wish.wants_hidden;
        let news = &mut shared.news;
        news.seen.clear();
        news.seen.extend(tracker.into_iter().flat_map(|tracker| tracker.drawn()).map(|drawn| Seen {
            object: drawn.object,
            position: drawn.position.metres(),
            velocity: drawn.velocity.metres(),
            orientation: drawn.orientation.quat(),
        }));
        for seen in &news.seen {
            // A number may have become another's.
            if let Some(named) = session.named(seen.object).filter(|named| news.names.get(&seen.object) != Some(*named))
            {
                news.names.insert(seen.object, named.clone());
            }
        }
        news.hidden.clear();
        if wants_hidden {
            news.hidden.extend(session.roster().filter_map(|(object, _)| {
                let explained = tracker?.explain(object).filter(|explained| explained.belief == BeliefKind::Hidden)?;
                let tbv = explained.tbv?;
                Some(HiddenBound {
                    centre: tbv.centre.metres(),
                    radius: tbv.radius_at(time.latest),
                    radius_in_the_end: tbv.radius_at(tbv.expires),
                    tested: explained.tested,
                    left: match tbv.expires {
                        WorldTime::MAX => f64::INFINITY,
                        expires => expires.seconds_since(time.latest),
                    },
                })
            }));
        }
        let stats = session.stats();
        news.numbers = Numbers {
            counts: tracker.map_or((0, 0, 0), |tracker| tracker.counts()),
            messages: (stats.records_in, stats.records_out),
            took: (report.cull, report.track),
            round_trip: session.round_trip().map(|(smoothed, _)| smoothed),
            eye_radius: self.ahead.eye_radius,
        };
        news.at = Some(Instant::now());
    }
}
