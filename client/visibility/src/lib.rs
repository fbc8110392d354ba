//! *View + scene → visible set*: scenes from glTF files and cullers over them.
//!
//! Nothing here knows of a network, a clock or another thread; it is worth using alone. The words are the papers'
//! (Klosowski & Silva 2000 and 2001, Staneker 2003, Coorg & Teller 1997, Sudarsky & Gotsman 1999).
//!
//! World: metres, right-handed, +Y up, −Z forward (glTF's convention). Inside a [`Scene`] every position is relative
//! to the scene's `anchor`.

mod all_round;
mod bound;
mod occluders;
mod occlusion;
mod scene;
mod under;
mod under_face;
mod view;

pub use all_round::{AllRound, AllRoundScratch, AllRoundStats};
pub use bound::{Aabb, Bound};
pub use occluders::Occluders;
pub use occlusion::{DynamicIndex, Occlusion, Target};
pub use scene::{Node, ObjectMesh, Scene, Sides, Triangle};
pub use under::{RegionError, UnderOcclusion, UnderStats};
pub use view::{EyeRegion, Resolution, View};
