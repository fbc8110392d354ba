//! How much may one client ask for, and what does it cost at most to be asked for more?
//!
//! Each session has a [`Meter`]: a token bucket for each kind of thing that can be asked too often, on the world's time, so
//! that it is the same in virtual time. What is over a limit is dropped and counted, before it is decoded where that can be.
//! Who goes on and on is sent away ([`eyeline_protocol::Refusal::Busy`]): a packet costs QUIC more to open than the world to
//! drop, and only an end of the connection ends that.
//!
//! An honest client at 60 Hz never meets a limit, not even when all objects come into view at once; each is therefore a
//! multiple of what it needs, and grows with what it has (avatars) and what there is (objects, N below).
//!
//! | a hostile client's | costs at most | by |
//! |---|---|---|
//! | datagram over the limit | one look-up of its session and two buckets; it is not decoded | [`Limits::datagrams`], [`Limits::bytes`] |
//! | datagram of requests | as many set entries and answers as it has records: at most 240, a state of at most 29 bytes each (5 times its own bytes), 2,048 + 4 N a second | [`Limits::requests`] |
//! | datagram of poses | one overwritten pose a record; the newest counts, once a tick | [`Limits::poses`] |
//! | lying acknowledgement | the states that were under way are due once more: at most those in its sight, at the next tick if over the limit | [`Limits::resends`] |
//! | message on the control stream | decoding at most 1.4 KB | [`Limits::control`] |
//! | teleport | one violation to each who may hold the avatar's bound, once a tick however often it is said | [`Limits::places`] |
//! | payload | one copy of at most 1 KB to each who is told of its object | [`Limits::payloads`] |
//! | wish for the world | one copy of the model, one at a time | [`Limits::worlds`] |
//! | all of it together | per object one entry in each of six sets and maps, and 256 datagrams whose fate is unknown | sets, not queues |
//!
//! `limits_tests` and `tests/it/floods.rs` hold the table to it, in counts, not in time. What comes before a session, and so
//! before this, is [`crate::net`]'s matter: addresses, handshakes, connections.

use eyeline_protocol::{ClientControl, ClientRecord, WorldTime};

/// Something that can be asked too often.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Limited {
    /// Datagrams.
    Datagrams,
    /// Bytes of datagrams and of control messages.
    Bytes,
    /// Poses and eyes.
    Poses,
    /// Requests, releases, acknowledged violations.
    Requests,
    /// States that are due again because the client says that they got lost.
    Resends,
    /// Control messages.
    Control,
    /// Teleports, coming and going.
    Places,
    /// Things taken and let go.
    Things,
    /// Payloads.
    Payloads,
    /// Commands of operators.
    Commands,
    /// Copies of the world's model.
    Worlds,
}

impl Limited {
    /// Number of kinds.
    pub const COUNT: usize = 11;

    /// All kinds.
    pub const ALL: [Limited; Limited::COUNT] = [
        Limited::Datagrams,
        Limited::Bytes,
        Limited::Poses,
        Limited::Requests,
        Limited::Resends,
        Limited::Control,
        Limited::Places,
        Limited::Things,
        Limited::Payloads,
        Limited::Commands,
        Limited::Worlds,
    ];

    /// Its name in metrics and settings.
    pub fn name(self) -> &'static str {
        match self {
            Limited::Datagrams => "datagrams",
            Limited::Bytes => "bytes",
            Limited::Poses => "poses",
            Limited::Requests => "requests",
            Limited::Resends => "resends",
            Limited::Control => "control",
            Limited::Places => "places",
            Limited::Things => "things",
            Limited::Payloads => "payloads",
            Limited::Commands => "commands",
            Limited::Worlds => "worlds",
        }
    }

    /// What a record counts towards.
    pub fn of_record(record: &ClientRecord) -> Limited {
        match record {
            ClientRecord::Pose { .. } | ClientRecord::Eye { .. } => Limited::Poses,
            ClientRecord::Request { .. } | ClientRecord::Release { .. } | ClientRecord::ViolationAck { .. } => {
                Limited::Requests
            }
        }
    }

    /// What a control message counts towards, besides [`Limited::Control`].
    pub fn of_control(message: &ClientControl) -> Option<Limited> {
        match message {
            ClientControl::Hello { .. } | ClientControl::Goodbye => None,
            ClientControl::WorldWanted => Some(Limited::Worlds),
            ClientControl::Place { .. } => Some(Limited::Places),
            ClientControl::Take { .. } | ClientControl::LetGo { .. } => Some(Limited::Things),
            ClientControl::Payload { .. } => Some(Limited::Payloads),
            ClientControl::Command(_) => Some(Limited::Commands),
        }
    }
}

