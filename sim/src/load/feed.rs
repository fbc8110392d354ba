//! What does the world itself cost, without sockets and without clients? Record what a crowd of real clients says to it,
//! and say it again.
//!
//! A world is deterministic: the same inputs at the same times give the same outputs. So sessions and trackers play once, in
//! virtual time, and what reached the world is kept; [`Prepared::replay`] then costs only the world. The path of the recording
//! takes `ONE_WAY` and loses nothing.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use eyeline_client::net::{Driver, FrameReport};
use eyeline_client::session::{IndexMaker, Session, SessionConfig};
use eyeline_client::tracking::{Ahead, TrackerConfig};
use eyeline_protocol::codec::ControlReader;
use eyeline_protocol::{LocalTime, WorldTime};
use eyeline_server::policy::PolicySettings;
use eyeline_server::world::{SessionId, Transmit, World, WorldConfig};
use eyeline_visibility::{DynamicOctree, FlatIndex};

use super::ways::{Replayer, WayRules, Ways};
use crate::people::Person;
use crate::stage::Stage;

/// Time under way, each way: loopback's order of magnitude.
const ONE_WAY: Duration = Duration::from_micros(100);

/// What a datagram may carry: the least that QUIC promises, less its own headers.
const DATAGRAM_LIMIT: usize = 1150;

/// What reaches a world.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Input {
    Connect,
    /// A control message of a session, without its length.
    Control(Vec<u8>),
    Datagram(Vec<u8>),
    Tick,
}

/// One thing that reached the world: who said it (by order of connecting), what, and when.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Said {
    who: u32,
    at: WorldTime,
    input: Input,
}

/// What a crowd said to a world.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Feed {
    clients: u32,
    said: Vec<Said>,
    /// Where in `said` all are in and have settled.
    settled: usize,
}

/// What to record.
#[derive(Clone, Copy, Debug)]
pub struct FeedRules {
    /// How many clients, each with an avatar.
    pub clients: u32,
    /// How many of them cull for themselves.
    pub culling: u32,
    /// Clients that join in a tick.
    pub joins_a_tick: u32,
    /// Ticks between the last join and the measurement.
    pub settle_ticks: u32,
    /// Ticks of the measurement.
    pub ticks: u32,
    /// The ways that they walk.
    pub ways: WayRules,
}

/// What became of a client of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Played {
    /// Objects in V at the end.
    pub visible: usize,
    /// Records that it was told, from the beginning.
    pub records_in: u64,
    /// Records that it said, poses included.
    pub records_out: u64,
}

/// What came out of a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Ticks.
    pub ticks: u64,
    /// Datagrams that the world was given.
    pub datagrams_in: u64,
    /// Their bytes.
    pub bytes_in: u64,
    /// Datagrams that it gave.
    pub datagrams_out: u64,
    /// Their bytes.
    pub bytes_out: u64,
}

/// One client of a recording.
struct Player {
    session: Session,
    driver: Box<dyn Driver>,
    reader: ControlReader,
    /// When its newest datagram arrived, or its newest frame was: its own time goes forward only.
    now: LocalTime,
    frame: u64,
    /// Whether the newest frame culled, and for which lead.
    has_looked: bool,
    ahead: Ahead,
}

/// A recording under way.
struct Recorder {
    world: World,
    /// Whether all are in and have settled.
    has_settled: bool,
    players: Vec<Player>,
    ids: Vec<SessionId>,
    by_id: BTreeMap<SessionId, usize>,
    said: Vec<Said>,
}

/// The world that feeds are made for.
///
/// # Errors
/// If the stage makes no world.
pub fn world(stage: &Stage) -> anyhow::Result<World> {
    let config = WorldConfig::default().with_grid_seed(7);
    stage.world(config, "visible", &PolicySettings::default(), WorldTime::ZERO)
}

