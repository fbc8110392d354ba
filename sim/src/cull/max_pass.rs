//! The yardstick: what touching every pixel of an image once costs, on this machine and at this moment.

// This is a driver: it may read the clock.
#![expect(clippy::disallowed_methods)]

use std::hint::black_box;
use std::time::Instant;

use eyeline_visibility::Resolution;

use super::run::millis;

/// One f32 max with a constant over a buffer of an image's pixels: what touching every pixel once costs.
pub struct MaxPass {
    buffer: Vec<f32>,
    next: f32,
}

impl MaxPass {
    /// A buffer for images of this size.
    pub fn new(resolution: Resolution) -> MaxPass {
        MaxPass { buffer: vec![0.0; resolution.pixels()], next: 0.0 }
    }

    /// One pass.
    #[inline(never)]
    pub fn pass(&mut self) {
        // Another value each time, or the compiler could see that nothing changes.
        self.next += 1e-3;
        let value = black_box(self.next);
        for depth in &mut self.buffer {
            *depth = if *depth > value { *depth } else { value };
        }
        black_box(&mut self.buffer);
    }

    /// One pass, in milliseconds.
    pub(super) fn run(&mut self) -> f64 {
        let began = Instant::now();
        self.pass();
        millis(began)
    }
}
