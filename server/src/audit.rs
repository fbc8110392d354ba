//! Is a client told only what it may see, even if it asks for more?
//!
//! An honest client asks for what its own occlusion does not hide. A modified one may ask for everything. With an audit the
//! server looks for itself before it tells a place: *entitled* is what some eye can see that the client may have by the
//! time the answer is there (DESIGN §3.4). What is refused is answered with a bound.

use eyeline_protocol::ObjectId;

use crate::policy::Watcher;
use crate::world::Object;

#[cfg(feature = "audit")]
pub use region::RegionAudit;

/// Decides who is entitled to what.
pub trait Audit: Send {
    /// A new state has been committed.
    fn begin_tick(&mut self, objects: &[Object]) {
        let _ = objects;
    }

    /// Whether `object`, as it is committed, can be seen from an eye within `radius` metres of the watcher's. In doubt, yes:
    /// a promise to show what is visible is worth more than a place given away.
    fn entitled(&mut self, objects: &[Object], watcher: &Watcher, radius: f64, object: ObjectId) -> bool;
}

#[cfg(feature = "audit")]
mod region {
    use std::sync::Arc;

    use eyeline_protocol::{Class, ObjectId};
    use eyeline_visibility::{AllRound, AllRoundScratch, Bound, EyeRegion, Occlusion};
    use glam::DVec3;

    use super::Audit;
    use crate::policy::Watcher;
    use crate::world::{Object, SessionId};

    /// An audit with triangles: visibility from the ball of eyes, all round, by static geometry alone. What it refuses is
    /// certainly hidden from all of the ball.
    pub struct RegionAudit {
        all_round: Arc<AllRound>,
        classes: Vec<Class>,
        /// Images of the newest watchers. A few, since each takes megabytes; beyond that the oldest is drawn over.
        views: Vec<Seen>,
        next: usize,
        culls: u64,
    }

    struct Seen {
        session: SessionId,
        region: Option<EyeRegion>,
        scratch: AllRoundScratch,
    }

    /// Pixels a side of the cube, as trackers use by default. Coarser would give more away; finer would refuse more of what
    /// clients ask for in good faith, who then ask again.
    const SIDE: u32 = 128;

    const VIEWS_MAX: usize = 64;

    /// Radii are rounded up to a multiple of this, metres, so that an image serves while the round trip changes a little.
    const STEP: f64 = 1.0 / 16.0;

    impl RegionAudit {
        /// An audit of a scene. `classes` are the world's.
        pub fn new(all_round: Arc<AllRound>, classes: Vec<Class>) -> RegionAudit {
            RegionAudit { all_round, classes, views: Vec::new(), next: 0, culls: 0 }
        }

        /// Images drawn so far: at most one a watcher and tick, and none for who asks for nothing.
        pub fn culls(&self) -> u64 {
            self.culls
        }

        /// The place in `views` of an image for this region, drawn if need be; `None` if there can be none.
        fn view(&mut self, session: SessionId, eye: DVec3, radius: f64) -> Option<usize> {
            let index = match self.views.iter().position(|view| view.session == session) {
                Some(index) => index,
                None if self.views.len() < VIEWS_MAX => {
                    self.views.push(Seen { session, region: None, scratch: self.all_round.scratch(SIDE) });
                    self.views.len() - 1
                }
                None => {
                    self.next = (self.next + 1) % VIEWS_MAX;
                    (self.views[self.next].session, self.views[self.next].region) = (session, None);
                    self.next
                }
            };
            let view = &mut self.views[index];
            let region = EyeRegion { centre: eye, radius: (radius / STEP).ceil() * STEP };
            if view.region != Some(region) {
                view.region = None;
                self.culls += 1;
                self.all_round.cull(region, &mut view.scratch).ok()?;
                view.region = Some(region);
            }
            Some(index)
        }
    }

