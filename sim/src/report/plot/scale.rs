//! Where on an axis does a value go, and which values get a tick?
//!
//! A scale turns values into positions: the value itself, its decimal logarithm, or the place of a name in a list.
//! plotters then only ever sees positions, so that one type serves every kind of axis.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// An axis, ready to draw.
#[derive(Clone, Debug)]
pub(super) struct Scale {
    log: bool,
    /// Positions at the two ends.
    ends: (f64, f64),
    /// Position and text of each tick, in ascending order.
    ticks: Vec<(f64, String)>,
    /// Where zeros stand on a log axis that has some, and the power of ten that the foot lies below.
    foot: Option<(f64, i32)>,
}

/// Why a value has no place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dropped {
    NotFinite,
    /// On a log axis.
    Negative,
}

/// The most ticks that an axis of the usual length bears.
const TICKS_MAX: i32 = 8;

impl Scale {
    /// An axis on which all the values have a place that can have one.
    pub(super) fn new(log: bool, values: impl Iterator<Item = f64>, with_zero: bool) -> Self {
        let values: Vec<f64> = values.filter(|v| v.is_finite() && !(log && *v < 0.0)).collect();
        if log { Self::log(&values) } else { Self::linear(&values, with_zero) }
    }

    /// An axis of names, the first at the top.
    pub(super) fn names(names: &[String]) -> Self {
        let ticks = names.iter().enumerate().rev().map(|(i, name)| (-(i as f64), name.clone())).collect();
        Self { log: false, ends: (0.5 - names.len().max(1) as f64, 0.5), ticks, foot: None }
    }

    fn linear(values: &[f64], with_zero: bool) -> Self {
        // Beyond any quantity that we measure, and safe to subtract and to scale.
        let (mut low, mut high) = bounds(values.iter().map(|v| v.clamp(-1e290, 1e290))).unwrap_or((0.0, 1.0));
        if with_zero || low > 0.0 && low < high * 0.5 {
            (low, high) = (low.min(0.0), high.max(0.0));
        }
        if high - low <= high.abs().max(low.abs()) * 1e-9 {
            let margin = if high == 0.0 { 1.0 } else { high.abs() * 0.1 };
            (low, high) =
                if with_zero || high == 0.0 { (low.min(0.0), high + margin) } else { (low - margin, high + margin) };
        }
        let step = nice_step((high - low) / 5.0);
        let (first, last) = ((low / step + 1e-9).floor(), (high / step - 1e-9).ceil());
        let count = (last - first).clamp(1.0, 20.0) as i32;
        let at = |i: i32| (first + f64::from(i)) * step;
        let largest = at(0).abs().max(at(count).abs());
        let ticks = (0..=count).map(|i| (at(i), linear_text(at(i), step, largest))).collect();
        Self { log: false, ends: (at(0), at(count)), ticks, foot: None }
    }

    fn log(values: &[f64]) -> Self {
        let zeros = values.contains(&0.0);
        let (low, high) = bounds(values.iter().filter(|v| **v > 0.0).map(|v| v.log10())).unwrap_or((0.0, 1.0));
        let (mut first, mut last) = ((low + 1e-9).floor(), (high - 1e-9).ceil());
        if last <= first {
            last = first + 1.0;
        }
        let (e0, e1) = (first as i32, last as i32);
        let mut ticks = Vec::new();
        if e1 - e0 <= 2 {
            let digits: &[i32] = if e1 - e0 == 1 { &[1, 2, 3, 5, 7] } else { &[1, 2, 5] };
            for exponent in e0..=e1 {
                for &digit in digits {
                    ticks.push((f64::from(exponent) + f64::from(digit).log10(), power_text(digit, exponent)));
                }
            }
            first = ticks.iter().map(|t| t.0).filter(|at| *at <= low + 1e-9).fold(first, f64::max);
            last = ticks.iter().map(|t| t.0).filter(|at| *at >= high - 1e-9 && *at > first).fold(last, f64::min);
            ticks.retain(|(at, _)| (first - 1e-9..=last + 1e-9).contains(at));
        } else {
            let stride = (e1 - e0 + TICKS_MAX - 1) / TICKS_MAX;
            ticks.extend((e0..=e1).step_by(stride as usize).map(|e| (f64::from(e), power_text(1, e))));
        }
        let mut scale = Self { log: true, ends: (first, last), ticks, foot: None };
        if zeros {
            let foot = first - (0.12 * (last - first)).max(0.05);
            scale.ticks.insert(0, (foot, "0".to_owned()));
            scale.ends.0 = foot;
            scale.foot = Some((foot, e0));
        }
        scale
    }

    /// The position of a value, and whether it stands at the foot because it is zero.
    pub(super) fn place(&self, value: f64) -> Result<(f64, bool), Dropped> {
        match value {
            v if !v.is_finite() => Err(Dropped::NotFinite),
            v if !self.log => Ok((v.clamp(-1e290, 1e290), false)),
            v if v < 0.0 => Err(Dropped::Negative),
            0.0 => Ok((self.foot.map_or(self.ends.0, |foot| foot.0), true)),
            v => Ok((v.log10(), false)),
        }
    }

    /// Where bars begin.
    pub(super) fn base(&self) -> f64 {
        if self.log { self.ends.0 } else { 0.0 }
    }

    /// The smallest power of ten of a log axis with zeros, in words.
    pub(super) fn foot_text(&self) -> Option<String> {
        self.foot.map(|(_, exponent)| power_text(1, exponent))
    }

