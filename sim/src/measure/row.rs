//! One row of a measurement's report, and what its columns mean.

use serde::Serialize;

use eyeline_server::world::AVATAR_CLASS;

use super::{MeasureConfig, Net, RunLog, Truth};
use crate::report::Column;
use crate::virtual_net::LinkRules;

/// One policy, measured.
#[derive(Clone, Debug, Serialize)]
#[expect(missing_docs, reason = "each column's meaning is in `columns`, where the report takes it from")]
pub struct MeasureRow {
    pub policy: String,
    pub setting: String,
    pub net: &'static str,
    pub clients: usize,
    pub objects: usize,
    pub hidden_mean: f64,
    pub seconds: f64,
    pub tick_hz: u32,
    pub resolution: String,
    pub interest: String,
    pub rtt_ms: f64,
    pub jitter_ms: f64,
    pub loss: f64,
    pub blur: f64,
    pub lead: String,
    pub lead_ms: f64,
    pub avatars: usize,
    pub messages_per_client_s: f64,
    pub pushed_per_client_s: f64,
    pub hidden_caused_per_client_s: f64,
    pub poses_per_client_s: f64,
    pub requests_per_client_s: f64,
    pub unknown_per_client_s: f64,
    pub exposed_per_client_s: f64,
    pub expired_per_client_s: f64,
    pub violated_per_client_s: f64,
    pub roster_per_client_s: f64,
    pub bounds_per_client_s: f64,
    pub releases_per_client_s: f64,
    pub messages_up_per_client_s: f64,
    pub messages_down_per_client_s: f64,
    pub datagrams_per_client_s: f64,
    pub datagrams_up_per_client_s: f64,
    pub datagrams_down_per_client_s: f64,
    pub udp_bytes_per_client_s: f64,
    pub udp_bytes_up_per_client_s: f64,
    pub udp_bytes_down_per_client_s: f64,
    pub truth_frames: u64,
    pub truth_frames_percent: f64,
    pub truth_visible_object_ms: f64,
    pub unknown_object_ms: f64,
    pub missed_object_ms: f64,
    pub missed_percent: f64,
    pub missed_px: u64,
    pub reveals: u64,
    pub late_over_bound: u64,
    pub reveal_p50_ms: f64,
    pub reveal_p99_ms: f64,
    pub position_error_p50_m: f64,
    pub position_error_p99_m: f64,
    pub position_error_p99_px: f64,
    pub ghost_object_ms: f64,
    pub overdisclosed_per_client_s: f64,
    pub client_frame_ms: f64,
    pub client_frame_p95_ms: f64,
    pub client_late_p99_ms: f64,
    pub frames_skipped: u64,
    pub server_us_per_message: f64,
    pub server_tick_p99_ms: f64,
    pub server_longest_ms: f64,
    pub bound_ms: f64,
    pub pixels_checked: u64,
    pub pixels_undecided: u64,
    pub pixels_differing: u64,
    pub late_refuted: u64,
    pub requests_resent: u64,
    pub poses_clamped: u64,
    pub slid_steps: u64,
    pub violations: u64,
    pub broken_bound_object_ms: f64,
    pub message_digest: String,
}

