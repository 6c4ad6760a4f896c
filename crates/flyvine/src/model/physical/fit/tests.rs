use super::super::parameters::PARAMETERS;
use super::super::synthetic::{random_commands, simulate_flight};
use super::*;

/// A vehicle that differs from the defaults in autopilot, arm and masses.
fn vehicle() -> Parameters<f64> {
    Parameters {
        position_gain_xy: 1.3,
        velocity_gain_xy: 2.4,
        integral_gain_xy: 1.0,
        attitude_gain: 9.0,
        command_delay: 0.027,
        base_stiffness: 1.2,
        joint_stiffness: 0.25,
        base_damping: 0.1,
        tip_mass: 0.14,
        ..Parameters::defaults()
    }
}

fn flights(rows: usize, noise: f64) -> Vec<Flight> {
    [1, 2]
        .map(|seed| {
            let commands = random_commands(rows, seed);
            simulate_flight(
                &format!("flight {seed}"),
                &vehicle(),
                0.8,
                &commands,
                noise,
                10 + seed,
            )
            .0
        })
        .to_vec()
}

fn data(flights: &[Flight]) -> Vec<FlightData> {
    flights
        .iter()
        .flat_map(|flight| FlightData::stretches(flight).unwrap())
        .collect()
}

#[test]
fn gradient_of_the_objective_agrees_with_finite_differences() {
    let mut stretches = data(&flights(80, 1e-3));
    stretches[1].weight = 3.0;
    let options = PhysicalFitOptions::default();
    let misfit = || Misfit {
        flights: &stretches,
        rows: usize::MAX,
        robust_scale_m: 0.05,
        correlated_rows: 30.0,
        options: &options,
    };
    // Two configurations of one vehicle, though with the same flights.
    let problem = Problem {
        misfits: vec![misfit(), misfit()],
        held: vec![],
        trust: Some((vec![vehicle(), vehicle()], 0.5)),
    };
    let parameters = Parameters {
        command_delay: 0.023, // away from the kinks at whole substeps
        velocity_feedforward: 0.05,
        acceleration_feedforward: 0.03,
        horizontal_speed_limit: 0.9,
        ..Parameters::defaults()
    };
    let other = Parameters {
        base_stiffness: 0.8,
        tip_mass: 0.15,
        ..parameters
    };
    let quadratic = problem.quadratic(&[parameters, other]);
    let scale = quadratic.gradient.amax();
    for entry in 0..2 * PARAMETER_COUNT {
        let (configuration, i) = (entry / PARAMETER_COUNT, entry % PARAMETER_COUNT);
        let info = &PARAMETERS[i];
        let shifted = |by: f64| {
            let moved = |(number, own): (usize, &Parameters<f64>)| {
                let mut values = own.to_array();
                if number == configuration {
                    // Not through `from_coordinates`, which clamps to the bounds.
                    values[i] = info.value(info.coordinate(values[i]) + by);
                }
                Parameters::from_array(values)
            };
            let both: Vec<_> = [parameters, other].iter().enumerate().map(moved).collect();
            problem.value(&both).0
        };
        let h = 1e-4;
        let difference =
            (8.0 * (shifted(h) - shifted(-h)) - (shifted(2.0 * h) - shifted(-2.0 * h))) / (12.0 * h);
        let exact = 2.0 * quadratic.gradient[entry];
        assert!(
            (exact - difference).abs() < 1e-6 * scale,
            "{}: {exact} against {difference}",
            info.name
        );
    }
}

