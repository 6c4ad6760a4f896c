use super::super::lag::{HEIGHT_ROW, QuadraticTerms, STATE_LEN};
use super::super::physical::Parameters;
use super::super::physical::synthetic::{random_commands, simulate_flight};
use super::super::rollout::advance;
use super::*;
use crate::flight::{Pose, Sample};
use crate::trajopt::Dynamics;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const ES: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
pub(crate) const EL: Configuration = Configuration {
    length_m: 1.0,
    pressure_kpa: 0.0,
};

/// A stable system of the paper's structure: every signal is damped and driven by the command and its
/// neighbour; the height row has an offset and a few products.
pub(crate) fn system() -> LagModel {
    let p = 30;
    let mut linear = vec![0.0; STATE_LEN * p];
    for row in 0..STATE_LEN {
        linear[row * p + row] = 0.9;
        linear[row * p + 9 + row] = -0.25;
        linear[row * p + 18 + (row + 1) % 9] = 0.05;
        linear[row * p + 27 + row % 3] = 0.1;
    }
    let mut upper_triangle = vec![0.0; 465];
    for (index, a) in upper_triangle.iter_mut().enumerate() {
        *a = if index % 7 == 0 {
            0.01 * (index as f64).sin()
        } else {
            0.0
        };
    }
    let mut offset = vec![0.0; STATE_LEN];
    offset[HEIGHT_ROW] = 0.2;
    let quadratic = [QuadraticTerms {
        row: HEIGHT_ROW,
        upper_triangle,
    }];
    LagModel::new(3, CommandInputs::Position, offset, linear, &quadratic).unwrap()
}

fn sample(row: usize, configuration: Configuration, command: [f64; 3], x: &[f64]) -> Sample {
    Sample {
        t_s: row as f64 * crate::DT,
        configuration,
        command,
        command_velocity: None,
        quadrotor: Some(Pose {
            position: [x[0], x[1], x[2]],
            attitude: [1.0, x[3], x[4], x[5]],
        }),
        end_effector: Some([x[6], x[7], x[8]]),
    }
}

/// Random steps of the command through [`system`], with `noise` on what is measured.
pub(crate) fn flight(name: &str, configuration: Configuration, rows: usize, seed: u64, noise: f64) -> Flight {
    let model = system();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut state = vec![0.0; 27];
    let mut samples = Vec::with_capacity(rows);
    for row in 0..rows {
        let command = std::array::from_fn(|_| random.random_range(-1.0..1.0));
        let mut measured = |value: f64| value + noise * random.random_range(-1.0..1.0);
        let x: [f64; STATE_LEN] = std::array::from_fn(|signal| measured(state[signal]));
        samples.push(sample(row, configuration, command, &x));
        let mut fresh = [0.0; STATE_LEN];
        model.step(row, &state, &command, &mut fresh);
        advance(&mut state, &fresh);
    }
    Flight {
        name: name.into(),
        samples,
    }
}

/// Every five rows: three random states, what [`system`] makes of them, and a wild row whose tip hygiene
/// has rejected.
fn scattered(transitions: usize, seed: u64) -> Flight {
    let model = system();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut samples = Vec::new();
    for _ in 0..transitions {
        let z: Vec<f64> = (0..27).map(|_| random.random_range(-1.0..1.0)).collect();
        let command = std::array::from_fn(|_| random.random_range(-1.0..1.0));
        let mut next = [0.0; STATE_LEN];
        model.step(0, &z, &command, &mut next);
        for x in [&z[18..], &z[9..18], &z[..9], &next, &[1e3; 9]] {
            let row = samples.len();
            samples.push(sample(row, ES, command, x));
        }
        samples.last_mut().unwrap().end_effector = None;
    }
    Flight {
        name: "scattered".into(),
        samples,
    }
}

fn plain() -> FitOptions {
    FitOptions {
        height_ridge: Ridge::Value(0.0),
        linear_ridge: Ridge::Value(0.0),
        positions: Some(Positions::Absolute),
        refinement: Refinement::Off,
        ..FitOptions::default()
    }
}

#[test]
fn plain_least_squares_recovers_the_system_from_valid_rows_only() {
    let (bank, report) = fit_bank(&[scattered(700, 1)], &plain()).unwrap();
    let Model::Lag(fitted) = &bank.models()[0].model else {
        panic!("a lag model");
    };
    let system = system();
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(far(&fitted.linear(), &system.linear()) < 1e-10);
    assert!(far(fitted.offset(), system.offset()) < 1e-10);
    let (terms, expected) = (&fitted.quadratic()[0], &system.quadratic()[0]);
    assert!(far(&terms.upper_triangle, &expected.upper_triangle) < 1e-10);
    assert_eq!(report.findings, [Finding::TooShortToCrossCheck]);
    let diagnostics = &bank.models()[0].diagnostics;
    assert_eq!((diagnostics.rows, diagnostics.coefficients), (700, 496));
}

#[test]
fn the_same_bits_whatever_the_number_of_threads() {
    let mut flights: Vec<Flight> = (0..3).map(|seed| flight("f", ES, 320, seed, 1e-3)).collect();
    flights.extend((3..6).map(|seed| flight("g", EL, 320, seed, 1e-3)));
    let fit = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| fit_bank(&flights, &FitOptions::default()).unwrap())
    };
    assert_eq!(fit(1), fit(3));
}

