//! A quadratic program, and products with its rows.

use crate::kernel;

/// The rows of C, in this order: every variable; its change from the command before; soft rows.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// Number n of variables.
    pub variables: usize,
    /// Entries m of one command: row n + i is `v_i − v_{i−m}`, or v_i for the first command. None for no such rows.
    pub changes_of: Option<usize>,
    /// Soft rows, each padded as [`kernel`] wants it.
    pub soft: &'a [f64],
    /// How much a soft row yields per unit of its multiplier.
    pub compliance: f64,
}

/// A quadratic program; matrices have rows padded with zeros to `kernel::padded(n)`.
#[derive(Debug, Clone, Copy)]
pub struct QuadraticProgram<'a> {
    /// H (n rows), symmetric positive definite.
    pub hessian: &'a [f64],
    /// H⁻¹ (n rows).
    pub inverse: &'a [f64],
    /// g, padded.
    pub gradient: &'a [f64],
    /// C.
    pub rows: Rows<'a>,
    /// Lower bound of every row, −∞ for none.
    pub lower: &'a [f64],
    /// Upper bound of every row, +∞ for none.
    pub upper: &'a [f64],
}

/// A row at one of its bounds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Active {
    pub row: usize,
    pub upper: bool,
}

impl Active {
    /// +1 for a row at its lower bound, −1 at its upper.
    pub fn sign(self) -> f64 {
        if self.upper { -1.0 } else { 1.0 }
    }
}

impl Rows<'_> {
    /// Number of the first soft row.
    pub fn first_soft(&self) -> usize {
        self.variables + self.changes_of.map_or(0, |_| self.variables)
    }

    pub(super) fn compliance_of(&self, row: usize) -> f64 {
        if row < self.first_soft() {
            0.0
        } else {
            self.compliance
        }
    }

    pub(super) fn soft_row(&self, row: usize) -> &[f64] {
        let stride = kernel::padded(self.variables);
        &self.soft[(row - self.first_soft()) * stride..][..stride]
    }
}

/// c̃ᵀ v ≥ b̃.
pub(super) fn bound(program: &QuadraticProgram<'_>, active: Active) -> f64 {
    if active.upper {
        -program.upper[active.row]
    } else {
        program.lower[active.row]
    }
}

/// c_rowᵀ x.
pub(super) fn row_product(rows: &Rows<'_>, row: usize, x: &[f64]) -> f64 {
    if row < rows.variables {
        return x[row];
    }
    match rows.changes_of {
        Some(m) if row < 2 * rows.variables => {
            let i = row - rows.variables;
            if i < m { x[i] } else { x[i] - x[i - m] }
        }
        _ => rows.soft_row(row).iter().zip(x).map(|(c, x)| c * x).sum(),
    }
}

/// out += scale · c_row.
pub(super) fn add_row(rows: &Rows<'_>, row: usize, scale: f64, out: &mut [f64]) {
    if row < rows.variables {
        out[row] += scale;
        return;
    }
    match rows.changes_of {
        Some(m) if row < 2 * rows.variables => {
            let i = row - rows.variables;
            out[i] += scale;
            if i >= m {
                out[i - m] -= scale;
            }
        }
        _ => add_scaled(scale, rows.soft_row(row), out),
    }
}

/// t = H⁻¹ c̃.
pub(super) fn write_direction(program: &QuadraticProgram<'_>, wanted: Active, direction: &mut [f64]) {
    let rows = &program.rows;
    let stride = direction.len();
    let inverse_row = |i: usize| &program.inverse[i * stride..][..stride];
    let sign = wanted.sign();
    direction.fill(0.0);
    if wanted.row < rows.variables {
        add_scaled(sign, inverse_row(wanted.row), direction);
        return;
    }
    match rows.changes_of {
        Some(m) if wanted.row < 2 * rows.variables => {
            let i = wanted.row - rows.variables;
            add_scaled(sign, inverse_row(i), direction);
            if i >= m {
                add_scaled(-sign, inverse_row(i - m), direction);
            }
        }
        _ => {
            kernel::multiply(
                program.inverse,
                rows.soft_row(wanted.row),
                &mut direction[..rows.variables],
            );
            direction.iter_mut().for_each(|entry| *entry *= sign);
        }
    }
}

/// out += scale · x.
pub(super) fn add_scaled(scale: f64, x: &[f64], out: &mut [f64]) {
    for (entry, x) in out.iter_mut().zip(x) {
        *entry += scale * x;
    }
}
