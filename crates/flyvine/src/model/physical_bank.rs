//! From flights to a bank of the physical family.

use super::bank::{Bank, BankModel, BankProvenance, ModelDiagnostics};
use super::corrections::{CorrectionTrial, correct};
use super::error::ModelError;
use super::family::Model;
use super::groups::{Groups, group, refuse_duplicates};
use super::options::FitOptions;
use super::physical::{
    FitProgress, PARAMETER_COUNT, ParameterEstimate, Parameters, PhysicalFitOptions, PhysicalModel,
    StreamTiming, fit_configurations, fit_physical, stream_timing,
};
use super::support::Support;
use crate::flight::{Configuration, Flight};
use nalgebra::DMatrix;
use serde::Serialize;
use std::collections::BTreeMap;

/// What a fit of the physical family found, corner by corner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PhysicalFitReport {
    /// One per corner, in the order of the bank's models.
    pub corners: Vec<CornerFit>,
    /// Names of the flights that were not fitted: at interior configurations, or with one that changes.
    pub cross_checked: Vec<String>,
    /// What a correction of the models did on held-out flights, if it was tried.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correction: Option<CorrectionTrial>,
}

/// The fit of one corner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CornerFit {
    /// Which.
    pub configuration: Configuration,
    /// Names of its flights.
    pub flights: Vec<String>,
    /// Rows simulated.
    pub rows: usize,
    /// Iterations on whole flights.
    pub iterations: usize,
    /// Whether the objective had stopped decreasing.
    pub converged: bool,
    /// Mean distance of the simulated end effector from where it was seen, m, over whole flights from their start.
    pub tip_error_m: f64,
    /// Every parameter.
    pub parameters: Vec<ParameterEstimate>,
    /// Clocks of the flights' streams.
    pub timing: StreamTiming,
    /// How lively the flights were: where the model may be believed.
    pub support: Support,
}

/// Fits one physical model per corner of the flown (pressure, length) range and joins them in a bank.
///
/// Every corner is fitted on its own first, then all together, drawn towards each other ([`fit_configurations`]), so
/// that they can be interpolated. With a single corner the first fit is kept. Flights at interior configurations and
/// flights whose configuration changes are not fitted.
///
/// `progress` is called with the configuration that is being fitted (`None`: all of them) and where its fit is.
///
/// # Errors
/// No flight with a constant configuration, a corner without flights, the same recording given twice, or as
/// [`fit_physical`].
pub fn fit_physical_bank(
    flights: &[Flight],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(Option<Configuration>, FitProgress),
) -> Result<(Bank, PhysicalFitReport), ModelError> {
    refuse_duplicates(flights)?;
    let groups = group(flights)?;
    let mut fits: Vec<PhysicalModel> = Vec::new();
    for (configuration, members) in &groups.corners {
        let members = chosen(flights, members);
        fits.push(fit_physical(&members, options, &mut |at| {
            progress(Some(*configuration), at)
        })?);
    }
    if fits.len() > 1 {
        let own: Vec<_> = fits.iter().map(|fit| fit.parameters).collect();
        fits = together(flights, &groups, &own, options, progress)?;
    }
    join(flights, &groups, fits, options)
}

/// Fits the physical family again, beginning with the models of `bank`: on more flights, or others. Where the bank's models
/// are corrected, a correction is tried again.
///
/// # Errors
/// As [`fit_physical_bank`]; `bank` is of another family, or does not cover the flights.
pub fn refit_physical_bank(
    bank: &Bank,
    flights: &[Flight],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(Option<Configuration>, FitProgress),
) -> Result<(Bank, PhysicalFitReport), ModelError> {
    refuse_duplicates(flights)?;
    let groups = group(flights)?;
    let start = |(configuration, _): &(Configuration, Vec<usize>)| match bank.at(*configuration)? {
        Model::Physical(model) => Ok(model.parameters),
        Model::Lag(_) => Err(ModelError::Unsupported {
            what: "bank to begin a physical fit with",
            found: "the lag family".into(),
            expected: "the physical family".into(),
        }),
    };
    let starts = groups
        .corners
        .iter()
        .map(start)
        .collect::<Result<Vec<_>, ModelError>>()?;
    let options = &PhysicalFitOptions {
        correction: options.correction || bank.is_corrected(),
        ..options.clone()
    };
    let fits = together(flights, &groups, &starts, options, progress)?;
    join(flights, &groups, fits, options)
}

fn together(
    flights: &[Flight],
    groups: &Groups,
    starts: &[Parameters<f64>],
    options: &PhysicalFitOptions,
    progress: &mut dyn FnMut(Option<Configuration>, FitProgress),
) -> Result<Vec<PhysicalModel>, ModelError> {
    let members: Vec<_> = groups
        .corners
        .iter()
        .map(|(_, members)| chosen(flights, members))
        .collect();
    let fits = fit_configurations(&members, starts, options, &mut |at| progress(None, at))?;
    Ok(fits)
}

fn chosen(flights: &[Flight], members: &[usize]) -> Vec<Flight> {
    members.iter().map(|&index| flights[index].clone()).collect()
}

fn join(
    flights: &[Flight],
    groups: &Groups,
    fits: Vec<PhysicalModel>,
    options: &PhysicalFitOptions,
) -> Result<(Bank, PhysicalFitReport), ModelError> {
    let (mut models, mut corners) = (Vec::new(), Vec::new());
    for ((configuration, members), fit) in groups.corners.iter().zip(fits) {
        corners.extend(corner_fit(*configuration, &fit, &chosen(flights, members))?);
        models.push(bank_model(*configuration, fit)?);
    }
    let provenance = BankProvenance {
        tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).into(),
        inputs: Vec::new(),
        options: FitOptions::default(),
        chosen: None,
        between: None,
    };
    let mut bank = Bank::new(models, provenance)?.with_support(Some(Support::of(flights)))?;
    let mut correction = None;
    if options.correction {
        (bank, correction) = correct(bank, flights, groups, options)?;
    }
    let report = PhysicalFitReport {
        correction,
        corners,
        cross_checked: groups
            .interior
            .iter()
            .map(|&index| flights[index].name.clone())
            .collect(),
    };
    Ok((bank, report))
}

