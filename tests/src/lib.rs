//! Whole-system tests: worlds, clients and links in virtual time, and checkers that know the truth.
//!
//! [`Pair`] is one server, one client, one link. [`Town`] is many clients among walls, made from a seed. [`Truth`] watches a
//! run and says where a promise of DESIGN §3 was broken. The scenarios are in `tests/it`.

mod index;
mod pair;
mod town;
mod truth;
mod walker;
mod walls;

pub use index::{IndexView, PlainIndex};
pub use pair::{HIDDEN, Log, OPEN, Pair, PairBuilder};
pub use town::{Town, TownRules};
pub use truth::{Allowance, Truth};
pub use walker::{Crowd, Standing, Walk, Walker};
pub use walls::{Wall, Walls, WallsFrom};
