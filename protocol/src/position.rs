//! Places and turns as they are on the wire.
//!
//! A position is fixed point in steps of 2⁻¹⁰ m relative to the world's anchor. The server snaps every state to this
//! grid when it commits it, so what a client receives is the truth, not a rounding of it.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// One step of the grid of positions, in metres: 2⁻¹⁰.
pub const QUANTUM_METRES: f64 = 1.0 / 1024.0;

/// Greatest distance from the anchor along one axis, in metres: (2³¹ − 1) steps, a little under 2,097,152 m.
pub const METRES_MAX: f64 = i32::MAX as f64 * QUANTUM_METRES;

/// The nearest whole number, halves away from zero: `f64::round`, which is a call on processors of which no more is known than that they are
/// x86-64, and positions are rounded for each object and tick. Numbers beyond those of an `i64` stay far out, and NaN becomes 0.
pub(crate) fn nearest(x: f64) -> f64 {
    let whole = x as i64 as f64;
    // Exact: both are of the same size, or it is `x` itself.
    let rest = x - whole;
    whole + f64::from(i8::from(rest >= 0.5) - i8::from(rest <= -0.5))
}

/// A coordinate is not a number or too far from the anchor.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("position ({x}, {y}, {z}) m is not within {METRES_MAX} m of the world's anchor")]
pub struct OutOfRange {
    /// The offending position, metres.
    pub x: f64,
    /// The offending position, metres.
    pub y: f64,
    /// The offending position, metres.
    pub z: f64,
}

/// A place relative to the world's anchor, in steps of [`QUANTUM_METRES`]. Twelve bytes on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Position {
    /// East, in steps.
    pub x: i32,
    /// Up, in steps.
    pub y: i32,
    /// South (towards the viewer), in steps.
    pub z: i32,
}

impl Position {
    /// The nearest grid position; off by at most half a step along each axis.
    ///
    /// # Errors
    /// If a coordinate is not finite or beyond [`METRES_MAX`].
    pub fn from_metres(metres: DVec3) -> Result<Position, OutOfRange> {
        // Written so that NaN fails too.
        if !(metres.abs().cmple(DVec3::splat(METRES_MAX)).all()) {
            return Err(OutOfRange { x: metres.x, y: metres.y, z: metres.z });
        }
        let steps = (metres / QUANTUM_METRES).map(nearest);
        Ok(Position { x: steps.x as i32, y: steps.y as i32, z: steps.z as i32 })
    }

    /// Metres relative to the anchor. Exact.
    pub fn metres(self) -> DVec3 {
        DVec3::new(f64::from(self.x), f64::from(self.y), f64::from(self.z)) * QUANTUM_METRES
    }
}

impl Serialize for Position {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = [0; 12];
        for (chunk, step) in bytes.chunks_exact_mut(4).zip([self.x, self.y, self.z]) {
            chunk.copy_from_slice(&step.to_le_bytes());
        }
        bytes.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Position {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Position, D::Error> {
        let bytes = <[u8; 12]>::deserialize(deserializer)?;
        let step = |i: usize| i32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
        Ok(Position { x: step(0), y: step(4), z: step(8) })
    }
}

/// A rotation in four bytes, "smallest three": the index of the greatest component of the unit quaternion in the top
/// two bits, the other three in 10 bits each over ±1/√2. Off by at most 0.0015 rad about each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Orientation(u32);

impl Orientation {
    const SCALE: f64 = 511.0 * std::f64::consts::SQRT_2;

    /// The nearest representable rotation. A quaternion that is not finite or has no length gives no turn.
    pub fn from_quat(quat: DQuat) -> Orientation {
        let quat = if quat.is_finite() && quat.length_squared() > 1e-12 { quat.normalize() } else { DQuat::IDENTITY };
        let components = quat.to_array();
        let greatest = (0..4).max_by(|&a, &b| components[a].abs().total_cmp(&components[b].abs())).unwrap_or(3);
        let sign = if components[greatest] < 0.0 { -1.0 } else { 1.0 };
        let mut bits = greatest as u32;
        for (i, component) in components.iter().enumerate() {
            if i != greatest {
                let step = nearest(component * sign * Self::SCALE).clamp(-511.0, 511.0) as i32;
                bits = bits << 10 | (step + 511) as u32;
            }
        }
        Orientation(bits)
    }

