//! `radius`: a client is told of what is within a distance, walls or no walls. What most worlds do.
//!
//! With hysteresis: what came within `radius` is told until it is farther than `radius · (1 + hysteresis)`, so that
//! somebody who walks along the border is not told and withdrawn at every other tick.

use std::collections::BTreeMap;

use eyeline_protocol::{Class, Extent, ObjectId};
use glam::DVec3;

use super::squares::Squares;
use super::{Policy, PolicyError, Watcher, check};
use crate::world::{Object, SessionId, present};

/// A client is told of every object whose extent comes within `radius` of its eye.
pub struct Radius {
    radius: f64,
    keep: f64,
    extents: Vec<Extent>,
    shares: bool,
    squares: Squares,
    /// The widest extent in the world: how far beyond `keep` a reference point may be.
    widest: f64,
    /// Number of the tick.
    tick: u64,
    /// What each watcher was told of, and at which tick.
    told: BTreeMap<SessionId, (u64, Vec<ObjectId>)>,
}

impl Radius {
    /// Tells within `radius` metres, until farther than `radius · (1 + hysteresis)`.
    ///
    /// # Errors
    /// If the radius is not a length, or the hysteresis no share.
    pub fn new(radius: f64, hysteresis: f64) -> Result<Radius, PolicyError> {
        check("radius", radius, SETTING_METRES)?;
        check("hysteresis", hysteresis, 0.0..=HYSTERESIS_MAX)?;
        Ok(Radius {
            radius,
            keep: radius * (1.0 + hysteresis),
            extents: Vec::new(),
            shares: true,
            squares: Squares::default(),
            widest: 0.0,
            tick: 0,
            told: BTreeMap::new(),
        })
    }

    /// Distance from an eye to the upright cylinder of an object, 0 within it; metres. What the radius is held against: a
    /// wide object is seen by its near side.
    pub fn distance(eye: DVec3, place: DVec3, extent: Extent) -> f64 {
        let aside = ((eye.x - place.x).hypot(eye.z - place.z) - extent.radius).max(0.0);
        let above = (eye.y - place.y - extent.top).max(place.y + extent.bottom - eye.y).max(0.0);
        aside.hypot(above)
    }
}

impl Policy for Radius {
    fn name(&self) -> &'static str {
        "radius"
    }

    fn start(&mut self, classes: &[Class]) {
        self.extents = classes.iter().map(|class| class.extent).collect();
    }

    fn has_index(&self) -> bool {
        true
    }

    fn share(&mut self, shares: bool) {
        self.shares = shares;
    }

    fn memory_bytes(&self) -> usize {
        let told: usize = self.told.values().map(|(_, told)| told.capacity()).sum();
        self.squares.memory_bytes() + told * size_of::<ObjectId>()
    }

    fn begin_tick(&mut self, objects: &[Object]) {
        // Every watcher is asked for at every tick: who was not, has left.
        let last = self.tick;
        self.told.retain(|_, (tick, _)| *tick == last);
        self.tick += 1;
        if !self.shares {
            return self.squares.clear();
        }
        let radii = present(objects).map(|(_, object)| extent(&self.extents, object).radius);
        self.widest = radii.fold(0.0, f64::max);
        // Half of what is asked for: fewer objects in vain than with whole squares, and still few rows.
        self.squares.fill((self.keep + self.widest) * 0.5, objects);
    }

    fn interest(&mut self, objects: &[Object], watcher: &Watcher, told: &mut Vec<ObjectId>) {
        let (_, before) = self.told.remove(&watcher.session).unwrap_or_default();
        let (eye, reach) = (watcher.eye, self.keep + self.widest);
        let is_told = |&id: &ObjectId| {
            let object = &objects[id.index()];
            let distance = Radius::distance(eye, object.position.metres(), extent(&self.extents, object));
            let is_near = distance <= self.radius || distance <= self.keep && before.binary_search(&id).is_ok();
            is_near && Some(id) != watcher.avatar
        };
        let mut now: Vec<ObjectId> = match self.shares {
            true => {
                let near = self.squares.within(eye.x - reach..=eye.x + reach, eye.z - reach..=eye.z + reach);
                near.filter(is_told).collect()
            }
            false => present(objects).map(|(id, _)| id).filter(is_told).collect(),
        };
        now.sort_unstable();
        told.extend_from_slice(&now);
        self.told.insert(watcher.session, (self.tick, now));
    }
}

/// What a radius or a cell may be, metres: wider than a world is as good as all of it.
pub(super) const SETTING_METRES: std::ops::RangeInclusive<f64> = 0.01..=1e7;

/// Ten times as far is no hysteresis any more.
const HYSTERESIS_MAX: f64 = 10.0;

fn extent(extents: &[Extent], object: &Object) -> Extent {
    extents[usize::from(object.class.0)]
}

#[cfg(test)]
mod tests {
    use super::super::made::{watcher, world};
    use super::*;
    use crate::world::World;

