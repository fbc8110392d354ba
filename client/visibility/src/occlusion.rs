//! What a static culler leaves behind for moving things, and the structure that holds them.

use crate::{Aabb, Bound};

/// Says whether a bound is hidden by the static scene, as seen from the eye region that it was made for.
pub trait Occlusion {
    /// True only if no point of `bound` can be seen from any eye of the region, in any direction that the interest
    /// covers. Rounds outward: a tie, or doubt, is `false`. [`Bound::Everywhere`] is never hidden.
    fn hides(&self, bound: &Bound) -> bool;

    /// A quick [`Occlusion::hides`] about a bound around several, each of which will be asked about if this is `false`: too
    /// large a bound to be worth an answer that costs much.
    fn hides_group(&self, around: &Bound) -> bool {
        self.hides(around)
    }

    /// A number that is another one whenever this may answer otherwise than before; none if that is not known. Of equal
    /// numbers a tracker learns that its eye stands still (Sudarsky & Gotsman 1999, §3.4).
    fn version(&self) -> Option<u64> {
        None
    }

    /// Of who has the same [`Occlusion::version`] as before: whether that is to be expected to go on, as of an eye that stands still,
    /// and not of one that walks about in the region that was culled for.
    fn stays(&self) -> bool {
        true
    }

    /// The parts of the scene that the eyes of the region can see into at all ([`crate::SealedParts`]), ascending; none
    /// if that is not known. While they stay the same, what [`Occlusion::seals_off`] said goes on to hold, wherever the
    /// eyes move.
    fn parts(&self) -> Option<&[u32]> {
        None
    }

    /// Whether walls seal a bound off from all these parts. What this is true of is hidden, too.
    fn seals_off(&self, bound: &Bound) -> bool {
        let _ = bound;
        false
    }

    /// Outside of which box everything is hidden, if that is known: what does not touch it need not be asked about.
    fn open(&self) -> Option<Open> {
        None
    }
}

/// What an occlusion knows at once: a bound that lies in `within` and does not touch `open`, seen from above, is hidden.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Open {
    /// Around all that may be seen; empty if nothing may.
    pub open: Aabb,
    /// Around all that is known.
    pub within: Aabb,
}

/// The dynamic half of S&G's structure T: holds one bound per key, and walks them against an occlusion without
/// touching what lies in hidden nodes (Sudarsky & Gotsman 1999, §4).
pub trait DynamicIndex {
    /// Inserts `key`, or moves it if it is there already.
    fn insert(&mut self, key: u32, bound: Bound);
    /// Removes `key`; returns whether it was there.
    fn remove(&mut self, key: u32) -> bool;
    /// Appends to `exposed` every key whose bound `occlusion` does not hide, in ascending order of key. Returns the
    /// work done: nodes visited plus bounds tested.
    fn exposed(&self, occlusion: &dyn Occlusion, exposed: &mut Vec<u32>) -> usize;
    /// Number of bounds held.
    fn len(&self) -> usize;
    /// Whether none is held.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Gives back the memory that it keeps for bounds that have gone, if it is empty.
    fn shrink(&mut self) {}
    /// Bytes that it takes, by the capacity of its lists; an estimate where a map does not tell.
    fn memory_bytes(&self) -> usize;
    /// Nodes that [`DynamicIndex::insert`] and [`DynamicIndex::remove`] have looked at since it was made. Keys in a structure
    /// without nodes count as one each.
    fn update_visits(&self) -> u64;
}

/// An image that a traversal draws occluders into and asks about boxes: what is left of a query back end when cPLP's
/// traversal is taken away. One target may be one view or six (all round).
pub trait Target {
    /// Draws these primitives of the scene that the target was made for.
    fn draw(&mut self, primitives: &[u32]);
    /// Whether any point of the box may be seen past what was drawn so far: in the view, and not certainly behind.
    /// Rounds outward: doubt is `true`. A box that touches the eye or the near plane is visible.
    fn sees(&self, aabb: &Aabb) -> bool;
    /// Whether any point of the box may be in the view at all, whatever was drawn: the cheap half of [`Target::sees`],
    /// for cells that are drawn by guess. Rounds outward too. A target that looks all round keeps this default.
    fn in_view(&self, aabb: &Aabb) -> bool {
        let _ = aabb;
        true
    }
    /// Whether a sealed face lets nothing be seen past it, once the triangles of the cell in front of it were drawn: every
    /// primitive that shows beyond it has a point within the face's skin of the place where it is seen through the face.
    /// Doubt is `false`, and so is the answer of a target that does not know: it is then asked about the cell behind instead.
    fn believes(&self, seal: &crate::SealedFace<'_>) -> bool {
        let _ = seal;
        false
    }
    /// Whether nothing more can be seen anywhere in the image, so that a traversal may stop.
    fn is_full(&self) -> bool;
}
