//! What a tracker counted.

/// Counters since the start. All are numbers of events unless they say otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrackerStats {
    /// Frames.
    pub frames: u64,
    /// Of these, those with the same occlusion as the frame before: the eye stood still.
    pub still_frames: u64,
    /// Bounds that were tested against an occlusion, and nodes of T visited.
    pub work: u64,
    /// Bounds found sealed off from wherever the eye can go, and left alone.
    pub sealed: u64,
    /// Bounds that became visible and cost a request.
    pub exposed: u64,
    /// Stages that ended hidden: growth that cost no message.
    pub stages: u64,
    /// Bounds whose time was up.
    pub expired: u64,
    /// Violations heard of.
    pub violated: u64,
    /// Objects that came into view.
    pub revealed: u64,
    /// Objects that went out of view.
    pub released: u64,
    /// Requests sent again.
    pub resent: u64,
    /// States and bounds that came too late to be believed.
    pub stale: u64,
    /// States of objects that had been released.
    pub unwanted: u64,
    /// Bounds that a later exact state proved wrong: a peer's mistake.
    pub broken_bounds: u64,
    /// Microseconds for which bounds were believed that their objects had broken, summed over objects.
    pub broken_believed_micros: u64,
}
