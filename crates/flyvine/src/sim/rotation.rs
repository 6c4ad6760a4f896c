//! Rotations of the chain's bodies: exponential and logarithm on quaternions, by series where angles are small.

use nalgebra::{UnitQuaternion, Vector3};

/// Coefficients of cos(h) in powers of h².
const COSINE: [f64; 6] = [
    1.0,
    -1.0 / 2.0,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
];
/// Coefficients of sin(h)/h in powers of h².
const SINC: [f64; 6] = [
    1.0,
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5040.0,
    1.0 / 362_880.0,
    -1.0 / 39_916_800.0,
];
/// Coefficients of 2 asin(s)/s in powers of s².
const ARCSINE: [f64; 7] = [
    2.0,
    1.0 / 3.0,
    3.0 / 20.0,
    5.0 / 56.0,
    35.0 / 576.0,
    63.0 / 1408.0,
    231.0 / 6656.0,
];

/// Horner's rule, coefficients in ascending powers.
fn polynomial<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    coefficients
        .iter()
        .rev()
        .fold(0.0, |sum, coefficient| sum * x + coefficient)
}

/// `exp(rotation) q`, renormalized by one Newton step (the error per step is of the rounding's order).
#[inline]
pub(super) fn rotate(rotation: Vector3<f64>, q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let squared = 0.25 * rotation.norm_squared();
    // sin(h)/h and cos(h) of the half angle h: series to double precision for h < 0.25, else closed form.
    let (cosine, sinc) = if squared < 0.0625 {
        (polynomial(&COSINE, squared), polynomial(&SINC, squared))
    } else {
        let half = squared.sqrt();
        (half.cos(), half.sin() / half)
    };
    let v = 0.5 * sinc * rotation;
    let product = nalgebra::Quaternion::new(cosine, v.x, v.y, v.z) * q.quaternion();
    UnitQuaternion::new_unchecked(product * (1.5 - 0.5 * product.norm_squared()))
}

/// Rotation vector of `child parent⁻¹`, world frame, rad: the bend of a joint.
#[inline]
pub(super) fn bend(parent: &UnitQuaternion<f64>, child: &UnitQuaternion<f64>) -> Vector3<f64> {
    let q = child.quaternion() * parent.quaternion().conjugate();
    let (w, v) = if q.w < 0.0 {
        (-q.w, -q.imag())
    } else {
        (q.w, q.imag())
    };
    let squared = v.norm_squared();
    // 2 asin(s)/s of the half angle's sine s: series to double precision for s < 0.1, else closed form.
    let scale = if squared < 0.01 {
        polynomial(&ARCSINE, squared)
    } else {
        let sine = squared.sqrt();
        2.0 * sine.atan2(w) / sine
    };
    scale * v
}

/// The link's axis d, pointing away from the clamp, world frame: `R (0, 0, −1)`.
#[inline]
pub(super) fn axis(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    Vector3::new(
        -2.0 * (x * z + w * y),
        -2.0 * (y * z - w * x),
        -1.0 + 2.0 * (x * x + y * y),
    )
}
