//! Coming, staying away for a moment, coming back, leaving: what happens to a session, and who is told of it.
//!
//! A connection that is lost is not a client that leaves: its avatars stand still where they were for a grace period, and
//! who comes back with the token of the last welcome has them again. If it kept its roster and bounds it is told only the
//! announcements that it missed; its bounds hold all the while, since violations were kept for it.

use std::collections::VecDeque;
use std::sync::Arc;

use eyeline_protocol::{
    ClientId, Continuity, Hold, Interest, ObjectId, Orientation, Position, Rank, Refusal, Resume, Role, RosterEntry,
    ServerControl, VERSION, Welcome, WorldTime, codec,
};
use glam::DVec3;

use super::lens::focal;
use super::object::Object;
use super::session::{Phase, Session};
use super::{AVATAR_CLASS, SessionId, Transmit, World, WorldEvent};
use crate::gate::{Caller, Denial, Permit};

/// A client's hello.
pub(super) struct Hello {
    pub version: u16,
    pub token: Vec<u8>,
    pub resolution: (u16, u16),
    pub interest: Interest,
    pub role: Role,
    pub name: String,
    pub resume: Option<Resume>,
}

/// How many announcements are kept for those who come back. One is of up to 256 objects.
const ANNOUNCEMENTS_KEPT: usize = 1024;

/// What everybody was told of who came and left, numbered from 0, the newest last.
#[derive(Default)]
pub(super) struct Announcements {
    kept: VecDeque<Arc<[u8]>>,
    /// Number of the first that is kept.
    first: u64,
    /// Objects that came since the last tick, and objects that left: told of at the next one, all at once.
    came: Vec<ObjectId>,
    left: Vec<ObjectId>,
}

impl Announcements {
    /// How many are kept.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.kept.len()
    }

    /// Number of the next announcement.
    fn next(&self) -> u64 {
        self.first + self.kept.len() as u64
    }

    fn push(&mut self, message: Arc<[u8]>) {
        self.kept.push_back(message);
        if self.kept.len() > ANNOUNCEMENTS_KEPT {
            self.kept.pop_front();
            self.first += 1;
        }
    }

    /// All from this number on; `None` if some of them are not kept any more, or were never made.
    fn since(&self, number: u64) -> Option<Vec<Arc<[u8]>>> {
        let skip = usize::try_from(number.checked_sub(self.first)?).ok()?;
        (skip <= self.kept.len()).then(|| self.kept.iter().skip(skip).cloned().collect())
    }
}

/// Where a session's roster stands.
#[derive(Clone, Copy, Default)]
pub(super) struct RosterMark {
    /// Pieces that followed its welcome.
    pieces: u32,
    /// Number of the first announcement after these.
    announced_from: u64,
}

impl World {
    /// A new connection, of which nothing is known. Until its hello it costs one small entry.
    pub fn connect(&mut self, now: WorldTime) -> SessionId {
        self.connect_from(now, Caller::default())
    }

    /// A new connection. Until its hello it costs one small entry.
    pub fn connect_from(&mut self, now: WorldTime, caller: Caller) -> SessionId {
        let id = SessionId(self.next_session);
        self.next_session = self.next_session.wrapping_add(1);
        self.sessions.insert(id, Session::new(ClientId(id.0), caller, now));
        id
    }

    /// The connection has gone. Its avatars leave the world, unless the client may come back: then they wait for it.
    pub fn disconnect(&mut self, id: SessionId) {
        let Some(session) = self.sessions.get_mut(&id) else { return };
        let is_live = matches!(session.phase, Phase::Live { .. });
        let may_return = is_live && !session.is_refused && session.may_return(self.config.resume_grace);
        if !may_return {
            return self.remove(id);
        }
        session.away_since = Some(self.tick);
        let client = session.client;
        self.note(WorldEvent::Away { client });
    }

