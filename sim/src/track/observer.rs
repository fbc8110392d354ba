//! Where is the observer of Coorg & Teller's tables? On a smooth way that is walked at some speed.

use eyeline_visibility::{Resolution, View};
use glam::DVec3;

/// Horizontal angle of view, as everywhere in the sweeps of `track`.
const FOV: f64 = std::f64::consts::FRAC_PI_2;

/// Pieces of the curve around each way point.
const PIECES: u32 = 16;

/// The observer looks at where it will be after this many metres.
const AHEAD: f64 = 0.5;

/// A smooth way: a quadratic B-spline of way points. It runs from the middle of each leg to the middle of the next, along the legs
/// there, so where the corners between are clear it is clear.
#[derive(Clone, Debug, PartialEq)]
pub struct Observer {
    places: Vec<DVec3>,
    /// Metres from the start to each place, ascending.
    along: Vec<f64>,
}

impl Observer {
    /// The way by some points. Points that are not finite are left out; without points it is the origin.
    pub fn by(points: &[DVec3]) -> Observer {
        let points: Vec<DVec3> = points.iter().copied().filter(|point| point.is_finite()).collect();
        let mut places = vec![points.first().copied().unwrap_or(DVec3::ZERO)];
        for three in points.windows(3) {
            let (from, to) = (three[0].midpoint(three[1]), three[1].midpoint(three[2]));
            places.extend((0..=PIECES).map(|piece| {
                let t = f64::from(piece) / f64::from(PIECES);
                from.lerp(three[1], t).lerp(three[1].lerp(to, t), t)
            }));
        }
        places.extend(points.last());
        places.dedup();
        let mut along = vec![0.0];
        for step in places.windows(2) {
            along.push(along[along.len() - 1] + step[0].distance(step[1]));
        }
        Observer { places, along }
    }

    /// Metres from start to end.
    pub fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// The place after some metres; the start before it and for NaN, the end after it.
    pub fn place(&self, metres: f64) -> DVec3 {
        let metres = if metres > 0.0 { metres.min(self.length()) } else { 0.0 };
        let next = self.along.partition_point(|along| *along <= metres);
        if next == 0 || next == self.places.len() {
            return self.places[next.saturating_sub(1)];
        }
        let share = (metres - self.along[next - 1]) / (self.along[next] - self.along[next - 1]);
        self.places[next - 1].lerp(self.places[next], share)
    }

    /// A level view from the place after some metres to where the way leads, in a scene's own coordinates.
    pub fn view(&self, metres: f64, anchor: DVec3, resolution: Resolution) -> View {
        // At the end, where nothing is ahead, as one came.
        let from = metres.min(self.length() - AHEAD);
        let ahead = self.place(from + AHEAD) - self.place(from);
        View::level(self.place(metres) - anchor, f64::atan2(-ahead.x, -ahead.z), FOV, resolution)
    }
}

#[cfg(test)]
mod tests {
    use eyeline_visibility::{LoadOptions, RayScene, Scene, load_glb};

    use super::*;
    use crate::scene::office::{self, OfficeRules};

    #[test]
    fn the_walk_through_the_offices_meets_nothing() {
        let rules = OfficeRules { floors: 3, cameras: 0, seed: 5 };
        let observer = Observer::by(&office::walk(&rules).unwrap());
        let scene = load_glb(&office::make(&rules).unwrap().glb, "office", &LoadOptions::default()).unwrap();
        // The furniture of one floor: that of all takes long.
        let of_others = |name: &str| name.starts_with("object.1") || name.starts_with("object.2");
        let kept = scene.nodes().iter().filter(|node| !of_others(&node.name));
        let triangles = kept
            .flat_map(|node| scene.triangles()[node.primitives.start as usize..node.primitives.end as usize].to_vec());
        let rays = RayScene::new(&Scene::from_triangles(triangles.collect()));
        assert!((700.0..1_500.0).contains(&observer.length()), "{}", observer.length());
        let (mut from, mut top) = (observer.place(0.0), 0.0_f64);
        for step in 1..(observer.length() / 0.1) as u32 {
            let to = observer.place(0.1 * f64::from(step));
            let way = to - from;
            // A body's width beside it, too.
            for aside in [DVec3::ZERO, DVec3::new(-way.z, 0.0, way.x), DVec3::new(way.z, 0.0, -way.x)] {
                let eye = from - scene.anchor() + aside.normalize_or_zero() * 0.25;
                assert!(rays.first_hit(eye, way.normalize(), 0.0, 0.1).is_none(), "at {from} to {to}");
            }
            (from, top) = (to, top.max(to.y));
        }
        // It gets to the last floor.
        assert!((2.0 * 3.2 + 1.5..2.0 * 3.2 + 1.7).contains(&top), "{top}");
    }

    #[test]
    fn a_way_is_smooth_and_has_ends() {
        let corner = Observer::by(&[DVec3::ZERO, DVec3::X * 4.0, DVec3::new(4.0, 0.0, 4.0)]);
        assert_eq!(corner.place(-1.0), DVec3::ZERO);
        assert_eq!(corner.place(f64::NAN), DVec3::ZERO);
        assert_eq!(corner.place(1e9), DVec3::new(4.0, 0.0, 4.0));
        assert!((6.5..8.0).contains(&corner.length()), "{}", corner.length());
        let turns = (0..75).map(|step| {
            let view = |metres: f64| corner.view(metres, DVec3::ZERO, Resolution::new(8, 8)).orientation;
            view(0.1 * f64::from(step)).angle_between(view(0.1 * f64::from(step + 1)))
        });
        assert!(turns.fold(0.0, f64::max) < 0.1);
        for points in [vec![], vec![DVec3::ONE], vec![DVec3::NAN, DVec3::ONE, DVec3::ONE], vec![DVec3::X; 5]] {
            let odd = Observer::by(&points);
            assert!(odd.view(0.3, DVec3::ZERO, Resolution::new(8, 8)).check().is_ok(), "{points:?}");
            assert_eq!(odd.length(), 0.0);
        }
    }
}
