//! From our frames to the autopilot's and back: ENU ↔ NED for the world, FLU ↔ FRD for the body.

use flyvine::flight::Pose;

/// East-north-up to north-east-down; its own inverse.
pub fn ned_from_enu([x, y, z]: [f64; 3]) -> [f64; 3] {
    [y, x, -z]
}

/// The attitude of an FRD body in the NED world from that of an FLU body in the ENU world, both Hamilton quaternions
/// `world_from_body`, scalar first. Its own inverse, up to sign; the sign is chosen so that w ≥ 0.
///
/// q_ned_frd = q_ned_enu ⊗ q_enu_flu ⊗ q_flu_frd, where q_ned_enu turns by π about (x + y)/√2 and q_flu_frd by π about x.
pub fn ned_frd_from_enu_flu([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = [half * (w + z), half * (x + y), half * (x - y), half * (w - z)];
    let sign = if turned[0] < 0.0 { -1.0 } else { 1.0 };
    turned.map(|entry| sign * entry)
}

/// A pose in NED and FRD.
pub fn ned_pose(pose: &Pose) -> Pose {
    Pose {
        position: ned_from_enu(pose.position),
        attitude: ned_frd_from_enu_flu(pose.attitude),
    }
}

/// Heading in NED (clockwise from north) of a heading in ENU (counter-clockwise from east), rad, in (−π, π].
pub fn ned_yaw_from_enu(yaw: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, PI, TAU};
    let turned = FRAC_PI_2 - yaw;
    PI - (PI - turned).rem_euclid(TAU)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Quaternion = [f64; 4];

    fn product(a: Quaternion, b: Quaternion) -> Quaternion {
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    }

    fn turn(q: Quaternion, v: [f64; 3]) -> [f64; 3] {
        let conjugate = [q[0], -q[1], -q[2], -q[3]];
        let turned = product(product(q, [0.0, v[0], v[1], v[2]]), conjugate);
        [turned[1], turned[2], turned[3]]
    }

    fn near(a: &[f64], b: &[f64]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn level_and_facing_east_is_a_heading_of_ninety_degrees() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let attitude = ned_frd_from_enu_flu([1.0, 0.0, 0.0, 0.0]);
        assert!(near(&attitude, &[half, 0.0, 0.0, half]), "{attitude:?}");
        assert!(near(
            &[ned_yaw_from_enu(0.0), ned_yaw_from_enu(-std::f64::consts::PI)],
            &[std::f64::consts::FRAC_PI_2, -std::f64::consts::FRAC_PI_2]
        ));
    }

    proptest! {
        /// A point fixed to the body is at the same place whichever way it is computed.
        #[test]
        fn body_points_agree(q in prop::array::uniform4(-1.0..1.0_f64), flu in prop::array::uniform3(-1.0..1.0_f64)) {
            let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            prop_assume!(norm > 0.1);
            let q = q.map(|x| x / norm);
            let frd = [flu[0], -flu[1], -flu[2]];
            let there = ned_frd_from_enu_flu(q);
            prop_assert!(near(&turn(there, frd), &ned_from_enu(turn(q, flu))));
            prop_assert!(there[0] >= 0.0);
            let back = ned_frd_from_enu_flu(there);
            let sign = if back[0] * q[0] < 0.0 { -1.0 } else { 1.0 };
            prop_assert!(near(&back.map(|x| sign * x), &q) || near(&back.map(|x| -sign * x), &q));
        }
    }
}