impl Feed {
    /// Lets a crowd of replayed walkers play in the world of `stage` and keeps what they say.
    ///
    /// # Errors
    /// If the stage makes no world, or has no rooms to walk in.
    pub fn record(stage: &Stage, rules: &FeedRules) -> anyhow::Result<(Feed, Vec<Played>)> {
        let bounds = stage.model.scene.bounds();
        let ways = Arc::new(Ways::record(&stage.ground(), bounds, &rules.ways)?);
        let mut recorder = Recorder {
            world: world(stage)?,
            has_settled: false,
            players: Vec::new(),
            ids: Vec::new(),
            by_id: BTreeMap::new(),
            said: Vec::new(),
        };
        let period = recorder.world.tick_period();
        let join_ticks = rules.clients.div_ceil(rules.joins_a_tick.max(1));
        let mut settled = 0;
        let mut joined = 0;
        for number in 0..join_ticks + rules.settle_ticks + rules.ticks {
            let at = WorldTime::ZERO + period * (number + 1);
            if number == join_ticks + rules.settle_ticks {
                settled = recorder.said.len();
                recorder.has_settled = true;
            }
            recorder.say(0, at, Input::Tick);
            recorder.deliver(at);
            for _ in 0..rules.joins_a_tick.min(rules.clients - joined) {
                let index = joined as usize;
                let tracker = TrackerConfig::default().with_frame(period);
                let config = SessionConfig::default().with_tracker(tracker);
                let (index_maker, driver): (IndexMaker, Box<dyn Driver>) = if joined < rules.culling {
                    let person = Person::on(&stage.ground(), rules.ways.seed, index, rules.ways.side, None)
                        .with_hold(rules.ways.hold);
                    (Box::new(move || Box::new(DynamicOctree::new(bounds))), Box::new(person))
                } else {
                    let replayer = Replayer::new(ways.clone(), index, rules.clients as usize, None);
                    (Box::new(|| Box::new(FlatIndex::default())), Box::new(replayer))
                };
                let session = Session::new(config, index_maker);
                recorder.join(session, driver, at);
                joined += 1;
            }
            for player in 0..recorder.players.len() {
                recorder.frame(player, at + period.mul_f64(player as f64 / f64::from(rules.clients)));
            }
        }
        let played = recorder.players.iter().map(|player| Played {
            visible: player.session.tracker().map_or(0, |tracker| tracker.counts().0),
            records_in: player.session.stats().records_in,
            records_out: player.session.stats().records_out,
        });
        let played = played.collect();
        Ok((Feed { clients: rules.clients, said: recorder.said, settled }, played))
    }

    /// How many clients it is of.
    pub fn clients(&self) -> u32 {
        self.clients
    }

    /// Says to a fresh `world` what was said before all had settled.
    pub fn prepare(&self, mut world: World) -> Prepared<'_> {
        let mut ids = Vec::with_capacity(self.clients as usize);
        say_all(&mut world, &mut ids, &self.said[..self.settled]);
        Prepared { feed: self, world, ids }
    }

    /// The feed as bytes, for a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend(self.clients.to_le_bytes());
        bytes.extend((self.settled as u64).to_le_bytes());
        for Said { who, at, input } in &self.said {
            let (kind, message): (u8, &[u8]) = match input {
                Input::Connect => (0, &[]),
                Input::Control(message) => (1, message),
                Input::Datagram(message) => (2, message),
                Input::Tick => (3, &[]),
            };
            bytes.push(kind);
            bytes.extend(who.to_le_bytes());
            bytes.extend(at.micros().to_le_bytes());
            bytes.extend((message.len() as u32).to_le_bytes());
            bytes.extend(message);
        }
        bytes
    }

    /// A feed from the bytes of [`Feed::to_bytes`].
    ///
    /// # Errors
    /// If they are not.
    pub fn from_bytes(mut bytes: &[u8]) -> anyhow::Result<Feed> {
        fn take<const N: usize>(bytes: &mut &[u8]) -> anyhow::Result<[u8; N]> {
            let (head, rest) = bytes.split_first_chunk::<N>().context("the feed ends early; record it again")?;
            *bytes = rest;
            Ok(*head)
        }
        let clients = u32::from_le_bytes(take(&mut bytes)?);
        let settled = u64::from_le_bytes(take(&mut bytes)?) as usize;
        let mut said = Vec::new();
        while !bytes.is_empty() {
            let [kind] = take(&mut bytes)?;
            let who = u32::from_le_bytes(take(&mut bytes)?);
            let at = WorldTime::from_micros(i64::from_le_bytes(take(&mut bytes)?));
            let length = u32::from_le_bytes(take(&mut bytes)?) as usize;
            let (message, rest) = bytes.split_at_checked(length).context("the feed ends early; record it again")?;
            bytes = rest;
            let input = match kind {
                0 => Input::Connect,
                1 => Input::Control(message.to_vec()),
                2 => Input::Datagram(message.to_vec()),
                3 => Input::Tick,
                _ => anyhow::bail!("a feed has no input of kind {kind}; record it again"),
            };
            anyhow::ensure!(who < clients.max(1), "client {who} of {clients} in a feed; record it again");
            said.push(Said { who, at, input });
        }
        anyhow::ensure!(settled <= said.len(), "the feed ends before all had settled; record it again");
        Ok(Feed { clients, said, settled })
    }
}