/// What the columns mean.
pub fn columns() -> Vec<Column> {
    let column = |key: &str, unit: &str, meaning: &str| Column::new(key, unit, meaning);
    vec![
        column(
            "policy",
            "",
            "whom the server tells: visible (ours), broadcast (everybody), oracle (exactly what can be seen, all round), radius \
             (what is near), grid (what is in nine squares), pvs (what is in cells that a table has)",
        ),
        column("setting", "", "what the policy was set to"),
        column(
            "net",
            "",
            "quic: real QUIC over loopback in real time; sim: a simulated network in virtual time; sim-quic: the same with QUIC's own state machines",
        ),
        column("clients", "", "watching clients, each with an avatar"),
        column("objects", "", "things that may move, avatars included"),
        column("hidden_mean", "", "objects that own no pixel in any direction, per client, mean"),
        column("seconds", "s", "measured time"),
        column("tick_hz", "1/s", "ticks, and frames, a second"),
        column("resolution", "px", "of the frames, 90° across"),
        column("interest", "", "which directions a client hears of"),
        column("rtt_ms", "ms", "smoothed round trip, mean over frames"),
        column("jitter_ms", "ms", "jitter of the simulated network, each way"),
        column("loss", "", "share of datagrams that it loses, each way"),
        column("blur", "m", "least radius within which a hidden object's place stays uncertain"),
        column("lead", "", "how the lead was chosen: none, auto or fixed"),
        column("lead_ms", "ms", "how far ahead visibility was tested, mean over frames"),
        column("avatars", "", "avatars in the world, watching or not"),
        column("messages_per_client_s", "1/s", "records about one object, both ways, per client"),
        column("pushed_per_client_s", "1/s", "of these, states for clients that want updates of an object"),
        column(
            "hidden_caused_per_client_s",
            "1/s",
            "of these, what exists because objects are hidden: requests, states told once to find out, bounds, releases, violations",
        ),
        column("poses_per_client_s", "1/s", "of these, the client's own poses"),
        column("requests_per_client_s", "1/s", "of these, requests"),
        column("unknown_per_client_s", "1/s", "of the requests, those because no bound was held"),
        column("exposed_per_client_s", "1/s", "of the requests, those because a bound came into sight"),
        column("expired_per_client_s", "1/s", "of the requests, those because a bound's time was up"),
        column(
            "violated_per_client_s",
            "1/s",
            "requests because a bound was broken, and what announces and acknowledges that",
        ),
        column("roster_per_client_s", "1/s", "objects that came or went"),
        column("bounds_per_client_s", "1/s", "of these, bounds"),
        column("releases_per_client_s", "1/s", "of these, objects let go"),
        column(
            "messages_up_per_client_s",
            "1/s",
            "messages to the server, as sent; the parts by kind are as they arrived there",
        ),
        column("messages_down_per_client_s", "1/s", "messages from the server"),
        column(
            "datagrams_per_client_s",
            "1/s",
            "UDP datagrams, both ways, QUIC's own included; in virtual time those that arrived, QUIC apart",
        ),
        column("datagrams_up_per_client_s", "1/s", "UDP datagrams to the server"),
        column("datagrams_down_per_client_s", "1/s", "UDP datagrams from the server"),
        column("udp_bytes_per_client_s", "B/s", "UDP payload, both ways"),
        column("udp_bytes_up_per_client_s", "B/s", "UDP payload to the server"),
        column("udp_bytes_down_per_client_s", "B/s", "UDP payload from the server"),
        column("truth_frames", "", "frames that the truth was computed for"),
        column("truth_frames_percent", "%", "share of all frames"),
        column(
            "truth_visible_object_ms",
            "ms",
            "time for which objects owned a pixel in those frames, summed over objects",
        ),
        column("unknown_object_ms", "ms", "of this, time for which the client did not know where the object was"),
        column("missed_object_ms", "ms", "of this, time for which it did not draw the object"),
        column("missed_percent", "%", "missed_object_ms in percent of truth_visible_object_ms: the picture's error"),
        column("missed_px", "px", "pixels of objects that were not drawn, summed over frames"),
        column("reveals", "", "objects that came into view within a burst"),
        column(
            "late_over_bound",
            "",
            "objects drawn later than the promise allows: one round trip (greatest of 5 s), one turnaround, one frame; with a \
             lead of that length the turnaround only; in virtual time each loss that concerns them adds a retry",
        ),
        column(
            "reveal_p50_ms",
            "ms",
            "median time from an object's first pixel to its first drawing, or to its last pixel if it was never drawn",
        ),
        column("reveal_p99_ms", "ms", "99th percentile of that"),
        column("position_error_p50_m", "m", "distance of a shown object from its committed place, median"),
        column("position_error_p99_m", "m", "99th percentile of that"),
        column("position_error_p99_px", "px", "the same in pixels at its distance"),
        column("ghost_object_ms", "ms", "time for which objects were drawn that are not in the world"),
        column(
            "overdisclosed_per_client_s",
            "1/s",
            "states received of objects that could not be seen in any direction",
        ),
        column("client_frame_ms", "ms", "culling and tracking per frame, mean; in virtual time culling only"),
        column("client_frame_p95_ms", "ms", "95th percentile of that"),
        column("client_late_p99_ms", "ms", "how late frames began, 99th percentile"),
        column("frames_skipped", "", "frames left out because the load generator came a whole frame late"),
        column("server_us_per_message", "µs", "the server's own work over all messages in and out"),
        column("server_tick_p99_ms", "ms", "work of a tick, 99th percentile"),
        column("server_longest_ms", "ms", "the server's longest piece of work: the turnaround in the promise"),
        column("bound_ms", "ms", "the promise's bound without its frame: greatest round trip and turnaround"),
        column("pixels_checked", "", "random pixels of the truth's images that f64 rays were cast through"),
        column("pixels_undecided", "", "of these, too near an edge or a tie to decide"),
        column("pixels_differing", "", "of these, where the rays saw something else"),
        column("late_refuted", "", "verdicts of late that rays did not bear out, dropped"),
        column("requests_resent", "", "requests sent again because no answer came"),
        column("poses_clamped", "", "poses held back to their motion bound"),
        column("slid_steps", "", "steps of recorded people that led into a wall, and along it instead"),
        column("violations", "", "bounds broken on purpose: teleports, entering, leaving"),
        column("broken_bound_object_ms", "ms", "time for which clients believed bounds that had been broken, summed"),
        column(
            "message_digest",
            "",
            "in virtual time, a digest of every message that arrived and when: the same seed gives the same",
        ),
    ]
}

