//! Scheduling on any variable beside length and pressure: banks that were fitted at several values of it, and the bank at a
//! value in between.
//!
//! Between two neighbours a < v < b, every configuration's model is interpolated as along length and pressure,
//!
//! ```text
//! θ(v) = (1 − t) θ(a) + t θ(b),   t = (v − a) / (b − a)
//! ```
//!
//! θ being the coefficients of a lag model, or the parameters of a physical one.

use super::band::PredictionBand;
use super::bank::{Bank, BankModel, BankProvenance, Between, ModelDiagnostics, same};
use super::error::{ModelError, display, require_finite};
use super::family::Model;
use super::support::Support;

/// The bank at `value` of `variable` (its name, with its unit, as in `payload_kg`) between `banks`, two or more that were
/// fitted at different values of it. At a value that one was fitted at, its models come back to the last bit.
///
/// What cannot be interpolated is the more careful of the two: the wider band, the smaller supported region; noise levels are
/// the nearer bank's.
///
/// # Errors
/// Fewer than two banks, values that are not finite or not distinct, a value outside theirs, or neighbours whose
/// configurations or models differ in structure.
pub fn bank_between(variable: &str, banks: &[(f64, Bank)], value: f64) -> Result<Bank, ModelError> {
    let unsupported = |what, found: String, expected: &str| ModelError::Unsupported {
        what,
        found,
        expected: expected.into(),
    };
    let values: Vec<f64> = banks.iter().map(|(value, _)| *value).collect();
    require_finite(variable, &values)?;
    require_finite(variable, &[value])?;
    let mut order: Vec<usize> = (0..banks.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    if order.windows(2).any(|pair| values[pair[0]] == values[pair[1]]) {
        let what = "values that the banks were fitted at";
        return Err(unsupported(
            what,
            format!("{variable} = {values:?}"),
            "different ones",
        ));
    }
    let neighbours = order
        .windows(2)
        .find(|pair| (values[pair[0]]..=values[pair[1]]).contains(&value))
        .ok_or_else(|| {
            let fitted: Vec<f64> = order.iter().map(|&i| values[i]).collect();
            let expected = format!("a value between two of those fitted, {fitted:?}");
            unsupported(
                "value to interpolate at",
                format!("{variable} = {value}"),
                &expected,
            )
        })?;
    let [(low, a), (high, b)] = [&banks[neighbours[0]], &banks[neighbours[1]]];
    if a.feedforward() != b.feedforward() {
        let what = "what the banks' flights were sent";
        let found = "positions only in one, velocities too in the other".into();
        return Err(unsupported(what, found, "the same in both"));
    }
    let share = (value - low) / (high - low);

    let mut models = Vec::with_capacity(a.models().len());
    for first in a.models() {
        let at = |model: &&BankModel| same(&model.configuration, &first.configuration);
        let second = b
            .models()
            .iter()
            .find(at)
            .filter(|_| a.models().len() == b.models().len())
            .ok_or_else(|| {
                let configurations = |bank: &Bank| {
                    let all = bank.models().iter().map(|model| display(&model.configuration));
                    all.collect::<Vec<_>>().join("; ")
                };
                let found = format!("{} and {}", configurations(a), configurations(b));
                unsupported("configurations of the banks", found, "the same in both")
            })?;
        if let Some(what) = first.model.structure_difference(&second.model) {
            return Err(unsupported(
                "models of the banks",
                what,
                "the same structure in both",
            ));
        }
        let parts = [(1.0 - share, &first.model), (share, &second.model)];
        let model = Model::between(&parts, first.configuration);
        models.push(BankModel {
            configuration: first.configuration,
            diagnostics: diagnostics(&model, first, second)?,
            model,
        });
    }
    let provenance = BankProvenance {
        tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).into(),
        inputs: [&a.provenance().inputs[..], &b.provenance().inputs].concat(),
        options: a.provenance().options.clone(),
        chosen: None,
        between: Some(Between {
            variable: variable.to_owned(),
            fitted_at: [*low, *high],
            at: value,
        }),
    };
    let nearer = if share <= 0.5 { a } else { b };
    Bank::new(models, provenance)?
        .with_band(a.band().zip(b.band()).and_then(|(a, b)| wider(a, b)))?
        .with_noise(nearer.noise().copied())?
        .with_support(a.support().zip(b.support()).map(|(a, b)| smaller(a, b)))
}

/// Those of both fits, the worse where there is one number.
fn diagnostics(model: &Model, a: &BankModel, b: &BankModel) -> Result<ModelDiagnostics, ModelError> {
    let (first, second) = (&a.diagnostics, &b.diagnostics);
    let mut residual_rms = first.residual_rms.clone();
    for (signal, &rms) in &second.residual_rms {
        let worse = residual_rms.entry(signal.clone()).or_insert(rms);
        *worse = worse.max(rms);
    }
    Ok(ModelDiagnostics {
        flights: [&first.flights[..], &second.flights].concat(),
        rows: first.rows + second.rows,
        coefficients: first.coefficients.max(second.coefficients),
        condition_number: first.condition_number.max(second.condition_number),
        linear_condition_number: first.linear_condition_number.max(second.linear_condition_number),
        spectral_radius: model.spectral_radius(a.configuration)?,
        residual_rms,
    })
}

