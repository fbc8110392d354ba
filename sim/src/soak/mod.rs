//! Does the whole system keep its promises, whatever happens? Towns made from seeds, and checkers that know the truth.
//!
//! [`Town`] is a server and many clients among walls, over links that lose, delay and reorder, in virtual time. Two checkers watch
//! it and say where a promise of DESIGN §3 was broken: [`Truth`] looks at what clients believe and draw (contained, never late),
//! [`Heard`] at what they are told (true, and no more than they may know). [`Mutant`]s show that they notice.

mod checks;
mod failures;
mod feasible;
mod heard;
mod index;
pub mod long;
mod mutant;
mod run;
mod sight;
mod town;
mod truth;
mod walk;
mod walker;
mod walls;

pub use failures::Failures;
pub use feasible::{Disc, Feasible, enclosing_radius};
pub use heard::{Heard, HeardCounts, Secrecy};
pub use index::{IndexView, PlainIndex};
pub use mutant::Mutant;
pub use run::{Outcome, SoakConfig, SoakCounts, Summary, hunt, live, run_seed, soak};
pub use sight::{Ground, Sight};
pub use town::{Town, TownRules};
pub use truth::{Allowance, Truth};
pub use walk::{Board, Walk};
pub use walker::{Crowd, Standing, Walker};
pub use walls::{Wall, Walls, WallsFrom};
