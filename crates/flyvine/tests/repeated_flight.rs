//! A recorded flight through the controller that flew it: the same commands, bit for bit.

mod common;

use std::ops::ControlFlow;
use std::time::Duration;

use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, FlightOutcome, Flying, fly_plan};
use flyvine::flight::StepStatus;
use flyvine::link::{RecordedVehicle, Vehicle};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, PlanOptions, make_plan};

fn flown(plan: &Plan, flying: &Flying, vehicle: &mut dyn Vehicle) -> FlightOutcome {
    let mut go_on = |_: usize, _: usize| ControlFlow::Continue(());
    fly_plan(plan, flying, Limits::default(), vehicle, 3, &mut go_on).unwrap()
}

#[test]
fn steps_that_were_cut_short_and_trust_from_an_earlier_flight_are_repeated_to_the_last_bit() {
    let task = common::task("lemniscate_5s_ES.toml");
    let plan = make_plan(&task, &common::prior_bank(), &PlanOptions::default()).unwrap();
    let trusting = Flying {
        law: ControlLaw::Mpc,
        step_limit: Some(Duration::from_nanos(1)),
        inconsistency: Some(0.5),
        ..Flying::default()
    };
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let outcome = flown(&plan, &trusting, &mut vehicle);
    let commands = |outcome: &FlightOutcome| -> Vec<[f64; 3]> {
        let rows = outcome.flight.samples.iter();
        rows.map(|sample| sample.command).collect()
    };
    let cut_short = |outcome: &FlightOutcome| {
        let steps = outcome.steps.iter();
        steps
            .filter(|step| step.report.status == StepStatus::BudgetSpent)
            .count()
    };
    assert!(cut_short(&outcome) > 0, "a nanosecond is enough for no step");
    assert_eq!(outcome.steps[0].report.inconsistency, 0.5);
    // Trust that is not earned anew: already the first commands are not the plan's.
    assert_ne!(commands(&outcome)[..5], plan.commands[..5]);

    let again = Flying {
        law: ControlLaw::Mpc,
        recorded: outcome.steps.clone(),
        ..Flying::default()
    };
    let repeated = flown(&plan, &again, &mut RecordedVehicle::new(outcome.flight.clone()));
    assert_eq!(commands(&repeated), commands(&outcome));

    let careful = Flying {
        law: ControlLaw::Mpc,
        ..Flying::default()
    };
    let other = flown(&plan, &careful, &mut RecordedVehicle::new(outcome.flight.clone()));
    assert_eq!(
        other.steps[0].report.inconsistency,
        flyvine::control::estimator::DOUBT
    );
    assert_ne!(commands(&other), commands(&outcome));
}
