//! The truth: what really could be seen, and how far the clients were from it.
//!
//! For each frame of a burst the committed world is drawn whole into an item buffer from the frame's eye: static
//! triangles in the frustum and everything that moves. That code shares nothing with the trackers' culling, and is itself
//! checked by f64 ray casting: at random pixels, and at every pixel on which a verdict of *late* rests.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use eyeline_protocol::{ObjectId, WorldTime};
use eyeline_server::policy::Meshes;
use eyeline_server::world::AVATAR_CLASS;
use eyeline_visibility::{Aabb, ItemBuffer, RayScene, Sides, Triangle, View, image_ray};
use glam::DVec3;

use super::{Commit, FrameLog, MeasureConfig, RunLog};
use crate::report::Progress;
use crate::stage::Stage;

/// What came of the comparison, over all clients.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Frames that were judged.
    pub frames: u64,
    /// Object-milliseconds in which an object owned a pixel.
    pub visible_object_ms: f64,
    /// Of these, the ones in which the client did not know where the object was.
    pub unknown_object_ms: f64,
    /// Of these, the ones in which it did not draw the object.
    pub missed_object_ms: f64,
    /// Pixels that objects owned which were not drawn, summed over frames.
    pub missed_px: u64,
    /// Objects that were drawn later than the promise allows, each time counted once.
    pub late: u64,
    /// Time from an object's first pixel to its first drawing, for those that came into view within a burst, ms.
    pub reveal_ms: Vec<f64>,
    /// Objects that came into view within a burst.
    pub reveals: u64,
    /// Errors of the places of shown objects, metres.
    pub error_m: Vec<f64>,
    /// The same in pixels.
    pub error_px: Vec<f64>,
    /// Object-milliseconds in which something was drawn that is not in the world.
    pub ghost_object_ms: f64,
    /// States received of objects that could not be seen from anywhere near the frame, in the frames looked at.
    pub overdisclosed: u64,
    /// Number of those frames.
    pub disclosure_frames: u64,
    /// Objects that could not be seen in any direction, summed over those frames.
    pub hidden: u64,
    /// Pixels of item buffers that rays were cast through.
    pub pixels_checked: u64,
    /// Of these, the ones that lie too near an edge or a tie for rays to decide.
    pub pixels_undecided: u64,
    /// Of these, the ones where the rays saw something else.
    pub pixels_differing: u64,
    /// Verdicts of *late* that the rays did not bear out, and that were dropped.
    pub late_refuted: u64,
}

impl Truth {
    fn add(&mut self, other: Truth) {
        self.frames += other.frames;
        self.visible_object_ms += other.visible_object_ms;
        self.unknown_object_ms += other.unknown_object_ms;
        self.missed_object_ms += other.missed_object_ms;
        self.missed_px += other.missed_px;
        self.late += other.late;
        self.reveal_ms.extend(other.reveal_ms);
        self.reveals += other.reveals;
        self.error_m.extend(other.error_m);
        self.error_px.extend(other.error_px);
        self.ghost_object_ms += other.ghost_object_ms;
        self.overdisclosed += other.overdisclosed;
        self.disclosure_frames += other.disclosure_frames;
        self.hidden += other.hidden;
        self.pixels_checked += other.pixels_checked;
        self.pixels_undecided += other.pixels_undecided;
        self.pixels_differing += other.pixels_differing;
        self.late_refuted += other.late_refuted;
    }
}

/// Judges a run. Uses every core; the result does not depend on how many there are.
pub fn judge(stage: &Stage, log: &RunLog, config: &MeasureConfig, progress: &Progress) -> Truth {
    let meshes = stage.meshes(&log.classes[usize::from(AVATAR_CLASS.0)]);
    let painter = Painter::new(stage, log, &meshes, config);
    let next = AtomicUsize::new(0);
    let results = Mutex::new(BTreeMap::new());
    let workers = std::thread::available_parallelism().map_or(1, |cores| cores.get());
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                let mut image = ItemBuffer::new(&painter.view(DVec3::ZERO, 0.0));
                loop {
                    let client = next.fetch_add(1, Ordering::Relaxed);
                    if client >= log.clients.len() {
                        break;
                    }
                    let truth = judge_client(&painter, log, client, &mut image, progress);
                    results.lock().unwrap_or_else(PoisonError::into_inner).insert(client, truth);
                }
            });
        }
    });
    let mut total = Truth::default();
    for truth in results.into_inner().unwrap_or_else(PoisonError::into_inner).into_values() {
        total.add(truth);
    }
    total.reveal_ms.sort_by(f64::total_cmp);
    total.error_m.sort_by(f64::total_cmp);
    total.error_px.sort_by(f64::total_cmp);
    total
}

