//! A table for four with chairs, plates, glasses, and candles on candlesticks, as boxes of polygons: some 5,700 of them, as
//! many as in Sudarsky & Gotsman's test scene 2 (1999, Fig. 11). Metres, the floor at y = 0, the table's middle at x = z = 0.
//!
//! What is turned is a profile, radii and heights from the bottom up, with `SIDES` quads for each piece of it.

use std::f64::consts::TAU;

use eyeline_visibility::Aabb;
use glam::DVec3;

/// Quads around whatever is turned.
const SIDES: usize = 32;
/// Height of the table.
const TOP: f64 = 0.75;

/// Where the candlesticks stand.
pub const CANDLESTICKS: [DVec3; 2] = [DVec3::new(-0.25, TOP, 0.03), DVec3::new(0.27, TOP, -0.05)];

/// The box of each polygon.
pub fn polygons() -> Vec<Aabb> {
    let mut polygons = Vec::new();
    block(&mut polygons, [-0.8, TOP - 0.04, -0.5], [0.8, TOP, 0.5]);
    for (x, z) in [(-0.74, -0.44), (0.74, -0.44), (-0.74, 0.44), (0.74, 0.44)] {
        block(&mut polygons, [x - 0.03, 0.0, z - 0.03], [x + 0.03, TOP - 0.04, z + 0.03]);
    }
    for (x, away) in [(-0.4, -1.0), (0.4, -1.0), (-0.4, 1.0), (0.4, 1.0)] {
        chair(&mut polygons, x, away);
        turned(&mut polygons, DVec3::new(x, TOP, away * 0.33), &plate());
        turned(&mut polygons, DVec3::new(x + 0.16, TOP, away * 0.2), &glass());
    }
    for at in CANDLESTICKS {
        let stick = candlestick();
        turned(&mut polygons, at, &stick);
        let top = stick.last().expect("a candlestick has a top")[1];
        turned(&mut polygons, at + DVec3::Y * top, &candle());
    }
    polygons
}

/// The six faces of a block.
fn block(polygons: &mut Vec<Aabb>, min: [f64; 3], max: [f64; 3]) {
    polygons.extend(super::faces(&Aabb::new(min.into(), max.into())));
}

/// A seat, four legs, two posts and four slats, on the side of the table that `away` says: 66 polygons.
fn chair(polygons: &mut Vec<Aabb>, x: f64, away: f64) {
    let mut part = |width: [f64; 2], height: [f64; 2], depth: [f64; 2]| {
        let [near, far] = depth.map(|depth| away * (0.45 + depth));
        block(polygons, [x + width[0], height[0], near.min(far)], [x + width[1], height[1], near.max(far)]);
    };
    part([-0.22, 0.22], [0.42, 0.46], [0.0, 0.44]);
    for left in [-0.22, 0.18] {
        part([left, left + 0.04], [0.0, 0.42], [0.0, 0.04]);
        part([left, left + 0.04], [0.0, 0.42], [0.4, 0.44]);
        part([left, left + 0.04], [0.46, 0.95], [0.4, 0.44]);
    }
    for slat in 0..4 {
        let bottom = 0.52 + 0.11 * f64::from(slat);
        part([-0.18, 0.18], [bottom, bottom + 0.05], [0.41, 0.43]);
    }
}

/// Turns a profile of radii and heights about a vertical axis.
fn turned(polygons: &mut Vec<Aabb>, at: DVec3, profile: &[[f64; 2]]) {
    let point = |[radius, height]: [f64; 2], side: usize| {
        let (sin, cos) = (TAU * (side % SIDES) as f64 / SIDES as f64).sin_cos();
        at + DVec3::new(radius * cos, height, radius * sin)
    };
    for piece in profile.windows(2) {
        for side in 0..SIDES {
            let corners =
                [(0, side), (0, side + 1), (1, side), (1, side + 1)].map(|(end, side)| point(piece[end], side));
            polygons.push(corners.into_iter().fold(Aabb::EMPTY, |aabb, corner| aabb.with_point(corner)));
        }
    }
}

/// A foot, a bowl and a rim with an upper and a lower side: 7 pieces.
fn plate() -> Vec<[f64; 2]> {
    let lower = [[0.001, 0.0], [0.06, 0.0], [0.065, 0.006], [0.125, 0.02]];
    let upper = [[0.118, 0.021], [0.07, 0.011], [0.062, 0.008], [0.001, 0.007]];
    [&lower[..], &upper].concat()
}

/// A foot, a stem and a bowl with an outer and an inner side: 12 pieces.
fn glass() -> Vec<[f64; 2]> {
    let foot = [[0.001, 0.0], [0.035, 0.0], [0.033, 0.003], [0.008, 0.008], [0.004, 0.02], [0.004, 0.07]];
    let outer = [[0.012, 0.08], [0.03, 0.095], [0.038, 0.12], [0.032, 0.17]];
    let inner = [[0.031, 0.17], [0.036, 0.12], [0.001, 0.082]];
    [&foot[..], &outer, &inner].concat()
}

/// A broad foot, a shaft with rings turned in it, and a cup: 34 pieces.
fn candlestick() -> Vec<[f64; 2]> {
    let foot = [[0.001, 0.0], [0.06, 0.0], [0.06, 0.006], [0.045, 0.012]];
    let ring = |i: u32| {
        let share = f64::from(i) / 24.0;
        [0.014 + 0.006 * (share * 6.0 * TAU).cos() * (1.0 - 0.5 * share), 0.02 + 0.18 * share]
    };
    let cup = [[0.01, 0.205], [0.024, 0.21], [0.026, 0.23], [0.023, 0.23], [0.02, 0.215], [0.001, 0.213]];
    foot.into_iter().chain((0..25).map(ring)).chain(cup).collect()
}

/// A candle, its flame, and its wick, which is the finest thing on the table: 13 pieces.
fn candle() -> Vec<[f64; 2]> {
    let mut profile = vec![[0.011, 0.0], [0.011, 0.15]];
    profile.extend((0..9).map(|i| [0.001 - 0.0002 * f64::from(i % 2), 0.152 + 0.001 * f64::from(i)]));
    profile.extend([[0.006, 0.17], [0.004, 0.19], [0.0005, 0.21]]);
    profile
}
