//! The arm's joints: elastic torques at any angle, and damping that is stable however strong it is.

use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::LINKS;
use super::step::SUBSTEP_S;
use super::vector::Vector;

/// `θ / sin θ` as a function of `u = (1 − cos θ)/2`: the series `Σ (2ⁿ n!)² uⁿ / (2n + 1)!`, cut after u⁶,
/// so that a linear bending torque `k θ` stays smooth at any angle (4 % soft at 120°).
#[inline(always)]
pub fn angle_over_sine<S: Scalar>(u: S) -> S {
    const SERIES: [f64; 7] = [
        1.0,
        2.0 / 3.0,
        8.0 / 15.0,
        16.0 / 35.0,
        128.0 / 315.0,
        256.0 / 693.0,
        1024.0 / 3003.0,
    ];
    let mut sum = S::from(SERIES[6]);
    for coefficient in SERIES[..6].iter().rev() {
        sum = sum * u + *coefficient;
    }
    sum
}

/// The torques C s⁺ that damp the joints: against the slip on a link, with it on its neighbour.
///
/// Inner masses are light and bases heavily damped, so that the slip rates s at the joints settle within a substep h.
/// What damps them is therefore the rate at the substep's end:
///
/// ```text
/// τ = −C s⁺,     s⁺ = s + h (ṡ₀ − W C s⁺)  ⇒  (I + h W C) s⁺ = s + h ṡ₀
/// ```
///
/// with ṡ₀ what everything but damping does to the rates, W what a unit torque at each joint does ([`mobility`]), and
/// `slips` s + h ṡ₀.
#[inline(always)]
pub fn damped<S: Scalar>(
    parameters: &Parameters<S>,
    lengths: &[(S, S); LINKS],
    slips: [Vector<S>; LINKS],
) -> [Vector<S>; LINKS] {
    let p = parameters;
    let [base, joint] = slips;
    let [w00, w01, w11] = mobility(p, lengths);
    let [c0, c1] = [p.base_damping, p.joint_damping];
    let [a00, a01] = [w00 * c0 * SUBSTEP_S + 1.0, w01 * c1 * SUBSTEP_S];
    let [a10, a11] = [w01 * c0 * SUBSTEP_S, w11 * c1 * SUBSTEP_S + 1.0];
    let scale = (a00 * a11 - a01 * a10).recip();
    [
        (base * a11 - joint * a01) * (scale * c0),
        (joint * a00 - base * a10) * (scale * c1),
    ]
}

/// The entries 00, 01, 11 of W: how a unit torque at each joint, base first, accelerates the angles of the joints, with the
/// arm straight.
#[inline(always)]
pub fn mobility<S: Scalar>(parameters: &Parameters<S>, lengths: &[(S, S); LINKS]) -> [S; 3] {
    let p = parameters;
    let [inner, outer] = lengths.map(|(length, _)| length.recip());
    let [joint, tip] = [p.joint_mass.recip(), p.tip_mass.recip()];
    // A torque at the base turns the body by 1 + o / l, one at the inner joint, by its force on the base, by o / l.
    let lever = p.base_offset * inner;
    let turned = lever + 1.0;
    [
        (joint + 1.0) * inner * inner + p.arm_torque_gain * turned * turned,
        -(joint * inner * (inner + outer) + inner * inner + p.arm_torque_gain * turned * lever),
        tip * outer * outer
            + joint * (inner + outer) * (inner + outer)
            + inner * inner
            + p.arm_torque_gain * lever * lever,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bending_torque_is_linear_in_the_angle() {
        for degrees in [1.0_f64, 30.0, 60.0, 90.0] {
            let angle = degrees.to_radians();
            let torque = angle_over_sine((1.0 - angle.cos()) / 2.0) * angle.sin();
            assert!((torque / angle - 1.0).abs() < 0.01, "{degrees}°: {torque}");
        }
    }
}