/// How much was dropped, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitCounts([u64; Limited::COUNT]);

impl LimitCounts {
    /// Of one kind: so many datagrams, records or messages; of [`Limited::Resends`], those that had to wait for a tick.
    pub fn of(&self, kind: Limited) -> u64 {
        self.0[kind as usize]
    }

    /// Of every kind.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }
}

/// A limit: a token bucket's two numbers, for a client of one avatar in a world without objects, and what more there is for
/// each avatar and object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// So many a second in the long run.
    pub per_second: f64,
    /// So many at once.
    pub burst: f64,
    /// For each avatar but the first, this share of both more.
    pub avatar: f64,
    /// For each object in the world, this share of both more.
    pub object: f64,
}

impl Rate {
    /// So many a second, and so many at once, whatever there is.
    pub const fn new(per_second: f64, burst: f64) -> Rate {
        Rate { per_second, burst, avatar: 0.0, object: 0.0 }
    }

    /// For each avatar but the first, this share more.
    pub const fn per_avatar(self, avatar: f64) -> Rate {
        Rate { avatar, ..self }
    }

    /// For each object, this share more.
    pub const fn per_object(self, object: f64) -> Rate {
        Rate { object, ..self }
    }

    /// No limit.
    pub const fn unlimited() -> Rate {
        Rate::new(f64::INFINITY, f64::INFINITY)
    }
}

/// The limits of one client. Units are datagrams, bytes, records or messages.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// Datagrams; default 480 a second, 960 at once: eight a frame at 60 Hz.
    pub datagrams: Rate,
    /// Bytes; default 256 KiB a second, 512 KiB at once. A client at 60 Hz sends 3 KB a second, and 6 more for each 1,000
    /// objects that it asks about.
    pub bytes: Rate,
    /// Poses; default 240 a second and avatar: four times 60 Hz.
    pub poses: Rate,
    /// Requests; default 2,048 and 4 an object a second, twice that at once: a client may ask about everything eight times in
    /// a row.
    pub requests: Rate,
    /// States due again since they are said to have got lost; default as many as requests. A fifth of 1,000 states at 20 Hz
    /// is 4,000 a second. Over it they wait for the next tick.
    pub resends: Rate,
    /// Control messages; default 32 a second, 256 at once.
    pub control: Rate,
    /// Teleports, coming and going; default 4 a second and avatar, 16 at once.
    pub places: Rate,
    /// Things taken and let go; default 8 a second, 32 at once.
    pub things: Rate,
    /// Payloads; default 8 a second, 32 at once. Each is copied to everybody who is told of its object.
    pub payloads: Rate,
    /// Commands; default 8 a second, 32 at once.
    pub commands: Rate,
    /// Copies of the model; default 2 at once, then one in 30 s.
    pub worlds: Rate,
    /// Datagrams and messages over a limit that are borne before the client is sent away; default 2,048, and 64 more a
    /// second. Greater bears more of what a clock that jumped makes a client say, and floods for longer.
    pub patience: Rate,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            datagrams: Rate::new(480.0, 960.0).per_avatar(1.0 / 30.0),
            bytes: Rate::new(262_144.0, 524_288.0).per_avatar(1.0 / 30.0),
            poses: Rate::new(240.0, 480.0).per_avatar(1.0),
            requests: Rate::new(2_048.0, 4_096.0).per_object(1.0 / 512.0),
            resends: Rate::new(2_048.0, 4_096.0).per_object(1.0 / 512.0),
            control: Rate::new(32.0, 256.0).per_avatar(0.125),
            places: Rate::new(4.0, 16.0).per_avatar(1.0),
            things: Rate::new(8.0, 32.0),
            payloads: Rate::new(8.0, 32.0),
            commands: Rate::new(8.0, 32.0),
            worlds: Rate::new(1.0 / 30.0, 2.0),
            patience: Rate::new(64.0, 2_048.0),
        }
    }
}

impl Limits {
    /// No limits at all: for simulations of what no honest client does.
    pub fn unlimited() -> Limits {
        let none = Rate::unlimited();
        Limits {
            datagrams: none,
            bytes: none,
            poses: none,
            requests: none,
            resends: none,
            control: none,
            places: none,
            things: none,
            payloads: none,
            commands: none,
            worlds: none,
            patience: none,
        }
    }

