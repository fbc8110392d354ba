//! How often was a number how large? Counts between fixed bounds, as Prometheus has them.

/// Counts of values between fixed bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    bounds: &'static [f64],
    /// One more than there are bounds: the last one's values are beyond all.
    counts: Vec<u64>,
    sum: f64,
}

impl Histogram {
    /// An empty one. A value counts for the first of `bounds` (ascending) that is not below it.
    pub fn new(bounds: &'static [f64]) -> Histogram {
        Histogram { bounds, counts: vec![0; bounds.len() + 1], sum: 0.0 }
    }

    /// Counts a value; one that is no number counts as beyond all.
    pub fn observe(&mut self, value: f64) {
        let index =
            if value.is_nan() { self.bounds.len() } else { self.bounds.partition_point(|&bound| bound < value) };
        self.counts[index] += 1;
        self.sum += if value.is_finite() { value } else { 0.0 };
    }

    /// Upper bounds, and how many values are between each and the one before; the last is infinite.
    pub fn buckets(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        self.bounds.iter().copied().chain([f64::INFINITY]).zip(self.counts.iter().copied())
    }

    /// Number of values.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Sum of all finite values.
    pub fn sum(&self) -> f64 {
        self.sum
    }
}

/// Bounds of durations, seconds: from 50 µs to 1 s.
pub const SECONDS: &[f64] =
    &[0.000_05, 0.000_1, 0.000_25, 0.000_5, 0.001, 0.002_5, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0];

/// Bounds of numbers of things: powers of two, and 0.
pub const NUMBERS: &[f64] =
    &[0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1_024.0, 2_048.0, 4_096.0, 16_384.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_counts_for_the_first_bound_that_is_not_below_it() {
        let mut histogram = Histogram::new(&[0.0, 1.0, 2.0]);
        for value in [-1.0, 0.0, 0.5, 1.0, 1.5, 2.0, 2.1, f64::INFINITY, f64::NAN] {
            histogram.observe(value);
        }
        let buckets: Vec<_> = histogram.buckets().collect();
        assert_eq!(buckets, [(0.0, 2), (1.0, 2), (2.0, 2), (f64::INFINITY, 3)]);
        assert_eq!((histogram.count(), histogram.sum()), (9, 6.1));
    }

    #[test]
    fn bounds_ascend() {
        for bounds in [SECONDS, NUMBERS] {
            assert!(bounds.is_sorted_by(|a, b| a < b));
        }
    }
}