#[test]
fn a_synthetic_vehicle_is_recovered() {
    let model = fit_physical(&flights(260, 5e-4), &PhysicalFitOptions::default(), &mut |_| {}).unwrap();
    model.validate().unwrap();

    // What the flights determine well is found; what they leave to the prior is not asked for.
    let (found, truth) = (model.parameters.to_array(), vehicle().to_array());
    for (i, info) in PARAMETERS.iter().enumerate() {
        let deviation = info.coordinate(found[i]) - info.coordinate(truth[i]);
        let sigma = model.covariance[i][i].sqrt();
        assert!(
            deviation.abs() < 3.0 * sigma,
            "{}: {} against {}",
            info.name,
            found[i],
            truth[i]
        );
    }
    assert!((model.parameters.position_gain_xy / 1.3 - 1.0).abs() < 0.02);
    assert!((model.parameters.tip_mass / 0.14 - 1.0).abs() < 0.1);

    // A flight that it has not seen, simulated from its start to its end.
    let (unseen, _) = simulate_flight("unseen", &vehicle(), 0.8, &random_commands(260, 9), 0.0, 0);
    let stretch = FlightData::stretches(&unseen).unwrap().remove(0);
    let mut state = model.rest_state([0.0, 0.0, 1.5]);
    for row in 0..stretch.rows() {
        let error = (6..9)
            .map(|i| (state[i] - stretch.observed[row].outputs[i]).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(error < 0.02, "row {row}: {error} m");
        let mut next = vec![0.0; state.len()];
        crate::trajopt::Dynamics::step(&model, row, &state, &stretch.commands[row], &mut next);
        state = next;
    }
}

#[test]
fn a_limit_on_the_horizontal_speed_is_found() {
    let limited = Parameters {
        horizontal_speed_limit: 0.7,
        ..vehicle()
    };
    let flight = |seed: u64| {
        let commands = random_commands(260, seed);
        simulate_flight(&format!("flight {seed}"), &limited, 0.8, &commands, 5e-4, seed).0
    };
    let model = fit_physical(
        &[flight(1), flight(2)],
        &PhysicalFitOptions::default(),
        &mut |_| {},
    )
    .unwrap();
    let found = model.parameters.horizontal_speed_limit;
    assert!((found / 0.7 - 1.0).abs() < 0.03, "{found} m/s");
    let error_m = model.fit.unwrap().tip_error_m;
    assert!(error_m < 4e-3, "{error_m} m");
}

#[test]
fn the_same_flights_give_the_same_bits_on_any_number_of_threads() {
    let flights = flights(60, 1e-3);
    let options = PhysicalFitOptions {
        max_iterations: 1,
        ..PhysicalFitOptions::default()
    };
    let fit_on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| fit_physical(&flights, &options, &mut |_| {}).unwrap())
    };
    assert!(fit_on(1) == fit_on(2));
}

#[test]
fn a_model_survives_its_file() {
    let options = PhysicalFitOptions {
        max_iterations: 1,
        ..PhysicalFitOptions::default()
    };
    let model = fit_physical(&flights(60, 1e-3), &options, &mut |_| {}).unwrap();
    let text = serde_json::to_string(&model).unwrap();
    assert!(serde_json::from_str::<PhysicalModel>(&text).unwrap() == model);
}

#[test]
fn bad_flights_are_refused_by_name() {
    let fit = |flights: &[Flight]| {
        let error = fit_physical(flights, &PhysicalFitOptions::default(), &mut |_| {}).unwrap_err();
        error.to_string()
    };
    assert!(fit(&[]).contains("no flight"));
    let good = flights(60, 0.0);

    let mut other = good.clone();
    other[1].samples[30].configuration.length_m = 0.9;
    assert!(fit(&other).contains("flight 2"));

    let mut broken = good.clone();
    broken[0].samples[7].command[1] = f64::NAN;
    assert!(fit(&broken).contains("row 7"));

    let mut short = good.clone();
    short[1].samples.truncate(10);
    assert!(fit(&short).contains("10 rows"));
}

/// The flight with its poses as a clock that is late by `late_s` and gains `drift` s per s shows them: the pose of
/// the time before, interpolated.
fn late(flight: &Flight, quadrotor_s: f64, tip_s: f64, drift: f64) -> Flight {
    let mut shifted = flight.clone();
    let rows = flight.samples.len();
    let pose_at = |row: usize, late_s: f64, entry: usize| {
        let position = (row as f64 - late_s / crate::DT).clamp(0.0, (rows - 1) as f64);
        let below = (position.floor() as usize).min(rows - 2);
        let share = position - below as f64;
        let value = |row: usize| {
            let sample = &flight.samples[row];
            match entry {
                0..3 => sample.quadrotor.unwrap().position[entry],
                _ => sample.end_effector.unwrap()[entry - 3],
            }
        };
        (1.0 - share) * value(below) + share * value(below + 1)
    };
    for row in 0..rows {
        let drifted = drift * (row as f64 - 0.5 * rows as f64) * crate::DT;
        let mut pose = shifted.samples[row].quadrotor.unwrap();
        pose.position = std::array::from_fn(|i| pose_at(row, quadrotor_s + drifted, i));
        shifted.samples[row].quadrotor = Some(pose);
        shifted.samples[row].end_effector =
            Some(std::array::from_fn(|i| pose_at(row, tip_s + drifted, 3 + i)));
    }
    shifted
}

