//! Where something may be: boxes, spheres and everywhere.

use glam::DVec3;

/// An axis-aligned box in metres. Legal values have `min ≤ max` in each coordinate and no NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
}

impl Aabb {
    /// The box that contains nothing: growing it by a point gives that point's box.
    pub const EMPTY: Aabb = Aabb { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The box with these corners.
    pub const fn new(min: DVec3, max: DVec3) -> Aabb {
        Aabb { min, max }
    }

    /// The box of `half` extents around `centre`.
    pub fn around(centre: DVec3, half: DVec3) -> Aabb {
        Aabb { min: centre - half, max: centre + half }
    }

    /// Whether no point lies in the box.
    pub fn is_empty(&self) -> bool {
        !(self.min.cmple(self.max).all())
    }

    /// The middle of the box.
    pub fn centre(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// The side lengths of the box.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// The least box that contains both.
    pub fn union(&self, other: &Aabb) -> Aabb {
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The least box that contains this one and `point`.
    pub fn with_point(&self, point: DVec3) -> Aabb {
        Aabb { min: self.min.min(point), max: self.max.max(point) }
    }

    /// The box with every face moved outward by `margin` metres.
    pub fn inflated(&self, margin: f64) -> Aabb {
        Aabb { min: self.min - DVec3::splat(margin), max: self.max + DVec3::splat(margin) }
    }

    /// Whether `point` lies in the box or on its surface.
    pub fn contains(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }

    /// Whether `other` lies in this box, surfaces included.
    pub fn contains_box(&self, other: &Aabb) -> bool {
        self.min.cmple(other.min).all() && other.max.cmple(self.max).all()
    }

    /// Whether the closed boxes share a point.
    pub fn intersects(&self, other: &Aabb) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Distance from `point` to the nearest point of the box; 0 inside.
    pub fn distance(&self, point: DVec3) -> f64 {
        point.clamp(self.min, self.max).distance(point)
    }

    /// The box with each face one step of rounding farther out.
    fn stepped_out(&self) -> Aabb {
        let Aabb { min, max } = self;
        let down = DVec3::new(min.x.next_down(), min.y.next_down(), min.z.next_down());
        let up = DVec3::new(max.x.next_up(), max.y.next_up(), max.z.next_up());
        Aabb::new(down, up)
    }

    /// The eight corners, x fastest.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            DVec3::new(
                if i & 1 == 0 { self.min.x } else { self.max.x },
                if i & 2 == 0 { self.min.y } else { self.max.y },
                if i & 4 == 0 { self.min.z } else { self.max.z },
            )
        })
    }
}

/// A volume that contains an object: what a culler is asked about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// An axis-aligned box.
    Box(Aabb),
    /// A ball of `radius` metres.
    Sphere {
        /// Centre.
        centre: DVec3,
        /// Radius in metres, finite and at least 0.
        radius: f64,
    },
    /// An upright cylinder: what a thing that turns about the vertical axis stays in.
    Upright {
        /// Middle of its axis.
        centre: DVec3,
        /// Radius in metres, finite and at least 0.
        radius: f64,
        /// Half its height in metres, finite and at least 0.
        half_height: f64,
    },
    /// No limit is known: never hidden.
    Everywhere,
}

impl Bound {
    /// The least axis-aligned box around the bound; `None` for [`Bound::Everywhere`].
    pub fn aabb(&self) -> Option<Aabb> {
        match *self {
            Bound::Box(aabb) => Some(aabb),
            Bound::Sphere { centre, radius } => Some(Aabb::around(centre, DVec3::splat(radius))),
            Bound::Upright { centre, radius, half_height } => {
                Some(Aabb::around(centre, DVec3::new(radius, half_height, radius)))
            }
            Bound::Everywhere => None,
        }
    }

    /// A box that contains the bound, rounding included. `None` if nothing finite does or the bound makes no sense (NaN, a
    /// negative radius, an inside-out box): nobody should be asked whether that is hidden.
    pub fn outer_box(&self) -> Option<Aabb> {
        let aabb = match *self {
            Bound::Sphere { radius, .. } if radius >= 0.0 => self.aabb()?.stepped_out(),
            Bound::Upright { radius, half_height, .. } if radius >= 0.0 && half_height >= 0.0 => {
                self.aabb()?.stepped_out()
            }
            Bound::Box(aabb) => aabb,
            Bound::Sphere { .. } | Bound::Upright { .. } | Bound::Everywhere => return None,
        };
        // The centre of a box near the greatest number would be infinite.
        let sane = aabb.min.is_finite() && aabb.max.is_finite() && aabb.centre().is_finite() && !aabb.is_empty();
        sane.then_some(aabb)
    }
}