    /// Those who stayed away too long have left.
    pub(super) fn end_graces(&mut self) {
        let (tick, grace) = (self.tick, self.config.resume_grace);
        let is_over = |session: &Session| session.away_since.is_some_and(|since| tick.since(since) >= grace);
        let gone: Vec<SessionId> =
            self.sessions.iter().filter(|(_, session)| is_over(session)).map(|(&id, _)| id).collect();
        for id in gone {
            self.remove(id);
        }
    }

    fn remove(&mut self, id: SessionId) {
        let Some(session) = self.sessions.remove(&id) else { return };
        let Phase::Live { slot, .. } = session.phase else { return };
        self.validity.forget(id);
        self.free_slots.push(slot);
        for object in &mut self.objects {
            object.forget_holder(slot);
        }
        for thing in &session.things {
            let entry = &mut self.objects[thing.index()];
            (entry.owner, entry.wanted) = (None, None);
        }
        for &object in &session.avatars {
            let entry = &mut self.objects[object.index()];
            entry.present = false;
            entry.alive = false;
            entry.wanted = None;
            entry.owner = None;
            self.free.push(object);
        }
        self.avatars_alive -= session.avatars.len();
        for other in self.sessions.values_mut() {
            for object in &session.avatars {
                other.forget(*object);
            }
        }
        for &object in &session.avatars {
            // Of whom nobody has heard nobody need hear that it left.
            match self.announcements.came.iter().position(|&came| came == object) {
                Some(index) => drop(self.announcements.came.remove(index)),
                None => self.announcements.left.push(object),
            }
        }
        self.note(WorldEvent::Left { client: session.client });
    }

    /// Tells a connection to go, and why.
    pub(super) fn refuse(&mut self, id: SessionId, refusal: Refusal, reason: &str) {
        if let Some(session) = self.sessions.get_mut(&id) {
            session.is_refused = true;
            if session.away_since.is_some() {
                return;
            }
        }
        let message = ServerControl::Refused { refusal, reason: reason.to_owned() };
        self.out.push_back((id, Transmit::Control(codec::encode_control(&message).into())));
        self.out.push_back((id, Transmit::Close(reason.to_owned())));
    }

    fn deny(&mut self, id: SessionId, refusal: Refusal, reason: &str) {
        self.stats.refused += 1;
        self.refuse(id, refusal, reason);
    }

    /// Lets a client in, or says why not.
    pub(super) fn admit(&mut self, id: SessionId, hello: Hello, now: WorldTime) {
        let Some(session) = self.sessions.get_mut(&id) else { return };
        let caller = session.caller;
        if hello.version != VERSION {
            let version = hello.version;
            let reason = format!("protocol version {version} is not the server's {VERSION}: update the older side");
            return self.deny(id, Refusal::Version, &reason);
        }
        let permit = match self.gate.admit(&hello.token, caller, now) {
            Ok(permit) => permit,
            Err(Denial { refusal, reason }) => return self.deny(id, refusal, &reason),
        };
        (session.interest, session.focal) = (hello.interest, focal(hello.resolution.0));
        if let Some(resume) = hello.resume
            && let Some(old) = self.whose(&resume, &permit)
        {
            return self.readmit(id, old, resume, permit, now);
        }
        let wanted = match hello.role {
            Role::Avatar => 1,
            Role::Actor { avatars } => usize::from(avatars),
            Role::Viewer => 0,
        };
        if wanted == 0 && hello.role != Role::Viewer {
            return self.deny(id, Refusal::Protocol, "an actor drives at least one avatar");
        }
        if wanted > 0 && permit.rank < Rank::Actor {
            let reason =
                "this token lets its bearer look only (rank viewer); come as a viewer, or ask for an actor's token";
            return self.deny(id, Refusal::Token, reason);
        }
        if hello.role == Role::Viewer && permit.rank == Rank::Actor {
            // Else every actor had a second, free eye.
            let reason =
                "an actor's eye stays by its avatar; come as an avatar, or with a viewer's or an operator's token";
            return self.deny(id, Refusal::Token, reason);
        }
        if wanted > usize::from(permit.avatars_max) {
            let most = permit.avatars_max;
            let reason = format!("{wanted} avatars are more than the {most} that this token is good for");
            return self.deny(id, Refusal::Token, &reason);
        }
        let alive = self.avatars_alive;
        if alive + wanted > self.config.avatars_max {
            let limit = self.config.avatars_max;
            let reason = format!("{wanted} more avatars are too many: {alive} of {limit} are taken; try again later");
            return self.deny(id, Refusal::Full, &reason);
        }
        let slot = self.free_slots.pop().unwrap_or_else(|| {
            self.slots += 1;
            self.slots - 1
        });
        let watches = !matches!(hello.role, Role::Actor { .. });
        let present = hello.role == Role::Avatar;
        let avatars: Vec<ObjectId> =
            (0..wanted).map(|number| self.spawn_avatar(id, present, called(&hello.name, number))).collect();
        self.avatars_alive += wanted;
        let Some(session) = self.sessions.get_mut(&id) else { return };
        session.phase = Phase::Live { slot, watches };
        session.avatars.clone_from(&avatars);
        session.heard_at = now;
        session.name = hello.name.clone();
        session.role = hello.role;
        let (client, subject) = (session.client, permit.subject.clone());
        session.permit = permit;
        self.welcome(id, Continuity::New, Vec::new());
        self.announcements.came.extend(&avatars);
        self.stats.admitted += 1;
        self.note(WorldEvent::Joined { client, name: hello.name, subject, avatars });
    }