    pub(super) fn ticks(&self) -> &[(f64, String)] {
        &self.ticks
    }

    /// The axis with a little room at both ends, so that marks are not cut by the frame.
    pub(super) fn with_margin(mut self, share: f64) -> Self {
        let margin = (self.ends.1 - self.ends.0) * share;
        self.ends = (self.ends.0 - margin, self.ends.1 + margin);
        self
    }

    /// The axis with room at the upper end only.
    pub(super) fn with_room_above(mut self, share: f64) -> Self {
        self.ends.1 += (self.ends.1 - self.ends.0) * share;
        self
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, at: &f64, limit: (i32, i32)) -> i32 {
        let share = (at - self.ends.0) / (self.ends.1 - self.ends.0);
        (f64::from(limit.0) + share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _hint: Hint) -> Vec<f64> {
        self.ticks.iter().map(|(at, _)| *at).collect()
    }

    fn range(&self) -> Range<f64> {
        self.ends.0..self.ends.1
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        self.ticks.iter().find(|(at, _)| at == value).map_or_else(String::new, |(_, text)| text.clone())
    }
}

fn bounds(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |ends, v| {
        let (low, high) = ends.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    })
}

/// The least of 1, 2 and 5 times a power of ten that is not less.
fn nice_step(rough: f64) -> f64 {
    let power = 10f64.powf(rough.max(1e-300).log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|digit| digit * power).find(|step| *step >= rough * 0.999).unwrap_or(power * 10.0)
}

fn linear_text(value: f64, step: f64, largest: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !(1e-3..1e6).contains(&largest) {
        let exponent = largest.log10().floor() as i32;
        let decimals = (f64::from(exponent) - step.log10().floor()).clamp(0.0, 12.0) as usize;
        return format!("{:.decimals$}·10{}", value / 10f64.powi(exponent), superscript(exponent));
    }
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.decimals$}")
}

fn power_text(digit: i32, exponent: i32) -> String {
    match exponent {
        0..=3 => (digit * 10i32.pow(exponent as u32)).to_string(),
        -3..0 => format!("{:.*}", -exponent as usize, f64::from(digit) * 10f64.powi(exponent)),
        _ if digit == 1 => format!("10{}", superscript(exponent)),
        _ => format!("{digit}·10{}", superscript(exponent)),
    }
}

fn superscript(number: i32) -> String {
    let raised = |c| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        digit => char::from_u32('⁰' as u32 + (digit as u32 - '0' as u32)).unwrap_or(digit),
    };
    number.to_string().chars().map(raised).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(scale: &Scale) -> Vec<&str> {
        scale.ticks.iter().map(|(_, text)| text.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(texts(&Scale::new(false, [0.3, 9.7].into_iter(), false)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(texts(&Scale::new(false, [-1.0, 1.0].into_iter(), false)), ["-1.0", "-0.5", "0", "0.5", "1.0"]);
        assert_eq!(texts(&Scale::new(true, [2.1, 3.4].into_iter(), false)), ["2", "3", "5"]);
        assert_eq!(
            texts(&Scale::new(true, [0.002, 700.0].into_iter(), false)),
            ["0.001", "0.01", "0.1", "1", "10", "100", "1000"]
        );
        let wide = Scale::new(true, [1e-12, 1e12].into_iter(), false);
        assert_eq!(texts(&wide)[..2], ["10⁻¹²", "10⁻⁹"]);
    }

    #[test]
    fn zeros_stand_at_the_foot_of_a_log_axis() {
        let scale = Scale::new(true, [0.0, 3.0, 40.0].into_iter(), false);
        let (foot, is_foot) = scale.place(0.0).unwrap();
        assert!(is_foot && foot < scale.place(3.0).unwrap().0);
        assert_eq!(scale.ticks[0], (foot, "0".to_owned()));
        assert_eq!(scale.foot_text().as_deref(), Some("1"));
        assert_eq!(scale.place(-1.0), Err(Dropped::Negative));
        assert_eq!(scale.place(f64::NAN), Err(Dropped::NotFinite));
    }

    #[test]
    fn any_values_make_an_axis_that_maps_into_its_frame() {
        let odd: [&[f64]; 10] = [
            &[],
            &[0.0],
            &[f64::NAN, f64::INFINITY],
            &[5.0],
            &[-5.0, -5.0],
            &[1e9, 1e9 + 1e-6],
            &[f64::MIN, f64::MAX],
            &[f64::MIN_POSITIVE, 5e-324],
            &[0.0, 5e-324, f64::MAX],
            &[-1.0, 0.0],
        ];
        for values in odd {
            for log in [false, true] {
                for with_zero in [false, true] {
                    let scale = Scale::new(log, values.iter().copied(), with_zero).with_margin(0.03);
                    assert!(!scale.ticks.is_empty() && scale.ticks.len() <= 22, "{values:?}: {:?}", scale.ticks);
                    assert!(scale.ticks.windows(2).all(|pair| pair[0].0 < pair[1].0), "{values:?}: {:?}", scale.ticks);
                    for (at, _) in values.iter().filter_map(|v| scale.place(*v).ok()) {
                        let pixel = scale.map(&at, (0, 1000));
                        assert!((0..=1000).contains(&pixel), "{values:?} {log}: {at} at {pixel}");
                    }
                }
            }
        }
    }
}
