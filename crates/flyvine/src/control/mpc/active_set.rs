//! A strictly convex quadratic program by a dual active-set method, warm-started and exact.
//!
//! ```text
//! min ½ vᵀ H v + gᵀ v    subject to    lower ≤ C v ≤ upper
//! ```
//!
//! The method is that of Goldfarb and Idnani (Math. Program. 27, 1983), in range-space form: with the active rows
//! c̃_a (signed so that c̃_aᵀ v ≥ b̃_a), the directions t_a = H⁻¹ c̃_a, and the Cholesky factor L of
//! M = [c̃_aᵀ t_b] + compliance, it keeps `v = −H⁻¹ g + Σ y_a t_a` optimal for the active rows with y ≥ 0, and adds
//! the row that is violated most until none is. H⁻¹ is known beforehand, so a change of the set costs O(n q).
//!
//! A soft row may be violated by its compliance times its multiplier: a quadratic penalty of weight 1/compliance.

mod program;

pub use program::{QuadraticProgram, Rows};

use crate::flight::StepStatus;
use crate::kernel;
use program::{Active, add_row, add_scaled, bound, row_product, write_direction};
use std::time::Instant;

/// Violation up to which a row counts as kept.
const VIOLATION_TOLERANCE: f64 = 1e-10;
/// Share of its own curvature below which a row counts as dependent on the active ones.
const DEPENDENT: f64 = 1e-11;
/// Changes of the active set between two looks at the clock.
const CHANGES_PER_LOOK: usize = 8;

/// When to stop before the optimum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget {
    /// Changes of the active set at most.
    pub changes: usize,
    /// When the answer is due.
    pub deadline: Option<Instant>,
}

impl Budget {
    /// Run to the end.
    pub const NONE: Self = Self {
        changes: usize::MAX,
        deadline: None,
    };

    fn spent(&self, changes: usize) -> bool {
        let late = |deadline| Instant::now() >= deadline;
        changes >= self.changes
            || (changes.is_multiple_of(CHANGES_PER_LOOK) && self.deadline.is_some_and(late))
    }
}

/// What a solve reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QpReport {
    /// How it ended.
    pub status: StepStatus,
    /// Rows added to or dropped from the active set after the warm start.
    pub changes: usize,
    /// Active rows at the end.
    pub active: usize,
    /// Largest of ‖Hv + g − C̃ᵀy‖∞ / (1 + ‖g‖∞), the violation of any row, and |y_a (c̃_aᵀv − b̃_a)|.
    pub residual: f64,
}

/// Workspace of the method, allocated once for the largest program, and the last active set, from which the next
/// solve starts.
#[derive(Debug, Clone)]
pub struct ActiveSet {
    variables: usize,
    stride: usize,
    /// Rows that may be active at once: all of them.
    capacity: usize,
    active: Vec<Active>,
    guess: Vec<Active>,
    is_active: Vec<bool>,
    /// y (capacity).
    multipliers: Vec<f64>,
    /// t_a (capacity × stride).
    directions: Vec<f64>,
    /// L, lower triangle (capacity × capacity).
    factor: Vec<f64>,
    /// v (stride).
    solution: Vec<f64>,
    /// t of the row that is being added (stride).
    direction: Vec<f64>,
    /// L⁻¹ C̃ t (capacity).
    coupling: Vec<f64>,
    /// How fast the multipliers fall while that row is added, L⁻ᵀ L⁻¹ C̃ t (capacity).
    rates: Vec<f64>,
    /// C v of the soft rows.
    soft_values: Vec<f64>,
}

impl ActiveSet {
    /// Room for programs of up to `variables` and `rows` in all, `soft` of them soft.
    pub fn new(variables: usize, rows: usize, soft: usize) -> Self {
        let stride = kernel::padded(variables);
        Self {
            variables,
            stride,
            capacity: rows,
            active: Vec::with_capacity(rows),
            guess: Vec::with_capacity(rows),
            is_active: vec![false; rows],
            multipliers: Vec::with_capacity(rows),
            directions: vec![0.0; rows * stride],
            factor: vec![0.0; rows * rows],
            solution: vec![0.0; stride],
            direction: vec![0.0; stride],
            coupling: vec![0.0; rows],
            rates: vec![0.0; rows],
            soft_values: vec![0.0; soft],
        }
    }

    /// v after the last solve.
    pub fn solution(&self) -> &[f64] {
        &self.solution[..self.variables]
    }

    /// Forgets the active set.
    pub fn forget(&mut self) {
        self.active.clear();
    }

    /// Renames the rows of the warm start; those without a new name are left out.
    pub fn rename(&mut self, mut new_name: impl FnMut(usize) -> Option<usize>) {
        self.active.retain_mut(|active| match new_name(active.row) {
            Some(row) => {
                active.row = row;
                true
            }
            None => false,
        });
    }

