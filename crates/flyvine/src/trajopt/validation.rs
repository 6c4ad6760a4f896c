//! What a [`Problem`] must be to be solved, and what is said of one that is not.

use super::{Dynamics, Equality, Problem, StateBound};

/// What is wrong with a [`Problem`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProblemError {
    /// Nothing to plan.
    #[error("knots: found {found}, expected at least 2 (one command between two knots)")]
    TooFewKnots {
        /// Number of knots given.
        found: usize,
    },
    /// An array has the wrong number of entries.
    #[error("{field}: found {found} entries, expected {expected}")]
    Length {
        /// Name of the array.
        field: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// NaN, or an infinity where only finite numbers make sense.
    #[error("{field}[{entry}]: found {value}, expected a finite number")]
    NotFinite {
        /// Name of the array.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// What was found.
        value: f64,
    },
    /// A weight below zero makes the cost unbounded.
    #[error("{field}[{entry}]: found {value}, expected a weight of at least 0")]
    NegativeWeight {
        /// Name of the array.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// What was found.
        value: f64,
    },
    /// A price that is none.
    #[error(
        "{field}[{entry}].price: found {value}, expected a positive number, or infinity for a hard constraint"
    )]
    Price {
        /// Name of the list.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// What was found.
        value: f64,
    },
    /// Lower above upper bound, or NaN.
    #[error("{field}[{entry}]: found the interval [{lower}, {upper}], expected lower ≤ upper")]
    EmptyInterval {
        /// `command bounds` or `state_bounds`.
        field: &'static str,
        /// Command entry, or position in the list of bounds.
        entry: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// A constraint names a knot that does not exist, or a range that ends before it begins.
    #[error("{field}[{entry}]: found knots {first}..={last}, expected an ascending range within 0..={max}")]
    KnotOutOfRange {
        /// Name of the list.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// First knot.
        first: usize,
        /// Last knot.
        last: usize,
        /// Largest knot, N − 1.
        max: usize,
    },
    /// A constraint names a state entry that does not exist.
    #[error("{field}[{entry}]: found state index {index}, expected less than {state_len}")]
    IndexOutOfRange {
        /// Name of the list.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// State entry named.
        index: usize,
        /// Length of the state.
        state_len: usize,
    },
    /// The fixed start violates a constraint at knot 0, which no command can mend.
    #[error(
        "{field}[{entry}]: the start has state[{index}] = {value}, expected within [{lower}, {upper}] at knot 0"
    )]
    StartViolates {
        /// Name of the list.
        field: &'static str,
        /// Position in it.
        entry: usize,
        /// State entry.
        index: usize,
        /// Its value at the start.
        value: f64,
        /// Lower bound at knot 0.
        lower: f64,
        /// Upper bound at knot 0.
        upper: f64,
    },
    /// An equality asks for a value that a bound on the same entry and knot forbids.
    #[error(
        "equalities[{entry}]: found value {value} at knot {knot}, expected within state_bounds[{bound}], [{lower}, {upper}]"
    )]
    EqualityOutsideBound {
        /// Position in the list of equalities.
        entry: usize,
        /// Its knot.
        knot: usize,
        /// Its value.
        value: f64,
        /// Position in the list of bounds.
        bound: usize,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
}

/// How far the start may be outside a constraint at knot 0 (rounding of files).
const START_TOLERANCE: f64 = 1e-9;

impl Problem {
    /// Checks every length, number and constraint, also against the dynamics' sizes.
    ///
    /// # Errors
    /// The first fault found.
    pub fn validate<D: Dynamics + ?Sized>(&self, dynamics: &D) -> Result<(), ProblemError> {
        let (n, m) = (dynamics.state_len(), dynamics.command_len());
        if self.knots < 2 {
            return Err(ProblemError::TooFewKnots { found: self.knots });
        }
        let steps = self.knots - 1;
        for (field, array, expected) in [
            ("start", &self.start, n),
            ("state_reference", &self.state_reference, self.knots * n),
            ("command_reference", &self.command_reference, steps * m),
            ("state_weight", &self.state_weight, n),
            ("command_weight", &self.command_weight, m),
            ("command_guess", &self.command_guess, steps * m),
        ] {
            check_array(field, array, expected)?;
        }
        for (field, array) in [
            ("state_weight", &self.state_weight),
            ("command_weight", &self.command_weight),
        ] {
            if let Some(entry) = array.iter().position(|&weight| weight < 0.0) {
                return Err(ProblemError::NegativeWeight {
                    field,
                    entry,
                    value: array[entry],
                });
            }
        }
        self.validate_command_bounds(m)?;
        self.validate_state_bounds(n)?;
        self.validate_equalities(n)
    }

