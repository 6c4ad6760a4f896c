//! The physical family on the flights of the independent reference vehicle.

#![allow(clippy::print_stdout, clippy::print_stderr)] // tables for people, and why a test was skipped

mod common;

use common::reference_flights;
use flyvine::flight::Flight;
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::{
    Bank, CheckReport, Family, FamilyOptions, FitOptions, WindowKind, check, fit_families, fit_physical_bank,
};

const CORNERS: [&str; 4] = ["ES", "IS", "EL", "IL"];

/// (median, p95, diverged share) of a flight at a horizon, cm.
fn error_cm(report: &CheckReport, flight: &str, horizon_s: f64) -> (f64, f64, f64) {
    let found = report
        .flights
        .iter()
        .find(|checked| checked.path.contains(flight))
        .unwrap();
    let error = found
        .rollout
        .iter()
        .find(|error| error.horizon_s == horizon_s)
        .unwrap();
    (
        100.0 * error.median_m.unwrap(),
        100.0 * error.p95_m.unwrap(),
        error.diverged_share,
    )
}

#[test]
fn three_flights_of_one_corner_predict_a_fourth() {
    let train = |name: &str| {
        ["ES_train1", "ES_train4", "ES_train6"]
            .iter()
            .any(|wanted| name.starts_with(wanted))
    };
    let Some(train_flights) = reference_flights(train) else {
        return;
    };
    let (bank, report) =
        fit_physical_bank(&train_flights, &PhysicalFitOptions::default(), &mut |_, _| {}).unwrap();
    let test = reference_flights(|name| name.starts_with("ES_test1")).unwrap();
    let checked = check(&bank, &test).unwrap();
    for horizon_s in [2.5, 10.0] {
        let (median, p95, diverged) = error_cm(&checked, "ES_test1", horizon_s);
        assert!(
            median <= 1.5 && p95 <= 4.0 && diverged == 0.0,
            "{median} {p95} {diverged} at {horizon_s} s"
        );
    }
    let corner = &report.corners[0];
    assert!(!corner.timing.streams_apart());
    for timing in &corner.timing.flights {
        assert!(!timing.notable(), "{timing}");
    }
    let named = |name: &str| {
        corner
            .parameters
            .iter()
            .find(|parameter| parameter.name == name)
            .unwrap()
    };
    assert!(named("position_gain_xy").identified);
    // No flight came near these limits.
    assert!(!named("thrust_maximum").identified && !named("tilt_limit").identified);
}

/// The bars of the family on every corner; minutes. `cargo test --release --test physical -- --ignored --nocapture`
#[test]
#[ignore = "minutes"]
fn every_corner_meets_its_bar_from_six_flights_and_from_two() {
    let judge =
        |name: &str| name.contains("_test1") || name.starts_with("mid_") || name.starts_with("growing_1");
    let Some(test) = reference_flights(judge) else {
        return;
    };
    for (fitted, bar_cm) in [("_train", 1.5), ("_author", 1.8)] {
        let members = reference_flights(|name| name.contains(fitted)).unwrap();
        let bank = bank_of(&members, Family::Physical);
        let checked = check(&bank, &test).unwrap();
        let mut worst_corner = [0.0_f64; 2];
        for corner in CORNERS {
            for (slot, horizon_s) in [2.5, 10.0].into_iter().enumerate() {
                let (median, p95, diverged) = error_cm(&checked, &format!("{corner}_test1"), horizon_s);
                println!("{fitted} {corner} at {horizon_s} s: median {median:.2} p95 {p95:.2} cm");
                let bar = if corner == "IS" && fitted == "_train" {
                    1.7
                } else {
                    bar_cm
                };
                assert!(median <= bar && p95 <= 4.0 && diverged == 0.0);
                worst_corner[slot] = worst_corner[slot].max(median);
            }
        }
        for flight in ["mid_L0.775", "mid_L0.8_", "mid_L0.925", "growing_1"] {
            for (slot, horizon_s) in [2.5, 10.0].into_iter().enumerate() {
                let (median, _, diverged) = error_cm(&checked, flight, horizon_s);
                println!(
                    "{fitted} {flight} at {horizon_s} s: median {median:.2} cm, worst corner {:.2} cm",
                    worst_corner[slot]
                );
                assert!(median <= 1.3 * bar_cm && diverged == 0.0);
            }
        }
    }
}

/// Coverage of the bands of confidence of both families on flights that neither fit nor band has seen; minutes.
#[test]
#[ignore = "minutes"]
fn bands_of_confidence_cover_what_they_promise() {
    let judge =
        |name: &str| name.contains("_test1") || name.starts_with("mid_") || name.starts_with("growing_1");
    let Some(test) = reference_flights(judge) else {
        return;
    };
    let members = reference_flights(|name| name.contains("_train")).unwrap();
    for family in [Family::Lag, Family::Physical] {
        let checked = check(&bank_of(&members, family), &test).unwrap();
        for pooled in &checked.pooled {
            let within = pooled.error.within_band.unwrap();
            println!(
                "{family}, {:?} at {} s: {:.1} % of {} windows",
                pooled.kind,
                pooled.error.horizon_s,
                100.0 * within,
                pooled.error.windows
            );
            assert!(pooled.kind != WindowKind::All || (0.90..=0.99).contains(&within));
        }
    }
}

fn bank_of(flights: &[Flight], family: Family) -> Bank {
    let options = FamilyOptions {
        families: vec![family],
        lag: FitOptions::default(),
        physical: PhysicalFitOptions::default(),
    };
    fit_families(flights, &options, &mut |_| {}).unwrap().0
}
