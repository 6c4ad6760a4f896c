//! Least squares on more flights than memory holds, on one machine or several.
//!
//! Flights are read one after the other and reduced to sums ([`Moments`](Reduction::Moments)) or triangular factors
//! ([`Orthogonal`](Reduction::Orthogonal)) per configuration; the memory that takes does not depend on the number of
//! rows. Parts of the flights may be reduced elsewhere and joined ([`PartialFit::append`]): sums are made in a fixed
//! order, so that the bank has the same bits whoever reduced what, on however many threads.
//!
//! One pass has nothing to hold out: ridges are given, not chosen, and `check` on other flights judges the bank.

mod file;
mod moments;
mod pairwise;
mod solve;
mod sums;

pub use self::solve::StreamedCorner;
pub use self::sums::Reduction;

use self::pairwise::PairwiseSum;
use self::solve::solve_cell;
use self::sums::{Basis, Sums};
use super::bank::{Bank, BankModel, BankProvenance, InputFile, LENGTH_TOLERANCE_M, PRESSURE_TOLERANCE_KPA};
use super::error::ModelError;
use super::lag::CommandInputs;
use super::options::{FitOptions, Positions, Refinement, Ridge, Structure, VelocityInput};
use super::selection::Candidate;
use super::shape::{Ridges, Shape};
use super::support::SupportCounts;
use super::track::{Track, constant_configuration};
use crate::Shard;
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What a partial fit's file says it is.
const SCHEMA: &str = "flyvine-partial-fit";
/// Version of the format of partial fits that this library writes and reads.
pub const PARTIAL_FIT_SCHEMA_VERSION: u64 = 2;

/// The sums of some of the flights of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartialFit {
    schema: String,
    schema_version: u64,
    options: FitOptions,
    reduction: Reduction,
    /// Number of flights of the whole fit.
    flights: usize,
    /// Flights that it has, as positions in the list of all: `start .. end`.
    start: usize,
    end: usize,
    /// Flights that are no corner's, or change their configuration.
    unused: Vec<String>,
    inputs: Vec<InputFile>,
    /// What all of its flights showed, those of no corner too.
    shown: SupportCounts,
    cells: Vec<Cell>,
}

/// Flights of one configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Cell {
    configuration: Configuration,
    flights: Vec<String>,
    sums: PairwiseSum<Sums>,
}

/// What a streaming fit found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StreamReport {
    /// How rows were reduced.
    pub reduction: Reduction,
    /// One per model of the bank, in its order.
    pub corners: Vec<StreamedCorner>,
    /// Flights that were not fitted: at interior configurations, or changing theirs.
    pub unused: Vec<String>,
}

impl PartialFit {
    /// The sums of no flights yet of `shard`, `flights` being the number of all.
    ///
    /// Of the options, ridges and the velocity input mean no where they say auto, positions are absolute, and refinement
    /// is not to be asked for: each needs flights that are held out. A ridge on the height row's products holds back products of the
    /// motion about rest, which are not quite those of [`super::fit_bank`].
    ///
    /// # Errors
    /// Options out of range, or refinement; no such shard, or one without a flight.
    pub fn new(
        options: &FitOptions,
        reduction: Reduction,
        flights: usize,
        shard: Shard,
    ) -> Result<Self, ModelError> {
        options.validate()?;
        if options.refinement == Refinement::On {
            return Err(ModelError::Unsupported {
                what: "refinement of a streaming fit",
                found: "on".into(),
                expected: "off: it needs the flights themselves".into(),
            });
        }
        if options.positions == Some(Positions::Relative) {
            return Err(ModelError::Unsupported {
                what: "positions of a streaming fit",
                found: "relative".into(),
                expected: "absolute".into(),
            });
        }
        if !(1..=shard.of).contains(&shard.number) || shard.of > flights {
            return Err(ModelError::Unsupported {
                what: "shard",
                found: format!("{}/{} of {flights} flights", shard.number, shard.of),
                expected: "i/n with 1 ≤ i ≤ n ≤ flights".into(),
            });
        }
        let start = shard.range(flights).start;
        Ok(Self {
            schema: SCHEMA.into(),
            schema_version: PARTIAL_FIT_SCHEMA_VERSION,
            options: options.clone(),
            reduction,
            flights,
            start,
            end: start,
            unused: Vec::new(),
            inputs: Vec::new(),
            shown: SupportCounts::default(),
            cells: Vec::new(),
        })
    }

