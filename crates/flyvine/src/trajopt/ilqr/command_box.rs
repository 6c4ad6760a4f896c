//! The command's own quadratic program at one knot: `min ½ dᵀ Q_uu d + hᵀ d` over `lower ≤ d ≤ upper`.
//!
//! A primal active-set method on a handful of variables (three, usually): held entries sit on a bound, the others
//! solve a linear system by Cholesky; an entry that leaves its interval is held, one whose multiplier has the wrong
//! sign is freed.

/// Where an entry of the command is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    Free,
    Lower,
    Upper,
}

/// Where to begin: held if the command is on a bound already and wants to leave the box. (From all free, a Hessian
/// that is indefinite only in held directions would be refused.)
#[inline(always)]
pub fn initial_hold(lower: f64, upper: f64, gradient: f64) -> Hold {
    if lower >= 0.0 && gradient > 0.0 {
        Hold::Lower
    } else if upper <= 0.0 && gradient < 0.0 {
        Hold::Upper
    } else {
        Hold::Free
    }
}

/// `Q_uu` is not positive definite on the free commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotPositiveDefinite;

/// Cholesky factor of `hessian` (m × m, row-major, lower triangle read) on the free entries, with the reciprocals of
/// the diagonal in its place; held rows and columns become those of the identity.
#[inline(always)]
pub fn factorize(hessian: &[f64], hold: &[Hold], factor: &mut [f64]) -> Result<(), NotPositiveDefinite> {
    let m = hold.len();
    for i in 0..m {
        for j in 0..=i {
            let held = hold[i] != Hold::Free || hold[j] != Hold::Free;
            let entry = match held {
                true if i == j => 1.0,
                true => 0.0,
                false => hessian[i * m + j],
            };
            let mut rest = entry;
            for l in 0..j {
                rest -= factor[i * m + l] * factor[j * m + l];
            }
            if i != j {
                factor[i * m + j] = rest * factor[j * m + j];
            } else if rest > PIVOT_FLOOR * entry.abs() {
                factor[i * m + i] = 1.0 / rest.sqrt();
            } else {
                return Err(NotPositiveDefinite);
            }
        }
    }
    Ok(())
}

/// A pivot this much smaller than its diagonal entry is noise.
const PIVOT_FLOOR: f64 = 1e-13;

/// `x ← L⁻ᵀ L⁻¹ x`.
#[inline(always)]
pub fn solve(factor: &[f64], x: &mut [f64]) {
    let m = x.len();
    let rows = factor.chunks_exact(m).enumerate();
    for (i, row) in rows.clone() {
        let (before, rest) = x.split_at_mut(i);
        for (l, &known) in row.iter().zip(&*before) {
            rest[0] -= l * known;
        }
        rest[0] *= row[i];
    }
    for (i, row) in rows.rev() {
        let (before, rest) = x.split_at_mut(i);
        rest[0] *= row[i];
        for (l, unknown) in row.iter().zip(before) {
            *unknown -= l * rest[0];
        }
    }
}

/// `−Q_uu⁻¹` (m × m, symmetric) on the free entries, zero on the held ones.
#[inline(always)]
pub fn negative_inverse(factor: &[f64], hold: &[Hold], inverse: &mut [f64]) {
    for (j, column) in inverse.chunks_exact_mut(hold.len()).enumerate() {
        column.fill(0.0);
        if hold[j] == Hold::Free {
            column[j] = -1.0;
            solve(factor, column);
        }
    }
}

/// The minimizer for fixed holds: held entries on their bounds, free ones from the factor.
#[inline(always)]
pub fn minimize_held(
    hessian: &[f64],
    factor: &[f64],
    gradient: &[f64],
    (lower, upper): (&[f64], &[f64]),
    hold: &[Hold],
    step: &mut [f64],
) {
    let m = step.len();
    let bound = |j: usize| match hold[j] {
        Hold::Free => 0.0,
        Hold::Lower => lower[j],
        Hold::Upper => upper[j],
    };
    for i in 0..m {
        step[i] = bound(i);
        if hold[i] == Hold::Free {
            step[i] = -gradient[i];
            for j in 0..m {
                step[i] -= hessian[i * m + j] * bound(j);
            }
        }
    }
    solve(factor, step);
}

/// Whether a step for fixed holds is the minimizer over the box: free entries inside, multipliers rightly signed.
#[inline(always)]
pub fn worst_fault(
    hessian: &[f64],
    gradient: &[f64],
    (lower, upper): (&[f64], &[f64]),
    hold: &[Hold],
    step: &[f64],
) -> Option<(usize, Hold)> {
    let m = step.len();
    // Leaving the box comes first; freeing only makes sense from a feasible point.
    for j in 0..m {
        if hold[j] == Hold::Free && step[j] < lower[j] {
            return Some((j, Hold::Lower));
        }
        if hold[j] == Hold::Free && step[j] > upper[j] {
            return Some((j, Hold::Upper));
        }
    }
    for j in (0..m).filter(|&j| hold[j] != Hold::Free) {
        let mut slope = gradient[j];
        for i in 0..m {
            slope += hessian[j * m + i] * step[i];
        }
        if (hold[j] == Hold::Lower && slope < 0.0) || (hold[j] == Hold::Upper && slope > 0.0) {
            return Some((j, Hold::Free));
        }
    }
    None
}

/// Minimizes over the box, from the given holds; leaves the holds, the factor of the free block and the step.
#[inline(always)]
pub fn minimize(
    hessian: &[f64],
    gradient: &[f64],
    bounds: (&[f64], &[f64]),
    hold: &mut [Hold],
    factor: &mut [f64],
    step: &mut [f64],
) -> Result<(), NotPositiveDefinite> {
    // Each change mends one fault; the limit guards against cycling on degenerate bounds.
    for _ in 0..=8 * hold.len() {
        factorize(hessian, hold, factor)?;
        minimize_held(hessian, factor, gradient, bounds, hold, step);
        match worst_fault(hessian, gradient, bounds, hold, step) {
            Some((entry, change)) => hold[entry] = change,
            None => return Ok(()),
        }
    }
    for (j, entry) in step.iter_mut().enumerate() {
        *entry = entry.clamp(bounds.0[j], bounds.1[j]);
    }
    Ok(())
}
