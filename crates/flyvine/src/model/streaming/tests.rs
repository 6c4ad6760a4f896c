use super::super::family::Model;
use super::super::fit::fit_bank;
use super::super::fit::tests::{EL, ES, flight as about_zero};
use super::super::lag::LagModel;
use super::super::one_step::one_step_rmse;
use super::*;
use crate::HOVER_HEIGHT_M;

/// Plain least squares.
fn plain() -> FitOptions {
    FitOptions {
        height_ridge: Ridge::Value(0.0),
        linear_ridge: Ridge::Value(0.0),
        command_velocity: VelocityInput::Off,
        positions: Some(Positions::Absolute),
        refinement: Refinement::Off,
        ..FitOptions::default()
    }
}

/// A noisy flight about rest at hover height.
fn flight(name: &str, configuration: Configuration, rows: usize, seed: u64, noise: f64) -> Flight {
    let mut flight = about_zero(name, configuration, rows, seed, noise);
    for sample in &mut flight.samples {
        sample.command[2] += HOVER_HEIGHT_M;
        if let Some(pose) = &mut sample.quadrotor {
            pose.position[2] += HOVER_HEIGHT_M;
        }
        if let Some(tip) = &mut sample.end_effector {
            tip[2] += HOVER_HEIGHT_M - configuration.length_m;
        }
    }
    flight
}

fn named(flight: Flight) -> (Flight, InputFile) {
    let input = InputFile {
        path: format!("{}.csv", flight.name),
        sha256: flight.name.clone(),
    };
    (flight, input)
}

/// Noisy flights at two lengths, and one in between.
fn flights() -> Vec<(Flight, InputFile)> {
    let middle = Configuration { length_m: 0.85, ..ES };
    [ES, EL, ES, middle, EL, ES, ES]
        .iter()
        .zip(0..)
        .map(|(&configuration, seed)| {
            named(flight(&format!("flight {seed}"), configuration, 400, seed, 3e-2))
        })
        .collect()
}

fn part(flights: &[(Flight, InputFile)], options: &FitOptions, by: Reduction, shard: Shard) -> PartialFit {
    let mut part = PartialFit::new(options, by, flights.len(), shard).unwrap();
    part.add(&flights[shard.range(flights.len())]).unwrap();
    part
}

fn whole(flights: &[(Flight, InputFile)], options: &FitOptions, by: Reduction) -> (Bank, StreamReport) {
    part(flights, options, by, Shard::WHOLE).bank().unwrap()
}

fn lag(model: &BankModel) -> &LagModel {
    match &model.model {
        Model::Lag(model) => model,
        Model::Physical(_) => panic!("a lag model"),
    }
}

#[test]
fn streaming_is_the_least_squares_of_all_rows() {
    let flights = flights();
    let in_memory: Vec<Flight> = flights.iter().map(|(flight, _)| flight.clone()).collect();
    let (dense, _) = fit_bank(&in_memory, &plain()).unwrap();
    for reduction in [Reduction::Moments, Reduction::Orthogonal] {
        let (streamed, report) = whole(&flights, &plain(), reduction);
        assert_eq!(report.unused, ["flight 3"]);
        assert!(streamed.support().is_some());
        assert_eq!(streamed.support(), dense.support());
        for (a, b) in streamed.models().iter().zip(dense.models()) {
            assert_eq!(a.configuration, b.configuration);
            assert_eq!(a.diagnostics.flights, b.diagnostics.flights);
            assert_eq!(a.diagnostics.rows, b.diagnostics.rows);
            let members: Vec<Track> = (in_memory.iter())
                .filter(|flight| a.diagnostics.flights.contains(&flight.name))
                .map(|flight| Track::new(flight, CommandInputs::Position).unwrap())
                .collect();
            let members: Vec<&Track> = members.iter().collect();
            let (found, least) = (one_step_rmse(lag(a), &members), one_step_rmse(lag(b), &members));
            for (signal, least) in least {
                assert!(
                    found[&signal] < least * (1.0 + 1e-9),
                    "{signal}: {:e}",
                    found[&signal] / least - 1.0
                );
                let reported = a.diagnostics.residual_rms[&signal];
                assert!((reported / found[&signal] - 1.0).abs() < 1e-6, "{reported}");
            }
        }
    }
}

#[test]
fn linear_rows_are_held_back_as_in_memory() {
    let flights = flights();
    let in_memory: Vec<Flight> = flights.iter().map(|(flight, _)| flight.clone()).collect();
    let options = FitOptions {
        structure: Structure::Linear,
        linear_ridge: Ridge::Value(1e-3),
        ..plain()
    };
    let (dense, _) = fit_bank(&in_memory, &options).unwrap();
    for reduction in [Reduction::Moments, Reduction::Orthogonal] {
        let (streamed, _) = whole(&flights, &options, reduction);
        for (a, b) in streamed.models().iter().zip(dense.models()) {
            let pairs = lag(a).linear().into_iter().zip(lag(b).linear());
            let difference = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(difference < 1e-9, "{difference:e}");
        }
    }
}

