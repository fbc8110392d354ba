//! How does it grow? One setting of a measurement, tried at several values.

use super::MeasureRow;
use crate::report::{Axis, Plot, PlotKind, Point, Series};

/// What is swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepKey {
    /// Rooms a side of a made building, with as many avatars to a room as the smallest has: hidden objects grow, what is in
    /// view does not.
    Rooms,
    /// Avatars in a world of one size, which gets fuller.
    Avatars,
    /// Watching clients.
    Clients,
    /// Round trip, milliseconds.
    Rtt,
    /// Share of datagrams lost.
    Loss,
    /// Lead: none, auto, or milliseconds.
    Lead,
    /// Blur, metres.
    Blur,
}

const KEYS: [(&str, SweepKey); 7] = [
    ("rooms", SweepKey::Rooms),
    ("avatars", SweepKey::Avatars),
    ("clients", SweepKey::Clients),
    ("rtt", SweepKey::Rtt),
    ("loss", SweepKey::Loss),
    ("lead", SweepKey::Lead),
    ("blur", SweepKey::Blur),
];

/// A setting and its values, as in `rtt=0,50,100`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    /// What is swept.
    pub key: SweepKey,
    /// Its values, as they would be given for the option itself.
    pub values: Vec<String>,
}

/// Most values of one sweep.
const VALUES_MAX: usize = 64;

impl std::str::FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Sweep, String> {
        let names = || KEYS.map(|(name, _)| name).join(", ");
        let (name, values) =
            text.split_once('=').ok_or_else(|| format!("give NAME=VALUE,VALUE,… with one of {}", names()))?;
        let known = KEYS.iter().find(|(known, _)| *known == name.trim());
        let &(_, key) = known.ok_or_else(|| format!("'{name}' is not one of {}", names()))?;
        let values: Vec<String> = values.split(',').map(|value| value.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) || values.len() > VALUES_MAX {
            return Err(format!("give 1 to {VALUES_MAX} values of {name}, with commas between them"));
        }
        Ok(Sweep { key, values })
    }
}

