//! Recorded sequences of MPC problems (`bench/problems/mpc_*.json`), and how fast and how exactly they are solved.

use super::json::{BenchmarkError, Node};
use crate::control::mpc::{Budget, Condensed, Horizon, HorizonLimits, Stage, Start, TrackingWeights, Window};
use crate::model::{CommandInputs, LagModel, STATE_LEN};
use crate::trajopt::Dynamics;
use serde::Serialize;
use std::path::Path;

/// MPC problems met one after the other in closed loop on one linear model.
#[derive(Debug, Clone)]
pub struct MpcSequence {
    /// The sequence's name.
    pub name: String,
    /// `x⁺ = A z + B u + c`.
    pub model: LagModel,
    /// Stages N.
    pub stages: usize,
    /// Diagonals of Q (n) and R (m).
    pub weights: TrackingWeights,
    /// Bounds on the command.
    pub limits: HorizonLimits,
    /// z̄, one row per time; step j sees rows j + 1 … j + N.
    pub state_reference: Vec<f64>,
    /// ū, one row per time; step j sees rows j … j + N − 1.
    pub command_reference: Vec<f64>,
    /// z at each step (n each).
    pub states: Vec<Vec<f64>>,
    /// The exact first command at each step.
    pub exact: Vec<[f64; 3]>,
}

/// What `flyvine bench mpc --json` prints. Times are of whole steps: rollout, gradient, quadratic program.
#[derive(Debug, Clone, Serialize)]
pub struct MpcReport {
    /// The sequence's name.
    pub problem: String,
    /// Steps solved, in order, each warm-started from the one before.
    pub steps: usize,
    /// Median process-CPU time of a step, ms.
    pub median_ms: f64,
    /// Its 99th percentile, ms.
    pub p99_ms: f64,
    /// The fastest step, ms.
    pub min_ms: f64,
    /// Largest difference of a first command's entry from the recorded one, m.
    pub max_u_error: f64,
    /// Largest optimality residual of a step ([`crate::control::mpc::QpReport::residual`]).
    pub max_residual: f64,
    /// Largest number of changes of the active set in a step.
    pub max_changes: usize,
    /// Mean number of active bounds.
    pub mean_active: f64,
}

/// Reads and validates a sequence.
///
/// # Errors
/// [`BenchmarkError`], naming the key, what was found and what was expected.
pub fn read_mpc_sequence(path: &Path) -> Result<MpcSequence, BenchmarkError> {
    let text = std::fs::read_to_string(path).map_err(|source| BenchmarkError::Io {
        path: path.to_path_buf(),
        source,
    })?;
    parse(&text)
}

fn parse(text: &str) -> Result<MpcSequence, BenchmarkError> {
    let document = serde_json::from_str(text)?;
    let root = Node::root(&document);
    let name = root.get("name", "the sequence's name")?;
    let name = name.value.as_str().ok_or_else(|| name.unexpected("text"))?;
    let stages_node = root.get("horizon", "the number of stages")?;
    let stages = stages_node.count()?;
    let states_node = root.get("z", "the states, one per step")?;
    let steps = states_node.items()?.count();
    if stages == 0 || steps == 0 {
        return Err(stages_node.unexpected("at least one stage and one step"));
    }
    let weight_node = root.get("Q", "the diagonal of the state weight")?;
    let (n, m) = (weight_node.items()?.count(), CommandInputs::Position.len());
    if n == 0 || n % STATE_LEN != 0 {
        return Err(weight_node.unexpected("a list of 9 numbers per lag"));
    }
    let vector = |key: &str, len: usize| root.get(key, &format!("{len} numbers"))?.vector(len);
    let matrix = |key: &str, rows: usize, columns: usize| {
        root.get(key, &format!("{rows} rows of {columns} numbers"))?
            .matrix(rows, columns)
    };
    let (a, b) = (matrix("A", STATE_LEN, n)?, matrix("B", STATE_LEN, m)?);
    let linear = (0..STATE_LEN).flat_map(|row| [&a[row * n..][..n], &b[row * m..][..m]].concat());
    let model = LagModel::new(
        n / STATE_LEN,
        CommandInputs::Position,
        vector("c", STATE_LEN)?,
        linear.collect(),
        &[],
    )?;
    Ok(MpcSequence {
        name: name.to_owned(),
        model,
        stages,
        weights: TrackingWeights {
            state: vector("Q", n)?,
            command: vector("R", m)?,
            command_change: vec![0.0; m],
        },
        limits: HorizonLimits {
            command_lower: vector("umin", m)?,
            command_upper: vector("umax", m)?,
            command_change: None,
            states: Vec::new(),
            penalty: 1.0,
        },
        state_reference: matrix("zref", steps + stages + 1, n)?,
        command_reference: matrix("uref", steps + stages, m)?,
        states: matrix("z", steps, n)?
            .chunks_exact(n)
            .map(<[f64]>::to_vec)
            .collect(),
        exact: matrix("u_exact", steps, m)?
            .chunks_exact(m)
            .map(|u| [u[0], u[1], u[2]])
            .collect(),
    })
}