#[test]
fn shards_and_threads_do_not_change_a_bit() {
    let flights = flights();
    let folder = tempfile::tempdir().unwrap();
    for reduction in [Reduction::Moments, Reduction::Orthogonal] {
        let (bank, report) = whole(&flights, &plain(), reduction);
        for shards in [2, 3, 7] {
            let mut merged: Option<PartialFit> = None;
            for number in 1..=shards {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(number)
                    .build()
                    .unwrap();
                let shard = Shard { number, of: shards };
                let path = folder.path().join("part");
                let part = pool.install(|| part(&flights, &plain(), reduction, shard));
                part.write(&path).unwrap();
                let part = PartialFit::read(&path).unwrap();
                match &mut merged {
                    None => merged = Some(part),
                    Some(merged) => merged.append(part).unwrap(),
                }
            }
            let (again, report_again) = merged.unwrap().bank().unwrap();
            assert_eq!(
                serde_json::to_string(&again).unwrap(),
                serde_json::to_string(&bank).unwrap()
            );
            assert_eq!(report_again, report);
        }
    }
}

#[test]
fn handing_flights_over_one_by_one_is_the_same() {
    let flights = flights();
    let mut part = PartialFit::new(&plain(), Reduction::Moments, flights.len(), Shard::WHOLE).unwrap();
    for flight in &flights {
        part.add(std::slice::from_ref(flight)).unwrap();
    }
    assert_eq!(
        part.bank().unwrap(),
        whole(&flights, &plain(), Reduction::Moments)
    );
}

#[test]
fn sums_that_lose_the_digits_are_refused_and_factors_are_not() {
    // The commanded height repeats the commanded x, but for rounding in the last digits that matter.
    let mut flights: Vec<(Flight, InputFile)> = (0..3)
        .map(|seed| named(flight(&format!("f{seed}"), ES, 400, seed, 3e-2)))
        .collect();
    for (flight, _) in &mut flights {
        for (row, sample) in flight.samples.iter_mut().enumerate() {
            sample.command[2] = sample.command[0] + 1e-9 * (0.7 * row as f64).sin();
        }
    }
    let error = part(&flights, &plain(), Reduction::Moments, Shard::WHOLE)
        .bank()
        .unwrap_err();
    assert!(matches!(error, ModelError::IllConditioned { .. }), "{error}");
    let (bank, report) = whole(&flights, &plain(), Reduction::Orthogonal);
    assert!(report.corners[0].condition_number > 1e8);
    let in_memory: Vec<Flight> = flights.iter().map(|(flight, _)| flight.clone()).collect();
    let (dense, _) = fit_bank(&in_memory, &plain()).unwrap();
    let rms = |bank: &Bank| bank.models()[0].diagnostics.residual_rms["ee_z"];
    assert!(
        rms(&bank) < rms(&dense) * (1.0 + 1e-6),
        "{:e}",
        rms(&bank) / rms(&dense) - 1.0
    );
}

#[test]
fn what_does_not_belong_together_is_said() {
    let flights = flights();
    let shard = |number: usize| part(&flights, &plain(), Reduction::Moments, Shard { number, of: 3 });
    let message = |error: ModelError| error.to_string();
    let mut first = shard(1);
    let wrong = message(first.append(shard(3)).unwrap_err());
    assert!(
        wrong.contains("begins with flight 5, expected flight 3 of 7"),
        "{wrong}"
    );
    let wrong = message(shard(2).bank().unwrap_err());
    assert!(wrong.contains("found flights 3 to 4, expected all 7"), "{wrong}");
    let other = part(
        &flights,
        &plain(),
        Reduction::Orthogonal,
        Shard { number: 2, of: 3 },
    );
    assert!(message(first.append(other).unwrap_err()).contains("different options"));
    let too_many = PartialFit::new(&plain(), Reduction::Moments, 2, Shard { number: 3, of: 3 });
    assert!(message(too_many.unwrap_err()).contains("3/3 of 2 flights"));
    let mut twice = PartialFit::new(&plain(), Reduction::Moments, 2, Shard::WHOLE).unwrap();
    let error = twice.add(&[flights[0].clone(), flights[0].clone()]).unwrap_err();
    assert!(matches!(error, ModelError::DuplicateFlight { .. }));
}

#[test]
fn a_number_that_is_none_is_named_by_row_and_field() {
    let mut bad = named(flight("bad", ES, 100, 1, 1e-3));
    bad.0.samples[17].command[1] = f64::NAN;
    let mut part = PartialFit::new(&plain(), Reduction::Moments, 1, Shard::WHOLE).unwrap();
    let message = part.add(&[bad]).unwrap_err().to_string();
    assert_eq!(message, "flight bad: cmd_y in row 17 is not a finite number");
}

#[test]
fn a_file_that_was_cut_off_or_changed_is_refused() {
    let flights = flights();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    part(&flights, &plain(), Reduction::Moments, Shard::WHOLE)
        .write(&path)
        .unwrap();
    let contents = std::fs::read_to_string(&path).unwrap();
    let refused = |contents: &str| {
        std::fs::write(&path, contents).unwrap();
        PartialFit::read(&path).unwrap_err().to_string()
    };
    assert!(refused(&contents[..contents.len() / 2]).contains("expected a partial fit, whole"));
    assert!(refused(&contents.replacen("\"fourth\":[", "\"fourth\":[1.0,", 1)).contains("other sums"));
    assert!(
        refused(&contents.replacen("\"schema_version\":2", "\"schema_version\":9", 1)).contains("version 9")
    );
}