    /// Takes the next flights of the list, in parallel. However they are handed over, the sums are the same.
    ///
    /// # Errors
    /// A flight without rows, with a value that is not finite, without the velocity that was asked for, or given
    /// twice; more flights than the list has.
    pub fn add(&mut self, flights: &[(Flight, InputFile)]) -> Result<(), ModelError> {
        if self.end + flights.len() > self.flights {
            return Err(ModelError::Parts {
                what: format!("more flights than the {} of the list", self.flights),
            });
        }
        let shape = self.shape();
        let reduce = |(flight, _): &(Flight, InputFile)| {
            let track = Track::new(flight, shape.inputs)?;
            let configuration = constant_configuration(flight).map(rounded);
            Ok(configuration.map(|configuration| {
                let basis = Basis::new(shape, configuration);
                (configuration, Sums::of_track(&track, &basis, self.reduction))
            }))
        };
        let reduced = flights
            .par_iter()
            .map(reduce)
            .collect::<Result<Vec<_>, ModelError>>()?;
        for (flight, input) in flights {
            self.take_input(&flight.name, input.clone())?;
        }
        for ((flight, _), reduced) in flights.iter().zip(reduced) {
            self.shown.add(flight);
            match reduced {
                Some((configuration, sums)) => self.push(&flight.name, configuration, sums),
                None => self.unused.push(flight.name.clone()),
            }
            self.end += 1;
        }
        self.drop_interior();
        Ok(())
    }

    /// Joins the part that begins where this one ends.
    ///
    /// # Errors
    /// Another fit's part, one that begins elsewhere, or a recording that both have.
    pub fn append(&mut self, later: Self) -> Result<(), ModelError> {
        let same = self.options == later.options
            && self.reduction == later.reduction
            && self.flights == later.flights;
        if !same {
            return Err(ModelError::Parts {
                what: "they were made with different options or of different lists of flights".into(),
            });
        }
        if later.start != self.end {
            return Err(ModelError::Parts {
                what: format!(
                    "found one that begins with flight {}, expected flight {} of {}",
                    later.start + 1,
                    self.end + 1,
                    self.flights
                ),
            });
        }
        for input in later.inputs {
            self.take_input(&input.path.clone(), input)?;
        }
        for mut cell in later.cells {
            match self
                .cells
                .iter_mut()
                .find(|own| own.configuration == cell.configuration)
            {
                None => {
                    let mut sums = PairwiseSum::new(self.start);
                    sums.skip_to(self.end);
                    cell.sums = joined(sums, cell.sums);
                    self.cells.push(cell);
                }
                Some(own) => {
                    own.sums.skip_to(self.end);
                    let sums = std::mem::replace(&mut own.sums, PairwiseSum::new(0));
                    own.sums = joined(sums, cell.sums);
                    own.flights.append(&mut cell.flights);
                }
            }
        }
        self.shown.append(&later.shown);
        self.unused.extend(later.unused);
        self.end = later.end;
        self.drop_interior();
        Ok(())
    }

