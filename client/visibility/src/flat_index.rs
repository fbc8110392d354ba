//! Which moving bounds may be seen, where most are told by a box alone.
//!
//! Some occlusions know a box outside of which they hide everything ([`Occlusion::open`]): a record of what somebody saw, say. Then
//! a tree over the bounds is of no use. Their boxes lie side by side here, each side in an array of its own, and are held against
//! that box, which takes about a nanosecond for each; what touches it is asked about. An update writes one place.
//! Without such a box every bound is asked about, and [`crate::DynamicOctree`] is the better choice.

use crate::{Aabb, Bound, DynamicIndex, IdMap, Occlusion, Open};

/// A flat list of moving bounds.
#[derive(Clone, Debug, Default)]
pub struct FlatIndex {
    /// Where each key is.
    slots: IdMap<u32>,
    keys: Vec<u32>,
    bounds: Vec<Bound>,
    /// The bounds' boxes, rounded outward: low and high x, y and z. What has no box is infinite.
    sides: [Vec<f32>; 6],
    updates: u64,
}

impl FlatIndex {
    fn sides_of(bound: &Bound) -> [f32; 6] {
        match bound.outer_box() {
            Some(aabb) => outward(&aabb),
            None => {
                [f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY]
            }
        }
    }
}

/// Low and high x, y and z of a box that contains this one. A step farther, since `as` rounds to the nearest.
fn outward(aabb: &Aabb) -> [f32; 6] {
    let (low, high) = (aabb.min.as_vec3(), aabb.max.as_vec3());
    [low.x.next_down(), high.x.next_up(), low.y.next_down(), high.y.next_up(), low.z.next_down(), high.z.next_up()]
}

/// The same of a box that this one contains.
fn inward(aabb: &Aabb) -> [f32; 6] {
    let (low, high) = (aabb.min.as_vec3(), aabb.max.as_vec3());
    [low.x.next_up(), high.x.next_down(), low.y.next_up(), high.y.next_down(), low.z.next_up(), high.z.next_down()]
}

impl DynamicIndex for FlatIndex {
    fn insert(&mut self, key: u32, bound: Bound) {
        self.updates += 1;
        let sides = FlatIndex::sides_of(&bound);
        let Some(&slot) = self.slots.get(key) else {
            self.slots.insert(key, self.keys.len() as u32);
            self.keys.push(key);
            self.bounds.push(bound);
            for (all, side) in self.sides.iter_mut().zip(sides) {
                all.push(side);
            }
            return;
        };
        self.bounds[slot as usize] = bound;
        for (all, side) in self.sides.iter_mut().zip(sides) {
            all[slot as usize] = side;
        }
    }

    fn remove(&mut self, key: u32) -> bool {
        let Some(slot) = self.slots.remove(key) else { return false };
        self.updates += 1;
        let slot = slot as usize;
        self.keys.swap_remove(slot);
        self.bounds.swap_remove(slot);
        for side in &mut self.sides {
            side.swap_remove(slot);
        }
        if let Some(&moved) = self.keys.get(slot) {
            self.slots.insert(moved, slot as u32);
        }
        true
    }

    fn exposed(&self, occlusion: &dyn Occlusion, exposed: &mut Vec<u32>) -> usize {
        let start = exposed.len();
        let mut tested = 0;
        let mut ask = |slot: usize| {
            tested += 1;
            if !occlusion.hides(&self.bounds[slot]) {
                exposed.push(self.keys[slot]);
            }
        };
        match occlusion.open() {
            None => (0..self.keys.len()).for_each(ask),
            Some(Open { open, within }) => {
                let (open, within) = (outward(&open), inward(&within));
                // Of one length, so that no access below is checked.
                let [low_x, high_x, low_y, high_y, low_z, high_z] =
                    self.sides.each_ref().map(|side| &side[..self.keys.len()]);
                let is_in_doubt = |slot: usize| {
                    let touches = (high_x[slot] >= open[0])
                        & (low_x[slot] <= open[1])
                        & (high_z[slot] >= open[4])
                        & (low_z[slot] <= open[5]);
                    let is_within = (low_x[slot] >= within[0])
                        & (high_x[slot] <= within[1])
                        & (low_y[slot] >= within[2])
                        & (high_y[slot] <= within[3])
                        & (low_z[slot] >= within[4])
                        & (high_z[slot] <= within[5]);
                    touches | !is_within
                };
                // In blocks: most have nothing to ask about, and to find that out takes no branch for each bound.
                for first in (0..self.keys.len()).step_by(BLOCK) {
                    let block = first..(first + BLOCK).min(self.keys.len());
                    if block.clone().fold(false, |any, slot| any | is_in_doubt(slot)) {
                        block.filter(|&slot| is_in_doubt(slot)).for_each(&mut ask);
                    }
                }
            }
        }
        exposed[start..].sort_unstable();
        tested
    }

    fn len(&self) -> usize {
        self.keys.len()
    }

