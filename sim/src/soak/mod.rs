//! Does the whole system keep its promises, whatever happens? Towns made from seeds, and checkers that know the truth.
//!
//! [`Town`] is a server and many clients among walls, over links that lose, delay and reorder, in virtual time. [`Truth`] watches
//! it and says where a promise of DESIGN §3 was broken.

mod index;
mod town;
mod truth;
mod walker;
mod walls;

pub use index::{IndexView, PlainIndex};
pub use town::{Town, TownRules};
pub use truth::{Allowance, Truth};
pub use walker::{Crowd, Standing, Walk, Walker};
pub use walls::{Wall, Walls, WallsFrom};
