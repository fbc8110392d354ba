//! Can one plane and mask stand for two parts of a tile?

use fearless_simd::prelude::*;
use fearless_simd::u32x8;

use super::lanes::{Plane, above, is_empty};

/// Planes that differ by less than this, relative to their depth, count as one: 7 mm at a distance of 30 m.
pub(super) const SAME: f32 = 1.0 / 4096.0;

/// How two parts of a tile go together: p, which is new, and the working layer q.
pub(super) struct Fits {
    /// Moved down by what rounding may hide.
    pub(super) p_lowered: Plane,
    pub(super) q_lowered: Plane,
    /// Whether `p_lowered` is nowhere nearer than q where q closes pixels, and the other way round.
    pub(super) p_serves: bool,
    pub(super) q_serves: bool,
    /// Whether one that serves is hardly farther than the other, too.
    pub(super) is_same: bool,
    /// Whether the other closes all of its pixels at least about as near.
    pub(super) p_adds_nothing: bool,
    pub(super) q_adds_nothing: bool,
}

impl Fits {
    /// `same` is what counts as no difference.
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, p: &Plane, p_mask: u32x8<S>, q: &Plane, q_mask: u32x8<S>, same: f32) -> Fits {
        let slack = p.rounding() + q.rounding();
        let p_lowered = Plane { at: p.at - 2.0 * slack, ..*p };
        let q_lowered = Plane { at: q.at - 2.0 * slack, ..*q };
        let p_serves = is_empty(simd, q_mask & !above(simd, &q.minus(&p_lowered), slack));
        let q_serves = is_empty(simd, p_mask & !above(simd, &p.minus(&q_lowered), slack));
        let p_over_q = p.minus(q);
        let q_is_near = is_empty(simd, p_mask & above(simd, &p_over_q, same));
        let p_is_near = is_empty(simd, q_mask & above(simd, &q.minus(p), same));
        Fits {
            p_lowered,
            q_lowered,
            p_serves,
            q_serves,
            is_same: p_serves && p_is_near || q_serves && q_is_near && !p_serves,
            p_adds_nothing: q_is_near && is_empty(simd, p_mask & !q_mask),
            q_adds_nothing: p_is_near && is_empty(simd, q_mask & !p_mask),
        }
    }
}