/// An object that owns pixels, for as long as it does within a burst.
struct Episode {
    began: WorldTime,
    /// Whether it came into view within the burst, so that `began` is exact, and has not been drawn yet.
    is_whole: bool,
    /// The newest frame in which it owned a pixel.
    last: WorldTime,
    is_drawn: bool,
    is_late: bool,
    /// When it must be drawn at the latest.
    need: WorldTime,
}

/// For how long a loss may still matter.
const LOSS_WINDOW: Duration = Duration::from_millis(1_500);

/// Frames back whose leads an object's first frame depends on.
const LEAD_FRAMES: usize = 10;

/// Ends the episodes of objects that are not `kept`. One that came into view and was never drawn counts with the time that
/// it had.
fn end(episodes: &mut BTreeMap<ObjectId, Episode>, truth: &mut Truth, kept: impl Fn(ObjectId) -> bool) {
    episodes.retain(|&object, episode| {
        let is_kept = kept(object);
        if !is_kept && episode.is_whole {
            truth.reveal_ms.push(episode.last.seconds_since(episode.began).max(0.0) * 1e3);
        }
        is_kept
    });
}

fn judge_client(painter: &Painter, log: &RunLog, client: usize, image: &mut ItemBuffer, progress: &Progress) -> Truth {
    let mut truth = Truth::default();
    let client_log = &log.clients[client];
    let frame_ms = painter.frame.as_secs_f64() * 1e3;
    let mut episodes: BTreeMap<ObjectId, Episode> = BTreeMap::new();
    let mut place_in_burst = 0;
    let retry = |began: WorldTime, object: ObjectId, frame: &FrameLog| {
        // Each lost question or answer in a row is forgiven what it takes to ask again (DESIGN §3.3): those shortly before
        // and since it came into view.
        let lately = |&&(lost, of): &&(WorldTime, ObjectId)| {
            of == object && lost <= frame.at && (lost >= began || began.since(lost) <= LOSS_WINDOW)
        };
        let losses = client_log.lost.iter().filter(lately).count() as u32;
        losses * (frame.retry_after + painter.frame)
    };
    for (number, frame) in client_log.frames.iter().enumerate() {
        let Some(known) = &frame.known else {
            end(&mut episodes, &mut truth, |_| false);
            place_in_burst = 0;
            continue;
        };
        progress.inc(1);
        truth.frames += 1;
        let commit = log.commit_at(frame.at);
        let view = painter.view(frame.eye, frame.yaw);
        let owned = painter.draw(image, &view, commit, client_log.avatar);
        end(&mut episodes, &mut truth, |object| owned.contains_key(&object));
        for (&object, &pixels) in &owned {
            let known = known.iter().find(|known| known.object == object);
            let is_drawn = known.is_some_and(|known| known.is_drawn);
            truth.visible_object_ms += frame_ms;
            if known.is_none() {
                truth.unknown_object_ms += frame_ms;
            }
            if !is_drawn {
                truth.missed_object_ms += frame_ms;
                truth.missed_px += pixels;
            }
            let is_new = !episodes.contains_key(&object);
            // Who looked ahead for long enough shows it in the first frame.
            let takes = frame.round_trip_max + log.turnaround;
            let lead =
                client_log.frames[number.saturating_sub(LEAD_FRAMES)..=number].iter().map(|f| f.ahead.time).min();
            let has_lead = lead.is_some_and(|lead| lead >= frame.round_trip_max + painter.frame);
            let allowed = if has_lead { log.turnaround } else { takes };
            let episode = episodes.entry(object).or_insert_with(|| Episode {
                began: frame.at,
                is_whole: place_in_burst > 0,
                last: frame.at,
                is_drawn: false,
                is_late: false,
                need: frame.at + allowed,
            });
            truth.reveals += u64::from(is_new && episode.is_whole);
            episode.last = frame.at;
            if episode.is_drawn && !is_drawn {
                // Lost while in sight: it must be back as fast as it had to come.
                episode.is_drawn = false;
                episode.is_late = false;
                episode.need = frame.at + allowed;
            }
            // The first frame at or after `need` must show it: a round trip, a turnaround, and the wait for a frame.
            let is_due = frame.at >= episode.need + retry(episode.began, object, frame)
                && (has_lead && episode.is_whole || !is_new);
            if !is_drawn && !episode.is_drawn && !episode.is_late && is_due {
                if painter.is_borne_out(image, &view, commit, client_log.avatar, object) {
                    episode.is_late = true;
                    truth.late += 1;
                } else {
                    truth.late_refuted += 1;
                }
            }
            if is_drawn && !episode.is_drawn {
                episode.is_drawn = true;
                if std::mem::take(&mut episode.is_whole) {
                    truth.reveal_ms.push(frame.at.seconds_since(episode.began).max(0.0) * 1e3);
                }
            }
        }
        // Everything that is shown, in sight or not: a ghost at a stale place is an error too.
        for known in known.iter().filter(|known| known.is_drawn) {
            let Some(Some((place, _))) = commit.places.get(known.object.index()) else {
                truth.ghost_object_ms += frame_ms;
                continue;
            };
            let error = known.position.metres().distance(place.metres());
            truth.error_m.push(error);
            truth.error_px.push(error * view.focal_px() / place.metres().distance(frame.eye).max(0.1));
        }
        if place_in_burst == 1 {
            painter.judge_disclosure(image, log, client, number, &mut truth);
            if client.is_multiple_of(8) {
                painter.draw(image, &view, commit, client_log.avatar);
                painter.check_pixels(image, &view, commit, client_log.avatar, &mut truth);
            }
        }
        place_in_burst += 1;
    }
    truth
}

