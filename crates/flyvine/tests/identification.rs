//! Lag models on recordings: the independent reference vehicle, and real Crazyflies with a slung load.

#![allow(clippy::print_stdout, clippy::print_stderr)] // tables for people, and why a test was skipped

mod common;

use common::{flights, reference_flights, shared_data};
use flyvine::flight::{Flight, Mapping};
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{
    CheckReport, Family, FamilyOptions, Finding, FitOptions, LagModel, Positions, Refinement, Ridge,
    Structure, check, fit_bank, fit_families, fit_physical_bank, spectral_radius,
};
use flyvine::trajopt::Dynamics;
use std::path::Path;

/// Median error, m, and share diverged of `flight` at `horizon_s`.
fn rollout(report: &CheckReport, flight: &str, horizon_s: f64) -> (f64, f64) {
    let found = report
        .flights
        .iter()
        .find(|checked| checked.path.contains(flight))
        .unwrap();
    let error = found
        .rollout
        .iter()
        .find(|error| (error.horizon_s - horizon_s).abs() < 1e-9)
        .unwrap();
    (error.median_m.unwrap(), error.diverged_share)
}

/// The paper's least squares on the same data, cm: 2.5 s and 10 s (data/README.md of the shared data).
const PAPER_CM: [(&str, f64, f64); 4] = [
    ("ES", 2.4, 3.9),
    ("IS", 2.8, 4.8),
    ("EL", 2.1, 3.0),
    ("IL", 2.7, 4.1),
];

#[test]
fn defaults_roll_out_as_well_as_plain_least_squares_and_never_diverge() {
    let Some(train) = reference_flights(|name| name.contains("_train")) else {
        return;
    };
    let test = reference_flights(|name| name.contains("_test1") || name.starts_with("mid_")).unwrap();
    let (bank, report) = fit_bank(&train, &FitOptions::default()).unwrap();
    let checked = check(&bank, &test).unwrap();
    for (corner, paper_2_5_s, paper_10_s) in PAPER_CM {
        for (horizon_s, paper_cm) in [(2.5, paper_2_5_s), (10.0, paper_10_s)] {
            let (median_m, diverged) = rollout(&checked, &format!("{corner}_test1"), horizon_s);
            let median_cm = 100.0 * median_m;
            assert!(
                median_cm <= 1.1 * paper_cm,
                "{corner} at {horizon_s} s: {median_cm:.2} cm"
            );
            assert_eq!(diverged, 0.0, "{corner} at {horizon_s} s");
        }
    }
    assert!(checked.models.iter().all(|model| model.spectral_radius < 1.0));
    // The four fits of held-out flights diverge with plain least squares, which is noticed.
    assert!(
        matches!(report.findings[..], [Finding::PlainLeastSquaresUnusable { .. }]),
        "{:?}",
        report.findings
    );
    assert!(report.chosen.height_ridge > Some(0.0));
}

#[test]
fn the_papers_structure_plain_is_the_papers_result() {
    let Some(train) = reference_flights(|name| name.starts_with("ES_train")) else {
        return;
    };
    let test = reference_flights(|name| name.starts_with("ES_test1")).unwrap();
    let plain = FitOptions {
        height_ridge: Ridge::Value(0.0),
        linear_ridge: Ridge::Value(0.0),
        positions: Some(Positions::Absolute),
        refinement: Refinement::Off,
        ..FitOptions::default()
    };
    let (bank, _) = fit_bank(&train, &plain).unwrap();
    let checked = check(&bank, &test).unwrap();
    // An independent least squares (numpy.linalg.lstsq on raw columns) gives 2.44 and 3.90 cm.
    assert!((rollout(&checked, "ES", 2.5).0 - 0.0244).abs() < 1e-3);
    assert!((rollout(&checked, "ES", 10.0).0 - 0.0390).abs() < 1e-3);
    let linear = FitOptions {
        structure: Structure::Linear,
        ..plain
    };
    let (bank, _) = fit_bank(&train, &linear).unwrap();
    let checked = check(&bank, &test).unwrap();
    assert!((rollout(&checked, "ES", 2.5).0 - 0.0342).abs() < 1e-3);
}

/// Positions in the room against relative ones, and what held-out rollouts choose; minutes.
/// `cargo test --release --test identification -- --ignored --nocapture`
#[test]
#[ignore = "minutes"]
fn relative_positions_beside_absolute_ones() {
    let judge = |name: &str| name.contains("_test1") || name.starts_with("mid_");
    let Some(test) = reference_flights(judge) else {
        return;
    };
    for fitted in ["_train", "_author"] {
        let members = reference_flights(|name| name.contains(fitted)).unwrap();
        for positions in [Some(Positions::Absolute), Some(Positions::Relative), None] {
            let options = FitOptions {
                positions,
                ..FitOptions::default()
            };
            let (bank, report) = fit_bank(&members, &options).unwrap();
            let checked = check(&bank, &test).unwrap();
            let chosen = report.chosen;
            println!(
                "{fitted}: asked for {positions:?}, chosen {:?}, refined {}, held out {:.2} cm",
                chosen.positions,
                chosen.refined,
                100.0 * chosen.score_m()
            );
            for flight in &checked.flights {
                for horizon_s in [2.5, 10.0] {
                    let (median_m, diverged) = rollout(&checked, &flight.path, horizon_s);
                    println!(
                        "  {} at {horizon_s} s: {:.2} cm, diverged {diverged:.2}",
                        flight.path,
                        100.0 * median_m
                    );
                    assert!(positions.is_some() || diverged == 0.0);
                }
            }
        }
    }
}

