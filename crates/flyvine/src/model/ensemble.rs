//! Models that the flights allow beside the best one: a bootstrap over whole flights.
//!
//! Every member is fitted on as many flights per corner as there are, drawn with replacement (Efron & Tibshirani
//! 1993, Ch. 8, with flights for blocks, since the rows of one flight are not independent). A plan that works on
//! all members does not depend on what the flights leave open, and the members' spread is an honest standard
//! error, to compare with the posterior's.

use super::bank::Bank;
use super::error::ModelError;
use super::families::Family;
use super::family::Model;
use super::fit::fit_bank;
use super::groups::group;
use super::options::{FitOptions, Refinement, Ridge};
use super::physical::PhysicalFitOptions;
use super::physical_bank::refit_physical_bank;
use crate::flight::Flight;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::collections::BTreeMap;

impl Bank {
    /// The family of the bank's models.
    pub fn family(&self) -> Family {
        match self.models()[0].model {
            Model::Lag(_) => Family::Lag,
            Model::Physical(_) => Family::Physical,
        }
    }
}

/// `members` banks like `bank`, which was fitted on `flights`, each on another draw of the corners' flights.
///
/// The physical family begins with the bank's parameters and weighs a flight by how often it was drawn. The lag
/// family, with the bank's choice of ridges, is fitted on the flights that were drawn at all. `progress` is called
/// with every finished member's number. The same seed gives the same banks.
///
/// # Errors
/// As [`fit_bank`] or [`super::fit_physical_bank`] on the flights of a draw: few flights may be too few.
pub fn bootstrap(
    bank: &Bank,
    flights: &[Flight],
    members: usize,
    seed: u64,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<Bank>, ModelError> {
    let corners: Vec<Vec<usize>> = group(flights)?
        .corners
        .into_iter()
        .map(|(_, members)| members)
        .collect();
    let mut banks = Vec::with_capacity(members);
    for member in 0..members {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(member as u64);
        let mut drawn: BTreeMap<usize, u32> = BTreeMap::new();
        for corner in &corners {
            for _ in corner {
                *drawn
                    .entry(corner[random.random_range(0..corner.len())])
                    .or_default() += 1;
            }
        }
        let chosen: Vec<Flight> = drawn.keys().map(|&index| flights[index].clone()).collect();
        let weights = drawn
            .iter()
            .map(|(&index, &times)| (flights[index].name.clone(), f64::from(times)))
            .collect();
        banks.push(match bank.family() {
            Family::Physical => {
                let options = PhysicalFitOptions {
                    weights,
                    ..PhysicalFitOptions::default()
                };
                refit_physical_bank(bank, &chosen, &options, &mut |_, _| {})?.0
            }
            Family::Lag => fit_bank(&chosen, &as_chosen(bank))?.0,
        });
        progress(member + 1);
    }
    Ok(banks)
}

/// The lag family's options with what the bank's fit chose.
fn as_chosen(bank: &Bank) -> FitOptions {
    let provenance = bank.provenance();
    let Some(chosen) = &provenance.chosen else {
        return provenance.options.clone();
    };
    FitOptions {
        linear_ridge: Ridge::Value(chosen.linear_ridge),
        height_ridge: chosen.height_ridge.map_or(Ridge::Auto, Ridge::Value),
        positions: Some(chosen.positions),
        refinement: if chosen.refined {
            Refinement::On
        } else {
            Refinement::Off
        },
        ..provenance.options.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::super::physical::synthetic::{random_commands, simulate_flight};
    use super::super::physical::{Parameters, PhysicalFitOptions};
    use super::super::physical_bank::fit_physical_bank;
    use super::*;

    #[test]
    fn members_differ_about_as_much_as_the_posterior_says_and_the_seed_repeats_them() {
        let flights: Vec<Flight> = (1..=4)
            .map(|seed| {
                let (commands, name) = (random_commands(150, seed), format!("flight {seed}"));
                simulate_flight(&name, &Parameters::defaults(), 0.8, &commands, 3e-3, seed).0
            })
            .collect();
        let options = PhysicalFitOptions {
            max_iterations: 3,
            // The residuals are what the synthetic noise is, and independent.
            position_sigma_m: 3e-3,
            attitude_sigma: 3e-3,
            correlated_rows: 1.0,
            ..PhysicalFitOptions::default()
        };
        let (bank, _) = fit_physical_bank(&flights, &options, &mut |_, _| {}).unwrap();
        let mut done = 0;
        let banks = bootstrap(&bank, &flights, 2, 7, &mut |number| done = number).unwrap();
        assert_eq!((banks.len(), done), (2, 2));
        assert!(banks[0] != banks[1]);
        assert!(bootstrap(&bank, &flights, 1, 7, &mut |_| {}).unwrap()[0] == banks[0]);
        let gain = |bank: &Bank| match &bank.models()[0].model {
            Model::Physical(model) => model.parameters.position_gain_xy,
            Model::Lag(_) => panic!("a physical model"),
        };
        for member in &banks {
            assert!(
                (gain(member) / gain(&bank) - 1.0).abs() < 0.05,
                "{}",
                gain(member)
            );
        }
    }
}
