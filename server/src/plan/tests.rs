use eyeline_protocol::codec::{DatagramWriter, encode_control};
use eyeline_protocol::{
    ClientControl, ClientHeader, ClientRecord, Interest, LinkHeader, ObjectId, Orientation, Role, VERSION, WorldInfo,
};
use glam::DVec3;

use super::*;
use crate::policy::{Grid, Policy, Radius, Visible};
use crate::spec::{ClassSpec, ObjectSpec, SpawnSpec, WorldSpec};
use crate::world::{SessionId, Transmit, WorldConfig};

const TICK: Duration = Duration::from_millis(50);

/// A world of posts that nobody moves, on a line along x, a metre apart.
fn world(posts: usize, policy: Box<dyn Policy>, switch: &str) -> World {
    let info = WorldInfo { name: "posts".into(), hash: [0; 32], size_bytes: 0, two_sided: false };
    let class = ClassSpec { name: "post".into(), radius: 0.2, bottom: 0.0, top: 1.0, speed_max: 1.0 };
    let post = |number: usize| ObjectSpec {
        name: format!("post {number}"),
        class: "post".into(),
        node: None,
        position: [number as f64, 0.0, 3.0],
        heading: 0.0,
        takeable: false,
        path: None,
    };
    let spawns = (0..4).map(|i| SpawnSpec { position: [4.0 * f64::from(i), 0.0, 0.0], heading: 0.0 }).collect();
    let spec =
        WorldSpec { classes: vec![class], objects: (0..posts).map(post).collect(), spawns, ..WorldSpec::default() };
    let states = PlanSwitch::AUTO.with(Stage::States, true);
    let switch = if switch == "states=on" { states } else { switch.parse().unwrap() };
    let config = WorldConfig::default().with_plan(switch).with_tick(TICK).with_resume_grace(Duration::ZERO);
    World::new(config, spec, info, DVec3::ZERO, policy, WorldTime::ZERO).unwrap()
}

fn join(world: &mut World, role: Role) -> SessionId {
    let id = world.connect(world.committed_at());
    let hello = ClientControl::Hello {
        version: VERSION,
        token: Vec::new(),
        resolution: (320, 240),
        interest: Interest::Around,
        role,
        name: String::new(),
        resume: None,
    };
    world.handle_control(id, &encode_control(&hello)[4..], world.committed_at());
    id
}

/// One tick; what it sends.
fn tick(world: &mut World) -> Vec<(SessionId, Transmit)> {
    let now = world.committed_at() + TICK;
    world.tick(now);
    std::iter::from_fn(|| world.poll_transmit(now)).collect()
}

fn ticks(world: &mut World, seconds: f64) {
    (0..(seconds / TICK.as_secs_f64()).round() as usize).for_each(|_| drop(tick(world)));
}

fn verdicts(world: &World) -> Vec<&'static str> {
    plan(world).lines.iter().map(PlanLine::verdict).collect()
}

#[test]
fn a_world_in_which_nothing_moves_tells_no_states_and_says_so() {
    let mut world = world(0, Box::new(Visible), "auto");
    assert_eq!(verdicts(&world), ["left out", "left out", "left out"]);
    join(&mut world, Role::Avatar);
    let mut datagrams = 0;
    for _ in 0..100 {
        let sent = tick(&mut world);
        datagrams += sent.iter().filter(|(_, sent)| matches!(sent, Transmit::Datagram(_))).count();
    }
    assert_eq!(datagrams, 0);
    assert_eq!(world.stats().out.pushed() + world.stats().out.hidden_caused(), 0);
    assert!(!plan(&world).runs(Stage::States), "{}", plan(&world));
    // Somebody else is something to see, from the tick on that tells of them.
    join(&mut world, Role::Avatar);
    tick(&mut world);
    assert!(plan(&world).runs(Stage::States), "{}", plan(&world));
    // Under this policy there is no index.
    assert!(!plan(&world).runs(Stage::Sharing), "{}", plan(&world));
}

