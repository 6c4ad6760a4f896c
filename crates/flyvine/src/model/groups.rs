//! Flights by configuration: the corners of a bank, and what lies between them.

use super::bank::{LENGTH_TOLERANCE_M, PRESSURE_TOLERANCE_KPA, same};
use super::error::ModelError;
use super::track::constant_configuration;
use crate::flight::{Configuration, Flight};

/// Flights by their place in the bank, as indices.
pub(crate) struct Groups {
    pub corners: Vec<(Configuration, Vec<usize>)>,
    /// Inside the range, or changing their configuration.
    pub interior: Vec<usize>,
}

/// Finds the corners: the extreme lengths and pressures among the flights of constant configuration.
pub(crate) fn group(flights: &[Flight]) -> Result<Groups, ModelError> {
    let constant: Vec<(usize, Configuration)> = flights
        .iter()
        .enumerate()
        .filter_map(|(index, flight)| {
            constant_configuration(flight).map(|configuration| (index, configuration))
        })
        .collect();
    if constant.is_empty() {
        return Err(ModelError::NoCornerFlights {
            flights: flights.len(),
        });
    }
    let extremes = |value: fn(&Configuration) -> f64, tolerance: f64| {
        let values = || constant.iter().map(|(_, configuration)| value(configuration));
        let (low, high) = (
            values().fold(f64::INFINITY, f64::min),
            values().fold(f64::NEG_INFINITY, f64::max),
        );
        if high - low <= tolerance {
            vec![low]
        } else {
            vec![low, high]
        }
    };
    let mut corners = Vec::new();
    for &pressure_kpa in &extremes(|c| c.pressure_kpa, PRESSURE_TOLERANCE_KPA) {
        for &length_m in &extremes(|c| c.length_m, LENGTH_TOLERANCE_M) {
            let corner = Configuration {
                length_m,
                pressure_kpa,
            };
            let members: Vec<usize> = constant
                .iter()
                .filter(|(_, c)| same(c, &corner))
                .map(|(index, _)| *index)
                .collect();
            if members.is_empty() {
                return Err(ModelError::MissingCorner { missing: corner });
            }
            corners.push((corner, members));
        }
    }
    let fitted: Vec<usize> = corners.iter().flat_map(|(_, members)| members.clone()).collect();
    let interior = (0..flights.len())
        .filter(|index| !fitted.contains(index))
        .collect();
    Ok(Groups { corners, interior })
}

/// Refuses one recording given twice.
pub(crate) fn refuse_duplicates(flights: &[Flight]) -> Result<(), ModelError> {
    for (index, second) in flights.iter().enumerate() {
        if let Some(first) = flights[..index]
            .iter()
            .find(|first| first.samples == second.samples)
        {
            return Err(ModelError::DuplicateFlight {
                first: first.name.clone(),
                second: second.name.clone(),
            });
        }
    }
    Ok(())
}