    /// The bank, if all flights are there.
    ///
    /// # Errors
    /// Flights are missing; no flight with a constant configuration; a corner without flights or with too few rows;
    /// [`ModelError::IllConditioned`] if sums do not determine the coefficients to the last digits that matter.
    pub fn bank(mut self) -> Result<(Bank, StreamReport), ModelError> {
        if (self.start, self.end) != (0, self.flights) {
            return Err(ModelError::Parts {
                what: format!(
                    "found flights {} to {}, expected all {}",
                    self.start + 1,
                    self.end,
                    self.flights
                ),
            });
        }
        if self.cells.is_empty() {
            return Err(ModelError::NoCornerFlights {
                flights: self.flights,
            });
        }
        let shape = self.shape();
        let height = given_ridge(self.options.height_ridge);
        let ridges = Ridges {
            linear: given_ridge(self.options.linear_ridge),
            height: (shape.structure == Structure::Paper).then_some(height),
        };
        let solve = |cell: Cell| solve_cell(cell, self.flights, shape, ridges);
        let solved = self
            .cells
            .into_par_iter()
            .map(solve)
            .collect::<Result<Vec<_>, ModelError>>()?;
        let (models, corners): (Vec<BankModel>, Vec<StreamedCorner>) = solved.into_iter().unzip();
        let provenance = BankProvenance {
            tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).into(),
            inputs: self.inputs,
            options: self.options,
            chosen: Some(Candidate {
                inputs: shape.inputs,
                positions: shape.positions,
                linear_ridge: ridges.linear,
                height_ridge: ridges.height,
                refined: false,
                corners: None,
                interior: None,
            }),
            between: None,
        };
        self.unused.sort_unstable(); // not by when they turned out to be interior
        let report = StreamReport {
            reduction: self.reduction,
            corners,
            unused: self.unused,
        };
        let bank = Bank::new(models, provenance)?.with_support(Some(self.shown.support()))?;
        Ok((bank, report))
    }

    /// The flights that it has, as positions in the list of all.
    pub fn range(&self) -> Range<usize> {
        self.start..self.end
    }

    /// Number of flights of the whole fit.
    pub fn flights(&self) -> usize {
        self.flights
    }

    fn shape(&self) -> Shape {
        Shape {
            structure: self.options.structure,
            lags: self.options.lags,
            inputs: match self.options.command_velocity {
                VelocityInput::On => CommandInputs::PositionAndVelocity,
                VelocityInput::Off | VelocityInput::Auto => CommandInputs::Position,
            },
            positions: Positions::Absolute,
        }
    }

    /// Takes a recording's hash, which no other may have.
    fn take_input(&mut self, name: &str, input: InputFile) -> Result<(), ModelError> {
        if let Some(first) = self.inputs.iter().find(|known| known.sha256 == input.sha256) {
            return Err(ModelError::DuplicateFlight {
                first: first.path.clone(),
                second: name.to_owned(),
            });
        }
        self.inputs.push(input);
        Ok(())
    }

    /// Takes the sums of flight number `end`.
    fn push(&mut self, flight: &str, configuration: Configuration, sums: Sums) {
        let known = self
            .cells
            .iter()
            .position(|cell| cell.configuration == configuration);
        let index = known.unwrap_or_else(|| {
            self.cells.push(Cell {
                configuration,
                flights: Vec::new(),
                sums: PairwiseSum::new(self.start),
            });
            self.cells.len() - 1
        });
        let cell = &mut self.cells[index];
        cell.flights.push(flight.to_owned());
        cell.sums.skip_to(self.end);
        cell.sums.push(Some(sums));
    }

    /// Forgets configurations that more extreme ones have made interior: four remain at most.
    fn drop_interior(&mut self) {
        let extremes = |value: fn(&Configuration) -> f64| {
            let values = self.cells.iter().map(|cell| value(&cell.configuration));
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            })
        };
        let (lengths, pressures) = (extremes(|c| c.length_m), extremes(|c| c.pressure_kpa));
        let extreme = |(low, high): (f64, f64), value: f64| value == low || value == high;
        let unused = &mut self.unused;
        self.cells.retain_mut(|cell| {
            let corner = extreme(lengths, cell.configuration.length_m)
                && extreme(pressures, cell.configuration.pressure_kpa);
            if !corner {
                unused.append(&mut cell.flights);
            }
            corner
        });
        // The order of flights does not decide the order of configurations.
        self.cells.sort_by(|a, b| {
            (a.configuration
                .pressure_kpa
                .total_cmp(&b.configuration.pressure_kpa))
            .then(a.configuration.length_m.total_cmp(&b.configuration.length_m))
        });
    }
}

/// The sums of two ranges that meet.
fn joined(mut earlier: PairwiseSum<Sums>, later: PairwiseSum<Sums>) -> PairwiseSum<Sums> {
    assert!(earlier.append(later), "both were brought to the same number");
    earlier
}

/// What is not chosen is not held back.
fn given_ridge(ridge: Ridge) -> f64 {
    match ridge {
        Ridge::Auto => 0.0,
        Ridge::Value(value) => value,
    }
}

/// The configuration on the grid of the bank's tolerances.
fn rounded(configuration: Configuration) -> Configuration {
    // Dividing by whole numbers gives the shortest decimals.
    let steps = |tolerance: f64| (1.0 / tolerance).round();
    let round = |value: f64, tolerance: f64| (value * steps(tolerance)).round() / steps(tolerance);
    Configuration {
        length_m: round(configuration.length_m, LENGTH_TOLERANCE_M),
        pressure_kpa: round(configuration.pressure_kpa, PRESSURE_TOLERANCE_KPA),
    }
}

#[cfg(test)]
mod tests;