    /// Solves `program`, from the active set of the last solve. Allocates nothing.
    pub fn solve(&mut self, program: &QuadraticProgram<'_>, budget: Budget) -> QpReport {
        self.variables = program.rows.variables;
        self.stride = kernel::padded(self.variables);
        for vector in [&mut self.solution, &mut self.direction] {
            vector.clear();
            vector.resize(self.stride, 0.0);
        }
        self.soft_values
            .resize(program.rows.soft.len() / self.stride, 0.0);
        self.warm_start(program);
        let (status, changes) = self.take_in_violated(program, budget);
        QpReport {
            status,
            changes,
            active: self.active.len(),
            residual: self.residual(program),
        }
    }

    /// The optimum for the rows of the last active set, without those whose multipliers are negative there.
    fn warm_start(&mut self, program: &QuadraticProgram<'_>) {
        std::mem::swap(&mut self.active, &mut self.guess);
        self.active.clear();
        self.multipliers.clear();
        self.is_active.fill(false);
        kernel::multiply(
            program.inverse,
            program.gradient,
            &mut self.solution[..self.variables],
        );
        for entry in &mut self.solution[..self.variables] {
            *entry = -*entry;
        }
        for index in 0..self.guess.len() {
            let candidate = self.guess[index];
            if bound(program, candidate).is_finite()
                && !self.is_active[candidate.row]
                && let Some(curvature) = self.prepare(program, candidate)
            {
                self.push(candidate, curvature, 0.0);
            }
        }
        // M y = b̃ − C̃ v₀
        loop {
            let count = self.active.len();
            for a in 0..count {
                let active = self.active[a];
                self.multipliers[a] = bound(program, active)
                    - active.sign() * row_product(&program.rows, active.row, &self.solution);
            }
            solve_lower(&self.factor, self.capacity, &mut self.multipliers);
            solve_upper(&self.factor, self.capacity, &mut self.multipliers);
            for a in (0..count).rev() {
                if self.multipliers[a] < 0.0 {
                    self.remove(a);
                }
            }
            if self.active.len() == count {
                break;
            }
        }
        for (direction, &multiplier) in self.directions.chunks_exact(self.stride).zip(&self.multipliers) {
            add_scaled(multiplier, direction, &mut self.solution);
        }
    }

    fn take_in_violated(&mut self, program: &QuadraticProgram<'_>, budget: Budget) -> (StepStatus, usize) {
        let mut changes = 0;
        while let Some((wanted, mut violation)) = self.most_violated(program) {
            let mut multiplier = 0.0;
            loop {
                if budget.spent(changes) {
                    return (StepStatus::BudgetSpent, changes);
                }
                changes += 1;
                let curvature = self.prepare(program, wanted);
                let count = self.active.len();
                self.rates[..count].copy_from_slice(&self.coupling[..count]);
                solve_upper(&self.factor, self.capacity, &mut self.rates[..count]);
                let full = curvature.map_or(f64::INFINITY, |curvature| violation / curvature);
                let (blocking, partial) = self.first_to_vanish();
                let step = full.min(partial);
                if step.is_infinite() {
                    return (StepStatus::Infeasible, changes);
                }
                self.advance(step);
                multiplier += step;
                match curvature {
                    Some(curvature) if full <= partial => {
                        self.push(wanted, curvature, multiplier);
                        break;
                    }
                    _ => {
                        violation -= step * curvature.unwrap_or(0.0);
                        self.remove(blocking);
                    }
                }
            }
        }
        (StepStatus::Optimal, changes)
    }

    /// The inactive row that is violated most, and by how much.
    fn most_violated(&mut self, program: &QuadraticProgram<'_>) -> Option<(Active, f64)> {
        let rows = &program.rows;
        kernel::multiply(rows.soft, &self.solution, &mut self.soft_values);
        let (mut worst, mut found) = (VIOLATION_TOLERANCE, None);
        for row in 0..program.lower.len() {
            let value = self.value(rows, row);
            let (below, above) = (program.lower[row] - value, value - program.upper[row]);
            let violation = below.max(above);
            if violation > worst && !self.is_active[row] {
                worst = violation;
                found = Some(Active {
                    row,
                    upper: above > below,
                });
            }
        }
        found.map(|active| (active, worst))
    }

    /// Entry `row` of C v; for soft rows as last computed.
    fn value(&self, rows: &Rows<'_>, row: usize) -> f64 {
        match row.checked_sub(rows.first_soft()) {
            Some(soft) => self.soft_values[soft],
            None => row_product(rows, row, &self.solution),
        }
    }

    /// Computes t = H⁻¹ c̃ of `wanted` and `coupling = L⁻¹ C̃ t`; gives the curvature that is left beside the active
    /// rows, c̃ᵀ t + compliance − ‖coupling‖², or nothing if the row depends on them.
    fn prepare(&mut self, program: &QuadraticProgram<'_>, wanted: Active) -> Option<f64> {
        write_direction(program, wanted, &mut self.direction);
        let own = wanted.sign() * row_product(&program.rows, wanted.row, &self.direction)
            + program.rows.compliance_of(wanted.row);
        let count = self.active.len();
        for (entry, active) in self.coupling.iter_mut().zip(&self.active) {
            *entry = active.sign() * row_product(&program.rows, active.row, &self.direction);
        }
        solve_lower(&self.factor, self.capacity, &mut self.coupling[..count]);
        let left = own - self.coupling[..count].iter().map(|w| w * w).sum::<f64>();
        (left > DEPENDENT * own).then_some(left)
    }

