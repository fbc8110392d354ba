//! A few people and a crowd among fixed walls, over any transport: for what a pair is too small for and a town too random.

use std::sync::Arc;
use std::time::Duration;

use eyeline_client::session::SessionConfig;
use eyeline_protocol::{Role, WorldInfo, WorldTime};
use eyeline_server::policy::Visible;
use eyeline_server::spec::{SpawnSpec, WorldSpec};
use eyeline_server::world::{World, WorldConfig};
use eyeline_sim::soak::{Allowance, Board, Crowd, Ground, IndexView, Truth, Walk, Walker, Wall, Walls};
use eyeline_sim::virtual_net::{Capacity, ClientPlan, Ignore, LinkRules, Observer, VirtualRun};
use glam::DVec3;

/// What a village is like.
#[derive(Clone)]
pub struct Rules {
    /// Decides who walks where, and what links do.
    pub seed: u64,
    /// Everybody's link; the crowd's loses nothing.
    pub link: LinkRules,
    /// What links carry.
    pub capacity: Capacity,
    /// Whether QUIC is between.
    pub is_quic: bool,
    /// How much faster than the server's the first person's clock runs, as a share.
    pub drift: f64,
}

impl Rules {
    /// A village over this link, without QUIC.
    pub fn new(seed: u64, link: LinkRules) -> Rules {
        Rules { seed, link, capacity: Capacity::default(), is_quic: false, drift: 0.0 }
    }

    /// The same over QUIC.
    pub fn over_quic(seed: u64, link: LinkRules) -> Rules {
        Rules { is_quic: true, ..Rules::new(seed, link) }
    }
}

/// People who look, by their number in the run. Client 0 is the crowd.
pub const PEOPLE: std::ops::RangeInclusive<usize> = 1..=4;

const CROWD: u16 = 12;
const HALF: f64 = 15.0;

/// A village that runs.
pub struct Village {
    pub run: VirtualRun,
    walls: Arc<Walls>,
    views: Vec<IndexView>,
    link: LinkRules,
}

impl Village {
    /// Everybody joins at once.
    pub fn new(rules: &Rules) -> Village {
        let walls = Arc::new(Walls {
            walls: vec![
                Wall::new(-12.0, -6.2, 4.0, -6.0),
                Wall::new(-2.0, 5.0, 13.0, 5.2),
                Wall::new(6.0, -12.0, 6.2, 2.0),
                Wall::new(-8.2, -3.0, -8.0, 12.0),
            ],
        });
        let place = |index: usize| {
            let (column, row) = (index % 4, index / 4);
            DVec3::new(-13.0 + 8.0 * column as f64, 0.0, -13.0 + 8.0 * row as f64)
        };
        let spawns = PEOPLE.map(|person| SpawnSpec { position: place(person - 1).to_array(), heading: 0.0 }).collect();
        let spec = WorldSpec { spawns, ..WorldSpec::default() };
        let info = WorldInfo { name: "village".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let start = WorldTime::from_micros(5_000_000);
        let config = WorldConfig::default().with_grid_seed(rules.seed);
        let world =
            World::new(config, spec, info, DVec3::ZERO, Box::new(Visible), start).expect("villages are well made");
        let mut run = match rules.is_quic {
            true => VirtualRun::over_quic(world, rules.seed, start).expect("TLS can be set up"),
            false => VirtualRun::new(world, rules.seed, start),
        };
        let walk = |number: usize, speed| {
            Walk::new(walls.clone(), rules.seed * 100 + number as u64, place(number % 16), speed, HALF)
        };
        let crowd = Crowd::new((0..usize::from(CROWD)).map(|number| walk(number + 4, 1.5)).collect(), 0.0, 0.0);
        let session = SessionConfig::default().with_role(Role::Actor { avatars: CROWD });
        let plan = ClientPlan::new(session, LinkRules { loss: 0.0, ..rules.link }).with_phase(Duration::ZERO);
        run.join(plan, Box::new(crowd), IndexView::default().maker());
        let (ground, board) = (Ground::in_plan(walls.clone()), Board::default());
        let mut views = Vec::new();
        for person in PEOPLE {
            let view = IndexView::default();
            let drift = if person == 1 { rules.drift } else { 0.0 };
            let plan = ClientPlan::new(SessionConfig::default(), rules.link)
                .with_phase(Duration::from_millis(11 * person as u64))
                .with_drift(drift)
                .with_capacity(rules.capacity.clone());
            let entry = board.enter();
            let walker = Walker::new(&ground, walk(person - 1, 1.3), 0.0, board.clone(), entry);
            assert_eq!(run.join(plan, Box::new(walker), view.maker()), person);
            views.push(view);
        }
        Village { run, walls, views, link: rules.link }
    }

    /// A checker of these people from now on. `slack` is what may be later than the link alone makes it.
    pub fn truth(&self, people: impl IntoIterator<Item = usize>, slack: Duration) -> Truth {
        let mut truth = Truth::new(self.walls.clone());
        let mut allowance = Allowance::of(self.link, self.link);
        allowance.up_max += slack;
        allowance.down_max += slack;
        for person in people {
            truth.watch(person, self.views[person - 1].clone(), allowance);
        }
        truth
    }

    /// Lets time pass.
    pub fn run_for(&mut self, span: Duration, observer: &mut dyn Observer) {
        self.run.run_for(span, observer);
    }

    /// Lets time pass that nobody looks at.
    pub fn settle(&mut self, span: Duration) {
        self.run.run_for(span, &mut Ignore);
    }
}