    fn shrink(&mut self) {
        if self.keys.is_empty() {
            *self = FlatIndex { updates: self.updates, ..FlatIndex::default() };
        }
    }

    fn memory_bytes(&self) -> usize {
        self.slots.memory_bytes()
            + self.keys.capacity() * size_of::<u32>()
            + self.bounds.capacity() * size_of::<Bound>()
            + self.sides.iter().map(|side| side.capacity() * size_of::<f32>()).sum::<usize>()
    }

    fn update_visits(&self) -> u64 {
        self.updates
    }
}

/// How many boxes are looked at together.
const BLOCK: usize = 32;

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::collections::BTreeMap;

    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    /// Hides what is inside `within` and does not touch `open`, and counts how often it is asked.
    struct Window {
        open: Option<Open>,
        asked: Cell<usize>,
    }

    impl Window {
        fn of(open: Aabb) -> Window {
            let within = Aabb::new(DVec3::splat(-50.0), DVec3::splat(50.0));
            Window { open: Some(Open { open, within }), asked: Cell::new(0) }
        }

        fn truth(&self, bound: &Bound) -> bool {
            let (Some(aabb), Some(Open { open, within })) = (bound.outer_box(), &self.open) else { return false };
            let apart = aabb.max.cmplt(open.min).any() || aabb.min.cmpgt(open.max).any();
            within.contains_box(&aabb) && apart
        }
    }

    impl Occlusion for Window {
        fn hides(&self, bound: &Bound) -> bool {
            self.asked.set(self.asked.get() + 1);
            self.truth(bound)
        }

        fn open(&self) -> Option<Open> {
            self.open
        }
    }

    fn ball(x: f64, z: f64, radius: f64) -> Bound {
        Bound::Sphere { centre: DVec3::new(x, 0.0, z), radius }
    }

    #[test]
    fn what_is_far_from_the_open_box_is_not_asked_about() {
        let window = Window::of(Aabb::new(DVec3::new(0.0, -1.0, 0.0), DVec3::new(5.0, 1.0, 5.0)));
        let mut index = FlatIndex::default();
        for key in 0..1000 {
            index.insert(key, ball(-20.0 - f64::from(key) * 0.01, 10.0, 1.0));
        }
        index.insert(7, ball(6.0, 2.0, 0.5));
        index.insert(8, ball(4.0, 2.0, 0.5));
        let mut exposed = Vec::new();
        index.exposed(&window, &mut exposed);
        assert_eq!(exposed, [8]);
        assert!(window.asked.get() <= 2, "{} were asked about", window.asked.get());
    }

    #[test]
    fn nothing_open_hides_all_but_what_has_no_box_or_lies_beyond() {
        let window = Window::of(Aabb::EMPTY);
        let mut index = FlatIndex::default();
        let bounds = [ball(0.0, 0.0, 1.0), Bound::Everywhere, ball(f64::NAN, 0.0, 1.0), ball(49.5, 0.0, 1.0)];
        for (key, bound) in (0..).zip(bounds) {
            index.insert(key, bound);
        }
        let mut exposed = Vec::new();
        index.exposed(&window, &mut exposed);
        assert_eq!(exposed, [1, 2, 3]);
    }

    proptest! {
        /// It says what asking about each bound says, with a box and without.
        #[test]
        fn it_agrees_with_asking_about_each(
            steps in prop::collection::vec((0u32..60, any::<bool>(), -60.0..60.0f64, -60.0..60.0f64, 0.0..20.0f64), 0..150),
            corner in (-60.0..60.0f64, -60.0..60.0f64),
            size in (0.0..40.0f64, 0.0..40.0f64),
            knows in any::<bool>(),
        ) {
            let low = DVec3::new(corner.0, -30.0, corner.1);
            let mut window = Window::of(Aabb::new(low, low + DVec3::new(size.0, 60.0, size.1)));
            let mut index = FlatIndex::default();
            let mut model: BTreeMap<u32, Bound> = BTreeMap::new();
            for (key, is_in, x, z, radius) in steps {
                if is_in {
                    index.insert(key, ball(x, z, radius));
                    model.insert(key, ball(x, z, radius));
                } else {
                    prop_assert_eq!(index.remove(key), model.remove(&key).is_some());
                }
                prop_assert_eq!(index.len(), model.len());
            }
            let expected: Vec<u32> = model.iter().filter(|(_, bound)| !window.truth(bound)).map(|(&key, _)| key).collect();
            if !knows {
                // It hides the same but does not say where.
                let open = window.open.take();
                let all: Vec<u32> = model.keys().copied().collect();
                let mut exposed = Vec::new();
                index.exposed(&window, &mut exposed);
                prop_assert_eq!(exposed, all);
                window.open = open;
            }
            let mut exposed = Vec::new();
            index.exposed(&window, &mut exposed);
            prop_assert_eq!(exposed, expected);
        }
    }
}