/// Crazyflie flights with a slung load whose file names match.
fn slung_loads(matches: impl Fn(&str) -> bool) -> Option<Vec<Flight>> {
    let folder = shared_data("slung_load")?.join("slung_load/cf_slung_single");
    let mappings = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/mappings");
    let mapping = Mapping::read(&mappings.join("crazyflie_slung.toml")).unwrap();
    Some(flights(
        &folder,
        |name| name.ends_with(".csv") && matches(name),
        |path| mapping.read_flight(path).unwrap(),
    ))
}

#[test]
fn a_family_that_does_not_follow_its_own_flights_gives_way() {
    let wanted = ["log184.csv", "log203.csv", "log204.csv"];
    let Some(mut all) = slung_loads(|name| wanted.contains(&name)) else {
        return;
    };
    // Too few rows to try the lag family with a flight held out; and the physical family does not follow vehicles that
    // are fed velocities of which it never hears.
    for sample in all.iter_mut().flat_map(|flight| &mut flight.samples) {
        sample.command_velocity = None;
    }
    let options = FamilyOptions {
        families: vec![Family::Lag, Family::Physical],
        lag: FitOptions::default(),
        physical: PhysicalFitOptions::default(),
    };
    let (bank, report) = fit_families(&all, &options, &mut |_| {}).unwrap();
    assert_eq!(report.diverging, [Family::Physical]);
    assert_eq!(report.chosen.family(), Family::Lag);
    for flight in &check(&bank, &all).unwrap().flights {
        assert!(flight.rollout[2].diverged_share == 0.0, "{flight:?}");
    }
}

fn all_but(flights: &[Flight], left_out: usize) -> Vec<Flight> {
    let mut kept = flights.to_vec();
    kept.remove(left_out);
    kept
}

#[test]
fn a_slung_load_that_is_sent_velocities_is_predicted_by_physics() {
    let Some(all) = slung_loads(|name| name != "log206.csv") else {
        return;
    };
    let mut medians = Vec::new();
    for left_out in 0..all.len() {
        let train = all_but(&all, left_out);
        let (bank, _) = fit_physical_bank(&train, &PhysicalFitOptions::default(), &mut |_, _| {}).unwrap();
        let checked = check(&bank, &all[left_out..=left_out]).unwrap();
        let (median_m, _) = rollout(&checked, "log", 2.5);
        eprintln!("{}: {:.1} cm by physics", all[left_out].name, 100.0 * median_m);
        medians.push(median_m);
    }
    medians.sort_by(f64::total_cmp);
    // 1.4, 1.6, 1.9 and 4.6 cm (log182, another vehicle); log203, the fastest of all, is beyond what the others show: 8.5 cm.
    assert!(medians[2] <= 0.03 && medians[4] <= 0.1, "{medians:?}");
}

#[test]
fn a_slung_load_needs_more_than_plain_least_squares_and_gets_it() {
    // log206 spins on the spot and is another thing.
    let Some(all) = slung_loads(|name| name != "log206.csv") else {
        return;
    };
    assert_eq!(all.len(), 5);
    let mut medians = Vec::new();
    for left_out in 0..all.len() {
        let train = all_but(&all, left_out);
        let (bank, report) = fit_bank(&train, &FitOptions::default()).unwrap();
        assert!(
            matches!(report.findings[0], Finding::PlainLeastSquaresUnusable { .. }),
            "{:?}",
            report.findings
        );
        let checked = check(&bank, &all[left_out..=left_out]).unwrap();
        let (median_m, _) = rollout(&checked, "log", 2.5);
        eprintln!(
            "{}: {:.1} cm with {:?}",
            all[left_out].name,
            100.0 * median_m,
            report.chosen
        );
        medians.push(median_m);
    }
    medians.sort_by(f64::total_cmp);
    // Plain least squares: 217 cm at 2 s; nothing moves: 66 cm.
    assert!(medians[2] <= 0.07, "{medians:?}");
}

#[test]
fn the_first_authors_five_lag_models_are_read_and_rolled_out() {
    let Some(folder) = shared_data("author").map(|data| data.join("author")) else {
        return;
    };
    // Tip minus quadrotor height where the command rests at 1.5 m, m: (I − A)⁻¹ B u by numpy.linalg.solve.
    let rest_offsets = [-0.783130, -1.024865, -0.940861, -0.854646, -0.676909];
    for (file, rest_offset) in (1..).zip(rest_offsets) {
        let model = LagModel::read_matrix(&folder.join(format!("AB{file}.csv"))).unwrap();
        assert_eq!((model.lags(), model.state_len()), (5, 45));
        let command = [0.0, 0.0, 1.5];
        let radius = spectral_radius(&model, &[0.0; 45], &command).unwrap();
        assert!((0.9865..0.9905).contains(&radius), "AB{file}: {radius}");
        let mut state = vec![0.0; 45];
        let mut fresh = [0.0; 9];
        for step in 0..2000 {
            model.step(step, &state, &command, &mut fresh);
            state.copy_within(..36, 9);
            state[..9].copy_from_slice(&fresh);
        }
        assert!(
            (fresh[8] - fresh[2] - rest_offset).abs() < 1e-5,
            "AB{file}: {}",
            fresh[8] - fresh[2]
        );
    }
}
