//! Where may a hidden object be, for all that a client was told? (DESIGN §3.4)
//!
//! A bound says: inside this ball, which grows. A pose says the same with a ball as small as the motion's slack. Together they
//! say: in the intersection of them all. The checker asks how large that is: for the radius of the least circle
//! around it, in plan, since height is no secret. Who asks often and averages can learn no more than that.

use eyeline_protocol::{MotionBound, Tbv, WorldTime};
use glam::DVec2;

use super::walls::plan;

/// Something that a client was told: the object is in this disc, which grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Middle, x and z.
    pub centre: DVec2,
    /// Radius at `since`, metres.
    pub radius: f64,
    /// Growth until `until`, m/s.
    pub speed: f64,
    /// When it was true.
    pub since: WorldTime,
    /// From when on only the motion bound says anything.
    pub until: WorldTime,
}

impl Disc {
    /// What a bound says.
    pub fn of_bound(tbv: &Tbv) -> Disc {
        let centre = plan(tbv.centre.metres());
        Disc { centre, radius: tbv.radius, speed: tbv.speed, since: tbv.issued, until: tbv.expires }
    }

    /// What a pose of time `tick` says about something that moves as `motion` says.
    pub fn of_pose(place: DVec2, tick: WorldTime, motion: MotionBound) -> Disc {
        Disc { centre: place, radius: motion.slack, speed: motion.speed_max, since: tick, until: WorldTime::MAX }
    }

    /// Radius at `time`, for something that moves as `motion` says.
    fn radius_at(&self, time: WorldTime, motion: MotionBound) -> f64 {
        let held = time.min(self.until).seconds_since(self.since).max(0.0);
        let beyond = time.seconds_since(self.until);
        let beyond = if beyond <= 0.0 || self.speed >= motion.speed_max {
            self.speed * beyond.max(0.0)
        } else {
            motion.slack + motion.speed_max * beyond
        };
        self.radius + self.speed * held + beyond
    }
}

/// Everything that one client was told of one object and that still says something.
#[derive(Clone, Debug, Default)]
pub struct Feasible {
    discs: Vec<Disc>,
}

impl Feasible {
    /// Something more was told.
    pub fn add(&mut self, disc: Disc) {
        // The same again, as of something that stands still or follows a path.
        if !self.discs.contains(&disc) {
            self.discs.push(disc);
        }
    }

    /// What was true before `time` says nothing any more: the object broke its bound then.
    pub fn forget_before(&mut self, time: WorldTime) {
        self.discs.retain(|disc| disc.since >= time);
    }

    /// Nothing is known.
    pub fn clear(&mut self) {
        self.discs.clear();
    }

    /// Radius of the least circle around the set at `time`, metres, never too great; infinite if nothing was told, and 0 for
    /// an empty set, which only lies make. Forgets what has come to say nothing.
    pub fn enclosing_radius(&mut self, time: WorldTime, motion: MotionBound) -> f64 {
        if let [disc] = self.discs[..] {
            return disc.radius_at(time, motion);
        }
        let mut kept: Vec<(Disc, f64)> = Vec::with_capacity(self.discs.len());
        for &disc in &self.discs {
            let radius = disc.radius_at(time, motion);
            // One disc in another that grows as fast: the other says nothing, now and for ever.
            let says_less = |a: &Disc, a_radius: f64, b: &Disc, b_radius: f64| {
                a.centre.distance(b.centre) + b_radius <= a_radius + 1e-12
                    && (a.speed >= motion.speed_max || a.speed >= b.speed && a.until <= b.until)
            };
            if kept.iter().any(|(other, other_radius)| says_less(&disc, radius, other, *other_radius)) {
                continue;
            }
            kept.retain(|(other, other_radius)| !says_less(other, *other_radius, &disc, radius));
            kept.push((disc, radius));
        }
        self.discs = kept.iter().map(|&(disc, _)| disc).collect();
        let discs: Vec<(DVec2, f64)> = kept.iter().map(|&(disc, radius)| (disc.centre, radius)).collect();
        enclosing_radius(&discs)
    }
}

/// Points of each circle that are tried: an arc between two of them bulges by at most 1 − cos(π/64), a thousandth of its radius.
const DIRECTIONS: u32 = 64;

/// Radius of the least circle around the intersection of discs (middle, radius): at most the true one, and less by a
/// thousandth of the least disc's radius at most.
///
/// The border of an intersection of discs is made of arcs of their circles, which end where two circles cross. So the crossings, and
/// some points of each circle, that lie in all discs are points of the set.
pub fn enclosing_radius(discs: &[(DVec2, f64)]) -> f64 {
    let Some(&(least, least_radius)) = discs.iter().min_by(|a, b| a.1.total_cmp(&b.1)) else { return f64::INFINITY };
    if discs.iter().all(|&(centre, radius)| centre.distance(least) + least_radius <= radius + 1e-12) {
        return least_radius;
    }
    let is_in_all = |point: DVec2| discs.iter().all(|&(centre, radius)| centre.distance(point) <= radius + 1e-9);
    let mut points = Vec::new();
    for (i, &(a, a_radius)) in discs.iter().enumerate() {
        for &(b, b_radius) in &discs[..i] {
            let way = b - a;
            let distance = way.length();
            if distance <= 1e-12 {
                continue;
            }
            let along = (distance * distance + a_radius * a_radius - b_radius * b_radius) / (2.0 * distance);
            let across = a_radius * a_radius - along * along;
            if across >= 0.0 {
                let (foot, side) = (a + way * (along / distance), way.perp() * (across.sqrt() / distance));
                points.extend([foot + side, foot - side].into_iter().filter(|&point| is_in_all(point)));
            }
        }
        let around = (0..DIRECTIONS).map(|i| f64::from(i) * std::f64::consts::TAU / f64::from(DIRECTIONS));
        points.extend(around.map(|angle| a + DVec2::from_angle(angle) * a_radius).filter(|&point| is_in_all(point)));
    }
    around_points(&points)
}

