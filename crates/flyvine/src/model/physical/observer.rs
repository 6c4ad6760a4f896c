//! Hidden states from poses: an extended Kalman filter over the physical model.
//!
//! Predicts with the model's step and its Jacobian F, and corrects with the poses that were seen, which are the
//! first nine entries of the state:
//!
//! ```text
//! P ← F P Fᵀ + Q,    K = P Cᵀ (C P Cᵀ + R)⁻¹,    z ← z + K (y − C z),    P ← (I − K C) P (I − K C)ᵀ + K R Kᵀ
//! ```

use super::error::PhysicalError;
use super::flight_data::{FlightData, Observed};
use super::parameters::Parameters;
use super::state::{OUTPUT_LEN, STATE_LEN, State, offset};
use crate::trajopt::Dynamics;
use nalgebra::{DMatrix, SMatrix, SVector};

type StateMatrix = SMatrix<f64, STATE_LEN, STATE_LEN>;

/// Standard deviation of a measured position, m, and of the attitude's vector part.
const POSITION_NOISE_M: f64 = 1e-3;
const ATTITUDE_NOISE: f64 = 1e-3;

/// Standard deviations of the state's blocks: what a pose leaves open at the start, and what one knot adds.
/// In the order of the flat layout; m, s, rad.
const BLOCKS: [(usize, f64, f64); 12] = [
    (3, 2e-3, 2e-4), // position
    (3, 2e-3, 1e-3), // attitude
    (3, 2e-3, 2e-4), // tip
    (3, 0.2, 1e-2),  // velocity
    (3, 0.3, 5e-2),  // body rate
    (3, 5.0, 0.5),   // angular acceleration
    (3, 1.0, 0.1),   // rate integrator
    (3, 1.0, 1e-2),  // integrator
    (3, 0.05, 1e-2), // filtered velocity
    (1, 1.0, 0.1),   // thrust
    (6, 1e-4, 1e-5), // commands in transport
    (3, 0.4, 2e-2),  // tip velocity
];
/// The same for the position and velocity of an inner joint.
const INNER_JOINT: [(usize, f64, f64); 2] = [(3, 0.05, 1e-3), (3, 0.4, 2e-2)];

/// The estimate of the state at one row.
#[derive(Debug, Clone)]
pub struct Observer {
    state: [f64; STATE_LEN],
    covariance: StateMatrix,
    process: SVector<f64, STATE_LEN>,
}

impl Observer {
    /// Starts at a state guessed from poses.
    pub fn new(start: &State<f64>) -> Self {
        let inner = (offset::JOINTS..STATE_LEN).step_by(6).flat_map(|_| INNER_JOINT);
        let deviations: Vec<(f64, f64)> = BLOCKS
            .into_iter()
            .chain(inner)
            .flat_map(|(count, initial, process)| std::iter::repeat_n((initial, process), count))
            .collect();
        let variances = |of: fn(&(f64, f64)) -> f64| SVector::from_fn(|i, _| of(&deviations[i]).powi(2));
        let mut state = [0.0; STATE_LEN];
        start.write_flat(&mut state);
        Observer {
            state,
            covariance: StateMatrix::from_diagonal(&variances(|d| d.0)),
            process: variances(|d| d.1),
        }
    }

    /// The estimate, in the flat layout of [`State`].
    pub fn state(&self) -> &[f64; STATE_LEN] {
        &self.state
    }

    /// One knot on, under `command`.
    pub fn predict(&mut self, dynamics: &impl Dynamics, knot: usize, command: &[f64; 3]) {
        let width = STATE_LEN + command.len();
        let mut jacobian = vec![0.0; STATE_LEN * width];
        let mut next = [0.0; STATE_LEN];
        dynamics.linearize(knot, &self.state, command, &mut next, &mut jacobian);
        let transition = StateMatrix::from_fn(|i, j| jacobian[i * width + j]);
        self.state = next;
        self.covariance = transition * self.covariance * transition.transpose();
        for i in 0..STATE_LEN {
            self.covariance[(i, i)] += self.process[i];
        }
    }

    /// A model that does not describe the vehicle may send an estimate beyond all numbers.
    fn is_finite(&self) -> bool {
        self.state.iter().all(|entry| entry.is_finite())
            && self.covariance.iter().all(|entry| entry.is_finite())
    }

    /// Takes in what was seen.
    pub fn correct(&mut self, observed: &Observed) {
        let seen: Vec<usize> = (0..OUTPUT_LEN)
            .filter(|&entry| {
                if entry < 6 {
                    observed.quadrotor
                } else {
                    observed.end_effector
                }
            })
            .collect();
        let noise = |entry: usize| {
            let attitude = (3..6).contains(&entry);
            (if attitude {
                ATTITUDE_NOISE
            } else {
                POSITION_NOISE_M
            })
            .powi(2)
        };
        let rows = seen.len();
        let mut innovation_covariance =
            DMatrix::from_fn(rows, rows, |i, j| self.covariance[(seen[i], seen[j])]);
        for i in 0..rows {
            innovation_covariance[(i, i)] += noise(seen[i]);
        }
        let Some(factor) = innovation_covariance.cholesky() else {
            return; // only if the covariance is no longer finite
        };
        // Kᵀ = S⁻¹ C P
        let cross = DMatrix::from_fn(rows, STATE_LEN, |i, j| self.covariance[(seen[i], j)]);
        let gain = factor.solve(&cross).transpose();
        let mut keep = StateMatrix::identity();
        let mut added = StateMatrix::zeros();
        for i in 0..STATE_LEN {
            for (j, &entry) in seen.iter().enumerate() {
                keep[(i, entry)] -= gain[(i, j)];
            }
            for k in 0..STATE_LEN {
                added[(i, k)] = (0..rows)
                    .map(|j| gain[(i, j)] * noise(seen[j]) * gain[(k, j)])
                    .sum();
            }
        }
        let innovation: Vec<f64> = seen
            .iter()
            .map(|&e| observed.outputs[e] - self.state[e])
            .collect();
        for i in 0..STATE_LEN {
            self.state[i] += (0..rows).map(|j| gain[(i, j)] * innovation[j]).sum::<f64>();
        }
        self.covariance = keep * self.covariance * keep.transpose() + added;
    }
}