/// A world in which all have joined and settled.
pub struct Prepared<'a> {
    feed: &'a Feed,
    world: World,
    ids: Vec<SessionId>,
}

impl Prepared<'_> {
    /// Says the rest: what is to be measured.
    pub fn replay(&mut self) -> Replayed {
        say_all(&mut self.world, &mut self.ids, &self.feed.said[self.feed.settled..])
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }
}

fn say_all(world: &mut World, ids: &mut Vec<SessionId>, said: &[Said]) -> Replayed {
    let mut replayed = Replayed::default();
    for Said { who, at, input } in said {
        match input {
            Input::Datagram(bytes) => {
                (replayed.datagrams_in, replayed.bytes_in) =
                    (replayed.datagrams_in + 1, replayed.bytes_in + bytes.len() as u64);
            }
            Input::Tick => replayed.ticks += 1,
            Input::Connect | Input::Control(_) => {}
        }
        say(world, ids, *who, *at, input);
        while let Some((_, transmit)) = world.poll_transmit(*at) {
            if let Transmit::Datagram(bytes) = transmit {
                (replayed.datagrams_out, replayed.bytes_out) =
                    (replayed.datagrams_out + 1, replayed.bytes_out + bytes.len() as u64);
            }
        }
    }
    replayed
}

/// What a driver does with what arrives. Connections are numbered in order.
fn say(world: &mut World, ids: &mut Vec<SessionId>, who: u32, at: WorldTime, input: &Input) {
    match (input, ids.get(who as usize)) {
        (Input::Connect, _) => {
            let id = world.connect(at);
            world.handle_datagram_limit(id, DATAGRAM_LIMIT);
            ids.push(id);
        }
        (Input::Control(message), Some(&id)) => world.handle_control(id, message, at),
        (Input::Datagram(message), Some(&id)) => world.handle_datagram(id, message, at),
        (Input::Tick, _) => world.tick(at),
        (Input::Control(_) | Input::Datagram(_), None) => {}
    }
}

/// All that a client does itself once all have settled: what callgrind is told to collect by the example `tracker_cost`.
#[inline(never)]
fn client_part<T>(work: impl FnOnce() -> T) -> T {
    black_box(work())
}

impl Player {
    /// Culls as the newest frame would have if there is something to track since.
    fn look_at_news(&mut self) {
        if self.frame > 0 && !self.has_looked && self.session.tracks() {
            self.driver.cull(self.ahead);
            self.has_looked = true;
        }
    }

    /// Takes what the world has to say; what can't wait to be answered.
    fn hear(&mut self, transmit: &Transmit, now: LocalTime) -> Vec<Vec<u8>> {
        self.now = self.now.max(now);
        match transmit {
            Transmit::Control(bytes) => {
                self.reader.push(bytes);
                while let Ok(Some(message)) = self.reader.next_message() {
                    self.session.handle_control(&message);
                }
                self.look_at_news();
                if let Some(occlusion) = self.driver.occlusion().filter(|_| self.has_looked) {
                    self.session.handle_news(occlusion);
                }
            }
            Transmit::Datagram(bytes) => {
                let occlusion = self.driver.occlusion().filter(|_| self.has_looked);
                self.session.handle_datagram(bytes, occlusion, self.now);
            }
            _ => {}
        }
        std::iter::from_fn(|| self.session.poll_urgent(DATAGRAM_LIMIT, self.now)).collect()
    }

    fn frame(&mut self, at: LocalTime) {
        self.now = self.now.max(at);
        let now = self.now;
        for pose in self.driver.poses(&self.session, now) {
            self.session.set_pose(pose.object, pose.position, pose.orientation);
        }
        let ahead = self.session.ahead();
        // As the client's own loop does: while nothing is tracked nobody need know what hides things.
        (self.has_looked, self.ahead) = (self.session.tracks() || !self.session.looks(), ahead);
        let time = if self.has_looked {
            self.driver.cull(ahead);
            self.driver.occlusion().and_then(|occlusion| self.session.frame(ahead, occlusion, now))
        } else {
            self.session.frame_alone(ahead, now)
        };
        let none = Duration::ZERO;
        let report =
            FrameReport { frame: self.frame, began: now, time, cull: none, track: none, late: none, skipped: 0 };
        self.driver.frame_done(&mut self.session, &report);
        self.frame += 1;
    }

    /// Its datagrams.
    fn datagrams(&mut self) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| self.session.poll_datagram(DATAGRAM_LIMIT, self.now)).collect()
    }
}

