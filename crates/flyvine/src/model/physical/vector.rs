//! Vectors and rotations over [`Scalar`]s.

use super::scalar::Scalar;
use std::ops::{Add, Mul, Sub};

/// A vector of three numbers.
#[derive(Debug, Clone, Copy)]
pub struct Vector<S>(pub [S; 3]);

impl<S: Scalar> Vector<S> {
    /// A constant vector.
    #[inline(always)]
    pub fn constant(entries: [f64; 3]) -> Self {
        Vector(entries.map(S::from))
    }

    /// The zero vector.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::constant([0.0; 3])
    }

    /// Inner product.
    #[inline(always)]
    pub fn dot(&self, other: &Self) -> S {
        let ([a, b, c], [x, y, z]) = (&self.0, &other.0);
        S::sum_of_products([(1.0, a, x), (1.0, b, y), (1.0, c, z)])
    }

    /// Cross product.
    #[inline(always)]
    pub fn cross(&self, other: &Self) -> Self {
        let ([a, b, c], [x, y, z]) = (&self.0, &other.0);
        Vector([
            S::sum_of_products([(1.0, b, z), (-1.0, c, y)]),
            S::sum_of_products([(1.0, c, x), (-1.0, a, z)]),
            S::sum_of_products([(1.0, a, y), (-1.0, b, x)]),
        ])
    }

    /// Squared length.
    #[inline(always)]
    pub fn norm_squared(&self) -> S {
        self.dot(self)
    }

    /// The part perpendicular to the unit vector `axis`.
    #[inline(always)]
    pub fn perpendicular_to(&self, axis: &Self) -> Self {
        *self - *axis * self.dot(axis)
    }
}

impl<S: Scalar> Add for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([a + x, b + y, c + z])
    }
}

impl<S: Scalar> Sub for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Vector([a - x, b - y, c - z])
    }
}

impl<S: Scalar> Mul<S> for Vector<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: S) -> Self {
        let [a, b, c] = self.0;
        Vector([a * factor, b * factor, c * factor])
    }
}

/// Multiplies by a constant.
impl<S: Scalar> Vector<S> {
    /// `self · factor` for a factor without derivatives.
    #[inline(always)]
    pub fn scale(self, factor: f64) -> Self {
        let [a, b, c] = self.0;
        Vector([a * factor, b * factor, c * factor])
    }
}

/// The unit quaternion `(√(1 − |v|²), v)`, `world_from_body`.
#[derive(Debug, Clone, Copy)]
pub struct Attitude<S> {
    /// Scalar part, positive.
    pub w: S,
    /// Vector part.
    pub v: Vector<S>,
}

impl<S: Scalar> Attitude<S> {
    /// From the vector part; the scalar part is kept away from zero (half a turn), where it has no derivative.
    #[inline(always)]
    pub fn from_vector_part(v: Vector<S>) -> Self {
        let remainder = S::from(1.0) - v.norm_squared();
        let w = if remainder.value() > 1e-4 {
            remainder.sqrt()
        } else {
            S::from(1e-2)
        };
        Attitude { w, v }
    }

    /// `R x`: from body to world coordinates.
    #[inline(always)]
    pub fn rotate(&self, x: &Vector<S>) -> Vector<S> {
        let t = self.v.cross(x).scale(2.0);
        *x + t * self.w + self.v.cross(&t)
    }

    /// `Rᵀ x`: from world to body coordinates.
    #[inline(always)]
    pub fn rotate_back(&self, x: &Vector<S>) -> Vector<S> {
        let t = x.cross(&self.v).scale(2.0);
        *x + t * self.w + t.cross(&self.v)
    }

    /// The body's up-axis in the world, `R ẑ`.
    #[inline(always)]
    pub fn up(&self) -> Vector<S> {
        let [x, y, z] = self.v.0;
        let w = self.w;
        Vector([
            (x * z + w * y) * 2.0,
            (y * z - w * x) * 2.0,
            S::from(1.0) - (x * x + y * y) * 2.0,
        ])
    }

    /// Vector part of `q* ⊗ other`: half the rotation from here to `other`, in body coordinates.
    #[inline(always)]
    pub fn half_rotation_to(&self, other: &Self) -> Vector<S> {
        other.v * self.w - self.v * other.w - self.v.cross(&other.v)
    }

    /// `q̇`'s vector part at body rate `rate`: ½ (w ω + v × ω).
    #[inline(always)]
    pub fn vector_part_rate(&self, rate: &Vector<S>) -> Vector<S> {
        (*rate * self.w + self.v.cross(rate)).scale(0.5)
    }

    /// Zero-yaw attitude whose up-axis is the unit vector `up`: pitch about y, then roll about the new x.
    ///
    /// The up-axis of `R_y(θ) R_x(φ)` is `(sin θ cos φ, −sin φ, cos θ cos φ)`.
    #[inline(always)]
    pub fn from_up(up: &Vector<S>) -> Self {
        let [x, y, z] = up.0;
        let cos_roll = (x * x + z * z).sqrt();
        let half = |cos: S, sin: S| {
            let half_cos = ((cos + 1.0) * 0.5).sqrt();
            (half_cos, sin / half_cos * 0.5)
        };
        let (cp, sp) = half(z / cos_roll, x / cos_roll);
        let (cr, sr) = half(cos_roll, -y);
        Attitude {
            w: cp * cr,
            v: Vector([cp * sr, sp * cr, -(sp * sr)]),
        }
    }
}
