//! Many clients among walls, everything made from a seed.

use std::sync::Arc;
use std::time::Duration;

use eyeline_client::session::SessionConfig;
use eyeline_client::tracking::{Growth, Lead, Sabotage, TrackerConfig};
use eyeline_protocol::{Role, WorldInfo, WorldTime};
use eyeline_server::policy::{Broadcast, Policy, Visible};
use eyeline_server::spec::{ClassSpec, ObjectSpec, PathSpec, SpawnSpec, SpringSpec, WorldSpec};
use eyeline_server::world::{Answers, World, WorldConfig};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::checks::Checks;
use super::failures::Failures;
use super::heard::{Heard, Secrecy};
use super::index::IndexView;
use super::mutant::{Mutant, Places};
use super::sight::Ground;
use super::truth::{Allowance, Truth};
use super::walk::{Board, Walk, free_place};
use super::walker::{Crowd, Walker};
use super::walls::{Wall, Walls};
use crate::virtual_net::{ClientPlan, LinkRules, VirtualRun};

/// What a town is like.
#[derive(Clone, Debug)]
pub struct TownRules {
    /// Decides everything else.
    pub seed: u64,
    /// The clients' links.
    pub link: LinkRules,
    /// Clients that walk and look.
    pub clients: usize,
    /// Avatars of an actor, which walk.
    pub crowd: u16,
    /// Objects with a path.
    pub carts: usize,
    /// Greatest pace error of a client's clock, as a share.
    pub drift: f64,
    /// Share of an avatar's frames at which it teleports.
    pub teleports: f64,
    /// Share of a crowd avatar's frames at which it leaves the world.
    pub away: f64,
    /// Time for which a bound holds at most.
    pub validity_max: Duration,
    /// Who chooses validity periods.
    pub growth: Growth,
    /// Greatest lateness of a tick.
    pub lateness: Duration,
    /// When the server answers requests.
    pub answers: Answers,
    /// How fast clients walk, m/s. An avatar's speed limit is 2 m/s.
    pub walk_speed: f64,
    /// Pixels a side of the faces that clients cull on; `None` to cull by geometry in plan, which is quick.
    pub image_side: Option<u32>,
    /// Share of the avatars that do all they can to be hard to follow.
    pub adversarial: f64,
    /// How far ahead clients look.
    pub lead: Lead,
    /// Whether everything is told to everybody, instead of what is asked for.
    pub broadcast: bool,
    /// Share of the promised room that hidden objects must be left; 1 in earnest.
    pub room_share: f64,
    /// Damage to the trackers.
    pub sabotage: Option<Sabotage>,
    /// Damage to anything.
    pub mutant: Option<Mutant>,
}

impl TownRules {
    /// Four to six clients, 44 movers beside them, images of 64 pixels a side, and a link that the seed decides.
    pub fn seeded(seed: u64) -> TownRules {
        let mut chance = Pcg64::seed_from_u64(seed ^ 0x7057_1e55);
        let millis = |chance: &mut Pcg64, most: u64| Duration::from_micros(chance.random_range(0..=most * 1_000));
        // A third each: a perfect local link; one that only delays; one with all that can go wrong.
        let kind = chance.random_range(0..3);
        let delay = millis(&mut chance, if kind == 0 { 5 } else { 80 });
        let mut link = LinkRules::default().with_delay(delay);
        if kind > 0 {
            link.jitter = millis(&mut chance, 30);
            link.duplicate = chance.random_range(0.0..0.05);
            link.reorder = chance.random_range(0.0..0.1);
        }
        if kind == 2 {
            link.loss = chance.random_range(0.01..0.12);
        }
        TownRules {
            seed,
            link,
            clients: chance.random_range(4..=6),
            crowd: 20,
            carts: 24,
            drift: if chance.random_bool(0.5) { 5e-4 } else { 0.0 },
            teleports: if chance.random_bool(0.5) { 0.002 } else { 0.0 },
            away: if chance.random_bool(0.5) { 0.003 } else { 0.0 },
            validity_max: Duration::from_millis(chance.random_range(800..20_000)),
            growth: if chance.random_bool(0.25) {
                Growth::FixedPeriod(Duration::from_millis(chance.random_range(200..2_000)))
            } else {
                Growth::AtClient
            },
            lateness: Duration::ZERO,
            // Without a draw, so that every other town is what it was.
            answers: if seed % 8 == 6 { Answers::Tick } else { Answers::Arrival },
            walk_speed: chance.random_range(0.5..2.0),
            image_side: Some(64),
            adversarial: 1.0 / 3.0,
            lead: if chance.random_bool(0.5) { Lead::Auto } else { Lead::None },
            broadcast: false,
            room_share: 1.0,
            sabotage: None,
            mutant: None,
        }
    }
}

