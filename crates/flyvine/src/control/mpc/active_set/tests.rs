use super::*;
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

/// A random program in plain matrices.
struct Case {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    changes_of: Option<usize>,
    soft: DMatrix<f64>,
    compliance: f64,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

/// The same, padded.
struct Padded {
    hessian: Vec<f64>,
    inverse: Vec<f64>,
    gradient: Vec<f64>,
    soft: Vec<f64>,
}

fn padded_rows(matrix: &DMatrix<f64>) -> Vec<f64> {
    let stride = kernel::padded(matrix.ncols());
    let mut rows = vec![0.0; matrix.nrows() * stride];
    for i in 0..matrix.nrows() {
        for j in 0..matrix.ncols() {
            rows[i * stride + j] = matrix[(i, j)];
        }
    }
    rows
}

impl Case {
    fn random(seed: u64, variables: usize, changes_of: Option<usize>, soft_rows: usize) -> Self {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = |scale: f64| random.random_range(-scale..scale);
        let square = DMatrix::from_fn(variables, variables, |_, _| uniform(1.0));
        let hessian = square.transpose() * &square + DMatrix::identity(variables, variables) * 0.05;
        let gradient = DVector::from_fn(variables, |_, _| uniform(3.0));
        let soft = DMatrix::from_fn(soft_rows, variables, |_, _| uniform(1.0));
        let hard = variables * if changes_of.is_some() { 2 } else { 1 };
        // Zero keeps every row, so the program is feasible; some rows have one bound or none.
        let mut bounds = |sign: f64| -> Vec<f64> {
            (0..hard + soft_rows)
                .map(|_| match uniform(1.0) {
                    open if open > 0.7 => sign * f64::INFINITY,
                    size => sign * (0.05 + size.abs()),
                })
                .collect()
        };
        Self {
            lower: bounds(-1.0),
            upper: bounds(1.0),
            hessian,
            gradient,
            changes_of,
            soft,
            compliance: 0.02,
        }
    }

    fn padded(&self) -> Padded {
        let inverse = self.hessian.clone().try_inverse().unwrap();
        let mut gradient = self.gradient.as_slice().to_vec();
        gradient.resize(kernel::padded(gradient.len()), 0.0);
        Padded {
            hessian: padded_rows(&self.hessian),
            inverse: padded_rows(&inverse),
            gradient,
            soft: padded_rows(&self.soft),
        }
    }

    fn program<'a>(&'a self, padded: &'a Padded) -> QuadraticProgram<'a> {
        QuadraticProgram {
            hessian: &padded.hessian,
            inverse: &padded.inverse,
            gradient: &padded.gradient,
            rows: Rows {
                variables: self.gradient.len(),
                changes_of: self.changes_of,
                soft: &padded.soft,
                compliance: self.compliance,
            },
            lower: &self.lower,
            upper: &self.upper,
        }
    }

    fn workspace(&self) -> ActiveSet {
        ActiveSet::new(self.gradient.len(), self.lower.len(), self.soft.nrows())
    }

    /// C as a plain matrix.
    fn rows(&self) -> DMatrix<f64> {
        let n = self.gradient.len();
        let mut rows = DMatrix::zeros(self.lower.len(), n);
        for i in 0..n {
            rows[(i, i)] = 1.0;
            if let Some(m) = self.changes_of {
                rows[(n + i, i)] = 1.0;
                if i >= m {
                    rows[(n + i, i - m)] = -1.0;
                }
            }
        }
        let first_soft = self.lower.len() - self.soft.nrows();
        for i in 0..self.soft.nrows() {
            rows.set_row(first_soft + i, &self.soft.row(i));
        }
        rows
    }