    impl Audit for RegionAudit {
        fn entitled(&mut self, objects: &[Object], watcher: &Watcher, radius: f64, object: ObjectId) -> bool {
            let Some(asked) = objects.get(object.index()) else { return false };
            let extent = self.classes[usize::from(asked.class.0)].extent;
            let place = asked.position.metres();
            let bound = Bound::Upright {
                centre: place + DVec3::Y * (0.5 * (extent.bottom + extent.top)),
                radius: extent.radius,
                half_height: 0.5 * (extent.top - extent.bottom),
            };
            match self.view(watcher.session, watcher.eye, radius) {
                Some(index) => !self.views[index].scratch.occlusion().hides(&bound),
                None => true,
            }
        }
    }
}

#[cfg(all(test, feature = "audit"))]
mod tests {
    use std::sync::Arc;

    use eyeline_protocol::{Interest, ObjectId, WorldInfo, WorldTime};
    use eyeline_visibility::{AllRound, Scene, Sides, Triangle};
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::policy::Visible;
    use crate::spec::{ClassSpec, ObjectSpec, WorldSpec};
    use crate::world::{SessionId, World, WorldConfig};

    /// A wall 20 m wide and 8 m high, 2 m before the eye; one object behind its middle, one in the open, and one 4 m
    /// behind its edge.
    fn stage() -> (RegionAudit, World) {
        let corner = |x: f32, y: f32| Vec3::new(x, y, -2.0);
        let (a, b, c, d) = (corner(-10.0, -3.0), corner(10.0, -3.0), corner(10.0, 5.0), corner(-10.0, 5.0));
        let triangle = |corners| Triangle { corners, sides: Sides::Both, occludes: true };
        let scene = Scene::from_triangles(vec![triangle([a, b, c]), triangle([a, c, d])]);
        let class = ClassSpec { name: "post".into(), radius: 0.3, bottom: 0.0, top: 1.5, speed_max: 2.0 };
        let post = |name: &str, position| ObjectSpec {
            name: name.into(),
            class: "post".into(),
            node: None,
            position,
            heading: 0.0,
            takeable: false,
            path: None,
        };
        let objects =
            vec![post("behind", [0.0, 0.0, -4.0]), post("open", [0.0, 0.0, 4.0]), post("edge", [9.0, 0.0, -6.0])];
        let spec = WorldSpec { classes: vec![class], objects, ..WorldSpec::default() };
        let info = WorldInfo { name: String::new(), hash: [0; 32], size_bytes: 0, two_sided: false };
        let config = WorldConfig::default();
        let world = World::new(config, spec, info, DVec3::ZERO, Box::new(Visible), WorldTime::ZERO).unwrap();
        (RegionAudit::new(Arc::new(AllRound::new(&scene)), world.classes().to_vec()), world)
    }

    #[test]
    fn what_no_eye_of_the_region_sees_is_refused_and_each_watcher_is_culled_for_once() {
        let (mut audit, world) = stage();
        let watcher = |session, eye| Watcher {
            session: SessionId(session),
            avatar: Some(ObjectId(9)),
            eye,
            yaw: 0.0,
            interest: Interest::Around,
        };
        let eye = DVec3::new(0.0, 1.6, 0.0);
        let mut entitled =
            |watcher: &Watcher, radius, object| audit.entitled(world.objects(), watcher, radius, ObjectId(object));
        let one = watcher(1, eye);
        assert_eq!([0, 1, 2].map(|object| entitled(&one, 0.5, object)), [false, true, false]);
        // From further along the wall an eye looks around its end, but only from a region that reaches so far.
        let two = watcher(2, DVec3::new(9.5, 1.6, -0.5));
        assert_eq!([0.0, 1.0].map(|radius| entitled(&two, radius, 2)), [false, true]);
        assert!(!entitled(&one, 0.5, 0), "the first watcher's image is still there");
        // An eye that is no place entitles to everything, since nothing can be said; an object that is not, to nothing.
        assert!(entitled(&watcher(3, DVec3::NAN), 0.5, 0));
        assert!(!entitled(&one, 0.5, 77));
        assert_eq!(audit.culls(), 4);
    }
}