pub(super) fn row(log: &RunLog, truth: &Truth, config: &MeasureConfig, net: &Net) -> MeasureRow {
    let link = match net {
        Net::Quic => LinkRules::default(),
        Net::QuicOver(link) | Net::Sim(link) | Net::SimQuic(link) => *link,
    };
    let clients = log.clients.len().max(1) as f64;
    let seconds = log.window.as_secs_f64();
    let rate = |count: u64| count as f64 / clients / seconds;
    let all = log.up.plus(&log.down);
    // Sent, not arrived: what gets lost on the way has been traffic too.
    let sent_up: u64 = log.clients.iter().map(|client| client.sent).sum();
    let frames: Vec<_> = log.clients.iter().flat_map(|client| &client.frames).collect();
    let sorted_ms = |f: &dyn Fn(&super::FrameLog) -> std::time::Duration| {
        let mut values: Vec<f64> = frames.iter().map(|frame| f(frame).as_secs_f64() * 1e3).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let frame_ms = sorted_ms(&|frame| frame.cull + frame.track);
    let late_ms = sorted_ms(&|frame| frame.late);
    let rtt_ms = sorted_ms(&|frame| frame.round_trip);
    let udp = log.clients.iter().fold([0; 4], |sum, client| std::array::from_fn(|i| sum[i] + client.udp[i]));
    let round_trip_max = frames.iter().map(|frame| frame.round_trip_max).max().unwrap_or_default();
    let ticks_ms: Vec<f64> = log.tick_micros.iter().map(|&micros| f64::from(micros) * 1e-3).collect();
    MeasureRow {
        policy: log.policy.clone(),
        setting: config.policy.describe(&log.policy),
        net: log.net,
        clients: log.clients.len(),
        objects: log.objects.len(),
        hidden_mean: truth.hidden as f64 / truth.disclosure_frames.max(1) as f64,
        seconds,
        tick_hz: config.tick_hz,
        resolution: config.resolution.to_string(),
        interest: config.interest.to_string(),
        rtt_ms: mean(&rtt_ms),
        jitter_ms: link.jitter.as_secs_f64() * 1e3,
        loss: link.loss,
        blur: config.blur,
        lead: config.lead.to_string(),
        lead_ms: mean(&sorted_ms(&|frame| frame.ahead.time)),
        avatars: log.objects.iter().filter(|object| object.class == AVATAR_CLASS).count(),
        messages_per_client_s: rate(sent_up + log.down.total()),
        pushed_per_client_s: rate(all.pushed()),
        hidden_caused_per_client_s: rate(all.hidden_caused()),
        poses_per_client_s: rate(all.poses),
        requests_per_client_s: rate(all.requests()),
        unknown_per_client_s: rate(all.requests_unknown),
        exposed_per_client_s: rate(all.requests_exposed),
        expired_per_client_s: rate(all.requests_expired),
        violated_per_client_s: rate(all.requests_violated + all.violations + all.violation_acks),
        roster_per_client_s: rate(all.roster),
        bounds_per_client_s: rate(all.bounds),
        releases_per_client_s: rate(all.releases),
        messages_up_per_client_s: rate(sent_up),
        messages_down_per_client_s: rate(log.down.total()),
        datagrams_per_client_s: rate(udp[0] + udp[2]),
        datagrams_up_per_client_s: rate(udp[0]),
        datagrams_down_per_client_s: rate(udp[2]),
        udp_bytes_per_client_s: rate(udp[1] + udp[3]),
        udp_bytes_up_per_client_s: rate(udp[1]),
        udp_bytes_down_per_client_s: rate(udp[3]),
        truth_frames: truth.frames,
        truth_frames_percent: 100.0 * truth.frames as f64 / frames.len().max(1) as f64,
        truth_visible_object_ms: truth.visible_object_ms,
        unknown_object_ms: truth.unknown_object_ms,
        missed_object_ms: truth.missed_object_ms,
        missed_percent: 100.0 * truth.missed_object_ms / truth.visible_object_ms.max(1e-9),
        missed_px: truth.missed_px,
        reveals: truth.reveals,
        late_over_bound: truth.late,
        reveal_p50_ms: percentile(&truth.reveal_ms, 0.5),
        reveal_p99_ms: percentile(&truth.reveal_ms, 0.99),
        position_error_p50_m: percentile(&truth.error_m, 0.5),
        position_error_p99_m: percentile(&truth.error_m, 0.99),
        position_error_p99_px: percentile(&truth.error_px, 0.99),
        ghost_object_ms: truth.ghost_object_ms,
        overdisclosed_per_client_s: truth.overdisclosed as f64 / truth.disclosure_frames.max(1) as f64
            * f64::from(config.tick_hz),
        client_frame_ms: mean(&frame_ms),
        client_frame_p95_ms: percentile(&frame_ms, 0.95),
        client_late_p99_ms: percentile(&late_ms, 0.99),
        frames_skipped: log.clients.iter().map(|client| client.skipped).sum(),
        server_us_per_message: match log.digest {
            // In virtual time nothing takes any.
            Some(_) => f64::NAN,
            None => log.server_work.as_secs_f64() * 1e6 / all.total().max(1) as f64,
        },
        server_tick_p99_ms: percentile(&ticks_ms, 0.99),
        server_longest_ms: log.turnaround.as_secs_f64() * 1e3,
        bound_ms: (round_trip_max + log.turnaround).as_secs_f64() * 1e3,
        pixels_checked: truth.pixels_checked,
        pixels_undecided: truth.pixels_undecided,
        pixels_differing: truth.pixels_differing,
        late_refuted: truth.late_refuted,
        requests_resent: log.clients.iter().map(|client| client.resent).sum(),
        poses_clamped: log.poses_clamped,
        slid_steps: 0,
        violations: log.violations,
        broken_bound_object_ms: log.clients.iter().map(|client| client.broken_believed.as_secs_f64() * 1e3).sum(),
        message_digest: log.digest.map_or_else(String::new, |digest| format!("{digest:016x}")),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The value that a share of the ascending values is not above; 0 if there are none.
pub(crate) fn percentile(values: &[f64], share: f64) -> f64 {
    let last = values.len().saturating_sub(1) as f64;
    values.get((last * share).ceil() as usize).copied().unwrap_or(0.0)
}
