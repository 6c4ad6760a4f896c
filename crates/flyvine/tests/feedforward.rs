//! Velocities beside positions: only where the task asks for them and the bank knows them, and then the same from plan to
//! recording.

mod common;

use std::ops::ControlFlow;

use flyvine::DT;
use flyvine::control::supervisor::Limits;
use flyvine::control::{ControlLaw, End, FlightOutcome, Flying, FlyingError, fly_plan};
use flyvine::flight::Sample;
use flyvine::link::Feedforward;
use flyvine::model::physical::{ArmLength, Parameters, PhysicalModel};
use flyvine::model::{
    Bank, BankModel, BankProvenance, CommandInputs, LagModel, Model, ModelDiagnostics, NoiseLevels,
};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{
    Plan, PlanError, PlanOptions, Task, make_ensemble_plan, make_plan, read_plan, write_plan,
};

/// The bank of the prior, with this feed-forward.
fn bank(velocity_feedforward: f64) -> Bank {
    let prior = common::prior_bank();
    let with_feedforward = |model: &BankModel| {
        let parameters = Parameters {
            velocity_feedforward,
            ..Parameters::defaults()
        };
        let arm = ArmLength::constant(model.configuration.length_m);
        BankModel {
            model: Model::Physical(Box::new(PhysicalModel::new(parameters, arm).unwrap())),
            ..model.clone()
        }
    };
    let models = prior.models().iter().map(with_feedforward).collect();
    Bank::new(models, prior.provenance().clone()).unwrap()
}

/// A lag model whose quadrotor follows the command late by `1 − share · feed-forward`, and its tip the quadrotor.
fn lag_bank(inputs: CommandInputs) -> Bank {
    let (lags, gain) = (2, 0.08);
    let p = lags * 9 + inputs.len();
    let mut linear = vec![0.0; 9 * p];
    let mut offset = vec![0.0; 9];
    for axis in 0..3 {
        // Quadrotor: x⁺ = x + g (u − x) + 0.9 v Δt, or without v; tip: a lightly damped oscillator about it.
        let (quadrotor, tip) = (axis, 6 + axis);
        linear[quadrotor * p + quadrotor] = 1.0 - gain;
        linear[quadrotor * p + lags * 9 + axis] = gain;
        if inputs == CommandInputs::PositionAndVelocity {
            linear[quadrotor * p + lags * 9 + 3 + axis] = 0.9 * DT;
        }
        linear[tip * p + tip] = 1.85;
        linear[tip * p + 9 + tip] = -0.9;
        linear[tip * p + quadrotor] = 0.05;
        offset[tip] = if axis == 2 { -0.05 * 0.7 } else { 0.0 };
    }
    let model = BankModel {
        configuration: task().configuration,
        model: Model::Lag(LagModel::new(lags, inputs, offset, linear, &[]).unwrap()),
        diagnostics: ModelDiagnostics::default(),
    };
    Bank::new(vec![model], BankProvenance::default()).unwrap()
}

/// There and back in 2 s.
fn task() -> Task {
    let text = r#"
        name = "there_and_back"
        configuration = { length_m = 0.7, pressure_kpa = 0.0 }
        [[waypoints.points]]
        t_s = 1.0
        end_effector = [0.4, 0.0, 0.8]
        [[waypoints.points]]
        t_s = 2.0
        end_effector = [0.0, 0.1, 0.8]
    "#;
    Task::parse(text, "there_and_back.toml").unwrap()
}

fn asking() -> Task {
    Task {
        feedforward: Feedforward::Velocity,
        ..task()
    }
}

fn planned(task: &Task, bank: &Bank) -> Plan {
    make_plan(task, bank, &PlanOptions::default()).unwrap()
}

fn flown(plan: &Plan, law: ControlLaw) -> FlightOutcome {
    try_to_fly(plan, law).unwrap()
}

fn try_to_fly(plan: &Plan, law: ControlLaw) -> Result<FlightOutcome, FlyingError> {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let flying = Flying {
        law,
        ..Flying::default()
    };
    let mut go_on = |_: usize, _: usize| ControlFlow::Continue(());
    fly_plan(plan, &flying, Limits::default(), &mut vehicle, 1, &mut go_on)
}

/// Largest difference, m/s, between the velocities of a recording and those of its commands, as far as these are not too fast.
fn inconsistency_m_s(start: [f64; 3], samples: &[Sample]) -> f64 {
    let mut before = start;
    let mut largest: f64 = 0.0;
    for sample in samples {
        let velocity = sample.command_velocity.expect("sent in every row");
        let moved: [f64; 3] = std::array::from_fn(|axis| (sample.command[axis] - before[axis]) / DT);
        let speed = moved.iter().map(|v| v * v).sum::<f64>().sqrt();
        let share = (Limits::default().command_speed_max_m_s / speed).min(1.0);
        for axis in 0..3 {
            largest = largest.max((velocity[axis] - share * moved[axis]).abs());
        }
        before = sample.command;
    }
    largest
}

#[test]
fn plans_assume_no_velocity_that_is_not_sent() {
    let (with, without) = (planned(&task(), &bank(0.8)), planned(&task(), &bank(0.0)));
    assert_eq!(with.commands, without.commands);
    assert_eq!(with.bank.models(), without.bank.models());
}

