//! Why does a client show an object at a moment, or not? Runs the measurement in virtual time until then, and asks the tracker,
//! the truth and rays.

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Context, bail};
use eyeline_client::tracking::BeliefKind;
use eyeline_protocol::{ClientRecord, ObjectId, ServerRecord, WorldTime, codec};
use eyeline_server::world::World;
use eyeline_visibility::{Bound, RayScene};
use glam::DVec3;

use super::MeasureConfig;
use super::virtual_time::{self, BEGIN};
use crate::report::Progress;
use crate::stage::{Crowd, Stage};
use crate::virtual_net::{Direction, Kind, LinkRules, Observer, Passing};

/// Counts what is said of one object to one client.
struct Ear {
    client: usize,
    object: Option<ObjectId>,
    /// What was said, newest last.
    said: Vec<(WorldTime, String)>,
}

impl Observer for Ear {
    fn arrives(&mut self, message: &Passing<'_>) {
        let Some(object) = self.object.filter(|_| message.client == self.client && message.kind == Kind::Datagram)
        else {
            return;
        };
        let mut note = |text: String| self.said.push((message.at, text));
        match message.direction {
            Direction::Up => {
                for record in codec::decode_client_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records) {
                    match record {
                        ClientRecord::Request { object: of, want, reason } if of == object => {
                            note(format!("request for a {want:?} ({reason:?})"));
                        }
                        ClientRecord::Release { object: of, .. } if of == object => note("release".into()),
                        ClientRecord::ViolationAck { object: of, .. } if of == object => note("violation heard".into()),
                        _ => {}
                    }
                }
            }
            Direction::Down => {
                for record in codec::decode_server_datagram(message.bytes).map_or(Vec::new(), |(_, records)| records) {
                    match record {
                        ServerRecord::State { object: of, .. } if of == object => note("state".into()),
                        ServerRecord::Bound { object: of, .. } if of == object => note("bound".into()),
                        ServerRecord::Violation { object: of, .. } if of == object => note("violation".into()),
                        ServerRecord::Hidden { object: of } if of == object => note("withdrawn".into()),
                        _ => {}
                    }
                }
            }
        }
    }
}

/// Explains, `at` into the measured time, what the `viewer`th client (from 0) believes of `object` (an id or a name) under
/// `policy`, and why.
///
/// # Errors
/// If there is no such client or object, or the world can't be run.
#[expect(clippy::too_many_arguments, reason = "a measurement's settings and a question")]
pub fn why(
    stage: &Stage,
    crowd: Option<&Crowd>,
    config: &MeasureConfig,
    link: &LinkRules,
    policy: &str,
    viewer: usize,
    object: &str,
    at: Duration,
) -> anyhow::Result<String> {
    if viewer >= config.clients {
        bail!("there is no client {viewer}; clients are 0 to {}: choose one, or raise --clients", config.clients - 1);
    }
    let begun = virtual_time::begin(stage, crowd, config, link, policy)?;
    let (mut run, client) = (begun.run, begun.numbers[viewer]);
    let mut ear = Ear { client, object: None, said: Vec::new() };
    let end = BEGIN + config.warm_up + at;
    let step = Duration::from_millis(250);
    let progress = Progress::new((config.warm_up + at).as_millis() as u64, &format!("{policy}: virtual time"));
    while run.now() < end {
        let next = (run.now() + step).min(end);
        progress.inc(next.since(run.now()).as_millis() as u64);
        run.run_until(next, &mut ear);
        if ear.object.is_none() {
            ear.object = find(run.world(), object);
        }
    }
    progress.finish();
    let id = ear.object.or_else(|| find(run.world(), object));
    let id = id.with_context(|| {
        format!("there is no object '{object}'; ids are 0 to {}, or give a name", run.world().objects().len() - 1)
    })?;
    let (now, session) = (run.now(), &run.clients()[client].session);
    let seconds = |time: WorldTime| time.seconds_since(BEGIN + config.warm_up);
    let eye = run.clients()[client].driver.eye().context("the client looks at nothing")?;
    let thing = &run.world().objects()[id.index()];
    let class = &run.world().classes()[usize::from(thing.class.0)];
    let place = thing.position.metres();
    let mut text = String::new();
    let out = &mut text;
    let at_metres = |p: DVec3| {
        let p = p + stage.anchor();
        format!("({:.2}, {:.2}, {:.2})", p.x, p.y, p.z)
    };
    writeln!(out, "at {:.3} s, client {viewer}: its eye is at {}", seconds(now), at_metres(eye))?;
    let ahead = session.ahead();
    writeln!(
        out,
        "  it looks {:.0} ms ahead, in which its eye can get {:.2} m far",
        ahead.time.as_secs_f64() * 1e3,
        ahead.eye_radius
    )?;
    writeln!(
        out,
        "object {} '{}' of class '{}' is truly at {}, {:.1} m from the eye{}",
        id.0,
        thing.name,
        class.name,
        at_metres(place),
        place.distance(eye),
        if thing.present { "" } else { " (not in the world)" }
    )?;
    let Some(tracker) = session.tracker() else {
        bail!("client {viewer} has not been let in by then; take a later --at")
    };
    let Some(why) = tracker.explain(id) else {
        let own = session.welcome().is_some_and(|welcome| welcome.avatars.iter().any(|avatar| avatar.0 == id));
        writeln!(
            out,
            "  {}",
            if own { "it is the client's own avatar" } else { "nobody has named it to this client" }
        )?;
        return Ok(text);
    };
    let is_drawn = tracker.drawn().any(|drawn| drawn.object == id);
    let belief = match why.belief {
        BeliefKind::Unknown => "it may be everywhere",
        BeliefKind::Hidden => "hidden: in a bound that cannot be seen",
        BeliefKind::Visible if is_drawn => "visible: the server tells of it, and it is drawn",
        BeliefKind::Visible => "visible until lately: the server still tells of it",
        BeliefKind::Absent => "not in the world",
    };
    writeln!(out, "  belief: {belief}")?;
    writeln!(out, "  last decision, at {:.3} s: {}", seconds(why.decision.1), why.decision.0)?;
    if let Some(tbv) = why.tbv {
        writeln!(
            out,
            "  bound: {:.2} m around {} as of {:.3} s, growing by {:.2} m/s: {:.2} m now; issue {}, {}",
            tbv.radius,
            at_metres(tbv.centre.metres()),
            seconds(tbv.issued),
            tbv.speed,
            tbv.radius_at(now),
            tbv.issue.0,
            if tbv.expires == WorldTime::MAX {
                "without end".into()
            } else {
                format!("until {:.1} s", seconds(tbv.expires))
            }
        )?;
    }
    if let Some(bound) = why.tested {
        writeln!(out, "  {}", occluders(stage, eye, &bound))?;
    }
    if let Some(tick) = why.state_of {
        writeln!(
            out,
            "  its state is known as of {:.3} s, {:.0} ms ago",
            seconds(tick),
            now.seconds_since(tick) * 1e3
        )?;
    }
    match (why.asked, why.due) {
        (Some((want, reason, heard)), _) => {
            let heard = if heard { "the server has heard it" } else { "the server may not have heard it" };
            writeln!(out, "  next event: the answer to its question for a {want:?} ({reason:?}); {heard}")?;
        }
        (None, Some(due)) => {
            let wait = due.seconds_since(now) - ahead.time.as_secs_f64();
            writeln!(
                out,
                "  next event: its stage ends in {:.0} ms; then the bound is tested, grown further",
                wait.max(0.0) * 1e3
            )?;
        }
        (None, None) if why.belief == BeliefKind::Visible => {
            let left = config.linger_frames.saturating_sub(why.hidden_frames);
            writeln!(out, "  next event: a push, or, after {left} frames out of sight, its release")?;
        }
        (None, None) => writeln!(out, "  next event: none until the server speaks of it")?,
    }
    writeln!(out, "  messages about it so far: {}; the last ones:", ear.said.len())?;
    for (time, said) in ear.said.iter().rev().take(6).rev() {
        writeln!(out, "    {:.3} s  {said}", seconds(*time))?;
    }
    Ok(text)
}