    /// The limit of one kind.
    pub fn rate(&self, kind: Limited) -> Rate {
        match kind {
            Limited::Datagrams => self.datagrams,
            Limited::Bytes => self.bytes,
            Limited::Poses => self.poses,
            Limited::Requests => self.requests,
            Limited::Resends => self.resends,
            Limited::Control => self.control,
            Limited::Places => self.places,
            Limited::Things => self.things,
            Limited::Payloads => self.payloads,
            Limited::Commands => self.commands,
            Limited::Worlds => self.worlds,
        }
    }

    /// Sets the limit of one kind.
    pub fn with_rate(mut self, kind: Limited, rate: Rate) -> Limits {
        *match kind {
            Limited::Datagrams => &mut self.datagrams,
            Limited::Bytes => &mut self.bytes,
            Limited::Poses => &mut self.poses,
            Limited::Requests => &mut self.requests,
            Limited::Resends => &mut self.resends,
            Limited::Control => &mut self.control,
            Limited::Places => &mut self.places,
            Limited::Things => &mut self.things,
            Limited::Payloads => &mut self.payloads,
            Limited::Commands => &mut self.commands,
            Limited::Worlds => &mut self.worlds,
        } = rate;
        self
    }

    /// Sets what is borne of a client that goes on and on.
    pub fn with_patience(self, patience: Rate) -> Limits {
        Limits { patience, ..self }
    }
}

/// What a limit grows with.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Size {
    /// Avatars of the client.
    pub avatars: usize,
    /// Objects in the world.
    pub objects: usize,
}

/// A token bucket that knows neither its size nor its rate: they are the world's.
#[derive(Clone, Copy, Debug, Default)]
struct Bucket {
    /// What was taken and has not flowed back.
    taken: f64,
    at: WorldTime,
}

impl Bucket {
    /// Takes `units`, if there are as many.
    fn take(&mut self, units: f64, rate: Rate, size: Size, now: WorldTime) -> bool {
        let share = 1.0 + rate.avatar * size.avatars.saturating_sub(1) as f64 + rate.object * size.objects as f64;
        let (per_second, burst) = (rate.per_second * share, rate.burst * share);
        // A clock that stands still gives nothing back; 0 · ∞ is nothing too.
        let elapsed = now.seconds_since(self.at).max(0.0);
        let back = if elapsed > 0.0 { per_second * elapsed } else { 0.0 };
        self.taken = (self.taken - back).max(0.0);
        self.at = self.at.max(now);
        let fits = self.taken + units <= burst;
        if fits {
            self.taken += units;
        }
        fits
    }
}

/// What one client has asked for of late.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Meter {
    buckets: [Bucket; Limited::COUNT],
    patience: Bucket,
    /// Whether patience has come to its end.
    pub is_spent: bool,
}

impl Meter {
    /// Whether the client may have `units` of this kind now. Takes them if so, and counts if not.
    pub fn take(
        &mut self,
        (kind, units): (Limited, usize),
        limits: &Limits,
        size: Size,
        now: WorldTime,
        counts: &mut LimitCounts,
    ) -> bool {
        let fits = self.buckets[kind as usize].take(units as f64, limits.rate(kind), size, now);
        counts.0[kind as usize] += u64::from(!fits);
        fits
    }

    /// The same for several kinds at once, of a datagram or message that is dropped whole if one of them is over its limit.
    pub fn admit(
        &mut self,
        wanted: &[(Limited, usize)],
        limits: &Limits,
        size: Size,
        now: WorldTime,
        counts: &mut LimitCounts,
    ) -> bool {
        let fits = wanted.iter().all(|&want| self.take(want, limits, size, now, counts));
        if !fits {
            self.bear(limits, now);
        }
        fits
    }