    /// Independent of the method: the KKT system of every choice of active sides, until one satisfies all
    /// conditions.
    fn by_enumeration(&self) -> DVector<f64> {
        let (rows, n, count) = (self.rows(), self.gradient.len(), self.lower.len());
        let first_soft = count - self.soft.nrows();
        for code in 0..3_usize.pow(count as u32) {
            let side = |row: usize| (code / 3_usize.pow(row as u32)) % 3; // 0 inactive, 1 lower, 2 upper
            let active: Vec<usize> = (0..count).filter(|&row| side(row) > 0).collect();
            let bound = |row: usize| {
                if side(row) == 1 {
                    self.lower[row]
                } else {
                    self.upper[row]
                }
            };
            if active.iter().any(|&row| bound(row).is_infinite()) {
                continue;
            }
            let size = n + active.len();
            let mut system = DMatrix::zeros(size, size);
            let mut right = DVector::zeros(size);
            system.view_mut((0, 0), (n, n)).copy_from(&self.hessian);
            right.rows_mut(0, n).copy_from(&-&self.gradient);
            for (a, &row) in active.iter().enumerate() {
                for j in 0..n {
                    system[(n + a, j)] = rows[(row, j)];
                    system[(j, n + a)] = -rows[(row, j)];
                }
                if row >= first_soft {
                    system[(n + a, n + a)] = self.compliance;
                }
                right[n + a] = bound(row);
            }
            let Some(point) = system.clone().lu().solve(&right) else {
                continue;
            };
            // Rows that depend on each other make a singular system, which rounding may hide.
            if (&system * &point - &right).amax().is_nan() || (&system * &point - &right).amax() > 1e-9 {
                continue;
            }
            let v = point.rows(0, n).into_owned();
            let signs_fit = active.iter().enumerate().all(|(a, &row)| {
                let multiplier = point[n + a];
                if side(row) == 1 {
                    multiplier >= -1e-9
                } else {
                    multiplier <= 1e-9
                }
            });
            let values = &rows * &v;
            let kept = (0..count).all(|row| {
                side(row) > 0 || (self.lower[row] - 1e-9..=self.upper[row] + 1e-9).contains(&values[row])
            });
            if signs_fit && kept {
                return v;
            }
        }
        panic!("no choice of active rows satisfies the optimality conditions");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn the_optimum_is_that_of_trying_every_active_set(seed in 0..u64::MAX, with_changes: bool) {
        let changes_of = with_changes.then_some(1);
        let case = Case::random(seed, 3, changes_of, if with_changes { 2 } else { 3 });
        let padded = case.padded();
        let mut workspace = case.workspace();
        let report = workspace.solve(&case.program(&padded), Budget::NONE);
        prop_assert_eq!(report.status, StepStatus::Optimal);
        prop_assert!(report.residual < 1e-9, "residual {}", report.residual);
        let expected = case.by_enumeration();
        for (found, expected) in workspace.solution().iter().zip(expected.iter()) {
            prop_assert!((found - expected).abs() < 1e-8, "{} against {}", found, expected);
        }
    }

    #[test]
    fn a_warm_start_changes_the_way_but_not_the_answer(seed in 0..u64::MAX) {
        let mut case = Case::random(seed, 30, Some(3), 12);
        let padded = case.padded();
        let mut warm = case.workspace();
        warm.solve(&case.program(&padded), Budget::NONE);
        let again = warm.solve(&case.program(&padded), Budget::NONE);
        prop_assert_eq!(again.changes, 0);
        case.gradient *= -0.7;
        let padded = case.padded();
        let mut cold = case.workspace();
        let warm_report = warm.solve(&case.program(&padded), Budget::NONE);
        let cold_report = cold.solve(&case.program(&padded), Budget::NONE);
        for report in [warm_report, cold_report] {
            prop_assert_eq!(report.status, StepStatus::Optimal);
            prop_assert!(report.residual < 1e-8, "residual {}", report.residual);
        }
        for (warm, cold) in warm.solution().iter().zip(cold.solution()) {
            prop_assert!((warm - cold).abs() < 1e-7);
        }
    }
}

#[test]
fn a_spent_budget_keeps_the_rows_taken_in_so_far() {
    let case = Case::random(3, 30, Some(3), 12);
    let padded = case.padded();
    let mut workspace = case.workspace();
    let whole = workspace.solve(&case.program(&padded), Budget::NONE);
    assert!(whole.changes > 4, "{whole:?}");
    workspace.forget();
    let budget = Budget {
        changes: 4,
        deadline: None,
    };
    let part = workspace.solve(&case.program(&padded), budget);
    assert_eq!((part.status, part.changes), (StepStatus::BudgetSpent, 4));
    assert!(part.residual > whole.residual);
    let mut again = case.workspace();
    again.solve(&case.program(&padded), budget);
    assert_eq!(
        again.solution(),
        workspace.solution(),
        "the same count gives the same bits"
    );
}

#[test]
fn contradicting_rows_are_infeasible() {
    let mut case = Case::random(5, 2, Some(1), 0);
    // v₀ ≥ 1, and at most 0.5 above what it was.
    case.lower = vec![1.0, f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    case.upper = vec![2.0, f64::INFINITY, 0.5, f64::INFINITY];
    let padded = case.padded();
    let report = case.workspace().solve(&case.program(&padded), Budget::NONE);
    assert_eq!(report.status, StepStatus::Infeasible);
}
