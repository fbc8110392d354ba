//! What walls seal off is asked about by nobody until the eye leaves its part of the scene.

use eyeline_protocol::{
    Class, ClassId, ClientRecord, Extent, Issue, LocalTime, MotionBound, ObjectId, Position, RosterEntry, Tbv, WireTbv,
    WorldTime,
};
use eyeline_visibility::{Aabb, Bound, DynamicOctree, Occlusion};
use glam::DVec3;

use super::{Ahead, Decision, Tracker, TrackerConfig};

/// Hides what lies beyond x = 0, if it hides at all, and may know that walls seal that off from the parts where the eye
/// is.
struct Wall {
    hides: bool,
    parts: Option<Vec<u32>>,
    seals: bool,
}

impl Occlusion for Wall {
    fn hides(&self, bound: &Bound) -> bool {
        self.hides && bound.outer_box().is_some_and(|aabb| aabb.min.x > 0.0)
    }

    fn parts(&self) -> Option<&[u32]> {
        self.parts.as_deref()
    }

    fn seals_off(&self, bound: &Bound) -> bool {
        self.seals && bound.outer_box().is_some_and(|aabb| aabb.min.x > 0.0)
    }
}

const SECOND: i64 = 1_000_000;

fn at(frame: i64) -> WorldTime {
    WorldTime::from_micros(SECOND + frame * 50_000)
}

/// A tracker that holds object 1, which never moves, 5 m behind the wall, and object 2, which may at 1 m/s, 30 m behind
/// it.
fn tracker(sealed: bool) -> Tracker {
    let class = Class {
        name: "post".into(),
        motion: MotionBound { speed_max: 1.0, slack: 0.0 },
        extent: Extent { radius: 0.2, bottom: 0.0, top: 1.0 },
        eye_height: 0.0,
        turn_max: None,
    };
    let config = TrackerConfig::default().with_sealed(sealed);
    let index = Box::new(DynamicOctree::new(Aabb::EMPTY));
    let mut tracker = Tracker::new(config, true, 0.0, vec![class], index);
    for (id, x, speed) in [(1, 5.0, 0.0), (2, 30.0, 1.0)] {
        let tbv = Tbv {
            centre: Position::from_metres(DVec3::new(x, 0.0, 0.0)).unwrap(),
            radius: 1.0,
            speed,
            issued: at(0),
            expires: at(400),
            issue: Issue(0),
        };
        let bound = WireTbv::new(&tbv, at(0));
        let (object, name, node) = (ObjectId(id), format!("post {id}"), String::new());
        let entry = RosterEntry { object, class: ClassId(0), name, node, bound, issue: Issue(0), present: true };
        tracker.handle_roster(&entry, at(0));
    }
    tracker
}

/// One frame; whom it asks about, by id: in what order depends on whether a stage ended or T told.
fn frame(tracker: &mut Tracker, number: i64, wall: &Wall) -> Vec<u32> {
    let now = LocalTime::from_micros(number * 50_000);
    tracker.frame(at(number), Ahead::default(), wall, now);
    let asked = std::iter::from_fn(|| tracker.poll_record(now)).filter_map(|record| match record {
        ClientRecord::Request { object, .. } => Some(object.0),
        _ => None,
    });
    let mut asked: Vec<u32> = asked.collect();
    asked.sort_unstable();
    asked
}

fn wall(hides: bool, parts: Option<&[u32]>, seals: bool) -> Wall {
    Wall { hides, parts: parts.map(<[u32]>::to_vec), seals }
}

#[test]
fn what_is_sealed_off_is_in_no_index_and_not_asked_about_though_the_image_is_open() {
    let mut tracker = tracker(true);
    let closed = wall(true, Some(&[3]), true);
    assert!(frame(&mut tracker, 1, &closed).is_empty());
    assert_eq!((tracker.sealed_off(), tracker.counts()), (1, (0, 2, 0)));
    assert_eq!(tracker.explain(ObjectId(1)).unwrap().decision.0, Decision::SealedOff);
    assert!(tracker.could_be_sealed());
    // An image that is too coarse to hide it asks nothing about it. What moves is no business of walls: it is asked
    // about.
    assert_eq!(frame(&mut tracker, 2, &wall(false, Some(&[3]), true)), [2]);
    // The eye is in another part, from which it is not sealed off: it is looked at in that very frame.
    assert_eq!(frame(&mut tracker, 3, &wall(false, Some(&[3, 4]), false)), [1]);
    assert_eq!(tracker.sealed_off(), 0);
}

#[test]
fn who_does_not_know_where_the_eye_is_or_leaves_the_stage_out_asks_as_before() {
    for (sealed, parts) in [(false, Some(&[3][..])), (true, None)] {
        let mut tracker = tracker(sealed);
        assert!(frame(&mut tracker, 1, &wall(true, parts, true)).is_empty());
        assert_eq!(tracker.sealed_off(), 0);
        assert_eq!(frame(&mut tracker, 2, &wall(false, parts, true)), [1, 2]);
        assert_eq!(tracker.could_be_sealed(), sealed);
    }
    // What was sealed off is looked at again, too, when nothing is known of parts any more.
    let mut tracker = tracker(true);
    frame(&mut tracker, 1, &wall(true, Some(&[3]), true));
    assert!(frame(&mut tracker, 2, &wall(true, None, false)).is_empty());
    assert_eq!((tracker.sealed_off(), tracker.counts()), (0, (0, 2, 0)));
    assert_eq!(frame(&mut tracker, 3, &wall(false, None, false)), [1, 2]);
}

#[test]
fn the_same_is_said_with_and_without_where_the_image_hides_it_anyway() {
    let said = |sealed| {
        let mut tracker = tracker(sealed);
        let mut said = Vec::new();
        for number in 1..500 {
            // The eye goes to and fro between two parts; the bound's time is up at frame 400.
            let part = [3 + (number / 40 % 2) as u32];
            said.push(frame(&mut tracker, number, &wall(true, Some(&part), number % 80 < 60)));
        }
        (said, tracker.stats().sealed)
    };
    let ((with, sealed), (without, none)) = (said(true), said(false));
    assert_eq!(with, without);
    assert!(with.concat().contains(&1), "its time was up");
    assert!(sealed > 3 && none == 0, "{sealed} {none}");
}

#[test]
fn an_object_that_leaves_or_breaks_its_bound_is_sealed_off_no_more() {
    let closed = wall(true, Some(&[3]), true);
    let mut gone = tracker(true);
    frame(&mut gone, 1, &closed);
    gone.handle_left(ObjectId(1));
    assert_eq!((gone.sealed_off(), gone.counts()), (0, (0, 1, 0)));
    let mut broken = tracker(true);
    frame(&mut broken, 1, &closed);
    broken.handle_violation(ObjectId(1), Issue(1), at(1), true);
    assert_eq!(broken.sealed_off(), 0);
    assert_eq!(frame(&mut broken, 2, &closed), [1]);
}