    /// Which session a token to come back with is of.
    fn whose(&self, resume: &Resume, permit: &Permit) -> Option<SessionId> {
        let is_it = |session: &Session| {
            session.may_return(self.config.resume_grace)
                && (session.caller.resume == resume.token || session.resume_before == Some(resume.token))
                && !session.is_refused
                && matches!(session.phase, Phase::Live { .. })
                // Another's token, or a rank that was lost, is not made good by having been here.
                && session.permit.is_like(permit)
        };
        self.sessions.iter().find(|(_, session)| is_it(session)).map(|(&id, _)| id)
    }

    /// `old` goes on as `id`.
    fn readmit(&mut self, id: SessionId, old: SessionId, resume: Resume, permit: Permit, now: WorldTime) {
        let (Some(mut session), Some(fresh)) = (self.sessions.remove(&old), self.sessions.remove(&id)) else { return };
        let Phase::Live { slot, watches } = session.phase else { return };
        // It may have come with a newer token; the one that it has shown now is the one that counts.
        session.permit = permit;
        if session.away_since.is_none() {
            let reason = "you have come back over another connection".to_owned();
            let message = ServerControl::Refused { refusal: Refusal::Replaced, reason: reason.clone() };
            self.out.push_back((old, Transmit::Control(codec::encode_control(&message).into())));
            self.out.push_back((old, Transmit::Close(reason)));
        }
        session.take_over(fresh, now, self.policy.tracking());
        self.validity.forget(old);
        for object in session.avatars.iter().chain(&session.things) {
            let entry = &mut self.objects[object.index()];
            (entry.owner, entry.wanted_seq) = (Some(id), 0);
        }
        let RosterMark { pieces, announced_from } = session.roster;
        let kept = resume.heard.filter(|_| watches).and_then(|heard| heard.checked_sub(pieces));
        let missed = kept.and_then(|heard| self.announcements.since(announced_from + u64::from(heard)));
        let client = session.client;
        if missed.is_none() {
            session.forget_all();
            // It does not know any more what it held.
            for thing in std::mem::take(&mut session.things) {
                let entry = &mut self.objects[thing.index()];
                (entry.owner, entry.wanted) = (None, None);
            }
            for object in &mut self.objects {
                object.forget_holder(slot);
            }
        }
        let things = session.things.clone();
        self.sessions.insert(id, session);
        let continuity = if missed.is_some() { Continuity::Kept } else { Continuity::Returned };
        self.welcome(id, continuity, missed.unwrap_or_default());
        // What it said of them last may have got lost.
        for object in things {
            self.say(id, &ServerControl::Held { object, hold: Hold::Yours });
        }
        self.stats.resumed += 1;
        self.note(WorldEvent::Returned { client });
    }