    /// Something was over a limit, however much of it: one datagram, one message. Too many, and the client is to go.
    pub fn bear(&mut self, limits: &Limits, now: WorldTime) {
        self.is_spent |= !self.patience.take(1.0, limits.patience, Size::default(), now);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const NOW: WorldTime = WorldTime::ZERO;
    const NONE: Size = Size { avatars: 1, objects: 0 };

    fn at(millis: u64) -> WorldTime {
        NOW + Duration::from_millis(millis)
    }

    /// How many of `asked` single ones pass at `now`.
    fn passed(meter: &mut Meter, kind: Limited, asked: usize, size: Size, now: WorldTime) -> usize {
        let (limits, mut counts) = (Limits::default(), LimitCounts::default());
        let passed = (0..asked).filter(|_| meter.take((kind, 1), &limits, size, now, &mut counts)).count();
        assert_eq!(counts.of(kind) as usize, asked - passed);
        assert_eq!(counts.total(), counts.of(kind));
        passed
    }

    #[test]
    fn a_burst_passes_then_what_the_rate_allows() {
        let mut meter = Meter::default();
        assert_eq!(passed(&mut meter, Limited::Datagrams, 5_000, NONE, at(0)), 960);
        assert_eq!(passed(&mut meter, Limited::Datagrams, 5_000, NONE, at(100)), 48);
        assert_eq!(passed(&mut meter, Limited::Datagrams, 5_000, NONE, at(600_000)), 960, "no more is saved up");
        // Another kind has a bucket of its own.
        assert_eq!(passed(&mut meter, Limited::Poses, 5_000, NONE, at(600_000)), 480);
    }

    #[test]
    fn limits_grow_with_what_there_is() {
        let many = Size { avatars: 100, objects: 0 };
        assert_eq!(passed(&mut Meter::default(), Limited::Poses, 100_000, many, at(0)), 48_000);
        let full = Size { avatars: 1, objects: 1_024 };
        assert_eq!(passed(&mut Meter::default(), Limited::Requests, 100_000, full, at(0)), 4_096 + 8 * 1_024);
        let nobody = Size { avatars: 0, objects: 0 };
        assert_eq!(passed(&mut Meter::default(), Limited::Poses, 1_000, nobody, at(0)), 480, "a viewer is limited too");
    }

    #[test]
    fn what_does_not_fit_takes_nothing() {
        let (limits, mut counts, mut meter) = (Limits::default(), LimitCounts::default(), Meter::default());
        let mut take = |units| meter.take((Limited::Bytes, units), &limits, NONE, at(0), &mut counts);
        assert!(!take(524_289) && take(524_288) && !take(1));
        assert_eq!(counts.of(Limited::Bytes), 2);
    }

    #[test]
    fn a_clock_that_runs_backwards_or_leaps_breaks_nothing() {
        let mut meter = Meter::default();
        assert_eq!(passed(&mut meter, Limited::Control, 1_000, NONE, at(10_000)), 256);
        assert_eq!(
            passed(&mut meter, Limited::Control, 1_000, NONE, at(0)),
            0,
            "time that has passed already counts once"
        );
        assert_eq!(passed(&mut meter, Limited::Control, 1_000, NONE, at(11_000)), 32);
        assert_eq!(passed(&mut meter, Limited::Control, 1_000, NONE, WorldTime::MAX), 256);
        assert_eq!(passed(&mut meter, Limited::Control, 1_000, NONE, WorldTime::MAX), 0);
    }

    #[test]
    fn patience_ends_and_only_for_who_goes_on() {
        let limits = Limits::default();
        let mut slow = Meter::default();
        let mut flood = Meter::default();
        for second in 0..600 {
            (0..64).for_each(|_| slow.bear(&limits, at(1_000 * second)));
        }
        assert!(!slow.is_spent, "64 a second are borne for ever");
        let borne = (0..5_000).take_while(|_| {
            flood.bear(&limits, at(0));
            !flood.is_spent
        });
        assert_eq!(borne.count(), 2_048);
    }

    #[test]
    fn without_limits_everything_passes() {
        let (limits, mut counts, mut meter) = (Limits::unlimited(), LimitCounts::default(), Meter::default());
        for kind in Limited::ALL {
            for now in [at(0), at(0), at(1)] {
                assert!(meter.take((kind, usize::MAX), &limits, NONE, now, &mut counts), "{}", kind.name());
            }
        }
        meter.bear(&limits, at(1));
        assert!(!meter.is_spent);
    }

    #[test]
    fn every_kind_has_its_own_place_and_rate() {
        for (index, kind) in Limited::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, index);
            let limits = Limits::default().with_rate(kind, Rate::new(1.0, 2.0));
            assert_eq!(limits.rate(kind), Rate::new(1.0, 2.0));
            let others = Limited::ALL.into_iter().filter(|&other| other != kind);
            assert!(others.into_iter().all(|other| limits.rate(other) == Limits::default().rate(other)));
        }
    }
}