    fn told(policy: &mut Radius, places: &[[f64; 3]], eye: DVec3) -> Vec<u32> {
        let world = world(places);
        // With the index and without it the same is told; the second watcher remembers what the first does.
        let told = [(1, true), (2, false)].map(|(session, shares)| {
            policy.share(shares);
            policy.begin_tick(world.objects());
            let mut told = [Vec::new(), Vec::new()];
            policy.interest(world.objects(), &watcher(session, 0, eye), &mut told[0]);
            policy.interest(world.objects(), &watcher(3 - session, 0, eye), &mut told[1]);
            told
        });
        assert!(told.iter().flatten().all(|one| *one == told[0][0]), "{told:?}");
        told[0][0].iter().map(|id| id.0).collect()
    }

    fn policy(radius: f64, hysteresis: f64) -> Radius {
        let mut policy = Radius::new(radius, hysteresis).unwrap();
        policy.start(world(&[]).classes());
        policy
    }

    #[test]
    fn the_distance_is_to_the_cylinder() {
        let extent = Extent { radius: 0.5, bottom: -1.0, top: 2.0 };
        let from = |x, y, z| Radius::distance(DVec3::new(x, y, z), DVec3::ZERO, extent);
        assert_eq!(from(0.2, 1.0, 0.2), 0.0);
        assert_eq!(from(3.5, 0.0, 0.0), 3.0);
        assert_eq!(from(0.0, 5.0, 0.0), 3.0);
        assert_eq!(from(0.0, 0.0, -4.5).hypot(3.0), from(0.0, -4.0, 4.5));
    }

    #[test]
    fn what_came_near_is_told_until_it_is_a_share_farther() {
        let mut policy = policy(10.0, 0.1);
        // The extent's radius is 0.5 m.
        let mut at = |x| told(&mut policy, &[[0.0; 3], [x, 0.0, 0.0]], DVec3::Y);
        for (x, expected) in
            [(11.4, &[][..]), (10.6, &[]), (10.4, &[1]), (11.4, &[1]), (11.6, &[]), (11.4, &[]), (10.5, &[1])]
        {
            assert_eq!(at(x), expected, "{x}");
        }
    }

    #[test]
    fn without_hysteresis_the_border_is_sharp_and_floors_count() {
        let mut policy = policy(10.0, 0.0);
        let places =
            [[0.0; 3], [10.6, 0.0, 0.0], [-10.4, 0.0, 0.0], [0.0, 10.9, 0.0], [0.0, 11.1, 0.0], [7.0, 0.0, -7.0]];
        assert_eq!(told(&mut policy, &places, DVec3::Y), [2, 3, 5]);
    }

    #[test]
    fn who_left_is_forgotten_and_comes_back_as_a_stranger() {
        let mut policy = policy(10.0, 0.1);
        let (near, far) = (world(&[[0.0; 3], [10.0, 0.0, 0.0]]), world(&[[0.0; 3], [11.0, 0.0, 0.0]]));
        let ask = |policy: &mut Radius, world: &World| {
            let mut told = Vec::new();
            policy.interest(world.objects(), &watcher(1, 0, DVec3::Y), &mut told);
            told.len()
        };
        policy.begin_tick(near.objects());
        assert_eq!(ask(&mut policy, &near), 1);
        policy.begin_tick(far.objects());
        assert_eq!(ask(&mut policy, &far), 1);
        // A tick without it, as when its connection has gone.
        policy.begin_tick(far.objects());
        policy.begin_tick(far.objects());
        assert!(policy.told.is_empty());
        assert_eq!(ask(&mut policy, &far), 0);
    }

    #[test]
    fn squares_find_what_looking_at_everything_finds() {
        use rand::{RngExt, SeedableRng};
        let mut chance = rand_pcg::Pcg64::seed_from_u64(5);
        for radius in [0.01, 12.0, 40.0, 1e7] {
            let mut policy = policy(radius, 0.0);
            let places: Vec<[f64; 3]> =
                (0..200).map(|_| [60.0, 3.0, 60.0].map(|far| chance.random_range(-far..far))).collect();
            let eye = DVec3::from_array(places[0]) + DVec3::new(0.3, 1.6, 0.0);
            let extent = world(&[]).classes()[1].extent;
            let near = |place: &[f64; 3]| {
                let place = eyeline_protocol::Position::from_metres(DVec3::from_array(*place)).unwrap().metres();
                Radius::distance(eye, place, extent) <= radius
            };
            let expected: Vec<u32> = (1..200).filter(|&id| near(&places[id as usize])).collect();
            assert_eq!(told(&mut policy, &places, eye), expected, "{radius}");
            assert_eq!(expected.is_empty(), radius < 1.0);
        }
    }

    #[test]
    fn settings_that_are_no_lengths_are_refused() {
        for radius in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e8] {
            let error = Radius::new(radius, 0.1).err().unwrap().to_string();
            assert!(error.contains("radius") && error.contains("0.01"), "{error}");
        }
        for hysteresis in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(Radius::new(1.0, hysteresis).err().unwrap().to_string().contains("hysteresis"));
        }
    }
}
