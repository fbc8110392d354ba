//! What a server of many people costs: people who are cheap to play, and the bare transport to hold the server against.

pub mod churn;
pub mod echo;
pub mod feed;
pub mod process;
pub mod throng;
pub mod ways;

/// Where in a period the frames of a client lie, as a share of it, 0 to 1, so that no client waits for another.
///
/// Any first few are spread as evenly as all are (steps of the golden ratio): those who cull come first and cost the most, and side by
/// side they would make everybody late.
pub fn phase_of(number: usize) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    (number as f64 * GOLDEN).fract()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_first_few_are_spread_as_evenly_as_all() {
        for count in [8, 32, 1000] {
            let mut phases: Vec<f64> = (0..count).map(super::phase_of).collect();
            phases.sort_by(f64::total_cmp);
            let gaps = phases.windows(2).map(|pair| pair[1] - pair[0]);
            let most = gaps.fold(1.0 - phases[count - 1] + phases[0], f64::max);
            assert!(most * (count as f64) < 2.7, "{most} of a period between two of {count}");
        }
    }
}
