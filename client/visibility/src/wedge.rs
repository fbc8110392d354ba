//! Which directions count? A level view looks only so far to the sides; what lies beyond need not be heard of.
//!
//! The paper's interest is the view's frustum (Sudarsky & Gotsman 1999, §3.3). Its side planes stand upright where the view is level,
//! so that in plan it is a wedge. Who turns while an answer is under way sees beyond it: the wedge is opened by as much as a
//! head can turn in that time, and its tip is the whole region of eyes.

use std::f64::consts::{PI, TAU};

use crate::{Bound, EyeRegion};

/// The directions in plan that level views from a region of eyes may cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wedge {
    region: EyeRegion,
    yaw: f64,
    half_angle: f64,
}

/// Added to the angle against rounding, radians.
const MARGIN: f64 = 1e-9;

impl Wedge {
    /// What can be looked at from `region` in directions within `half_angle` radians of `yaw` (about +Y; 0 looks along
    /// −Z). An angle of π or more, or none, is all round.
    pub fn new(region: EyeRegion, yaw: f64, half_angle: f64) -> Wedge {
        Wedge { region, yaw, half_angle: if half_angle >= 0.0 { half_angle } else { PI } }
    }

    /// Whether no eye of the region that looks so sees any of the bound, whatever stands between. Conservative: doubt is
    /// `false`.
    pub fn excludes(&self, bound: &Bound) -> bool {
        let (centre, radius) = match *bound {
            Bound::Sphere { centre, radius } | Bound::Upright { centre, radius, .. } => (centre, radius),
            Bound::Box(aabb) if !aabb.is_empty() => {
                let size = aabb.size();
                (aabb.centre(), 0.5 * size.x.hypot(size.z))
            }
            Bound::Box(_) | Bound::Everywhere => return false,
        };
        let way = centre - self.region.centre;
        let distance = way.x.hypot(way.z);
        let reach = (radius + self.region.radius) * (1.0 + MARGIN) + MARGIN;
        if distance.is_nan() || distance <= reach {
            return false;
        }
        let bearing = (-way.x).atan2(-way.z);
        let aside = ((bearing - self.yaw + PI).rem_euclid(TAU) - PI).abs();
        aside - (reach / distance).asin() > self.half_angle + MARGIN
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    const AHEAD: DVec3 = DVec3::new(0.0, 0.0, -10.0);

    fn ball(centre: DVec3, radius: f64) -> Bound {
        Bound::Sphere { centre, radius }
    }

    #[test]
    fn what_is_behind_is_excluded_and_what_is_near_is_not() {
        let wedge = Wedge::new(EyeRegion::point(DVec3::ZERO), 0.0, PI / 4.0);
        assert!(!wedge.excludes(&ball(AHEAD, 1.0)));
        assert!(wedge.excludes(&ball(-AHEAD, 1.0)));
        assert!(!wedge.excludes(&ball(-AHEAD, 10.0)), "the eye is in it");
        assert!(!wedge.excludes(&Bound::Everywhere));
        assert!(!wedge.excludes(&ball(DVec3::splat(f64::NAN), 1.0)));
        assert!(!Wedge::new(EyeRegion::point(DVec3::ZERO), 0.0, f64::NAN).excludes(&ball(-AHEAD, 1.0)));
        // A quarter turn to the left looks along −X.
        let left = Wedge::new(EyeRegion::point(DVec3::ZERO), PI / 2.0, PI / 4.0);
        assert!(!left.excludes(&ball(DVec3::new(-10.0, 0.0, 0.0), 1.0)));
        assert!(left.excludes(&ball(DVec3::new(10.0, 0.0, 0.0), 1.0)));
    }

    proptest! {
        /// Whatever an eye of the region may look at is not excluded.
        #[test]
        fn nothing_in_view_is_excluded(
            eye in prop::array::uniform3(-1.0..1.0f64),
            to in prop::array::uniform3(-20.0..20.0f64),
            inside in prop::array::uniform3(-1.0..1.0f64),
            region_radius in 0.0..1.0f64,
            radius in 0.0..3.0f64,
            yaw in -10.0..10.0f64,
            half in 0.0..3.2f64,
        ) {
            let region = EyeRegion { centre: DVec3::new(3.0, 1.0, -2.0), radius: region_radius };
            let centre = DVec3::from_array(to);
            let eye = region.centre + DVec3::from_array(eye).clamp_length_max(1.0) * region_radius;
            let point = centre + DVec3::from_array(inside).clamp_length_max(1.0) * radius;
            let way = point - eye;
            let bearing = (-way.x).atan2(-way.z);
            let aside = ((bearing - yaw + PI).rem_euclid(TAU) - PI).abs();
            let wedge = Wedge::new(region, yaw, half);
            if aside <= half {
                prop_assert!(!wedge.excludes(&ball(centre, radius)));
                let upright = Bound::Upright { centre, radius, half_height: 1.0 };
                prop_assert!(!wedge.excludes(&upright));
            }
        }
    }
}