/// The estimated flat state at every row of `data` from row `first` on. From the third on, each is made of this
/// and earlier rows only (the first guess looks two rows ahead). Where an estimate leaves the finite numbers, the next row
/// with both poses begins anew.
///
/// `dynamics` counts the flight's rows as knots; `parameters` are those at row `first`.
///
/// # Errors
/// Row `first` does not exist or lacks a pose.
pub fn observe(
    dynamics: &impl Dynamics,
    parameters: &Parameters<f64>,
    data: &FlightData,
    first: usize,
) -> Result<Vec<[f64; STATE_LEN]>, PhysicalError> {
    if !data.observed.get(first).is_some_and(Observed::complete) {
        return Err(PhysicalError::NoPose {
            flight: data.name.clone(),
            row: data.first_row + first,
        });
    }
    let mut observer = Observer::new(&data.start(first, parameters));
    observer.correct(&data.observed[first]);
    let mut estimates = vec![*observer.state()];
    for row in first + 1..data.rows() {
        observer.predict(dynamics, data.first_row + row - 1, &data.commands[row - 1]);
        if !observer.is_finite() && data.observed[row].complete() {
            observer = Observer::new(&data.start(row, parameters));
        }
        observer.correct(&data.observed[row]);
        estimates.push(*observer.state());
    }
    Ok(estimates)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{random_commands, simulate_flight};
    use super::*;
    use crate::model::physical::{ArmLength, PhysicalModel};

    fn truth_and_estimates(masked: std::ops::Range<usize>) -> (Vec<[f64; STATE_LEN]>, Vec<[f64; STATE_LEN]>) {
        let parameters = Parameters::defaults();
        let model = PhysicalModel::new(parameters, ArmLength::constant(0.8)).unwrap();
        let (mut flight, truth) =
            simulate_flight("synthetic", &parameters, 0.8, &random_commands(200, 3), 3e-4, 4);
        for sample in &mut flight.samples[masked] {
            sample.quadrotor = None;
            sample.end_effector = None;
        }
        let data = FlightData::stretches(&flight).unwrap().remove(0);
        // From the middle of the manoeuvre, knowing nothing of what was before.
        (
            truth[60..].to_vec(),
            observe(&model, &parameters, &data, 60).unwrap(),
        )
    }

    fn worst(truth: &[f64; STATE_LEN], estimate: &[f64; STATE_LEN], entries: std::ops::Range<usize>) -> f64 {
        entries
            .map(|i| (truth[i] - estimate[i]).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn hidden_states_are_found_from_poses() {
        let (truth, estimates) = truth_and_estimates(0..0);
        let (truth, estimate) = (truth.last().unwrap(), estimates.last().unwrap());
        assert!(worst(truth, estimate, 0..9) < 2e-3, "outputs");
        assert!(
            worst(truth, estimate, offset::VELOCITY..offset::BODY_RATE) < 0.02,
            "velocity"
        );
        assert!(
            worst(truth, estimate, offset::INTEGRATOR..offset::FILTERED_VELOCITY) < 0.05,
            "integrator"
        );
        assert!(
            worst(truth, estimate, offset::JOINTS..offset::JOINTS + 3) < 0.01,
            "inner joint"
        );
    }

    #[test]
    fn missing_poses_are_bridged() {
        let (truth, estimates) = truth_and_estimates(140..160);
        // The last masked row: a second without poses.
        let row = 159 - 60;
        assert!(worst(&truth[row], &estimates[row], 0..9) < 0.03);
        let last = truth.len() - 1;
        assert!(worst(&truth[last], &estimates[last], 0..9) < 2e-3);
    }

    #[test]
    fn an_estimate_beyond_all_numbers_begins_anew() {
        let parameters = Parameters::defaults();
        let model = PhysicalModel::new(parameters, ArmLength::constant(0.8)).unwrap();
        let (mut flight, truth) =
            simulate_flight("synthetic", &parameters, 0.8, &random_commands(200, 3), 3e-4, 4);
        flight.samples[101].end_effector = None;
        let mut data = FlightData::stretches(&flight).unwrap().remove(0);
        data.commands[100] = [f64::NAN; 3];
        let estimates = observe(&model, &parameters, &data, 0).unwrap();
        assert!(
            estimates[101].iter().any(|entry| entry.is_nan()),
            "no pose to begin with"
        );
        for row in (0..200).filter(|&row| row != 101) {
            assert!(
                estimates[row][..OUTPUT_LEN].iter().all(|entry| entry.is_finite()),
                "row {row}"
            );
            assert!(worst(&truth[row], &estimates[row], 0..9) < 5e-3, "row {row}");
        }
    }

    #[test]
    fn observing_needs_both_poses_at_the_start() {
        let parameters = Parameters::defaults();
        let model = PhysicalModel::new(parameters, ArmLength::constant(0.8)).unwrap();
        let (mut flight, _) = simulate_flight("synthetic", &parameters, 0.8, &random_commands(60, 3), 0.0, 4);
        flight.samples[10].end_effector = None;
        let data = FlightData::stretches(&flight).unwrap().remove(0);
        assert!(observe(&model, &parameters, &data, 10).is_err());
        assert!(observe(&model, &parameters, &data, 60).is_err());
    }
}
