//! A flight as arrays, and which rows follow each other without a gap.

use super::bank::same;
use super::error::ModelError;
use super::lag::{CommandInputs, STATE_LEN};
use crate::flight::{COMMAND_COLUMNS, Configuration, Flight, SIGNALS, VELOCITY_COLUMNS};

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
    /// No rows; a value that is not finite; the model takes the commanded velocity, but a row has none.
    pub fn new(flight: &'a Flight, inputs: CommandInputs) -> Result<Self, ModelError> {
        let samples = &flight.samples;
        if samples.is_empty() {
            return Err(ModelError::EmptyFlight {
                flight: flight.name.clone(),
            });
        }
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
        let mut run = vec![0; samples.len()];
        for segment in flight.segments() {
            for (before, row) in segment.enumerate() {
                run[row] = before + 1;
            }
        }
        let states: Vec<[f64; STATE_LEN]> = samples
            .iter()
            .map(|sample| sample.state().unwrap_or_default())
            .collect();
        refuse_non_finite(flight, &states, &commands, inputs)?;
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

    /// Writes `w = (z, u)` of `row`.
    pub fn regressors(&self, row: usize, lags: usize, w: &mut [f64]) {
        let (state, command) = w.split_at_mut(lags * STATE_LEN);
        self.lagged_state(row, state);
        command.copy_from_slice(self.command(row));
    }

    /// `x_{row+1} − x_row`.
    pub fn increments(&self, row: usize) -> [f64; STATE_LEN] {
        let (now, next) = (self.state(row), self.state(row + 1));
        std::array::from_fn(|signal| next[signal] - now[signal])
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

/// Refuses NaN and infinities, by row and field.
fn refuse_non_finite(
    flight: &Flight,
    states: &[[f64; STATE_LEN]],
    commands: &[f64],
    inputs: CommandInputs,
) -> Result<(), ModelError> {
    let first = |values: &[f64], width: usize| {
        let index = values.iter().position(|value| !value.is_finite())?;
        Some((index / width, index % width))
    };
    let state = first(states.as_flattened(), STATE_LEN).map(|(row, field)| (row, SIGNALS[field]));
    let names = [COMMAND_COLUMNS, VELOCITY_COLUMNS].concat();
    let command = first(commands, inputs.len()).map(|(row, field)| (row, names[field]));
    match state.into_iter().chain(command).min_by_key(|(row, _)| *row) {
        None => Ok(()),
        Some((row, field)) => Err(ModelError::FlightValue {
            flight: flight.name.clone(),
            row,
            field,
        }),
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