#[test]
fn a_plan_is_revised_at_once_for_more_and_after_a_while_for_less() {
    let mut world = world(0, Box::new(Grid::new(5.0).unwrap()), "auto");
    let revised = |world: &mut World| {
        let plan = world.poll_plan().unwrap_or_default();
        plan.lines.iter().map(|line| (line.stage, line.runs)).collect::<Vec<_>>()
    };
    assert_eq!(revised(&mut world), []);
    // The first client: who looks changes what is said of both, and turns nothing.
    let first = join(&mut world, Role::Avatar);
    ticks(&mut world, 0.1);
    assert_eq!(revised(&mut world), [(Stage::States, false), (Stage::Sharing, false)]);
    ticks(&mut world, 0.1);
    assert_eq!(revised(&mut world), []);
    // The second.
    let second = join(&mut world, Role::Avatar);
    ticks(&mut world, 0.05);
    assert_eq!(revised(&mut world), [(Stage::States, true), (Stage::Sharing, true)]);
    // A third is no news.
    let third = join(&mut world, Role::Avatar);
    ticks(&mut world, 0.1);
    assert_eq!(revised(&mut world), []);
    // Who goes and comes again turns nothing.
    world.disconnect(third);
    world.disconnect(second);
    ticks(&mut world, 4.0);
    let second = join(&mut world, Role::Avatar);
    ticks(&mut world, 10.0);
    assert_eq!(revised(&mut world), []);
    assert_eq!(verdicts(&world), ["left out", "runs", "runs"]);
    world.disconnect(second);
    ticks(&mut world, 4.9);
    assert_eq!(revised(&mut world), []);
    ticks(&mut world, 0.3);
    assert_eq!(revised(&mut world), [(Stage::States, false), (Stage::Sharing, false)]);
    // The last client leaves: no more is left out, but it is said.
    world.disconnect(first);
    ticks(&mut world, 5.2);
    assert_eq!(revised(&mut world), [(Stage::States, false), (Stage::Sharing, false)]);
    let text = plan(&world).to_string();
    assert!(text.contains("0 avatars for 0 clients") && text.contains("there for 0 watchers"), "{text}");
}

#[test]
fn paths_and_rest_come_and_go() {
    let mut world = world(2, Box::new(Visible), "auto");
    assert_eq!(verdicts(&world), ["runs", "runs", "left out"]);
    assert!(plan(&world).to_string().contains("A preset path moves 0 of 2 objects, and nobody moves 2."));
    assert_eq!(world.poll_plan(), None);
    let config = WorldConfig::default().with_swept(false);
    let info = WorldInfo { name: String::new(), hash: [0; 32], size_bytes: 0, two_sided: false };
    let spec = WorldSpec::default();
    let without = World::new(config, spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO).unwrap();
    assert_eq!(plan(&without).lines[0].verdict(), "forced off");
}

#[test]
fn a_level_rises_at_once_and_falls_late() {
    let at = |seconds: f64| WorldTime::ZERO + Duration::from_secs_f64(seconds);
    let mut level = Level::default();
    assert!(!level.count(0, at(0.0)) && level.count(2, at(1.0)) && !level.count(1, at(2.0)));
    // Up in between begins the time anew.
    assert!(!level.count(2, at(6.9)) && !level.count(0, at(7.0)) && !level.count(1, at(11.9)));
    assert!(level.count(1, at(12.0)));
    assert_eq!(level.held, 1);
}

