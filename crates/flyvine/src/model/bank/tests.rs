use super::super::lag::tests::random_model;
use super::super::lag::{CommandInputs, HEIGHT_ROW, STATE_LEN};
use super::*;
use crate::trajopt::Dynamics;

const fn configuration(length_m: f64, pressure_kpa: f64) -> Configuration {
    Configuration {
        length_m,
        pressure_kpa,
    }
}

const CORNERS: [Configuration; 4] = [
    configuration(1.0, 0.4),
    configuration(0.7, 0.0),
    configuration(1.0, 0.0),
    configuration(0.7, 0.4),
];

fn model(configuration: Configuration, seed: u64) -> BankModel {
    BankModel {
        configuration,
        model: Model::Lag(random_model(3, CommandInputs::Position, &[HEIGHT_ROW], seed)),
        diagnostics: ModelDiagnostics::default(),
    }
}

fn four_corners() -> Vec<BankModel> {
    CORNERS
        .iter()
        .zip(1..)
        .map(|(&corner, seed)| model(corner, seed))
        .collect()
}

fn bank(models: Vec<BankModel>) -> Result<Bank, ModelError> {
    Bank::new(models, BankProvenance::default())
}

fn predict(model: &Model) -> [f64; STATE_LEN] {
    let state: Vec<f64> = (0..27).map(|i| (i as f64).sin()).collect();
    let mut fresh = [0.0; STATE_LEN];
    model.step(0, &state, &[0.1, -0.2, 1.5], &mut fresh);
    fresh
}

#[test]
fn interpolated_coefficients_interpolate_predictions() {
    let models = four_corners();
    let corner = |index: usize| predict(&models[index].model);
    let (il, es, el, is) = (corner(0), corner(1), corner(2), corner(3));
    let between = predict(
        &bank(models.clone())
            .unwrap()
            .at(configuration(0.775, 0.3))
            .unwrap(),
    );
    for row in 0..STATE_LEN {
        let short = 0.25 * es[row] + 0.75 * is[row];
        let long = 0.25 * el[row] + 0.75 * il[row];
        assert!((between[row] - (0.75 * short + 0.25 * long)).abs() < 1e-13);
    }
}

#[test]
fn a_corner_is_its_own_model_to_the_last_bit() {
    let models = four_corners();
    let bank = bank(models.clone()).unwrap();
    for model in &models {
        assert_eq!(bank.at(model.configuration).unwrap(), model.model);
    }
}

#[test]
fn outside_the_flown_range_is_an_error_unless_allowed() {
    let bank = bank(four_corners()).unwrap();
    for outside in [
        configuration(1.1, 0.2),
        configuration(0.8, -0.1),
        configuration(f64::NAN, 0.0),
    ] {
        let message = bank.at(outside).unwrap_err().to_string();
        assert!(
            message.contains("length 0.700 to 1.000 m and pressure 0.000 to 0.400 kPa"),
            "{message}"
        );
    }
    let allowing = bank.with_extrapolation(Extrapolation::Allow);
    assert!(allowing.at(configuration(1.1, 0.2)).is_ok());
    assert!(allowing.at(configuration(f64::INFINITY, 0.2)).is_err());
}

#[test]
fn models_at_counts_what_is_mixed() {
    let bank = bank(four_corners())
        .unwrap()
        .with_extrapolation(Extrapolation::Allow);
    for (at, models) in [
        (CORNERS[1], 1.0),
        (configuration(0.85, 0.0), 2.0),
        (configuration(0.85, 0.2), 4.0),
        (configuration(1.2, 0.0), 1.0),
    ] {
        assert!((bank.models_at(at) - models).abs() < 1e-12, "{at:?}");
    }
}

#[test]
fn one_model_serves_its_own_configuration_only() {
    let bank = bank(vec![model(CORNERS[1], 1)]).unwrap();
    assert!(bank.at(CORNERS[1]).is_ok());
    assert!(bank.at(CORNERS[2]).is_err());
}

#[test]
fn two_models_interpolate_along_their_axis() {
    let bank = bank(vec![model(CORNERS[1], 1), model(CORNERS[2], 2)]).unwrap();
    assert!(bank.at(configuration(0.85, 0.0)).is_ok());
    assert!(bank.at(configuration(0.85, 0.1)).is_err());
}

#[test]
fn what_is_no_grid_is_refused() {
    let corners = four_corners();
    let missing = bank(corners[..3].to_vec()).unwrap_err().to_string();
    assert!(
        missing.contains("no model at configuration (length 0.700 m, pressure 0.400 kPa)"),
        "{missing}"
    );
    let twice = bank(vec![corners[0].clone(), corners[0].clone()]).unwrap_err();
    assert!(matches!(twice, ModelError::DuplicateConfiguration { .. }));
    let three = bank(vec![
        model(configuration(0.8, 0.0), 1),
        corners[1].clone(),
        corners[2].clone(),
    ]);
    assert!(three.unwrap_err().to_string().contains("expected one or two"));
    assert!(bank(Vec::new()).is_err());
}

#[test]
fn models_of_different_structure_are_not_mixed() {
    let linear = BankModel {
        model: Model::Lag(random_model(3, CommandInputs::Position, &[], 1)),
        ..model(CORNERS[2], 1)
    };
    let message = bank(vec![model(CORNERS[1], 1), linear]).unwrap_err().to_string();
    assert!(message.contains("quadratic rows [], not [8]"), "{message}");
}

#[test]
fn a_schedule_follows_its_configurations() {
    let bank = bank(four_corners()).unwrap();
    let schedule = [CORNERS[1], CORNERS[1], configuration(0.85, 0.2), CORNERS[0]];
    let scheduled = bank.scheduled(&schedule).unwrap();
    for (knot, &configuration) in schedule.iter().enumerate() {
        assert_eq!(scheduled.at_knot(knot), &bank.at(configuration).unwrap());
    }
    assert_eq!(scheduled.at_knot(99), &bank.at(CORNERS[0]).unwrap());
    assert!(bank.scheduled(&[]).is_err());
}
