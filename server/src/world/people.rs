//! What people do besides walking and looking: take things, speak, keep order; and what the application may want to know.

use std::collections::VecDeque;
use std::time::Duration;

use eyeline_protocol::{
    ClientEntry, ClientId, Command, Hold, ObjectId, PAYLOAD_BYTES_MAX, Rank, Refusal, ServerControl, TAKE_REACH,
    TEXT_BYTES_MAX, WorldTime,
};

use super::session::{Phase, Session};
use super::{SessionId, World};
use crate::gate::Denial;

/// Something that happened, for the application around a world.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WorldEvent {
    /// Somebody came.
    Joined {
        /// Its number.
        client: ClientId,
        /// What it calls itself.
        name: String,
        /// Whom its token was issued to; empty without one.
        subject: String,
        /// Its avatars.
        avatars: Vec<ObjectId>,
    },
    /// Its connection was lost; its avatars wait for it.
    Away {
        /// Whose.
        client: ClientId,
    },
    /// It has come back.
    Returned {
        /// Who.
        client: ClientId,
    },
    /// It has left for good.
    Left {
        /// Who.
        client: ClientId,
    },
    /// It has taken a thing.
    Taken {
        /// Who.
        client: ClientId,
        /// What.
        object: ObjectId,
    },
    /// It has let a thing go.
    LetGo {
        /// Who.
        client: ClientId,
        /// What.
        object: ObjectId,
    },
    /// It has sent a payload about one of its avatars or things; clients that are told of that have got it too.
    Payload {
        /// Who.
        client: ClientId,
        /// About which object.
        object: ObjectId,
        /// What.
        bytes: Vec<u8>,
    },
}

/// Most events that wait to be taken; more, and the oldest are dropped.
const EVENTS_MAX: usize = 4096;

/// Most things that one client may hold.
const THINGS_MAX: usize = 16;

/// Events that the application has not taken.
#[derive(Default)]
pub(super) struct Events {
    /// Nothing is kept until somebody has asked.
    wanted: bool,
    waiting: VecDeque<WorldEvent>,
}

impl World {
    /// What happened, oldest first. Nothing is kept before the first call; more than 4,096 events are not.
    pub fn poll_event(&mut self) -> Option<WorldEvent> {
        self.events.wanted = true;
        self.events.waiting.pop_front()
    }

    pub(super) fn note(&mut self, event: WorldEvent) {
        if !self.events.wanted {
            return;
        }
        if self.events.waiting.len() == EVENTS_MAX {
            self.events.waiting.pop_front();
        }
        self.events.waiting.push_back(event);
    }

    /// Tells one client something of the application's; says whether it is here. More than [`PAYLOAD_BYTES_MAX`] bytes are not
    /// sent.
    pub fn send_payload(&mut self, client: ClientId, bytes: Vec<u8>) -> bool {
        let Some(id) = self.session_of(client).filter(|_| bytes.len() <= PAYLOAD_BYTES_MAX) else { return false };
        self.say(id, &ServerControl::Payload { object: None, bytes });
        true
    }

    /// Tells everybody something.
    pub fn say_to_all(&mut self, text: &str) {
        let message = ServerControl::Said { text: shortened(text) };
        let ids: Vec<SessionId> = self.live().map(|(id, _)| id).collect();
        for id in ids {
            self.say(id, &message);
        }
    }

    /// Sends a client away; says whether it is here.
    pub fn kick(&mut self, client: ClientId, reason: &str) -> bool {
        self.send_away(client, Refusal::Kicked, reason)
    }

    /// Sends a client away for `time` (`None`: until the world ends): nobody with its token comes in before, or, if it had
    /// none, from its address. Says whether it is here.
    pub fn ban(&mut self, client: ClientId, time: Option<Duration>, reason: &str) -> bool {
        let Some(session) = self.session_of(client).and_then(|id| self.sessions.get(&id)) else { return false };
        let until = time.map_or(WorldTime::MAX, |time| self.tick + time);
        self.gate.ban(&session.permit.subject, session.caller, until);
        self.send_away(client, Refusal::Banned, reason)
    }

    fn send_away(&mut self, client: ClientId, refusal: Refusal, reason: &str) -> bool {
        let Some(id) = self.session_of(client) else { return false };
        let is_away = self.sessions.get(&id).is_some_and(|session| session.away_since.is_some());
        self.refuse(id, refusal, &shortened(reason));
        if is_away {
            self.disconnect(id);
        }
        true
    }

    /// Sends away whom the gate would no longer let in, once there is news of that.
    pub(super) fn heed_gate(&mut self, now: WorldTime) {
        if !self.gate.look(now) {
            return;
        }
        let dismissed = |(_, session): (SessionId, &Session)| {
            let denial = self.gate.dismisses(&session.permit, session.caller, now).filter(|_| !session.is_refused)?;
            Some((session.client, denial))
        };
        let dismissed: Vec<_> = self.live().filter_map(dismissed).collect();
        for (client, Denial { refusal, reason }) in dismissed {
            self.stats.dismissed += 1;
            self.send_away(client, refusal, &reason);
        }
    }

    fn live(&self) -> impl Iterator<Item = (SessionId, &Session)> {
        let is_live = |session: &Session| matches!(session.phase, Phase::Live { .. });
        self.sessions.iter().filter(move |(_, session)| is_live(session)).map(|(&id, session)| (id, session))
    }

    fn session_of(&self, client: ClientId) -> Option<SessionId> {
        self.live().find(|(_, session)| session.client == client).map(|(id, _)| id)
    }