    fn validate_command_bounds(&self, m: usize) -> Result<(), ProblemError> {
        check_length("command_lower", &self.command_lower, m)?;
        check_length("command_upper", &self.command_upper, m)?;
        for entry in 0..m {
            check_interval(
                "command bounds",
                entry,
                self.command_lower[entry],
                self.command_upper[entry],
            )?;
        }
        Ok(())
    }

    fn validate_state_bounds(&self, n: usize) -> Result<(), ProblemError> {
        let field = "state_bounds";
        for (entry, bound) in self.state_bounds.iter().enumerate() {
            check_place(
                field,
                entry,
                (bound.first_knot, bound.last_knot),
                self.knots,
                bound.index,
                n,
            )?;
            check_interval(field, entry, bound.lower, bound.upper)?;
            check_price(field, entry, bound.price)?;
            if bound.first_knot == 0 && bound.price == f64::INFINITY {
                self.check_start(field, entry, bound.index, bound.lower, bound.upper)?;
            }
        }
        Ok(())
    }

    fn validate_equalities(&self, n: usize) -> Result<(), ProblemError> {
        let field = "equalities";
        for (entry, equality) in self.equalities.iter().enumerate() {
            let Equality {
                knot,
                index,
                value,
                price,
            } = *equality;
            check_place(field, entry, (knot, knot), self.knots, index, n)?;
            check_price(field, entry, price)?;
            if !value.is_finite() {
                return Err(ProblemError::NotFinite { field, entry, value });
            }
            if price < f64::INFINITY {
                continue;
            }
            if knot == 0 {
                self.check_start(field, entry, index, value, value)?;
            }
            let clash = self.state_bounds.iter().position(|bound| {
                bound.index == index
                    && bound.price == f64::INFINITY
                    && (bound.first_knot..=bound.last_knot).contains(&knot)
                    && !(bound.lower..=bound.upper).contains(&value)
            });
            if let Some(bound) = clash {
                let StateBound { lower, upper, .. } = self.state_bounds[bound];
                return Err(ProblemError::EqualityOutsideBound {
                    entry,
                    knot,
                    value,
                    bound,
                    lower,
                    upper,
                });
            }
        }
        Ok(())
    }

    fn check_start(
        &self,
        field: &'static str,
        entry: usize,
        index: usize,
        lower: f64,
        upper: f64,
    ) -> Result<(), ProblemError> {
        let value = self.start[index];
        if value < lower - START_TOLERANCE || value > upper + START_TOLERANCE {
            return Err(ProblemError::StartViolates {
                field,
                entry,
                index,
                value,
                lower,
                upper,
            });
        }
        Ok(())
    }
}

fn check_length(field: &'static str, array: &[f64], expected: usize) -> Result<(), ProblemError> {
    match array.len() {
        found if found != expected => Err(ProblemError::Length {
            field,
            found,
            expected,
        }),
        _ => Ok(()),
    }
}

/// Length and finiteness.
pub(super) fn check_array(field: &'static str, array: &[f64], expected: usize) -> Result<(), ProblemError> {
    check_length(field, array, expected)?;
    match array.iter().position(|value| !value.is_finite()) {
        Some(entry) => Err(ProblemError::NotFinite {
            field,
            entry,
            value: array[entry],
        }),
        None => Ok(()),
    }
}

/// A non-empty interval; infinite ends mean "none", so they must point outwards.
fn check_interval(field: &'static str, entry: usize, lower: f64, upper: f64) -> Result<(), ProblemError> {
    if lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY {
        Ok(())
    } else {
        Err(ProblemError::EmptyInterval {
            field,
            entry,
            lower,
            upper,
        })
    }
}

fn check_price(field: &'static str, entry: usize, value: f64) -> Result<(), ProblemError> {
    if value > 0.0 {
        Ok(())
    } else {
        Err(ProblemError::Price { field, entry, value })
    }
}

fn check_place(
    field: &'static str,
    entry: usize,
    (first, last): (usize, usize),
    knots: usize,
    index: usize,
    state_len: usize,
) -> Result<(), ProblemError> {
    if first > last || last >= knots {
        return Err(ProblemError::KnotOutOfRange {
            field,
            entry,
            first,
            last,
            max: knots - 1,
        });
    }
    if index >= state_len {
        return Err(ProblemError::IndexOutOfRange {
            field,
            entry,
            index,
            state_len,
        });
    }
    Ok(())
}
