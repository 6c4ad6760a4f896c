//! Numbers that may carry derivatives: one piece of model code serves simulation and its sensitivities.

use super::dynamics::MOST_VARIABLES;
use crate::kernel::padded;
use pulp::{Arch, WithSimd};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number, or a real number with its gradient.
pub trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + From<f64>
{
    /// The value without its derivatives.
    fn value(self) -> f64;

    /// `f(self)`, given the value `f` and the derivative `slope` there (the chain rule).
    fn chain(self, f: f64, slope: f64) -> Self;

    /// Runs `operation` with the widest vectors that the machine has, where these numbers carry gradients.
    fn vectorize<W: WithSimd>(operation: W) -> W::Output;

    /// `Σ w x y` over triples `(w, x, y)`, with fewer passes over gradients than by single operations.
    fn sum_of_products<const K: usize>(terms: [(f64, &Self, &Self); K]) -> Self;

    /// Square root, of a positive number.
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value().sqrt();
        self.chain(root, 0.5 / root)
    }

    /// Reciprocal.
    #[inline(always)]
    fn recip(self) -> Self {
        let inverse = 1.0 / self.value();
        self.chain(inverse, -inverse * inverse)
    }

    /// Tangent.
    #[inline(always)]
    fn tan(self) -> Self {
        let tan = self.value().tan();
        self.chain(tan, 1.0 + tan * tan)
    }

    /// Exponential.
    #[inline(always)]
    fn exp(self) -> Self {
        let exp = self.value().exp();
        self.chain(exp, exp)
    }

    /// `ln(1 + eˣ)`, without overflow.
    #[inline(always)]
    fn softplus(self) -> Self {
        let x = self.value();
        self.chain(x.max(0.0) + (-x.abs()).exp().ln_1p(), 1.0 / (1.0 + (-x).exp()))
    }
}

impl Scalar for f64 {
    fn value(self) -> f64 {
        self
    }

    fn chain(self, f: f64, _slope: f64) -> f64 {
        f
    }

    fn vectorize<W: WithSimd>(operation: W) -> W::Output {
        operation.with_simd(pulp::Scalar::new())
    }

    #[inline(always)]
    fn sum_of_products<const K: usize>(terms: [(f64, &f64, &f64); K]) -> f64 {
        terms.iter().map(|(w, x, y)| w * *x * *y).sum()
    }
}

/// Room for derivatives by the most variables there are, those of a Jacobian; of whole vectors, so that loops over them
/// have no remainders.
const ROOM: usize = padded(MOST_VARIABLES);

/// A number and its gradient (forward-mode differentiation).
#[derive(Debug, Clone, Copy)]
pub struct Dual {
    /// The number.
    pub value: f64,
    /// Its partial derivatives.
    pub gradient: [f64; ROOM],
}

impl Dual {
    /// The variable number `index`, at `value`.
    pub fn variable(value: f64, index: usize) -> Self {
        let mut gradient = [0.0; ROOM];
        gradient[index] = 1.0;
        Dual { value, gradient }
    }

    /// `value` with gradient `a ∇x + b ∇y`.
    #[inline(always)]
    fn combine(value: f64, a: f64, x: &Self, b: f64, y: &Self) -> Self {
        let mut gradient = [0.0; ROOM];
        for i in 0..ROOM {
            gradient[i] = a * x.gradient[i] + b * y.gradient[i];
        }
        Dual { value, gradient }
    }
}

impl From<f64> for Dual {
    #[inline(always)]
    fn from(value: f64) -> Self {
        Dual {
            value,
            gradient: [0.0; ROOM],
        }
    }
}

impl Scalar for Dual {
    #[inline(always)]
    fn value(self) -> f64 {
        self.value
    }

    #[inline(always)]
    fn chain(self, f: f64, slope: f64) -> Self {
        let mut scaled = self.gradient;
        for entry in &mut scaled {
            *entry *= slope;
        }
        Dual {
            value: f,
            gradient: scaled,
        }
    }

    fn vectorize<W: WithSimd>(operation: W) -> W::Output {
        Arch::new().dispatch(operation)
    }

    #[inline(always)]
    fn sum_of_products<const K: usize>(terms: [(f64, &Self, &Self); K]) -> Self {
        let (mut value, mut gradient) = (0.0, [0.0; ROOM]);
        for i in 0..ROOM {
            for (w, x, y) in &terms {
                gradient[i] += w * y.value * x.gradient[i] + w * x.value * y.gradient[i];
            }
        }
        for (w, x, y) in terms {
            value += w * x.value * y.value;
        }
        Dual { value, gradient }
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::combine(self.value + other.value, 1.0, &self, 1.0, &other)
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::combine(self.value - other.value, 1.0, &self, -1.0, &other)
    }
}

impl Mul for Dual {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::combine(self.value * other.value, other.value, &self, self.value, &other)
    }
}

impl Div for Dual {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let quotient = self.value / other.value;
        Self::combine(
            quotient,
            1.0 / other.value,
            &self,
            -quotient / other.value,
            &other,
        )
    }
}

impl Neg for Dual {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl Add<f64> for Dual {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: f64) -> Self {
        self.value += other;
        self
    }
}

impl Sub<f64> for Dual {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: f64) -> Self {
        self.value -= other;
        self
    }
}

impl Mul<f64> for Dual {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        self.chain(self.value * other, other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation, in one expression without kinks.
    fn expression<S: Scalar>(x: S, y: S) -> S {
        let product = (x * y + 0.3) / (y * 0.5 - 4.0) - x.sqrt();
        product.softplus() + (-(x * 0.1)).exp() * y.recip() + (x * 0.2).tan()
    }

    #[test]
    fn gradient_agrees_with_finite_differences() {
        for (x, y) in [(0.7, 1.3), (2.1, -0.4), (5.0, 3.0)] {
            let dual = expression(Dual::variable(x, 0), Dual::variable(y, 1));
            let h = 1e-6;
            let slopes = [
                (expression(x + h, y) - expression(x - h, y)) / (2.0 * h),
                (expression(x, y + h) - expression(x, y - h)) / (2.0 * h),
            ];
            assert_eq!(dual.value, expression(x, y));
            for (exact, difference) in dual.gradient.iter().zip(slopes) {
                assert!(
                    (exact - difference).abs() < 1e-7 * (1.0 + exact.abs()),
                    "{exact} {difference}"
                );
            }
        }
    }

    #[test]
    fn softplus_neither_overflows_nor_underflows_to_nan() {
        for x in [-1e3, -40.0, 0.0, 40.0, 1e3] {
            let y = Dual::variable(x, 0).softplus();
            assert!(y.value >= x.max(0.0) && y.value.is_finite());
            assert!((0.0..=1.0).contains(&y.gradient[0]));
        }
    }
}