    /// The active row whose multiplier vanishes first along −`rates`, and after which step.
    fn first_to_vanish(&self) -> (usize, f64) {
        let (mut first, mut step) = (0, f64::INFINITY);
        for (a, (&multiplier, &rate)) in self.multipliers.iter().zip(&self.rates).enumerate() {
            if rate > 0.0 && multiplier / rate < step {
                (first, step) = (a, multiplier / rate);
            }
        }
        (first, step)
    }

    /// v += step (t − Σ r_a t_a), y −= step r.
    fn advance(&mut self, step: f64) {
        add_scaled(step, &self.direction, &mut self.solution);
        let rates = self.directions.chunks_exact(self.stride).zip(&self.rates);
        for ((direction, &rate), multiplier) in rates.zip(&mut self.multipliers) {
            add_scaled(-step * rate, direction, &mut self.solution);
            *multiplier -= step * rate;
        }
    }

    /// Appends the row that was prepared last.
    fn push(&mut self, active: Active, curvature: f64, multiplier: f64) {
        let count = self.active.len();
        let row = &mut self.factor[count * self.capacity..][..=count];
        row[..count].copy_from_slice(&self.coupling[..count]);
        row[count] = curvature.sqrt();
        self.directions[count * self.stride..][..self.stride].copy_from_slice(&self.direction);
        self.active.push(active);
        self.multipliers.push(multiplier);
        self.is_active[active.row] = true;
    }

    /// Removes active row `gone`: its row leaves L, and rotations of neighbouring columns make L triangular again.
    fn remove(&mut self, gone: usize) {
        let (capacity, stride) = (self.capacity, self.stride);
        self.is_active[self.active[gone].row] = false;
        self.active.remove(gone);
        self.multipliers.remove(gone);
        let count = self.active.len();
        self.directions
            .copy_within((gone + 1) * stride..(count + 1) * stride, gone * stride);
        for row in gone..count {
            let from = (row + 1) * capacity;
            self.factor.copy_within(from..from + row + 2, row * capacity);
        }
        for column in gone..count {
            let (a, b) = (
                self.factor[column * capacity + column],
                self.factor[column * capacity + column + 1],
            );
            let length = a.hypot(b);
            let (cosine, sine) = (a / length, b / length);
            for row in column..count {
                let pair = &mut self.factor[row * capacity + column..][..2];
                let (a, b) = (pair[0], pair[1]);
                pair[0] = cosine * a + sine * b;
                pair[1] = cosine * b - sine * a;
            }
        }
    }

    /// See [`QpReport::residual`].
    fn residual(&mut self, program: &QuadraticProgram<'_>) -> f64 {
        let rows = &program.rows;
        // Hv + g − C̃ᵀ y in `direction`.
        kernel::multiply(
            program.hessian,
            &self.solution,
            &mut self.direction[..self.variables],
        );
        let mut scale = 1.0_f64;
        for (entry, &g) in self.direction.iter_mut().zip(program.gradient) {
            *entry += g;
            scale = scale.max(1.0 + g.abs());
        }
        for (active, &multiplier) in self.active.iter().zip(&self.multipliers) {
            add_row(rows, active.row, -active.sign() * multiplier, &mut self.direction);
        }
        let mut worst = self.direction[..self.variables]
            .iter()
            .fold(0.0_f64, |worst, entry| worst.max(entry.abs()))
            / scale;
        kernel::multiply(rows.soft, &self.solution, &mut self.soft_values);
        for row in (0..program.lower.len()).filter(|&row| !self.is_active[row]) {
            let value = self.value(rows, row);
            worst = worst
                .max(program.lower[row] - value)
                .max(value - program.upper[row]);
        }
        for (active, &multiplier) in self.active.iter().zip(&self.multipliers) {
            let gap = active.sign() * self.value(rows, active.row) - bound(program, *active)
                + rows.compliance_of(active.row) * multiplier;
            worst = worst.max(-gap).max((gap * multiplier).abs()).max(-multiplier);
        }
        worst
    }
}

/// x ← L⁻¹ x.
fn solve_lower(factor: &[f64], capacity: usize, x: &mut [f64]) {
    for i in 0..x.len() {
        let row = &factor[i * capacity..][..=i];
        let sum: f64 = row[..i].iter().zip(&*x).map(|(l, x)| l * x).sum();
        x[i] = (x[i] - sum) / row[i];
    }
}

/// x ← L⁻ᵀ x.
fn solve_upper(factor: &[f64], capacity: usize, x: &mut [f64]) {
    for i in (0..x.len()).rev() {
        let row = &factor[i * capacity..][..=i];
        x[i] /= row[i];
        let entry = x[i];
        add_scaled(-entry, &row[..i], x);
    }
}

#[cfg(test)]
mod tests;