#[test]
fn late_and_drifting_streams_are_measured_below_the_sampling_time() {
    let mut flights = flights(260, 3e-4);
    let commands = random_commands(260, 3);
    flights.push(simulate_flight("flight 3", &vehicle(), 0.8, &commands, 3e-4, 13).0);
    let truth = PhysicalModel {
        parameters: vehicle(),
        arm: crate::model::physical::ArmLength::constant(0.8),
        correction: None,
        covariance: Vec::new(),
        fit: None,
    };
    let options = PhysicalFitOptions::default();
    let timing = |flights: &[Flight]| stream_timing(&truth, flights, &options).unwrap().flights;
    for flight in timing(&flights) {
        assert!(!flight.notable(), "{flight}");
    }
    let good = flights[1].clone();
    flights[1] = late(&good, 0.0, 0.04, 0.0);
    let found = timing(&flights);
    assert!(
        found[1].notable() && !found[0].notable(),
        "{} {}",
        found[0],
        found[1]
    );
    assert!(
        (found[1].end_effector_late_s.value - 0.04).abs() < 0.005,
        "{}",
        found[1]
    );
    assert!(found[1].quadrotor_late_s.value.abs() < 0.005, "{}", found[1]);

    flights[1] = late(&good, 0.02, 0.02, 0.0);
    let found = &timing(&flights)[1];
    assert!((found.quadrotor_late_s.value - 0.02).abs() < 0.006, "{found}");

    flights[1] = late(&good, 0.0, 0.0, 4e-3);
    let found = &timing(&flights)[1];
    // Of 13 s: the prior holds a third of it back.
    assert!(
        found.notable() && (found.drift.value - 4e-3).abs() < 2e-3,
        "{found}"
    );

    // A stream that is late in all flights is late behind the other stream.
    let all: Vec<Flight> = flights
        .iter()
        .map(|flight| late(flight, 0.0, 0.02, 0.0))
        .collect();
    let found = stream_timing(&truth, &[all[0].clone(), all[2].clone()], &options).unwrap();
    assert!(found.streams_apart() && (found.end_effector_behind_quadrotor_s - 0.02).abs() < 0.006);
}

#[test]
fn a_feedforward_is_found_where_velocities_were_sent_and_nowhere_else() {
    let truth = Parameters {
        velocity_feedforward: 0.8,
        acceleration_feedforward: 0.5,
        ..Parameters::defaults()
    };
    // Smooth commands: two waves per axis.
    let command = |row: usize, seed: f64| -> [f64; 3] {
        let t = row as f64 * crate::DT;
        let wave = |rate: f64| 0.5 * (rate * t).sin() + 0.2 * (2.3 * rate * t).sin();
        [
            wave(0.9 + 0.2 * seed),
            wave(1.3 - 0.1 * seed),
            1.5 + 0.1 * wave(0.7),
        ]
    };
    let mut flights: Vec<Flight> = (0..2)
        .map(|seed| {
            let commands: Vec<[f64; 3]> = (0..200).map(|row| command(row, f64::from(seed))).collect();
            simulate_flight("waves", &truth, 0.8, &commands, 1e-3, seed as u64).0
        })
        .collect();
    let options = PhysicalFitOptions::default();
    let unsent = fit_physical(&flights, &options, &mut |_| {}).unwrap();
    assert_eq!(unsent.parameters.velocity_feedforward, 0.0);
    assert_eq!(unsent.parameters.acceleration_feedforward, 0.0);
    let not_told = unsent
        .estimates()
        .into_iter()
        .find(|e| e.name == "velocity_feedforward")
        .unwrap();
    assert!(!not_told.identified && !not_told.at_bound);
    for flight in &mut flights {
        for row in (0..flight.samples.len()).rev() {
            let before = flight.samples[row.saturating_sub(1)].command;
            let sample = &mut flight.samples[row];
            sample.command_velocity = Some(std::array::from_fn(|axis| {
                (sample.command[axis] - before[axis]) / crate::DT
            }));
        }
    }
    let sent = fit_physical(&flights, &options, &mut |_| {}).unwrap();
    let found = sent.parameters.velocity_feedforward;
    assert!((found - 0.8).abs() < 0.1, "{found}");
    let found = sent.parameters.acceleration_feedforward;
    assert!((found - 0.5).abs() < 0.2, "{found}");
    let tip_error_m = |model: &PhysicalModel| model.fit.as_ref().unwrap().tip_error_m;
    assert!(tip_error_m(&sent) < tip_error_m(&unsent));
}