/// Draws the committed world from anywhere.
pub(super) struct Painter<'a> {
    stage: &'a Stage,
    log: &'a RunLog,
    meshes: &'a Meshes,
    /// Runs of static triangles with their boxes.
    clusters: Vec<(Aabb, std::ops::Range<usize>)>,
    /// What stands still, for rays.
    statics: RayScene,
    config: &'a MeasureConfig,
    frame: Duration,
}

/// Static triangles whose box is tested at once.
const CLUSTER: usize = 128;

/// Rays cast through an image that is checked.
const PIXELS_CHECKED: u32 = 64;

/// How near an edge, in pixels, a ray does not decide: the item buffer snaps vertices to 1/256 px.
const EDGE_PX: f64 = 1.0 / 64.0;

/// How near in depth, relatively, two surfaces are a tie for a ray: the item buffer's depth is an f32.
const TIE: f64 = 1e-5;

impl<'a> Painter<'a> {
    pub(super) fn new(stage: &'a Stage, log: &'a RunLog, meshes: &'a Meshes, config: &'a MeasureConfig) -> Painter<'a> {
        let triangles = stage.model.scene.triangles();
        let clusters = (0..triangles.len())
            .step_by(CLUSTER)
            .map(|first| {
                let range = first..(first + CLUSTER).min(triangles.len());
                let aabb = triangles[range.clone()].iter().fold(Aabb::EMPTY, |aabb, t| aabb.union(&t.aabb()));
                (aabb, range)
            })
            .collect();
        let statics = RayScene::new(&stage.model.scene);
        Painter { stage, log, meshes, clusters, statics, config, frame: config.frame() }
    }

    pub(super) fn view(&self, eye: DVec3, yaw: f64) -> View {
        View::level(eye, yaw, std::f64::consts::FRAC_PI_2, self.config.resolution)
    }

    /// Draws everything and counts the pixels that each object owns.
    pub(super) fn draw(
        &self,
        image: &mut ItemBuffer,
        view: &View,
        commit: &Commit,
        own: ObjectId,
    ) -> BTreeMap<ObjectId, u64> {
        image.begin(view);
        let triangles = self.stage.model.scene.triangles();
        for (aabb, range) in &self.clusters {
            if may_be_in(view, aabb) {
                for id in range.clone() {
                    image.draw_triangle(id as u32, &triangles[id], DVec3::ZERO);
                }
            }
        }
        let first = triangles.len() as u32;
        self.each_object(commit, own, |object, aabb, corners, sides| {
            if may_be_in(view, aabb) {
                for (&corners, &sides) in corners.iter().zip(sides) {
                    image.draw_corners(first + object.0, corners, sides);
                }
            }
        });
        let mut owned = BTreeMap::new();
        for &id in image.ids() {
            if id != ItemBuffer::NONE && id >= first {
                *owned.entry(ObjectId(id - first)).or_insert(0) += 1;
            }
        }
        owned
    }

    fn each_object(&self, commit: &Commit, own: ObjectId, mut f: impl FnMut(ObjectId, &Aabb, &[[DVec3; 3]], &[Sides])) {
        let (mut corners, mut sides) = (Vec::new(), Vec::new());
        for (index, place) in commit.places.iter().enumerate() {
            let object = ObjectId(index as u32);
            let (Some((position, orientation)), Some(info)) = (place, self.log.objects.get(index)) else { continue };
            if object == own {
                continue;
            }
            corners.clear();
            sides.clear();
            let is_avatar = info.class == AVATAR_CLASS;
            let placed = self.meshes.placed(is_avatar, &info.node, position.metres(), orientation.quat());
            for (triangle, original) in placed {
                corners.push(triangle);
                sides.push(original.sides);
            }
            let aabb = corners.iter().flatten().fold(Aabb::EMPTY, |aabb, &corner| aabb.with_point(corner));
            f(object, &aabb, &corners, &sides);
        }
    }

    /// What rays see: all static triangles, then each object's.
    fn rays(&self, commit: &Commit, own: ObjectId) -> (RayScene, Vec<ObjectId>) {
        let (mut extra, mut owners) = (Vec::new(), Vec::new());
        self.each_object(commit, own, |object, _, corners, sides| {
            for (corners, &sides) in corners.iter().zip(sides) {
                extra.push(Triangle { corners: corners.map(|corner| corner.as_vec3()), sides, occludes: true });
                owners.push(object);
            }
        });
        (RayScene::new(&self.stage.model.scene).with_extra(&extra), owners)
    }

    /// Casts rays through random pixels of an image that was drawn.
    fn check_pixels(&self, image: &ItemBuffer, view: &View, commit: &Commit, own: ObjectId, truth: &mut Truth) {
        let (rays, owners) = self.rays(commit, own);
        // Weyl's sequence: spread over the image, the same every time.
        for i in 0..PIXELS_CHECKED {
            let x = (f64::from(i) * 0.754_877_666).fract() * f64::from(view.resolution.width);
            let y = (f64::from(i) * 0.569_840_291).fract() * f64::from(view.resolution.height);
            truth.pixels_checked += 1;
            match self.ray_id(&rays, &owners, view, x as u32, y as u32) {
                None => truth.pixels_undecided += 1,
                Some(seen) if seen != image.id_at(x as u32, y as u32) => truth.pixels_differing += 1,
                Some(_) => {}
            }
        }
    }

    /// What a pixel's ray hits, as an item buffer's id; `None` if rays can't decide.
    fn ray_id(&self, rays: &RayScene, owners: &[ObjectId], view: &View, x: u32, y: u32) -> Option<Option<u32>> {
        let statics = self.stage.model.scene.triangles().len() as u32;
        let item = |primitive: u32| {
            let object = primitive.checked_sub(statics).and_then(|index| owners.get(index as usize));
            object.map_or(primitive, |object| statics + object.0)
        };
        let mut hits = Vec::new();
        let mut seen = None;
        for (dx, dy) in [(0.0, 0.0), (EDGE_PX, EDGE_PX), (-EDGE_PX, EDGE_PX), (EDGE_PX, -EDGE_PX), (-EDGE_PX, -EDGE_PX)]
        {
            let ray = image_ray(view, f64::from(x) + 0.5 + dx, f64::from(y) + 0.5 + dy);
            hits.clear();
            rays.near_hits(view.eye, ray, view.near, f64::INFINITY, TIE, &mut hits);
            let mut ids = hits.iter().map(|hit| item(hit.primitive));
            let id = ids.next();
            if ids.any(|other| Some(other) != id) {
                return None;
            }
            match seen {
                None => seen = Some(id),
                Some(known) if known != id => return None,
                Some(_) => {}
            }
        }
        seen
    }

    /// Whether rays see `object` in at least one of the pixels that the image gives it, or can't decide any.
    fn is_borne_out(&self, image: &ItemBuffer, view: &View, commit: &Commit, own: ObjectId, object: ObjectId) -> bool {
        let (rays, owners) = self.rays(commit, own);
        let id = self.stage.model.scene.triangles().len() as u32 + object.0;
        let width = view.resolution.width as usize;
        let pixels = image.ids().iter().enumerate().filter(|&(_, &winner)| winner == id);
        let mut refuted = 0;
        for (index, _) in pixels.take(64) {
            match self.ray_id(&rays, &owners, view, (index % width) as u32, (index / width) as u32) {
                Some(Some(seen)) if seen == id => return true,
                Some(_) => refuted += 1,
                None => {}
            }
        }
        refuted == 0
    }

    /// Whether rays find an eye of the frame's lead region that sees a corner of the object past what stands still.
    fn is_entitled(&self, frame: &FrameLog, commit: &Commit, object: ObjectId) -> bool {
        let (Some(Some((position, orientation))), Some(info)) =
            (commit.places.get(object.index()), self.log.objects.get(object.index()))
        else {
            return false;
        };
        let is_avatar = info.class == AVATAR_CLASS;
        let placed = self.meshes.placed(is_avatar, &info.node, position.metres(), orientation.quat());
        let corners: Vec<DVec3> = placed.flat_map(|(corners, _)| corners).collect();
        let stride = (corners.len() / 24).max(1);
        let radius = frame.ahead.eye_radius;
        (0..if radius > 0.0 { EYES + 1 } else { 1 }).any(|i| {
            // Around the middle in plan, where walking leads.
            let turn = std::f64::consts::TAU * f64::from(i) / f64::from(EYES);
            let eye = frame.eye
                + if i == EYES || radius == 0.0 {
                    DVec3::ZERO
                } else {
                    DVec3::new(turn.cos(), 0.0, turn.sin()) * radius
                };
            corners.iter().step_by(stride).any(|&corner| {
                let way = corner - eye;
                way.length_squared() > 1e-12 && self.statics.first_hit(eye, way, 0.0, 1.0 - 1e-9).is_none()
            })
        })
    }

    /// How many states arrived of objects that could not be seen, all round, in this frame or the one before.
    fn judge_disclosure(&self, image: &mut ItemBuffer, log: &RunLog, client: usize, number: usize, truth: &mut Truth) {
        let own = log.clients[client].avatar;
        let frames = &log.clients[client].frames[number.saturating_sub(1)..=number];
        let mut seen: BTreeMap<ObjectId, u64> = BTreeMap::new();
        let mut seen_last = 0;
        for frame in frames {
            let commit = log.commit_at(frame.at);
            let side = self.config.resolution.width.max(self.config.resolution.height);
            let mut now: BTreeMap<ObjectId, u64> = BTreeMap::new();
            for view in View::cube(frame.eye, side) {
                for (object, pixels) in self.draw(image, &view, commit, own) {
                    *now.entry(object).or_insert(0) += pixels;
                }
            }
            seen_last = now.len();
            seen.extend(now);
        }
        let FrameLog { at, received, .. } = &log.clients[client].frames[number];
        let there = log.commit_at(*at).places.iter().flatten().count().saturating_sub(1);
        truth.hidden += there.saturating_sub(seen_last) as u64;
        // What an eye of the lead's region sees is no over-disclosure; rays find most of it.
        let back = log.clients[client].frames[number].round_trip_max.as_secs_f64() / self.frame.as_secs_f64();
        let frames = &log.clients[client].frames;
        let from = [&frames[number.saturating_sub(back.ceil() as usize + 1)], &frames[number]];
        for &object in received.iter().filter(|object| !seen.contains_key(object)) {
            let is_entitled = from.iter().any(|frame| self.is_entitled(frame, log.commit_at(*at), object));
            truth.overdisclosed += u64::from(!is_entitled);
        }
        truth.disclosure_frames += 1;
    }
}

/// Eyes of a lead's region that rays are cast from, besides its middle.
const EYES: u32 = 16;

/// Whether a box may meet the view's frustum: false only if it is wholly beyond one of its planes.
pub(super) fn may_be_in(view: &View, aabb: &Aabb) -> bool {
    if aabb.is_empty() {
        return false;
    }
    let view_from_world = view.orientation.inverse();
    let tan_x = (view.fov_x * 0.5).tan();
    let tan_y = tan_x * f64::from(view.resolution.height) / f64::from(view.resolution.width);
    // One bit for each plane that a corner is beyond; a margin for rounding.
    let beyond = aabb.corners().iter().fold(0b11111, |all, &corner| {
        let p = view_from_world * (corner - view.eye);
        let depth = -p.z * (1.0 + 1e-6) + 1e-6;
        all & (u8::from(p.x > depth * tan_x)
            | u8::from(-p.x > depth * tan_x) << 1
            | u8::from(p.y > depth * tan_y) << 2
            | u8::from(-p.y > depth * tan_y) << 3
            | u8::from(depth < 0.0) << 4)
    });
    beyond == 0
}