/// Half the side of the town's square, metres.
const HALF: f64 = 18.0;

/// A town that runs.
pub struct Town {
    /// The run.
    pub run: VirtualRun,
    /// What is known to be wrong with it.
    pub truth: Truth,
    /// What is known to be wrong with what clients are told.
    pub heard: Heard,
    rules: TownRules,
    places: Places,
    ground: Ground,
    board: Board,
    chance: Pcg64,
}

impl Town {
    /// Builds the town; its clients join in the first 200 ms.
    pub fn new(mut rules: TownRules) -> Town {
        if let Some(mutant) = rules.mutant {
            mutant.prepare(&mut rules);
        }
        let mut chance = Pcg64::seed_from_u64(rules.seed);
        let walls = Arc::new(walls(&mut chance));
        let mut config = WorldConfig::default().with_grid_seed(rules.seed);
        config.validity_max = rules.validity_max;
        config.answers = rules.answers;
        let secrecy = Secrecy { blur: config.blur, validity_max: rules.validity_max, datagram_limit: 1150 };
        let spec = spec(&walls, &mut chance, rules.carts);
        let start = WorldTime::from_micros(0);
        let info = WorldInfo { name: "town".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let policy: Box<dyn Policy> = if rules.broadcast { Box::new(Broadcast) } else { Box::new(Visible) };
        let world = World::new(config, spec, info, DVec3::ZERO, policy, start).expect("towns are well made");
        let mut run = VirtualRun::new(world, rules.seed, start);
        if rules.lateness > Duration::ZERO {
            let mut late = Pcg64::seed_from_u64(rules.seed ^ 0x1a7e);
            let most = rules.lateness.as_micros() as u64;
            // Often on time, sometimes by several ticks.
            run.set_lateness(move |_| {
                Duration::from_micros(if late.random_bool(0.3) { late.random_range(0..most) } else { 0 })
            });
        }
        let ground = match rules.image_side {
            Some(side) => Ground::with_images(walls.clone(), side),
            None => Ground::in_plan(walls.clone()),
        };
        let truth = Truth::new(walls.clone());
        let heard = Heard::new(walls, secrecy, rules.room_share);
        let places = Places::default();
        if let Some(mutant) = rules.mutant {
            run.intercept(mutant.liar(rules.seed, places.clone()));
        }
        let mut town = Town { run, truth, heard, rules, places, ground, board: Board::default(), chance };
        town.join_crowd();
        for _ in 0..town.rules.clients {
            town.join();
            town.run_for(Duration::from_millis(30));
        }
        town
    }

    fn join_crowd(&mut self) {
        let count = self.rules.crowd;
        if count == 0 {
            return;
        }
        let walks = (0..count).map(|_| self.walk(1.6, None)).collect();
        let session = SessionConfig::default().with_role(Role::Actor { avatars: count });
        let plan = ClientPlan::new(session, self.rules.link);
        let driver = Crowd::new(walks, self.rules.teleports, self.rules.away);
        self.run.join(plan, Box::new(driver), IndexView::default().maker());
    }

    /// A walk; `own` is its entry on the board, if it has eyes.
    fn walk(&mut self, speed: f64, own: Option<usize>) -> Walk {
        let place = free_place(&self.ground.walls, &mut self.chance, HALF);
        let walk = Walk::new(self.ground.walls.clone(), self.chance.random(), place, speed, HALF);
        let is_adversarial = self.chance.random_bool(self.rules.adversarial);
        if is_adversarial { walk.adversarial(self.board.clone(), own) } else { walk }
    }

    /// Another client joins, now; returns its number.
    pub fn join(&mut self) -> usize {
        let tracker = TrackerConfig::default()
            .with_growth(self.rules.growth)
            .with_lead(self.rules.lead)
            .with_sabotage(self.rules.sabotage);
        let expects_lead = self.rules.lead != Lead::None || self.rules.mutant == Some(Mutant::LeadForgotten);
        let session = SessionConfig::default().with_tracker(tracker);
        let drift = if self.chance.random_bool(0.5) { self.rules.drift } else { -self.rules.drift };
        let plan = ClientPlan::new(session, self.rules.link).with_drift(drift);
        let waits = match self.run.world().answer_wait() {
            Duration::ZERO => Duration::ZERO,
            tick => tick + self.rules.lateness,
        };
        let allowance = Allowance::of(plan.up, plan.down).with_answer_wait(waits).with_lead(expects_lead);
        let entry = self.board.enter();
        let walk = self.walk(self.rules.walk_speed, Some(entry));
        let driver = Walker::new(&self.ground, walk, self.rules.teleports, self.board.clone(), entry);
        let view = IndexView::default();
        let client = self.run.join(plan, Box::new(driver), view.maker());
        self.truth.watch(client, view, allowance);
        self.heard.watch(client);
        client
    }

    /// A client's connection is cut.
    pub fn leave(&mut self, client: usize) {
        self.run.cut(client);
    }

    /// What it is like.
    pub fn rules(&self) -> &TownRules {
        &self.rules
    }

    /// Lets time pass.
    pub fn run_for(&mut self, span: Duration) {
        self.run.run_for(span, &mut Checks { truth: &mut self.truth, heard: &mut self.heard, places: &self.places });
    }

    /// Everything that was wrong.
    pub fn failures(&self) -> Failures {
        let mut failures = self.truth.failures.clone();
        failures.extend(&self.heard.failures);
        failures
    }
}

/// Walls of all lengths, 0.2 m thick, along both axes.
fn walls(chance: &mut Pcg64) -> Walls {
    let walls = (0..16)
        .map(|i| {
            // Even corners are exact in f32, so that triangles are where the truth has walls.
            let mut even = |low: f64, high: f64| (chance.random_range(low..high) * 64.0).round() / 64.0;
            let (x, z) = (even(-HALF, HALF), even(-HALF, HALF));
            let (long, thick) = (even(3.0, 14.0), 13.0 / 64.0);
            if i % 2 == 0 { Wall::new(x, z, x + long, z + thick) } else { Wall::new(x, z, x + thick, z + long) }
        })
        .collect();
    Walls { walls }
}

fn spec(walls: &Walls, chance: &mut Pcg64, carts: usize) -> WorldSpec {
    let cart = ClassSpec { name: "cart".into(), radius: 0.4, bottom: 0.0, top: 1.0, speed_max: 3.0 };
    let objects = (0..carts)
        .map(|i| {
            let points: Vec<[f64; 3]> =
                (0..chance.random_range(2..5)).map(|_| free_place(walls, chance, HALF).to_array()).collect();
            let mut path = PathSpec {
                speed: chance.random_range(0.3..2.0),
                pause: chance.random_range(0.0..2.0),
                phase: chance.random_range(0.0..1.0),
                wobble: if chance.random_bool(0.3) { 0.1 } else { 0.0 },
                wobble_per_metre: 1.0,
                points,
                // Every third hangs on its path by a spring: stiff, soft, swinging or slow.
                spring: (i % 3 == 2).then(|| SpringSpec {
                    time_constant: [1e-6, 0.05, 0.5, 30.0][i / 3 % 4],
                    damping: [1.0, 0.1, 0.0, 4.0][i / 3 % 4],
                    wall: None,
                }),
            };
            if path.wobble > 0.0 {
                // With its swing it must keep within its class's speed.
                path.speed = path.speed.min(1.8);
            }
            let position = path.points[0];
            ObjectSpec {
                name: format!("cart {i}"),
                class: "cart".into(),
                node: None,
                position,
                heading: 0.0,
                takeable: false,
                path: Some(path),
            }
        })
        .collect();
    let spawns =
        (0..8).map(|_| SpawnSpec { position: free_place(walls, chance, HALF).to_array(), heading: 0.0 }).collect();
    WorldSpec { spawns, classes: vec![cart], objects, ..WorldSpec::default() }
}