/// All that is sent while clients come, walk and go: the plan as it is switched, and revised in between.
fn said(policy: Box<dyn Policy>, posts: usize, switch: &str, clients: usize) -> Vec<(SessionId, Transmit)> {
    let mut world = world(posts, policy, switch);
    let mut sent = Vec::new();
    let mut ids = Vec::new();
    for number in 0..400u32 {
        // One comes at a time; all but the first go again, and come again.
        if number % 40 == 1 && ids.len() < clients && !(150..280).contains(&number) {
            ids.push((join(&mut world, Role::Avatar), number));
        }
        if number == 150 {
            ids.drain(1.min(ids.len())..).for_each(|(id, _)| world.disconnect(id));
        }
        for &(id, since) in &ids {
            let Some((object, place)) = own(&world, id, &ids) else { continue };
            let position = eyeline_protocol::Position::from_metres(place + DVec3::X * 0.09).unwrap();
            let record = ClientRecord::Pose { object, position, orientation: Orientation::default() };
            let link = LinkHeader { seq: number - since + 1, ..LinkHeader::default() };
            let mut writer = DatagramWriter::new(&ClientHeader { link, frame: WorldTime::ZERO }, 1200);
            assert!(writer.push(&record));
            world.handle_datagram(id, &writer.finish(), world.committed_at());
        }
        sent.extend(tick(&mut world));
    }
    sent
}

/// The avatar of the client that came as so manieth of those who are here.
fn own(world: &World, id: SessionId, ids: &[(SessionId, u32)]) -> Option<(ObjectId, DVec3)> {
    let nth = ids.iter().position(|&(other, _)| other == id)?;
    let avatars = world.objects().iter().enumerate().filter(|(_, object)| object.alive && object.node.is_empty());
    let (index, object) = avatars.filter(|(_, object)| object.name.starts_with("avatar")).nth(nth)?;
    Some((ObjectId(index as u32), object.position.metres()))
}

#[test]
fn messages_are_the_same_with_and_without_an_index_for_one_client_and_for_several() {
    type Make = fn() -> Box<dyn Policy>;
    let makes: [Make; 2] = [|| Box::new(Grid::new(3.0).unwrap()), || Box::new(Radius::new(4.0, 0.2).unwrap())];
    for make in makes {
        for clients in [1, 3] {
            let auto = said(make(), 40, "auto", clients);
            let told = auto.iter().filter(|(_, sent)| matches!(sent, Transmit::Datagram(_))).count();
            assert!(told > 300, "{told}");
            assert_eq!(auto, said(make(), 40, "sharing=on", clients));
            assert_eq!(auto, said(make(), 40, "sharing=off", clients));
        }
    }
}

#[test]
fn messages_are_the_same_whether_what_is_due_is_looked_for_or_not() {
    for clients in [1, 3] {
        for make in [|| Box::new(Visible) as Box<dyn Policy>, || Box::new(Grid::new(3.0).unwrap()) as Box<dyn Policy>] {
            assert_eq!(said(make(), 0, "auto", clients), said(make(), 0, "states=on", clients));
        }
    }
}

/// `cargo test --release -p eyeline-server --lib -- --ignored --nocapture from_how_many`
#[test]
#[ignore = "a measurement, of the release build"]
#[expect(clippy::disallowed_methods, reason = "it measures")]
fn from_how_many_watchers_on_an_index_pays() {
    use std::time::Instant;
    for posts in [100, 1_000, 10_000] {
        for watchers in [1, 2, 4, 8, 16] {
            let mut times = [Vec::new(), Vec::new()];
            let mut worlds = ["sharing=on", "sharing=off"].map(|switch| {
                let mut world = world(posts, Box::new(Radius::new(4.0, 0.2).unwrap()), switch);
                for _ in 0..watchers {
                    join(&mut world, Role::Avatar);
                }
                ticks(&mut world, 0.2);
                world
            });
            for round in 0..60 {
                for side in [round % 2, 1 - round % 2] {
                    let began = Instant::now();
                    tick(&mut worlds[side]);
                    times[side].push(began.elapsed().as_secs_f64());
                }
            }
            let [on, off] = times.map(|mut times| {
                times.sort_by(f64::total_cmp);
                times[times.len() / 2] * 1e6
            });
            println!(
                "{posts} posts, {watchers} watchers: a tick with an index {on:.1} us, without {off:.1} us, {:.2}",
                on / off
            );
        }
    }
}
