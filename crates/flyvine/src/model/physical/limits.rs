//! Limits with a rounded corner, so that derivatives exist everywhere.
//!
//! A magnitude r is limited to `L` by `sat(r) = r − w ln(1 + e^{(r − L)/w})`: within `w e^{-|r−L|/w}` of
//! `min(r, L)`, at most `w ln 2` below it at the corner. The rounding is `w = 0.04 L`.

use super::scalar::Scalar;
use super::vector::Vector;

/// Rounding of the corner, as a share of the limit.
const ROUNDING: f64 = 0.04;
/// Below this many roundings under the limit nothing is changed (by less than 1e-9 of the limit).
const CLEAR: f64 = -18.0;

/// `min(magnitude, limit)`, rounded; for magnitudes ≥ 0.
#[inline(always)]
pub fn limit_from_above<S: Scalar>(magnitude: S, limit: S) -> S {
    let width = limit * ROUNDING;
    let excess = (magnitude - limit) / width;
    if excess.value() < CLEAR {
        return magnitude;
    }
    magnitude - width * excess.softplus()
}

/// `max(value, limit)`, with a corner rounded over `width`.
#[inline(always)]
pub fn limit_from_below<S: Scalar>(value: S, limit: f64, width: f64) -> S {
    let shortfall = (-value + limit) * (1.0 / width);
    if shortfall.value() < CLEAR {
        return value;
    }
    value + shortfall.softplus() * width
}

/// Scales a vector so that its length is at most `limit`, rounded.
#[inline(always)]
pub fn limit_length<S: Scalar, const K: usize>(vector: [S; K], limit: S) -> [S; K] {
    let squared = vector.iter().fold(S::from(0.0), |sum, x| sum + *x * *x);
    if squared.value().sqrt() < limit.value() * (1.0 + CLEAR * ROUNDING) {
        return vector;
    }
    let length = squared.sqrt();
    let factor = limit_from_above(length, limit) / length;
    vector.map(|x| x * factor)
}

/// [`limit_length`] of a [`Vector`].
#[inline(always)]
pub fn limit_vector<S: Scalar>(vector: Vector<S>, limit: S) -> Vector<S> {
    Vector(limit_length(vector.0, limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn below_the_limit_nothing_changes_and_above_nothing_exceeds_it() {
        assert_eq!(limit_from_above(0.2, 1.0), 0.2);
        for magnitude in [0.5, 0.9, 1.0, 1.2, 3.0, 100.0] {
            let limited = limit_from_above(magnitude, 1.0);
            assert!(limited <= magnitude.min(1.0) + 1e-12);
            assert!(limited >= magnitude.min(1.0) - ROUNDING * std::f64::consts::LN_2 - 1e-12);
        }
    }

    #[test]
    fn a_lower_limit_holds_and_leaves_larger_values_alone() {
        assert_eq!(limit_from_below(9.81, 1.0, 0.4), 9.81);
        for value in [-50.0, 0.0, 1.0, 1.5] {
            let limited = limit_from_below(value, 1.0, 0.4);
            assert!(
                limited >= value.max(1.0) && limited <= value.max(1.0) + 0.4 * std::f64::consts::LN_2 + 1e-12
            );
        }
    }

    #[test]
    fn a_limited_vector_keeps_its_direction() {
        let limited = limit_length([30.0, -40.0], 2.0);
        assert!((limited[0] / limited[1] + 0.75).abs() < 1e-12);
        assert!((limited[0].hypot(limited[1]) - 2.0).abs() < 1e-9);
    }
}