impl Recorder {
    fn say(&mut self, who: usize, at: WorldTime, input: Input) {
        say(&mut self.world, &mut self.ids, who as u32, at, &input);
        self.said.push(Said { who: who as u32, at, input });
    }

    fn join(&mut self, session: Session, driver: Box<dyn Driver>, at: WorldTime) {
        let who = self.players.len();
        self.say(who, at, Input::Connect);
        self.by_id.insert(self.ids[who], who);
        let now = LocalTime::from_micros(at.micros());
        let (reader, ahead) = (ControlReader::default(), Ahead::default());
        self.players.push(Player { session, driver, reader, now, frame: 0, has_looked: false, ahead });
        self.speak(who, at);
        self.deliver(at);
    }

    /// Lets a player work.
    fn play<T>(&mut self, who: usize, work: impl FnOnce(&mut Player) -> T) -> T {
        let player = &mut self.players[who];
        if self.has_settled { client_part(|| work(player)) } else { work(player) }
    }

    /// Sends what a player has to say, and lets it hear the answers, until nobody has more to say.
    fn speak(&mut self, who: usize, at: WorldTime) {
        while let Some(bytes) = self.players[who].session.poll_control() {
            self.say(who, at + ONE_WAY, Input::Control(bytes[4..].to_vec()));
        }
        for bytes in self.play(who, Player::datagrams) {
            self.say(who, at + ONE_WAY, Input::Datagram(bytes));
        }
        self.deliver(at + ONE_WAY);
    }

    /// Brings everybody what the world has to say.
    fn deliver(&mut self, at: WorldTime) {
        while let Some((id, transmit)) = self.world.poll_transmit(at) {
            let Some(&who) = self.by_id.get(&id) else { continue };
            let now = LocalTime::from_micros((at + ONE_WAY).micros());
            for bytes in self.play(who, |player| player.hear(&transmit, now)) {
                self.say(who, at + 2 * ONE_WAY, Input::Datagram(bytes));
            }
        }
    }

    fn frame(&mut self, who: usize, at: WorldTime) {
        self.play(who, |player| player.frame(LocalTime::from_micros(at.micros())));
        self.speak(who, at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::plan::RoomsRules;

    const RULES: FeedRules = FeedRules {
        clients: 6,
        culling: 1,
        joins_a_tick: 2,
        settle_ticks: 4,
        ticks: 10,
        ways: WayRules { ways: 3, frames: 20, period: Duration::from_millis(50), side: 32, hold: 0.25, seed: 7 },
    };

    #[test]
    fn a_replay_is_what_the_recording_was() {
        let stage = Stage::made(&RoomsRules { columns: 3, rows: 2, ..RoomsRules::default() }).unwrap();
        let (feed, played) = Feed::record(&stage, &RULES).unwrap();
        assert!(played.iter().all(|client| client.visible > 0), "{played:?}");
        let mut prepared = feed.prepare(world(&stage).unwrap());
        let replayed = prepared.replay();
        assert_eq!(replayed.ticks, u64::from(RULES.ticks));
        // Each client says something in each frame and is told something in each tick.
        let least = u64::from(RULES.clients * RULES.ticks);
        assert!(replayed.datagrams_in >= least && replayed.datagrams_out >= least, "{replayed:?}");
        let stats = prepared.world().stats();
        assert_eq!([stats.rejected_datagrams, stats.rejected_control, stats.forbidden], [0; 3], "{stats:?}");
        assert_eq!(prepared.world().avatars(), RULES.clients as usize);
        let (again, _) = Feed::record(&stage, &RULES).unwrap();
        assert!(again == feed, "recording is deterministic");
    }

    #[test]
    fn a_feed_survives_its_file_and_half_a_file_is_refused() {
        let said = vec![
            Said { who: 0, at: WorldTime::from_micros(5), input: Input::Connect },
            Said { who: 0, at: WorldTime::from_micros(6), input: Input::Control(vec![1, 2, 3]) },
            Said { who: 0, at: WorldTime::from_micros(7), input: Input::Tick },
            Said { who: 0, at: WorldTime::from_micros(-8), input: Input::Datagram(vec![9]) },
        ];
        let feed = Feed { clients: 1, said, settled: 3 };
        let bytes = feed.to_bytes();
        assert_eq!(Feed::from_bytes(&bytes).unwrap(), feed);
        let whole = [12, 29, 49, 66, bytes.len()];
        for length in (0..bytes.len()).filter(|length| !whole.contains(length)) {
            assert!(Feed::from_bytes(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
        }
    }
}