#[test]
fn velocities_that_a_bank_does_not_know_are_refused_by_name() {
    let options = PlanOptions::default();
    for bank in [bank(0.0), lag_bank(CommandInputs::Position)] {
        for refused in [
            make_plan(&asking(), &bank, &options),
            make_ensemble_plan(&asking(), &[bank.clone(), bank.clone()], &options),
        ] {
            let error = refused.unwrap_err();
            assert!(matches!(error, PlanError::NoFeedforward { .. }), "{error}");
            assert!(
                error
                    .to_string()
                    .contains("there_and_back`, feedforward: found a bank")
            );
        }
    }
    // And a bank that takes them is not planned on without.
    let unasked = make_plan(&task(), &lag_bank(CommandInputs::PositionAndVelocity), &options).unwrap_err();
    assert!(matches!(unasked, PlanError::Inputs { found: 6, .. }), "{unasked}");
    assert!(unasked.to_string().contains("feedforward"), "{unasked}");
}

#[test]
fn plans_without_velocities_are_written_as_before() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plan.json");
    for (plan, mentioned) in [
        (planned(&task(), &bank(0.0)), false),
        (planned(&asking(), &bank(0.8)), true),
    ] {
        write_plan(&path, &plan).unwrap();
        assert_eq!(read_plan(&path).unwrap(), plan);
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text.contains(r#""feedforward":"velocity""#), mentioned);
    }
    let text = format!("feedforward = \"speed\"\n{}", "name = \"a\"");
    assert!(
        Task::parse(&text, "task.toml")
            .unwrap_err()
            .to_string()
            .contains("speed")
    );
}

/// What the model knows of velocities shortens the lead of the commands over the end effector.
#[test]
fn commands_lead_less_where_velocities_are_sent() {
    // Mean square distance between command and reference, along x.
    let lead = |plan: &Plan| {
        let pairs = plan.commands.iter().zip(&plan.reference);
        pairs.map(|(u, r)| (u[0] - r[0]).powi(2)).sum::<f64>() / plan.commands.len() as f64
    };
    for (with, without) in [
        (planned(&asking(), &bank(0.9)), planned(&task(), &bank(0.0))),
        (
            planned(&asking(), &lag_bank(CommandInputs::PositionAndVelocity)),
            planned(&task(), &lag_bank(CommandInputs::Position)),
        ),
    ] {
        assert!(with.solve.converged, "{}", with.solve.status);
        assert!(
            with.solve.predicted_error_m < 0.06,
            "{} m",
            with.solve.predicted_error_m
        );
        assert!(
            lead(&with) < 0.7 * lead(&without),
            "{} against {}",
            lead(&with),
            lead(&without)
        );
    }
}

/// A plan's own prediction is what its model makes of its commands and their differences.
#[test]
fn a_lag_plan_predicts_with_the_velocities_that_are_sent() {
    let plan = planned(&asking(), &lag_bank(CommandInputs::PositionAndVelocity));
    let (mut x, mut before) = (0.0, 0.0);
    for (knot, command) in plan.commands.iter().enumerate() {
        assert!((plan.states[knot][0] - x).abs() < 1e-9, "knot {knot}");
        x += 0.08 * (command[0] - x) + 0.9 * (command[0] - before);
        before = command[0];
    }
}

#[test]
fn laws_send_the_velocities_of_what_they_command_or_refuse() {
    let physical = bank(0.9).with_noise(Some(NoiseLevels::PHYSICAL)).unwrap();
    for bank in [physical, lag_bank(CommandInputs::PositionAndVelocity)] {
        let plan = planned(&asking(), &bank);
        for law in [ControlLaw::Tracking, ControlLaw::Replan] {
            let error = try_to_fly(&plan, law).unwrap_err();
            assert!(matches!(error, FlyingError::Feedforward { .. }), "{error}");
        }
        for law in [ControlLaw::OpenLoop, ControlLaw::Mpc] {
            let outcome = flown(&plan, law);
            let samples = &outcome.flight.samples;
            // What an abort holds is no velocity; models this crude need not fly to the end.
            let rows = match outcome.end {
                End::Completed => samples.len(),
                End::Aborted { t_s, .. } => (t_s / DT).round() as usize,
            };
            assert!(rows > 10, "{law:?}: {:?}", outcome.end);
            assert!(
                inconsistency_m_s([0.0, 0.0, 1.5], &samples[..rows]) < 1e-9,
                "{law:?}"
            );
        }
    }
}

/// The same commands, with and without their velocities: the vehicle is sent what the plan's task says, and is less far behind.
#[test]
fn the_vehicle_is_less_far_behind_where_velocities_are_sent() {
    let with = planned(&asking(), &bank(0.9));
    let mut without = with.clone();
    without.task.feedforward = Feedforward::None;
    let [heard, unheard] = [&with, &without].map(|plan| flown(plan, ControlLaw::OpenLoop));
    assert!(
        unheard
            .flight
            .samples
            .iter()
            .all(|row| row.command_velocity.is_none())
    );
    let behind_m = |outcome: &FlightOutcome| {
        assert!(matches!(outcome.end, End::Completed), "{:?}", outcome.end);
        let rows = outcome.flight.samples.iter();
        let behind = rows.filter_map(|row| Some((row.command[0] - row.quadrotor?.position[0]).powi(2)));
        (behind.sum::<f64>() / with.commands.len() as f64).sqrt()
    };
    let (heard, unheard) = (behind_m(&heard), behind_m(&unheard));
    assert!(
        heard < 0.95 * unheard,
        "{heard} m behind with velocities, {unheard} m without"
    );
}
