//! Regression statistics against statsmodels, to eight digits.

use flyvine::model::statistics::{Observations, RobustLoss, regress, regress_robustly};
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
struct Fixture {
    source: String,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    intercept: bool,
    x: Vec<Vec<f64>>,
    y: Vec<f64>,
    estimate: Vec<f64>,
    standard_error: Vec<f64>,
    t: Vec<f64>,
    p: Vec<f64>,
    confidence_95: Vec<[f64; 2]>,
    r_squared: f64,
    adjusted_r_squared: f64,
    rmse: f64,
    f: f64,
    f_p: f64,
    durbin_watson: f64,
    leverage: Vec<f64>,
    cooks_distance: Vec<f64>,
    robust: BTreeMap<String, RobustCase>,
}

#[derive(Deserialize)]
struct RobustCase {
    estimate: Vec<f64>,
    standard_error: Vec<f64>,
    scale: f64,
}

fn cases() -> Vec<Case> {
    let fixture: Fixture = serde_json::from_str(include_str!("fixtures/regression.json")).unwrap();
    assert!(fixture.source.starts_with("statsmodels"));
    fixture.cases
}

fn observations(case: &Case) -> Observations {
    let width = case.estimate.len();
    let constant = if case.intercept { vec![1.0] } else { Vec::new() };
    Observations {
        names: (0..width).map(|column| format!("x{column}")).collect(),
        regressors: case
            .x
            .iter()
            .flat_map(|row| [constant.clone(), row.clone()].concat())
            .collect(),
        response: case.y.clone(),
        intercept: case.intercept,
    }
}

fn same(what: &str, found: impl IntoIterator<Item = f64>, expected: &[f64]) {
    let found: Vec<f64> = found.into_iter().collect();
    assert_eq!(found.len(), expected.len(), "{what}");
    for (found, expected) in found.iter().zip(expected) {
        assert!(
            (found - expected).abs() <= 1e-8 * expected.abs(),
            "{what}: {found:e} against {expected:e}"
        );
    }
}

#[test]
fn ordinary_least_squares_agrees_with_statsmodels() {
    for case in cases() {
        let fit = regress(&observations(&case)).unwrap();
        let each = || fit.coefficients.iter();
        same("estimate", each().map(|c| c.estimate), &case.estimate);
        same(
            "standard error",
            each().map(|c| c.standard_error),
            &case.standard_error,
        );
        same("t", each().map(|c| c.t), &case.t);
        same("p", each().map(|c| c.p), &case.p);
        same(
            "interval",
            each().flat_map(|c| c.confidence_95),
            case.confidence_95.as_flattened(),
        );
        let found = [
            fit.r_squared,
            fit.adjusted_r_squared,
            fit.rmse,
            fit.f,
            fit.f_p,
            fit.durbin_watson,
        ];
        let expected = [
            case.r_squared,
            case.adjusted_r_squared,
            case.rmse,
            case.f,
            case.f_p,
            case.durbin_watson,
        ];
        same(&case.name, found, &expected);
        same("leverage", fit.leverage.clone(), &case.leverage);
        same(
            "Cook's distance",
            fit.cooks_distance.clone(),
            &case.cooks_distance,
        );
        assert_eq!(fit.degrees_of_freedom, case.y.len() - case.estimate.len());
    }
}

#[test]
fn robust_regression_agrees_with_statsmodels() {
    for case in cases() {
        for (name, loss) in [("huber", RobustLoss::Huber), ("bisquare", RobustLoss::Bisquare)] {
            let fit = regress_robustly(&observations(&case), loss).unwrap();
            assert!(fit.converged, "{name}, {}", case.name);
            let expected = &case.robust[name];
            same(name, fit.estimates, &expected.estimate);
            same(name, fit.standard_errors, &expected.standard_error);
            same(name, [fit.scale], &[expected.scale]);
        }
    }
}

#[test]
fn what_cannot_be_regressed_is_named() {
    let data = observations(&cases()[0]);
    let message = |change: &dyn Fn(&mut Observations)| {
        let mut data = data.clone();
        change(&mut data);
        regress(&data).unwrap_err().to_string()
    };
    let dependent = message(&|data| {
        for row in data.regressors.chunks_mut(5) {
            row[3] = row[1] - 2.0 * row[2];
        }
    });
    assert!(
        dependent.contains("regressor x3 depends on those before it"),
        "{dependent}"
    );
    assert!(message(&|data| data.regressors[7] = f64::NAN).contains("regressors: value 7 is not a finite"));
    assert!(message(&|data| data.response[3] = f64::INFINITY).contains("response: value 3"));
    assert!(message(&|data| data.response.truncate(39)).contains("found 200 values, expected 195"));
    let few = message(&|data| {
        data.response.truncate(5);
        data.regressors.truncate(25);
    });
    assert!(few.contains("5 observations for 5 coefficients"), "{few}");
}