    /// A turn about +Y by `yaw` radians; 0 looks along −Z.
    pub fn from_yaw(yaw: f64) -> Orientation {
        Orientation::from_quat(DQuat::from_rotation_y(yaw))
    }

    /// The rotation as a unit quaternion.
    pub fn quat(self) -> DQuat {
        let greatest = (self.0 >> 30) as usize;
        let mut components = [0.0; 4];
        let mut rest = 1.0;
        let mut shift = 30;
        for (i, component) in components.iter_mut().enumerate() {
            if i != greatest {
                shift -= 10;
                let step = (self.0 >> shift & 0x3ff) as f64 - 511.0;
                *component = step.clamp(-511.0, 511.0) / Self::SCALE;
                rest -= *component * *component;
            }
        }
        components[greatest] = f64::max(rest, 0.0).sqrt();
        DQuat::from_array(components).normalize()
    }

    /// The turn about +Y in radians, for things that stand upright.
    pub fn yaw(self) -> f64 {
        let forward = self.quat() * DVec3::NEG_Z;
        f64::atan2(-forward.x, -forward.z)
    }
}

impl Serialize for Orientation {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.to_le_bytes().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Orientation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Orientation, D::Error> {
        Ok(Orientation(u32::from_le_bytes(<[u8; 4]>::deserialize(deserializer)?)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn positions_beyond_the_wire_are_refused() {
        for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, METRES_MAX + 1.0, -3e6, 1e300] {
            assert!(Position::from_metres(DVec3::new(0.0, bad, 0.0)).is_err(), "{bad}");
        }
        assert_eq!(Position::from_metres(DVec3::splat(METRES_MAX)).map(|p| p.x), Ok(i32::MAX));
    }

    #[test]
    fn the_nearest_whole_number_is_what_rounding_says() {
        let halves = (-9..=9).map(|i| 0.5 * f64::from(i));
        let next = halves.flat_map(|x: f64| [x.next_down(), x, x.next_up()]);
        for x in next.chain([-1e300, -9.3e18, -4.6e15, 4.6e15, 9.3e18, f64::INFINITY]) {
            let expected = if x.abs() < 9e18 { x.round() } else { nearest(x) };
            assert_eq!(nearest(x), expected, "{x}");
            assert!(x.abs() < 9e18 || nearest(x).abs() > 9e18 && nearest(x).signum() == x.signum(), "{x}");
        }
        assert_eq!(nearest(f64::NAN), 0.0);
    }

    proptest! {
        #[test]
        fn a_position_is_off_by_at_most_half_a_step(x in -2e6..2e6f64, y in -2e6..2e6f64, z in -2e6..2e6f64) {
            let metres = DVec3::new(x, y, z);
            let back = Position::from_metres(metres).unwrap().metres();
            prop_assert!((back - metres).abs().max_element() <= QUANTUM_METRES / 2.0);
        }

        #[test]
        fn a_turn_is_off_by_little(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64, w in -1.0..1.0f64) {
            let quat = DQuat::from_xyzw(x, y, z, w);
            prop_assume!(quat.length_squared() > 1e-6);
            let quat = quat.normalize();
            let back = Orientation::from_quat(quat).quat();
            prop_assert!(quat.angle_between(back) < 0.006, "{}", quat.angle_between(back));
        }

        #[test]
        fn any_bits_are_a_rotation(bits: u32) {
            prop_assert!((Orientation(bits).quat().length() - 1.0).abs() < 1e-9);
        }

        #[test]
        fn yaw_survives(yaw in -3.1..3.1f64) {
            prop_assert!((Orientation::from_yaw(yaw).yaw() - yaw).abs() < 0.006);
        }
    }
}