/// The object of this id or name.
fn find(world: &World, object: &str) -> Option<ObjectId> {
    let by_id = object.parse::<u32>().ok().filter(|&id| (id as usize) < world.objects().len());
    let by_name = || world.objects().iter().position(|thing| thing.alive && thing.name == object).map(|id| id as u32);
    by_id.or_else(by_name).map(ObjectId)
}

/// What rays from the eye to points of the bound's outline meet first.
fn occluders(stage: &Stage, eye: DVec3, bound: &Bound) -> String {
    let Some(aabb) = bound.aabb() else { return "what is tested is everywhere".into() };
    let scene = &stage.model.scene;
    let rays = RayScene::new(scene);
    let (centre, half) = (aabb.centre(), aabb.size() * 0.5);
    let (mut clear, mut met) = (0, std::collections::BTreeMap::<String, (u32, f64)>::new());
    let mut points = 0;
    for x in -2..=2 {
        for y in -1..=1 {
            for z in -2..=2 {
                let point = centre + DVec3::new(f64::from(x) * 0.5, f64::from(y), f64::from(z) * 0.5) * half;
                let way = point - eye;
                if way.length_squared() < 1e-12 {
                    continue;
                }
                points += 1;
                match rays.first_hit(eye, way, 0.0, 1.0) {
                    None => clear += 1,
                    Some(hit) => {
                        let node = scene.nodes().iter().find(|node| node.primitives.contains(&hit.primitive));
                        let name = node.map_or(String::new(), |node| format!(" of node '{}'", node.name));
                        let entry = met.entry(name).or_insert((hit.primitive, f64::INFINITY));
                        let distance = hit.t * way.length();
                        if distance < entry.1 {
                            *entry = (hit.primitive, distance);
                        }
                    }
                }
            }
        }
    }
    let size = aabb.size();
    let mut text = format!(
        "tested: a box of {:.1} × {:.1} × {:.1} m; of {points} rays from the eye into it {clear} arrive",
        size.x, size.y, size.z
    );
    for (name, (primitive, distance)) in met.iter().take(4) {
        let _ = write!(text, "; some meet triangle {primitive}{name}, the nearest {distance:.1} m away");
    }
    text
}