    /// Says welcome, and then `missed`, or the whole roster unless the client kept its own.
    fn welcome(&mut self, id: SessionId, continuity: Continuity, missed: Vec<Arc<[u8]>>) {
        let Some(session) = self.sessions.get(&id) else { return };
        let Phase::Live { slot, watches } = session.phase else { return };
        // The newcomer learns of everything but its own; who came in this tick is announced with it.
        let others: Vec<ObjectId> = if watches && continuity != Continuity::Kept {
            let is_new = |id: &ObjectId| session.avatars.contains(id) || self.announcements.came.contains(id);
            let all = (0..self.objects.len() as u32).map(ObjectId);
            all.filter(|id| self.objects[id.index()].alive && !is_new(id)).collect()
        } else {
            Vec::new()
        };
        let place = |&avatar: &ObjectId| {
            let object = &self.objects[avatar.index()];
            (avatar, object.position, object.orientation)
        };
        let may_return = session.may_return(self.config.resume_grace);
        let grace = if may_return { self.config.resume_grace } else { std::time::Duration::ZERO };
        let welcome = Welcome {
            version: VERSION,
            client: session.client,
            avatars: session.avatars.iter().map(place).collect(),
            anchor: self.anchor.to_array(),
            tick_micros: self.config.tick.as_micros() as u32,
            answer_micros: self.config.answer_wait().as_micros() as u32,
            policy: self.policy.name().to_owned(),
            tracking: self.policy.tracking(),
            blur: self.config.blur,
            dead_reckoning_px: self.config.dead_reckoning_px,
            world: self.info.clone(),
            classes: self.classes.clone(),
            objects: others.len() as u32,
            rank: session.permit.rank,
            resume: session.caller.resume,
            grace_millis: u32::try_from(grace.as_millis()).unwrap_or(u32::MAX),
            continuity,
        };
        self.say(id, &ServerControl::Welcome(Box::new(welcome)));
        if continuity == Continuity::Kept {
            self.out.extend(missed.into_iter().map(|message| (id, Transmit::Control(message))));
            return;
        }
        let pieces = others.chunks(ServerControl::ROSTER_MAX);
        let mark = RosterMark { pieces: pieces.len() as u32, announced_from: self.announcements.next() };
        for piece in pieces {
            let message = self.roster(piece, &[slot]);
            self.stats.out.roster += piece.len() as u64;
            self.say(id, &message);
        }
        if let Some(session) = self.sessions.get_mut(&id) {
            session.roster = mark;
        }
    }

    /// Says something to one client, unless it is away.
    pub(super) fn say(&mut self, id: SessionId, message: &ServerControl) {
        if self.sessions.get(&id).is_some_and(|session| session.away_since.is_none()) {
            self.out.push_back((id, Transmit::Control(codec::encode_control(message).into())));
        }
    }

    /// Tells everybody who looks of those who came and left since the last tick. A client may hear of its own avatars here,
    /// which is no news to it: so all get the same bytes.
    pub(super) fn announce(&mut self) {
        let left = std::mem::take(&mut self.announcements.left);
        for piece in left.chunks(eyeline_protocol::AVATARS_MAX) {
            let message = codec::encode_control(&ServerControl::Left { objects: piece.to_vec() });
            self.announce_message(message.into(), piece.len());
        }
        let came = std::mem::take(&mut self.announcements.came);
        if came.is_empty() {
            return;
        }
        let watching: Vec<usize> = self
            .sessions
            .values()
            .filter_map(|session| match session.phase {
                Phase::Live { slot, watches: true } => Some(slot),
                _ => None,
            })
            .collect();
        for piece in came.chunks(ServerControl::ROSTER_MAX) {
            let message = codec::encode_control(&self.roster(piece, &watching));
            self.announce_message(message.into(), piece.len());
        }
    }

    fn announce_message(&mut self, message: Arc<[u8]>, objects: usize) {
        for (&id, session) in &self.sessions {
            if matches!(session.phase, Phase::Live { watches: true, .. }) && session.away_since.is_none() {
                self.out.push_back((id, Transmit::Control(message.clone())));
                self.stats.out.roster += objects as u64;
            }
        }
        self.announcements.push(message);
    }