    /// Who is here, by number.
    pub fn clients(&self) -> Vec<ClientEntry> {
        let entry = |(_, session): (SessionId, &Session)| ClientEntry {
            client: session.client,
            name: session.name.clone(),
            subject: session.permit.subject.clone(),
            rank: session.permit.rank,
            avatars: u16::try_from(session.avatars.len()).unwrap_or(u16::MAX),
            seconds: u32::try_from(self.tick.since(session.came_at).as_secs()).unwrap_or(u32::MAX),
            rtt_micros: session.round_trip().and_then(|rtt| u32::try_from(rtt.as_micros()).ok()),
            away: session.away_since.is_some(),
        };
        let mut clients: Vec<ClientEntry> = self.live().map(entry).collect();
        clients.sort_unstable_by_key(|entry| entry.client.0);
        clients
    }

    pub(super) fn handle_command(&mut self, id: SessionId, command: Command) {
        let is_operator = self.sessions.get(&id).is_some_and(|session| session.permit.rank >= Rank::Operator);
        let (ok, text) = match command {
            _ if !is_operator => {
                self.stats.forbidden += 1;
                (false, "only operators may do that; come with an operator's token".to_owned())
            }
            Command::List => {
                let clients = self.clients();
                for piece in clients.chunks(ServerControl::ROSTER_MAX) {
                    self.say(id, &ServerControl::Clients { entries: piece.to_vec() });
                }
                (true, format!("{} clients", clients.len()))
            }
            Command::Kick { client, reason } => done(self.kick(client, &reason), client, "sent away"),
            Command::Ban { client, seconds, reason } => {
                let time = (seconds > 0).then(|| Duration::from_secs(u64::from(seconds)));
                done(self.ban(client, time, &reason), client, "banned")
            }
            Command::Say { text } => {
                self.say_to_all(&text);
                (true, "said".to_owned())
            }
        };
        self.say(id, &ServerControl::Done { ok, text });
    }

    /// Gives a client a thing to move, if it stands beside it, is told of it, and nobody else has it.
    pub(super) fn take(&mut self, id: SessionId, object: ObjectId) {
        let hold = self.hold(id, object);
        if hold == Hold::Yours {
            let entry = &mut self.objects[object.index()];
            if entry.owner != Some(id) {
                entry.owner = Some(id);
                entry.wanted = None;
                entry.wanted_seq = 0;
                // What stood, or followed its path, was bounded by that. From now on it moves as it is moved.
                entry.is_freed = true;
                if let Some(session) = self.sessions.get_mut(&id) {
                    session.things.push(object);
                    let client = session.client;
                    self.note(WorldEvent::Taken { client, object });
                }
            }
        }
        self.say(id, &ServerControl::Held { object, hold });
    }

    fn hold(&self, id: SessionId, object: ObjectId) -> Hold {
        let (Some(session), Some(entry)) = (self.sessions.get(&id), self.objects.get(object.index())) else {
            return Hold::Fixed;
        };
        if session.things.contains(&object) {
            return Hold::Yours;
        }
        let Some(avatar) = session.avatars.first().filter(|_| session.things.len() < THINGS_MAX) else {
            return Hold::Fixed;
        };
        if !entry.takeable || !entry.alive || !entry.present {
            return Hold::Fixed;
        }
        let avatar = &self.objects[avatar.index()];
        let radius = |class: eyeline_protocol::ClassId| self.classes[usize::from(class.0)].extent.radius;
        let distance = avatar.position.metres().distance(entry.position.metres());
        let is_near = distance <= TAKE_REACH + radius(avatar.class) + radius(entry.class);
        // Who is not told of it does not learn here that it is near, or whose it is.
        match entry.owner {
            _ if !avatar.present || !is_near || !session.is_told(object) => Hold::TooFar,
            Some(_) => Hold::Taken,
            None => Hold::Yours,
        }
    }

    /// A client puts a thing down.
    pub(super) fn let_go(&mut self, id: SessionId, object: ObjectId) {
        let entry = self.objects.get_mut(object.index());
        let Some(entry) = entry.filter(|entry| entry.takeable && entry.owner == Some(id)) else {
            self.stats.forbidden += 1;
            return self.say(id, &ServerControl::Held { object, hold: Hold::Fixed });
        };
        entry.owner = None;
        entry.wanted = None;
        if let Some(session) = self.sessions.get_mut(&id) {
            session.things.retain(|&thing| thing != object);
            let client = session.client;
            self.note(WorldEvent::LetGo { client, object });
        }
        self.say(id, &ServerControl::Held { object, hold: Hold::Free });
    }

    /// Something of the application's, for those who are told of the object that it is about.
    pub(super) fn pass_payload(&mut self, id: SessionId, object: ObjectId, bytes: Vec<u8>) {
        if self.objects.get(object.index()).is_none_or(|entry| entry.owner != Some(id)) {
            self.stats.forbidden += 1;
            return;
        }
        let is_told = |session: &Session| session.is_told(object);
        let told: Vec<SessionId> =
            self.live().filter(|&(to, session)| to != id && is_told(session)).map(|(to, _)| to).collect();
        let message = ServerControl::Payload { object: Some(object), bytes: bytes.clone() };
        for to in told {
            self.stats.payloads += 1;
            self.say(to, &message);
        }
        if let Some(client) = self.sessions.get(&id).map(|session| session.client) {
            self.note(WorldEvent::Payload { client, object, bytes });
        }
    }
}

fn done(ok: bool, client: ClientId, what: &str) -> (bool, String) {
    let text = if ok { format!("client {} {what}", client.0) } else { format!("there is no client {}", client.0) };
    (ok, text)
}

/// At most what the wire carries.
fn shortened(text: &str) -> String {
    let mut end = text.len().min(TEXT_BYTES_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text[..end].to_owned()
}