/// What there is to say about the fit of one corner.
fn corner_fit(
    configuration: Configuration,
    model: &PhysicalModel,
    flights: &[Flight],
) -> Result<Option<CornerFit>, ModelError> {
    let Some(summary) = &model.fit else {
        return Ok(None);
    };
    Ok(Some(CornerFit {
        configuration,
        flights: summary.flights.clone(),
        rows: summary.rows,
        iterations: summary.iterations,
        converged: summary.converged,
        tip_error_m: summary.tip_error_m,
        parameters: model.estimates(),
        timing: stream_timing(model, flights, &summary.options)?,
        support: Support::of(flights),
    }))
}

fn bank_model(configuration: Configuration, fit: PhysicalModel) -> Result<BankModel, ModelError> {
    let (flights, rows) = fit
        .fit
        .as_ref()
        .map(|summary| (summary.flights.clone(), summary.rows))
        .unwrap_or_default();
    let condition_number = condition_number(&fit.covariance);
    let model = Model::Physical(Box::new(fit));
    let diagnostics = ModelDiagnostics {
        flights,
        rows,
        coefficients: PARAMETER_COUNT,
        condition_number,
        linear_condition_number: condition_number,
        spectral_radius: model.spectral_radius(configuration)?,
        residual_rms: BTreeMap::new(),
    };
    Ok(BankModel {
        configuration,
        model,
        diagnostics,
    })
}

/// Condition number of the equilibrated sensitivities: the root of that of the posterior's correlation matrix.
fn condition_number(covariance: &[Vec<f64>]) -> f64 {
    let sigma: Vec<f64> = covariance
        .iter()
        .enumerate()
        .map(|(i, row)| row[i].sqrt())
        .collect();
    let correlation = DMatrix::from_fn(sigma.len(), sigma.len(), |i, j| {
        covariance[i][j] / (sigma[i] * sigma[j])
    });
    let eigenvalues = correlation.symmetric_eigenvalues();
    (eigenvalues.max() / eigenvalues.min()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::super::physical::ArmLength;
    use super::super::physical::synthetic::{random_commands, simulate_flight};
    use super::*;
    use crate::trajopt::Dynamics;

    fn flights() -> Vec<Flight> {
        let flight = |length_m: f64, seed: u64| {
            let commands = random_commands(120, seed);
            let name = format!("{length_m} m, flight {seed}");
            simulate_flight(&name, &Parameters::defaults(), length_m, &commands, 3e-4, seed).0
        };
        vec![flight(0.7, 1), flight(1.0, 2)]
    }

    fn quick() -> PhysicalFitOptions {
        PhysicalFitOptions {
            max_iterations: 1,
            ..PhysicalFitOptions::default()
        }
    }

    #[test]
    fn a_bank_of_two_lengths_has_one_vehicle_and_predicts_its_flights() {
        let flights = flights();
        let (bank, fitted) = fit_physical_bank(&flights, &quick(), &mut |_, _| {}).unwrap();
        assert_eq!(fitted.corners.len(), 2);
        let parameters: Vec<&Parameters<f64>> = bank
            .models()
            .iter()
            .map(|model| match &model.model {
                Model::Physical(model) => &model.parameters,
                Model::Lag(_) => panic!("a physical model"),
            })
            .collect();
        // Drawn towards each other, the vehicles are nearly one.
        let gain = |own: &Parameters<f64>| own.velocity_gain_xy;
        assert!((gain(parameters[0]) / gain(parameters[1]) - 1.0).abs() < 0.05);
        let report = check(&bank, &flights).unwrap();
        for flight in &report.flights {
            let error = flight.rollout[2].median_m.unwrap();
            assert!(error < 0.02, "{}: {error} m at 2.5 s", flight.path);
        }
        assert!(report.models.iter().all(|model| model.spectral_radius < 1.0));

        let text = serde_json::to_string(&bank).unwrap();
        assert!(serde_json::from_str::<Bank>(&text).unwrap() == bank);
    }

    #[test]
    fn a_schedule_knows_how_fast_the_arm_grows() {
        let model = |length_m: f64| {
            let fit = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(length_m)).unwrap();
            BankModel {
                configuration: at_length(length_m),
                model: Model::Physical(Box::new(fit)),
                diagnostics: ModelDiagnostics::default(),
            }
        };
        let bank = Bank::new(vec![model(0.7), model(1.0)], BankProvenance::default()).unwrap();
        let lengths = [0.7, 0.7, 0.701, 0.702, 0.702];
        let schedule = bank.scheduled(&lengths.map(at_length)).unwrap();
        let rates: Vec<f64> = (0..7)
            .map(|knot| match schedule.at_knot(knot) {
                Model::Physical(model) => model.arm.rate_m_s,
                Model::Lag(_) => panic!("a physical model"),
            })
            .collect();
        for (found, expected) in rates.iter().zip([0.0, 0.02, 0.02, 0.0, 0.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-12, "{rates:?}");
        }
        assert_eq!(schedule.state_len(), schedule.fresh_len());
    }

    fn at_length(length_m: f64) -> Configuration {
        Configuration {
            length_m,
            pressure_kpa: 0.0,
        }
    }
}