/// At every horizon that both have, the wider one; `None` if they do not say the same of anything.
fn wider(a: &PredictionBand, b: &PredictionBand) -> Option<PredictionBand> {
    if a.confidence != b.confidence {
        return None;
    }
    let mut band = PredictionBand {
        growth_per_rad: Vec::new(),
        horizons_s: Vec::new(),
        radii_m: Vec::new(),
        windows: Vec::new(),
        flights: [&a.flights[..], &b.flights].concat(),
        ..*a
    };
    for (i, horizon_s) in a.horizons_s.iter().enumerate() {
        if let Some(j) = b.horizons_s.iter().position(|other| other == horizon_s) {
            band.horizons_s.push(*horizon_s);
            band.radii_m.push(a.radii_m[i].max(b.radii_m[j]));
            band.growth_per_rad.push(a.growth(i).max(b.growth(j)));
            band.windows.push(a.windows[i].min(b.windows[j]));
        }
    }
    (!band.horizons_s.is_empty()).then_some(band)
}

/// What both support.
fn smaller(a: &Support, b: &Support) -> Support {
    Support {
        tilt: a.tilt.min(b.tilt),
        speed_m_s: a.speed_m_s.min(b.speed_m_s),
        arm_angle: a.arm_angle.min(b.arm_angle),
        tip_speed_m_s: a.tip_speed_m_s.min(b.tip_speed_m_s),
        command_lead_m: a.command_lead_m.min(b.command_lead_m),
    }
}

#[cfg(test)]
mod tests {
    use super::super::lag::tests::random_model;
    use super::super::lag::{CommandInputs, HEIGHT_ROW, STATE_LEN};
    use super::*;
    use crate::flight::Configuration;
    use crate::trajopt::Dynamics;

    fn bank(lags: usize, length_m: f64, seed: u64) -> Bank {
        let model = BankModel {
            configuration: Configuration {
                length_m,
                pressure_kpa: 0.0,
            },
            model: Model::Lag(random_model(lags, CommandInputs::Position, &[HEIGHT_ROW], seed)),
            diagnostics: ModelDiagnostics::default(),
        };
        let band = PredictionBand {
            confidence: 0.95,
            horizons_s: vec![0.5, 1.0],
            radii_m: vec![0.01 * seed as f64, 0.02],
            growth_per_rad: vec![0.0],
            windows: vec![30, 20],
            flights: vec![format!("flight {seed}")],
        };
        let support = Support {
            tilt: 0.1 * seed as f64,
            speed_m_s: 1.0,
            arm_angle: 1.0,
            tip_speed_m_s: 1.0 / seed as f64,
            command_lead_m: 1.0,
        };
        let bank = Bank::new(vec![model], BankProvenance::default()).unwrap();
        bank.with_band(Some(band))
            .unwrap()
            .with_support(Some(support))
            .unwrap()
    }

    fn predict(bank: &Bank) -> [f64; STATE_LEN] {
        let z: Vec<f64> = (0..3 * STATE_LEN).map(|i| 0.1 * (i as f64).sin()).collect();
        let mut next = [0.0; STATE_LEN];
        bank.models()[0].model.step(0, &z, &[0.2, -0.1, 1.4], &mut next);
        next
    }

    #[test]
    fn predictions_lie_between_those_of_the_neighbours() {
        // In any order; 0.05 has nothing to do with what is between 0 and 0.02.
        let banks = [
            (0.05, bank(3, 0.7, 3)),
            (0.0, bank(3, 0.7, 1)),
            (0.02, bank(3, 0.7, 2)),
        ];
        let mixed = bank_between("payload_kg", &banks, 0.005).unwrap();
        let [empty, loaded] = [&banks[1].1, &banks[2].1].map(predict);
        for (i, found) in predict(&mixed).into_iter().enumerate() {
            let expected = 0.75 * empty[i] + 0.25 * loaded[i];
            assert!(
                (found - expected).abs() < 1e-12,
                "signal {i}: {found} against {expected}"
            );
        }
        assert_eq!(mixed.band().unwrap().radii_m, [0.02, 0.02]);
        assert_eq!(mixed.support().unwrap().tilt, 0.1);
        assert_eq!(mixed.support().unwrap().tip_speed_m_s, 0.5);
        let between = mixed.provenance().between.as_ref().unwrap();
        assert_eq!((between.fitted_at, between.at), ([0.0, 0.02], 0.005));
        for (value, fitted) in &banks {
            let again = bank_between("payload_kg", &banks, *value).unwrap();
            assert_eq!(again.models()[0].model, fitted.models()[0].model);
        }
    }

    #[test]
    fn what_cannot_be_mixed_is_named() {
        let refused = |banks: &[(f64, Bank)], value: f64| {
            bank_between("payload_kg", banks, value).unwrap_err().to_string()
        };
        let two = [(0.0, bank(3, 0.7, 1)), (0.05, bank(3, 0.7, 2))];
        let message = refused(&two, 0.06);
        assert!(
            message.contains("payload_kg = 0.06") && message.contains("[0.0, 0.05]"),
            "{message}"
        );
        assert!(refused(&two[..1], 0.0).contains("between two of those fitted"));
        assert!(refused(&two, f64::NAN).contains("payload_kg"));
        let twice = [two[0].clone(), two[0].clone()];
        assert!(refused(&twice, 0.0).contains("different ones"));
        let lengths = [two[0].clone(), (0.05, bank(3, 0.9, 2))];
        assert!(refused(&lengths, 0.01).contains("configurations of the banks"));
        let lags = [two[0].clone(), (0.05, bank(2, 0.7, 2))];
        assert!(refused(&lags, 0.01).contains("the same structure"));
    }
}