/// Solves the sequence in order; `cpu_ms` reads the process's CPU clock.
///
/// # Errors
/// The condensed Hessian is not positive definite.
pub fn mpc_report(sequence: &MpcSequence, cpu_ms: &dyn Fn() -> f64) -> Result<MpcReport, BenchmarkError> {
    let stage = Stage {
        state: sequence.model.state_len(),
        command: sequence.model.command_len(),
        fresh: sequence.model.fresh_len(),
    };
    let (n, m, stages) = (stage.state, stage.command, sequence.stages);
    let jacobians = padded_jacobian(&sequence.model, &stage).repeat(stages);
    let condensed = Condensed::new(&stage, &jacobians, &sequence.weights, &[1.0], None, &[])?;
    let mut horizon = Horizon::new(stage, stages, sequence.weights.clone(), sequence.limits.clone());
    let (no_command, no_disturbance) = (vec![0.0; m], vec![0.0; stage.fresh]);

    let mut times = Vec::with_capacity(sequence.states.len());
    let mut report = MpcReport {
        problem: sequence.name.clone(),
        steps: sequence.states.len(),
        median_ms: 0.0,
        p99_ms: 0.0,
        min_ms: 0.0,
        max_u_error: 0.0,
        max_residual: 0.0,
        max_changes: 0,
        mean_active: 0.0,
    };
    for (step, (state, exact)) in sequence.states.iter().zip(&sequence.exact).enumerate() {
        let window = Window {
            dynamics: &sequence.model,
            knot: step,
            condensed: &condensed,
            scale: 0,
            jacobians: &jacobians,
            state_reference: &sequence.state_reference[(step + 1) * n..][..stages * n],
            command_reference: &sequence.command_reference[step * m..][..stages * m],
            reference_before: &no_command,
            terminal: None,
        };
        let start = Start {
            state,
            held_command: &no_command,
            disturbance: &no_disturbance,
            gust: &no_disturbance,
            decay: 0.0,
            delay: 0.0,
            command_deviation: f64::INFINITY,
        };
        let started = cpu_ms();
        let solved = horizon.solve(&window, &start, Budget::NONE);
        times.push(cpu_ms() - started);
        let difference = horizon
            .commands()
            .iter()
            .zip(exact)
            .map(|(u, exact)| (u - exact).abs());
        report.max_u_error = difference.fold(report.max_u_error, f64::max);
        report.max_residual = report.max_residual.max(solved.residual);
        report.max_changes = report.max_changes.max(solved.changes);
        report.mean_active += solved.active as f64 / sequence.states.len() as f64;
    }
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[(share * (times.len() - 1) as f64).ceil() as usize];
    (report.median_ms, report.p99_ms, report.min_ms) = (at(0.5), at(0.99), times[0]);
    Ok(report)
}