    /// Entries for these objects, for the clients in `slots`; with bounds, if the policy lets clients track.
    fn roster(&mut self, ids: &[ObjectId], slots: &[usize]) -> ServerControl {
        let mut entries = Vec::with_capacity(ids.len());
        for &id in ids {
            let is_told = self.policy.tracking() && self.objects[id.index()].present;
            let bound = if is_told { self.wire_bound(id) } else { None };
            if bound.is_some() {
                // Its owner is told, too, with the same bytes, but holds no bound of its own avatar.
                let own = self.objects[id.index()].owner.and_then(|owner| self.sessions.get(&owner));
                let own = own.filter(|session| session.avatars.contains(&id)).and_then(|session| session.phase.slot());
                for &slot in slots.iter().filter(|&&slot| Some(slot) != own) {
                    self.objects[id.index()].note_holder(slot);
                }
            }
            let object = &self.objects[id.index()];
            entries.push(RosterEntry {
                object: id,
                class: object.class,
                name: object.name.clone(),
                node: object.node.clone(),
                bound,
                issue: object.issue,
                present: object.present,
            });
        }
        ServerControl::Roster { tick: self.tick, entries }
    }

    fn spawn_avatar(&mut self, owner: SessionId, present: bool, name: Option<String>) -> ObjectId {
        let spawns = &self.spec.spawns;
        let (feet, heading) = match spawns.get(self.spawned % spawns.len().max(1)) {
            Some(spawn) => (DVec3::from_array(spawn.position), spawn.heading),
            None => (self.anchor + self.config.default_spawn, 0.0),
        };
        self.spawned += 1;
        // The specification's spawns were checked when the world was made.
        let position = Position::from_metres(feet - self.anchor).unwrap_or_default();
        let id = self.free.pop().unwrap_or_else(|| {
            self.objects.push(Object::new(String::new(), AVATAR_CLASS, position, self.tick));
            ObjectId(self.objects.len() as u32 - 1)
        });
        let tick = self.tick;
        let object = &mut self.objects[id.index()];
        let issue = eyeline_protocol::Issue(object.issue.0 + 1);
        let name = name.unwrap_or_else(|| format!("avatar {}", id.0));
        *object = Object::new(name, AVATAR_CLASS, position, tick);
        object.orientation = Orientation::from_yaw(heading);
        object.issue = issue;
        object.owner = Some(owner);
        object.present = present;
        id
    }
}

/// The longest name of an avatar. Everybody is told of it, and who chose it pays for none of that; twice what viewers write over heads.
const CALLED_BYTES_MAX: usize = 48;

/// What the avatar of somebody who came under this name is called in rosters; the later ones of an actor are numbered from 2. `None` for who
/// gave no name. What is too long is cut, before the number.
fn called(name: &str, number: usize) -> Option<String> {
    let name = name.trim();
    if name.is_empty() {
        return None;
    }
    let suffix = if number == 0 { String::new() } else { format!(" {}", number + 1) };
    let end =
        (0..=name.len()).rev().find(|&end| name.is_char_boundary(end) && end + suffix.len() <= CALLED_BYTES_MAX)?;
    Some(format!("{}{suffix}", &name[..end]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn avatars_are_called_as_who_came() {
        assert_eq!(called("Ada", 0).as_deref(), Some("Ada"));
        assert_eq!(called(" Ada ", 2).as_deref(), Some("Ada 3"));
        assert_eq!([called("", 0), called(" \t", 1)], [None, None]);
        // Wherever a letter would be cut.
        for letter in ["a", "é", "🦀"] {
            let long = letter.repeat(255 / letter.len());
            for number in [0, 1, 4_095] {
                let called = called(&long, number).unwrap();
                assert!(called.len() <= CALLED_BYTES_MAX && called.starts_with(letter), "{called}");
                assert_eq!(called.ends_with(&format!(" {}", number + 1)), number > 0);
            }
        }
    }
}