#[test]
fn what_cannot_be_fitted_is_said() {
    let fail = |flights: &[Flight], options: &FitOptions| fit_bank(flights, options).unwrap_err().to_string();
    let short = [flight("f", ES, 300, 1, 0.0)];
    let message = fail(&short, &plain());
    assert!(
        message.contains("297 usable rows in 1 flights for 496 coefficients"),
        "{message}"
    );
    assert!(fail(&[], &plain()).contains("0 flights"));
    let twice = [flight("a", ES, 300, 1, 0.0), flight("b", ES, 300, 1, 0.0)];
    assert!(fail(&twice, &plain()).contains("flights a and b hold the same samples"));
    let mut deploying = flight("d", ES, 300, 1, 0.0);
    deploying.samples[299].configuration = EL;
    assert!(fail(&[deploying], &plain()).contains("no flight with a constant configuration"));
    let velocity = FitOptions {
        command_velocity: VelocityInput::On,
        ..plain()
    };
    assert!(fail(&short, &velocity).contains("flight f: no commanded velocity in row 0"));
    let negative = FitOptions {
        height_ridge: Ridge::Value(-1.0),
        ..plain()
    };
    assert!(fail(&short, &negative).contains("height_ridge: found -1"));
    let empty = Flight {
        name: "empty".into(),
        samples: Vec::new(),
    };
    assert!(fail(&[short[0].clone(), empty], &plain()).contains("flight empty: no rows"));
    let diagonal = Configuration {
        length_m: 1.0,
        pressure_kpa: 0.4,
    };
    let apart = [flight("f", ES, 300, 1, 0.0), flight("g", diagonal, 300, 2, 0.0)];
    assert!(fail(&apart, &plain()).contains("no model at configuration"));
}

#[test]
fn options_refuse_unknown_keys() {
    assert!(toml::from_str::<FitOptions>("lagz = 4").is_err());
    let options: FitOptions = toml::from_str("lags = 4\nheight_ridge = { value = 0.1 }").unwrap();
    assert_eq!((options.lags, options.height_ridge), (4, Ridge::Value(0.1)));
}

/// A flight of a simulated vehicle in a room whose origin is elsewhere.
fn elsewhere(seed: u64, shift: [f64; 3]) -> Flight {
    let (commands, name) = (random_commands(360, seed), format!("flight {seed}"));
    let mut flight = simulate_flight(&name, &Parameters::defaults(), 0.8, &commands, 3e-4, seed).0;
    let moved = |position: [f64; 3]| std::array::from_fn(|axis| position[axis] + shift[axis]);
    for sample in &mut flight.samples {
        sample.command = moved(sample.command);
        sample.quadrotor = sample.quadrotor.map(|pose| Pose {
            position: moved(pose.position),
            ..pose
        });
        sample.end_effector = sample.end_effector.map(moved);
    }
    flight
}

#[test]
fn with_relative_positions_shifting_the_room_shifts_the_prediction() {
    let options = FitOptions {
        positions: Some(Positions::Relative),
        height_ridge: Ridge::Value(1e-2),
        linear_ridge: Ridge::Value(1e-6),
        refinement: Refinement::On,
        ..FitOptions::default()
    };
    let fit = |shift: [f64; 3]| {
        let flights: Vec<Flight> = (1..=3).map(|seed| elsewhere(seed, shift)).collect();
        let (bank, report) = fit_bank(&flights, &options).unwrap();
        assert!(report.chosen.refined);
        bank.models()[0].model.clone()
    };
    let (here, there) = (fit([0.0; 3]), fit([3.0, -2.0, 1.0]));
    let Model::Lag(lag) = &here else {
        panic!("a lag model");
    };
    assert_eq!(lag.quadratic().len(), 1);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut state = here.rest_state(Configuration {
        length_m: 0.8,
        pressure_kpa: 0.0,
    });
    state
        .iter_mut()
        .for_each(|entry| *entry += random.random_range(-0.1..0.1));
    let command = [0.3, -0.2, 1.6];
    let step = |model: &Model, shift: [f64; 3]| {
        let mut state = state.clone();
        for x in state.chunks_exact_mut(STATE_LEN) {
            for axis in 0..3 {
                x[axis] += shift[axis];
                x[6 + axis] += shift[axis];
            }
        }
        let command: [f64; 3] = std::array::from_fn(|axis| command[axis] + shift[axis]);
        let mut fresh = [0.0; STATE_LEN];
        model.step(0, &state, &command, &mut fresh);
        fresh
    };
    let shift = [1.5, -4.0, 0.7];
    let (plain, shifted, other) = (step(&here, [0.0; 3]), step(&here, shift), step(&there, [0.0; 3]));
    for signal in 0..STATE_LEN {
        let by = match signal {
            0..3 => shift[signal],
            6.. => shift[signal - 6],
            _ => 0.0,
        };
        assert!(
            (shifted[signal] - plain[signal] - by).abs() < 1e-9,
            "signal {signal}"
        );
        // And it does not matter in which room the vehicle was identified.
        assert!((other[signal] - plain[signal]).abs() < 1e-5, "signal {signal}");
    }
}

#[test]
fn positions_are_relative_where_flights_of_several_rooms_say_so() {
    let flights: Vec<Flight> = (1..=4)
        .map(|seed| elsewhere(seed, [2.0 * seed as f64, -1.5 * seed as f64, 0.0]))
        .collect();
    let options = FitOptions {
        structure: Structure::Linear,
        refinement: Refinement::Off,
        ..FitOptions::default()
    };
    let (bank, report) = fit_bank(&flights, &options).unwrap();
    let least = |positions: Positions| {
        (report.candidates.iter())
            .filter(|candidate| candidate.positions == positions)
            .map(Candidate::score_m)
            .fold(f64::INFINITY, f64::min)
    };
    assert!(least(Positions::Relative) < least(Positions::Absolute));
    assert_eq!(report.chosen.positions, Positions::Relative);
    assert_eq!(bank.provenance().chosen, Some(report.chosen));
}