/// Radius of the least circle around points: one goes through two or three of them (Welzl 1991, without his recursion).
fn around_points(points: &[DVec2]) -> f64 {
    let Some(&first) = points.first() else { return 0.0 };
    let is_out = |(centre, radius): (DVec2, f64), point: DVec2| centre.distance(point) > radius + 1e-10;
    let mut circle = (first, 0.0);
    for (i, &a) in points.iter().enumerate() {
        if !is_out(circle, a) {
            continue;
        }
        circle = (a, 0.0);
        for (j, &b) in points[..i].iter().enumerate() {
            if !is_out(circle, b) {
                continue;
            }
            circle = ((a + b) * 0.5, a.distance(b) * 0.5);
            for &c in &points[..j] {
                if is_out(circle, c) {
                    circle = through(a, b, c).unwrap_or(circle);
                }
            }
        }
    }
    circle.1
}

/// The circle through three points; `None` if they are on a line.
fn through(a: DVec2, b: DVec2, c: DVec2) -> Option<(DVec2, f64)> {
    let (u, v) = (b - a, c - a);
    let twice = 2.0 * u.perp_dot(v);
    if twice.abs() < 1e-18 {
        return None;
    }
    let (u2, v2) = (u.length_squared(), v.length_squared());
    let centre = a + DVec2::new(v.y * u2 - u.y * v2, u.x * v2 - v.x * u2) / twice;
    Some((centre, centre.distance(a)))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const WALK: MotionBound = MotionBound { speed_max: 2.0, slack: 0.1 };

    fn disc(x: f64, radius: f64, millis: i64) -> Disc {
        let since = WorldTime::from_micros(millis * 1_000);
        Disc { centre: DVec2::new(x, 0.0), radius, speed: 2.0, since, until: WorldTime::MAX }
    }

    #[test]
    fn discs_side_by_side_leave_a_lens() {
        let lens = enclosing_radius(&[(DVec2::ZERO, 1.0), (DVec2::X, 1.0)]);
        assert!((lens - 0.75f64.sqrt()).abs() < 1e-9, "{lens}");
        assert_eq!(enclosing_radius(&[(DVec2::ZERO, 1.0), (DVec2::X * 0.2, 2.0)]), 1.0);
        assert_eq!(enclosing_radius(&[]), f64::INFINITY);
        assert_eq!(enclosing_radius(&[(DVec2::ZERO, 1.0), (DVec2::X * 5.0, 1.0)]), 0.0);
    }

    #[test]
    fn the_grid_of_bounds_alone_loses_up_to_three_tenths() {
        // Both sides of a cell's border, at once: two circles around squares of side √2.
        let across = enclosing_radius(&[(DVec2::ZERO, 1.0), (DVec2::X * 2.0f64.sqrt(), 1.0)]);
        assert!((across - 0.5f64.sqrt()).abs() < 1e-9, "{across}");
    }

    #[test]
    fn what_was_told_fades_as_the_object_may_move() {
        let mut feasible = Feasible::default();
        feasible.add(Disc::of_pose(DVec2::ZERO, WorldTime::ZERO, WALK));
        let at = |millis: i64| WorldTime::from_micros(millis * 1_000);
        assert_eq!(feasible.enclosing_radius(at(0), WALK), 0.1);
        assert_eq!(feasible.enclosing_radius(at(500), WALK), 1.1);
        feasible.add(disc(1.0, 1.0, 500));
        let both = feasible.enclosing_radius(at(500), WALK);
        assert!(both > 0.85 && both < 1.0, "{both}");
        // Later they are as good as one.
        assert!(feasible.enclosing_radius(at(60_000), WALK) > 119.9);
        feasible.forget_before(at(100));
        assert_eq!(feasible.enclosing_radius(at(500), WALK), 1.0);
    }

    #[test]
    fn a_bound_by_a_path_fades_only_when_it_expires() {
        let mut feasible = Feasible::default();
        let until = WorldTime::from_micros(1_000_000);
        feasible.add(Disc { speed: 0.0, until, ..disc(0.0, 3.0, 0) });
        assert_eq!(feasible.enclosing_radius(until, WALK), 3.0);
        assert_eq!(feasible.enclosing_radius(WorldTime::from_micros(2_000_000), WALK), 5.1);
    }

    proptest! {
        /// Beside dense sampling: no less than around the samples, and no more than around those that the region's points may lie
        /// between. Where discs barely meet no sample need lie in all of them.
        #[test]
        fn the_radius_is_that_of_sampling(
            discs in prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64, 0.7..2.0f64), 2..5),
        ) {
            const STEP: f64 = 0.05;
            let discs: Vec<(DVec2, f64)> = discs.into_iter().map(|(x, y, r)| (DVec2::new(x, y), r)).collect();
            let radius = enclosing_radius(&discs);
            let sampled = |wider: f64| {
                let at = (-61..=61).flat_map(|i| (-61..=61).map(move |j| DVec2::new(f64::from(i), f64::from(j)) * STEP));
                let is_in_all = |point: &DVec2| discs.iter().all(|&(centre, r)| centre.distance(*point) <= r + wider);
                around_points(&at.filter(is_in_all).collect::<Vec<_>>())
            };
            // No point is farther from a sample.
            let near = STEP * 0.5f64.sqrt();
            let (least, most) = (sampled(0.0) - 0.003, sampled(near) + near + 0.003);
            prop_assert!(radius >= least && radius <= most, "{least} {radius} {most}");
        }
    }
}
