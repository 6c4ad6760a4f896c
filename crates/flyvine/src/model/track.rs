//! A flight as arrays, and which rows follow each other without a gap.

use super::bank::same;
use super::error::ModelError;
use super::lag::{CommandInputs, STATE_LEN};
use crate::flight::{Configuration, Flight};

/// A flight as arrays for fitting and rolling out.
pub(crate) struct Track<'a> {
    pub flight: &'a Flight,
    /// x per row; meaningless where the row has no state.
    states: Vec<[f64; STATE_LEN]>,
    /// Commands, `command_len` per row.
    commands: Vec<f64>,
    command_len: usize,
    /// Length of the unbroken run of valid, evenly timed rows that ends with this row; 0 where it has no state.
    run: Vec<usize>,
}

impl<'a> Track<'a> {
    /// Unpacks `flight`.
    ///
    /// # Errors
    /// The model takes the commanded velocity, but a row has none.
    pub fn new(flight: &'a Flight, inputs: CommandInputs) -> Result<Self, ModelError> {
        let samples = &flight.samples;
        let mut commands = Vec::with_capacity(samples.len() * inputs.len());
        for (row, sample) in samples.iter().enumerate() {
            commands.extend(sample.command);
            if inputs == CommandInputs::PositionAndVelocity {
                let missing = || ModelError::NoCommandVelocity {
                    flight: flight.name.clone(),
                    row,
                };
                commands.extend(sample.command_velocity.ok_or_else(missing)?);
            }
        }
        let mut run: Vec<usize> = samples
            .iter()
            .map(|sample| usize::from(sample.state().is_some()))
            .collect();
        for row in valid_transitions(flight) {
            run[row + 1] = run[row] + 1;
        }
        let states = samples
            .iter()
            .map(|sample| sample.state().unwrap_or_default())
            .collect();
        Ok(Self {
            flight,
            states,
            commands,
            command_len: inputs.len(),
            run,
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.states.len()
    }

    /// x at `row`.
    pub fn state(&self, row: usize) -> &[f64; STATE_LEN] {
        &self.states[row]
    }

    /// u at `row`.
    pub fn command(&self, row: usize) -> &[f64] {
        &self.commands[row * self.command_len..(row + 1) * self.command_len]
    }

    /// Writes `z = (x_row, x_{row−1}, …)` into `state`.
    pub fn lagged_state(&self, row: usize, state: &mut [f64]) {
        for (lag, x) in state.chunks_exact_mut(STATE_LEN).enumerate() {
            x.copy_from_slice(&self.states[row - lag]);
        }
    }

    /// Whether `z` at `row` and the `steps` rows after it are all valid and evenly timed.
    pub fn unbroken(&self, row: usize, lags: usize, steps: usize) -> bool {
        row + steps < self.rows() && self.run[row + steps] >= lags + steps
    }

    /// The configuration of every row.
    pub fn configurations(&self) -> Vec<Configuration> {
        self.flight
            .samples
            .iter()
            .map(|sample| sample.configuration)
            .collect()
    }

    /// The configuration, if it is the same in every row.
    pub fn constant_configuration(&self) -> Option<Configuration> {
        constant_configuration(self.flight)
    }
}

/// The configuration of `flight`, if it is the same in every row (and there is a row).
pub(crate) fn constant_configuration(flight: &Flight) -> Option<Configuration> {
    let first = flight.samples.first()?.configuration;
    flight
        .samples
        .iter()
        .all(|sample| same(&sample.configuration, &first))
        .then_some(first)
}

/// Rows k whose own state and successor's are valid, one sample time apart.
fn valid_transitions(flight: &Flight) -> Vec<usize> {
    let valid = |k: usize| {
        let (now, next) = (&flight.samples[k], &flight.samples[k + 1]);
        let on_time = (next.t_s - now.t_s - crate::DT).abs() <= 0.1 * crate::DT;
        on_time && now.state().is_some() && next.state().is_some()
    };
    (0..flight.samples.len().saturating_sub(1))
        .filter(|&k| valid(k))
        .collect()
}