impl SweepKey {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        KEYS.iter().find(|&&(_, key)| key == self).map_or("", |&(name, _)| name)
    }

    /// Its axis, and where a row lies on it.
    fn axis(self) -> (Axis, fn(&MeasureRow) -> f64) {
        match self {
            SweepKey::Rooms | SweepKey::Avatars => {
                (Axis::log("objects that cannot be seen, mean"), |row| row.hidden_mean)
            }
            SweepKey::Clients => (Axis::log("watching clients"), |row| row.clients as f64),
            SweepKey::Rtt => (Axis::linear("round trip, ms"), |row| row.rtt_ms),
            SweepKey::Loss => (Axis::linear("share of datagrams lost"), |row| row.loss),
            SweepKey::Lead => (Axis::linear("lead, ms"), |row| row.lead_ms),
            SweepKey::Blur => (Axis::linear("blur, m"), |row| row.blur),
        }
    }

    /// Whether growth is a power of what is swept, so that an exponent says something.
    fn is_power(self) -> bool {
        matches!(self, SweepKey::Rooms | SweepKey::Avatars | SweepKey::Clients)
    }

    /// Its plots: traffic, error and disclosure against what is swept.
    pub fn plots(self, rows: &[MeasureRow]) -> Vec<Plot> {
        let (axis, x) = self.axis();
        let traffic = |label: &str| if self.is_power() { Axis::log(label) } else { Axis::linear(label) };
        let plot = |title: &str, y_axis: Axis, is_fitted: bool, y: &dyn Fn(&MeasureRow) -> f64| {
            let mut plot = Plot::new(title, PlotKind::Line, axis.clone(), y_axis);
            let mut fits = Vec::new();
            for policy in policies(rows) {
                let of = rows.iter().filter(|row| row.policy == policy);
                let points: Vec<(f64, f64)> = of.map(|row| (x(row), y(row))).collect();
                if let Some(exponent) = exponent(&points).filter(|_| is_fitted) {
                    fits.push(format!("{policy} {exponent:.2}"));
                }
                plot = plot.with_series(Series::new(policy, points.iter().map(|&(x, y)| Point::new(x, y)).collect()));
            }
            if fits.is_empty() { plot } else { plot.with_note(format!("Exponents: {}.", fits.join(", "))) }
        };
        let is_power = self.is_power();
        vec![
            plot("Messages", traffic("messages per client and second"), is_power, &|row| row.messages_per_client_s),
            plot("Messages caused by hidden objects", traffic("messages per client and second"), is_power, &|row| {
                row.hidden_caused_per_client_s
            }),
            plot("Bytes", traffic("UDP bytes per client and second"), is_power, &|row| row.udp_bytes_per_client_s),
            plot("Picture error", Axis::linear("time that visible objects were not drawn, %"), false, &|row| {
                row.missed_percent
            }),
            plot("Latest reveals", Axis::linear("reveal, 99th percentile, ms"), false, &|row| row.reveal_p99_ms),
            plot("Disclosure", Axis::linear("states of objects out of sight, per client and second"), false, &|row| {
                row.overdisclosed_per_client_s
            }),
        ]
    }

    /// The exponents of growth, in words; `None` where there are none.
    pub fn exponents(self, rows: &[MeasureRow]) -> Option<String> {
        let (_, x) = self.axis();
        let of = |policy: &str, y: fn(&MeasureRow) -> f64| {
            let points: Vec<_> = rows.iter().filter(|row| row.policy == policy).map(|row| (x(row), y(row))).collect();
            exponent(&points)
        };
        let text = |policy: &str| {
            let messages = of(policy, |row| row.messages_per_client_s)?;
            let hidden = of(policy, |row| row.hidden_caused_per_client_s);
            let hidden =
                hidden.map_or(String::new(), |hidden| format!(" ({hidden:.2} for those that hidden ones cause)"));
            Some(format!("{policy} {messages:.2}{hidden}"))
        };
        let texts: Vec<String> = policies(rows).into_iter().filter_map(text).collect();
        (self.is_power() && !texts.is_empty()).then(|| format!("Messages grow with the power: {}.", texts.join(", ")))
    }
}

/// The policies of these rows, in order.
fn policies(rows: &[MeasureRow]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in rows {
        if !names.contains(&row.policy.as_str()) {
            names.push(&row.policy);
        }
    }
    names
}

/// The slope of the line through these points on double logarithmic paper, by least squares; `None` of fewer than two that
/// have a logarithm, or all above one another.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|&&(x, y)| x > 0.0 && y > 0.0).map(|&(x, y)| (x.ln(), y.ln())).collect();
    let count = logs.len() as f64;
    let (sum_x, sum_y) = logs.iter().fold((0.0, 0.0), |(a, b), &(x, y)| (a + x, b + y));
    let (mean_x, mean_y) = (sum_x / count, sum_y / count);
    let spread: f64 = logs.iter().map(|&(x, _)| (x - mean_x) * (x - mean_x)).sum();
    let common: f64 = logs.iter().map(|&(x, y)| (x - mean_x) * (y - mean_y)).sum();
    (logs.len() >= 2 && spread > 1e-9).then(|| common / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweeps_are_read_or_refused_with_a_remedy() {
        let sweep: Sweep = "rtt=0, 50,100".parse().unwrap();
        assert_eq!(sweep, Sweep { key: SweepKey::Rtt, values: ["0", "50", "100"].map(str::to_owned).to_vec() });
        for bad in ["rtt", "speed=1", "rtt=", "rtt=1,,2"] {
            assert!(bad.parse::<Sweep>().is_err(), "{bad}");
        }
        assert!("speed=1".parse::<Sweep>().unwrap_err().contains("avatars"));
    }

    #[test]
    fn a_power_is_found() {
        let points = [(1.0, 3.0), (4.0, 6.0), (16.0, 12.0), (0.0, 5.0)];
        assert!((exponent(&points).unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(exponent(&[(2.0, 1.0), (2.0, 4.0)]), None);
        assert_eq!(exponent(&[(2.0, 1.0)]), None);
    }
}
