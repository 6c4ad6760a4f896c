//! Predictive control on models of another vehicle gives way to the plan.

mod common;

use std::ops::ControlFlow;

use flyvine::control::estimator::DOUBT;
use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, End, Flying, fly_plan};
use flyvine::flight::Configuration;
use flyvine::model::{Bank, BankModel, BankProvenance, CommandInputs, LagModel, Model, ModelDiagnostics};
use flyvine::report::score;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{PlanOptions, make_plan};

/// A lag model of a vehicle that follows its command slowly, with an arm that trails far behind and hardly swings.
fn sluggish_bank() -> Bank {
    let configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };
    let (mut linear, mut offset) = (vec![0.0; 9 * 12], vec![0.0; 9]);
    for axis in 0..3 {
        linear[axis * 12 + axis] = 0.9;
        linear[axis * 12 + 9 + axis] = 0.1;
        linear[(3 + axis) * 12 + 3 + axis] = 0.5;
        linear[(6 + axis) * 12 + axis] = 0.2;
        linear[(6 + axis) * 12 + 6 + axis] = 0.8;
    }
    offset[8] = -0.2 * configuration.length_m;
    let model = LagModel::new(1, CommandInputs::Position, offset, linear, &[]).unwrap();
    let model = BankModel {
        configuration,
        model: Model::Lag(model),
        diagnostics: ModelDiagnostics::default(),
    };
    Bank::new(vec![model], BankProvenance::default()).unwrap()
}

/// Mean distance of the tip to the reference on the built-in vehicle, m, and the greatest inconsistency reported.
fn flown(bank: &Bank, law: ControlLaw) -> (f64, f64) {
    let task = common::task("lemniscate_10s_ES.toml");
    let plan = make_plan(&task, bank, &PlanOptions::default()).unwrap();
    let flying = Flying {
        law,
        ..Flying::default()
    };
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let mut go_on = |_: usize, _: usize| ControlFlow::Continue(());
    let outcome = fly_plan(&plan, &flying, Limits::default(), &mut vehicle, 1, &mut go_on).unwrap();
    assert!(matches!(outcome.end, End::Completed), "{:?}", outcome.end);
    let score = score(
        &outcome.flight,
        &plan.reference,
        &plan.predicted_end_effector(),
        None,
    )
    .unwrap();
    let inconsistencies = outcome.steps.iter().map(|step| step.report.inconsistency);
    (score.ee_vs_reference.mean_m, inconsistencies.fold(0.0, f64::max))
}

#[test]
fn predictive_control_on_models_of_another_vehicle_flies_the_plan() {
    let bank = sluggish_bank();
    let (plan_alone, _) = flown(&bank, ControlLaw::OpenLoop);
    let (with_feedback, inconsistency) = flown(&bank, ControlLaw::Mpc);
    assert!(inconsistency > 2.0 * DOUBT, "{inconsistency}");
    // Feedback that goes on is off by half as much again.
    assert!(
        with_feedback < 1.1 * plan_alone,
        "{with_feedback} m, the plan alone {plan_alone} m"
    );
}