/// The model's Jacobian, which is the same everywhere, with padded rows.
fn padded_jacobian(model: &LagModel, stage: &Stage) -> Vec<f64> {
    let width = stage.state + stage.command;
    let mut jacobian = vec![0.0; stage.fresh * width];
    model.jacobian(
        0,
        &vec![0.0; stage.state],
        &vec![0.0; stage.command],
        &mut jacobian,
    );
    let mut padded = Vec::with_capacity(stage.jacobian_len());
    for row in jacobian.chunks_exact(width) {
        padded.extend_from_slice(row);
        padded.resize(padded.len().next_multiple_of(stage.stride()), 0.0);
    }
    padded
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    fn shipped(name: &str) -> MpcSequence {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bench/problems");
        read_mpc_sequence(format!("{folder}/{name}.json").as_ref()).expect("shipped")
    }

    /// The first command of every step by another method on matrices built another way: primal-dual active sets
    /// (Hintermüller, Ito and Kunisch, SIAM J. Optim. 13, 2002) on the Hessian that powers of A give.
    fn by_primal_dual_active_sets(sequence: &MpcSequence) -> Vec<[f64; 3]> {
        let (n, m, stages) = (sequence.model.state_len(), 3, sequence.stages);
        let variables = m * stages;
        let width = n + m;
        let mut jacobian = vec![0.0; STATE_LEN * width];
        sequence
            .model
            .jacobian(0, &vec![0.0; n], &[0.0; 3], &mut jacobian);
        let transition = DMatrix::from_fn(n, width, |i, j| {
            if i < STATE_LEN {
                jacobian[i * width + j]
            } else {
                f64::from(j + STATE_LEN == i)
            }
        });
        let (a, b) = (transition.columns(0, n), transition.columns(n, m));
        let mut offset = DVector::zeros(n);
        offset
            .rows_mut(0, STATE_LEN)
            .copy_from_slice(sequence.model.offset());
        // z_j = powers_j z_0 + drift_j + effect_j u
        let mut effect = DMatrix::zeros(n * stages, variables);
        let (mut power, mut drift) = (DMatrix::identity(n, n), DVector::zeros(n));
        let (mut powers, mut drifts) = (Vec::new(), Vec::new());
        for j in 0..stages {
            for stage in j..stages {
                let block = &power * b;
                effect
                    .view_mut((n * stage, m * (stage - j)), (n, m))
                    .copy_from(&block);
            }
            power = a * power;
            drift = a * drift + &offset;
            powers.push(power.clone());
            drifts.push(drift.clone());
        }
        let weight = DVector::from_fn(n * stages, |i, _| sequence.weights.state[i % n]);
        let weighted = DMatrix::from_fn(n * stages, variables, |i, j| weight[i] * effect[(i, j)]);
        let mut hessian = effect.transpose() * &weighted;
        for i in 0..variables {
            hessian[(i, i)] += sequence.weights.command[i % m];
        }
        let bound = |side: &[f64]| DVector::from_fn(variables, |i, _| side[i % m]);
        let lower = bound(&sequence.limits.command_lower);
        let upper = bound(&sequence.limits.command_upper);
        let solve_step = |step: usize| {
            let state = DVector::from_column_slice(&sequence.states[step]);
            let reference = &sequence.state_reference[(step + 1) * n..];
            let miss = DVector::from_fn(n * stages, |i, _| {
                (powers[i / n].row(i % n) * &state)[0] + drifts[i / n][i % n] - reference[i]
            });
            let mut gradient = weighted.transpose() * miss;
            for i in 0..variables {
                gradient[i] -= sequence.weights.command[i % m] * sequence.command_reference[step * m + i];
            }
            let mut side = vec![0_i8; variables];
            for _ in 0..100 {
                let mut matrix = hessian.clone();
                let mut right = -&gradient;
                for i in 0..variables {
                    if side[i] != 0 {
                        matrix.row_mut(i).fill(0.0);
                        matrix[(i, i)] = 1.0;
                        right[i] = if side[i] < 0 { lower[i] } else { upper[i] };
                    }
                }
                let u = matrix.lu().solve(&right).expect("regular");
                let multiplier = &hessian * &u + &gradient;
                let next: Vec<i8> = (0..variables)
                    .map(|i| match side[i] {
                        -1 if multiplier[i] >= 0.0 => -1,
                        1 if multiplier[i] <= 0.0 => 1,
                        0 if u[i] < lower[i] => -1,
                        0 if u[i] > upper[i] => 1,
                        _ => 0,
                    })
                    .collect();
                if next == side {
                    return [u[0], u[1], u[2]];
                }
                side = next;
            }
            panic!("step {step}: the sets did not settle");
        };
        (0..sequence.states.len()).map(solve_step).collect()
    }

    #[test]
    fn shipped_sequences_are_solved_exactly() {
        for (name, recorded_error) in [("mpc_20", 2e-6), ("mpc_40", 1e-4)] {
            let mut sequence = shipped(name);
            // The recorded commands come from an interior-point method, which is up to 7e-5 m off where a bound is
            // only just active.
            let report = mpc_report(&sequence, &|| 0.0).unwrap();
            assert!(
                report.max_u_error <= recorded_error,
                "{name}: {:e}",
                report.max_u_error
            );
            sequence.exact = by_primal_dual_active_sets(&sequence);
            let report = mpc_report(&sequence, &|| 0.0).unwrap();
            assert_eq!(report.steps, 200);
            assert!(report.max_u_error <= 1e-9, "{name}: {:e}", report.max_u_error);
            assert!(report.max_residual <= 1e-11, "{name}: {:e}", report.max_residual);
            assert!(report.mean_active > 3.0, "{name}: bounds matter");
        }
    }

    #[test]
    fn what_is_wrong_with_a_file_is_named() {
        let message = |text: &str| parse(text).unwrap_err().to_string();
        assert!(message("{}").contains("name"));
        assert!(message(r#"{"name": "a", "horizon": 0, "z": [[0]]}"#).contains("at least one stage"));
        assert!(
            message(r#"{"name": "a", "horizon": 1, "z": [[0]], "Q": [1]}"#).contains("9 numbers per lag")
        );
    }
}
