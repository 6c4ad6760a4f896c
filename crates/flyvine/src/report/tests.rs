//! The figures and the page, from results small enough to count by hand.

use super::*;
use crate::DT;
use crate::flight::{Configuration, Flight, Pose, Sample, StepReport, StepStatus, SurroundingsReport};

const SHORT: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

/// A point of a lemniscate at height `z`.
fn lemniscate(t: f64, z: f64) -> [f64; 3] {
    let phase = std::f64::consts::TAU * t / 5.0;
    [phase.sin(), phase.sin() * phase.cos(), z]
}

/// An experiment of `rows` rows whose end effector is 3 cm above its reference and was missed in row 4.
fn experiment(kind: ExperimentKind, label: &str, period_s: Option<f64>, rows: usize) -> Experiment {
    let reference: Vec<[f64; 3]> = (0..rows).map(|k| lemniscate(k as f64 * DT, 0.8)).collect();
    let samples = reference
        .iter()
        .enumerate()
        .map(|(k, &[x, y, z])| Sample {
            t_s: k as f64 * DT,
            configuration: SHORT,
            command: [x, y, 1.5],
            command_velocity: None,
            quadrotor: Some(Pose {
                position: [x, y, 1.5],
                attitude: [1.0, 0.0, 0.0, 0.0],
            }),
            end_effector: (k != 4).then_some([x, y, z + 0.03]),
        })
        .collect();
    let name = format!("{kind:?} {period_s:?} {label}");
    let flight = Flight {
        name: name.clone(),
        samples,
    };
    let swing = (kind == ExperimentKind::Swing).then_some(SwingTask {
        target: SwingTarget {
            knot: 25,
            position: [1.5, if label.ends_with('S') { 1.0 } else { 0.75 }],
        },
        quadrotor_x_max: Some(1.02),
        quadrotor_z_max: Some(1.53),
    });
    let score = score(&flight, &reference, &reference, swing.map(|s| s.target)).unwrap();
    Experiment {
        name,
        kind,
        label: label.into(),
        period_s,
        predicted_quadrotor: reference.clone(),
        predicted_end_effector: reference.clone(),
        reference,
        flight,
        arm: Vec::new(),
        swing,
        score: Some(score),
        remark: None,
        solver: SolverSummary {
            status: "converged".into(),
            converged: true,
            iterations: 12,
            cost: 3.5,
            max_violation: 1e-8,
        },
        last_step: None,
    }
}

/// The paper's 13 experiments, two checked flights and a training flight.
fn results() -> Results {
    let mut experiments = Vec::new();
    for label in ["ES", "IS", "EL", "IL"] {
        experiments.push(experiment(ExperimentKind::Lemniscate, label, Some(10.0), 60));
        experiments.push(experiment(ExperimentKind::Lemniscate, label, Some(5.0), 40));
        experiments.push(experiment(ExperimentKind::Swing, label, None, 50));
    }
    experiments.push(experiment(ExperimentKind::Deploy, "ES → IL", Some(5.0), 80));
    let rollout = |label: &str| FlightRollout {
        path: format!("{label}_test.csv"),
        label: label.into(),
        configuration: SHORT,
        rollout: [0.5, 1.0, 2.5]
            .map(|horizon_s| HorizonError {
                horizon_s,
                windows: 9,
                median_m: Some(0.02 * horizon_s),
                p95_m: (horizon_s < 2.0).then_some(0.05 * horizon_s),
                diverged_share: 0.125,
            })
            .to_vec(),
    };
    Results {
        summary: RunSummary {
            title: "Thirteen flights".into(),
            seed: Some(7),
            ..RunSummary::default()
        },
        training: vec![experiments[0].flight.clone()],
        experiments,
        rollouts: vec![rollout("ES"), rollout("IL")],
        models: vec![ModelDiagnostics {
            label: "ES".into(),
            configuration: SHORT,
            spectral_radius: 0.98,
            condition_number: 1e6,
        }],
        findings: vec![Finding {
            flight: "ES_train".into(),
            what: "frozen".into(),
        }],
    }
}

/// Names of all series of a figure, after parsing it as XML.
fn series(figure: &Figure) -> Vec<String> {
    let document = roxmltree::Document::parse(&figure.svg).unwrap();
    document
        .descendants()
        .filter(|node| node.attribute("class") == Some("series"))
        .map(|node| node.attribute("data-series").unwrap().to_owned())
        .collect()
}

#[test]
fn figures_show_every_flight_with_the_papers_curve_behind_it() {
    let figures = figures(&results());
    let names: Vec<&str> = figures.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names[..3], ["errors", "lemniscates", "swings"]);
    assert_eq!(names[4..], ["pretzel", "rollouts"]);
    let count = |figure: usize, matches: &dyn Fn(&str) -> bool| {
        series(&figures[figure])
            .iter()
            .filter(|name| matches(name))
            .count()
    };
    let paper = |name: &str| name.ends_with(", paper");
    let limit = |name: &str| name == "limit";
    let reference = |name: &str| name == "reference";
    // Two panels of each of two periods hold four configurations; the reference stands in the lower panels.
    assert_eq!(
        (count(1, &paper), count(1, &reference), series(&figures[1]).len()),
        (16, 2, 34)
    );
    // Paths of two bodies and three time series; limits: x once and z twice among the paths, x over time once.
    assert_eq!(
        (count(2, &paper), count(2, &limit), series(&figures[2]).len()),
        (8 + 12, 4, 44)
    );
    // Three axes of two bodies and one reference.
    assert_eq!(
        (count(3, &paper), count(3, &reference), series(&figures[3]).len()),
        (6, 3, 15)
    );
    assert_eq!((count(4, &paper), series(&figures[4]).len()), (3, 6));
    assert_eq!(
        series(&figures[5]),
        ["ES_test.csv (ES)", "IL_test.csv (IL)"].repeat(2)
    );
}

#[test]
fn a_row_that_was_missed_interrupts_the_end_effectors_line_alone() {
    let figures = figures(&results());
    let document = roxmltree::Document::parse(&figures[3].svg).unwrap();
    let strokes = |series: &str| -> Vec<usize> {
        let drawn = document
            .descendants()
            .filter(|n| n.attribute("data-series") == Some(series));
        drawn
            .map(|n| n.attribute("d").unwrap().matches('M').count())
            .collect()
    };
    assert_eq!(strokes("end effector"), [2, 2, 2]);
    assert_eq!(strokes("quadrotor"), [1, 1, 1]);
}

#[test]
fn short_swings_are_drawn_lower_so_that_the_targets_coincide() {
    let figures = figures(&results());
    let document = roxmltree::Document::parse(&figures[2].svg).unwrap();
    // One common target among the paths and one over time.
    assert_eq!(
        document
            .descendants()
            .filter(|n| n.tag_name().name() == "circle")
            .count(),
        2
    );
    assert!(
        figures[2].caption.contains("ES by 0.25 m, IS by 0.25 m"),
        "{}",
        figures[2].caption
    );
}

#[test]
fn what_a_controller_found_in_flight_is_shown_and_nothing_of_others() {
    let mut results = results();
    assert!(!html(&results).unwrap().contains("Found in flight"));
    results.experiments[0].last_step = Some(StepReport {
        status: StepStatus::Optimal,
        changes: 0,
        active: 0,
        residual: 0.0,
        delay_knots: 0.25,
        delay_deviation_knots: 0.125,
        inconsistency: 1.0,
        surroundings: SurroundingsReport {
            wind_m_s: [1.5, -0.5],
            wind_deviation_m_s: [0.25, 0.5],
            tip_load: 0.375,
            ..SurroundingsReport::default()
        },
    });
    let page = html(&results).unwrap();
    for shown in ["1.50 ± 0.25", "-0.50 ± 0.50", "0.25 ± 0.12"] {
        assert!(page.contains(shown), "{shown}");
    }
    assert!(
        !page.contains("37.50"),
        "a load without a deviation was not estimated"
    );
}

#[test]
fn other_periods_and_labels_stand_without_the_papers_curves() {
    let mut results = results();
    results.experiments = vec![experiment(ExperimentKind::Lemniscate, "0.85 m", Some(7.5), 30)];
    let figures = figures(&results);
    assert_eq!(series(&figures[1]), ["0.85 m", "reference", "0.85 m"]);
    assert_eq!(paper::published_error(&results.experiments[0]), None);
}

#[test]
fn experiments_are_read_by_task_slow_first_in_the_papers_order_of_corners() {
    let results = results();
    let order: Vec<String> = results
        .experiments_in_order()
        .into_iter()
        .map(Experiment::title)
        .collect();
    assert_eq!(
        order[..2],
        ["Lemniscate, period 10 s, ES", "Lemniscate, period 10 s, IS"]
    );
    assert_eq!(order[4], "Lemniscate, period 5 s, ES");
    assert_eq!(
        order[8..],
        [
            "Swing, ES",
            "Swing, IS",
            "Swing, EL",
            "Swing, IL",
            "Deployment, period 5 s, ES → IL"
        ]
    );
}

#[test]
fn the_same_results_make_the_same_page() {
    assert_eq!(html(&results()).unwrap(), html(&results()).unwrap());
}

#[test]
fn the_page_needs_nothing_else() {
    let page = html(&results()).unwrap();
    for attribute in ["src=\"", "href=\""] {
        let markup = page.split("<script>").next().unwrap();
        for link in markup.split(attribute).skip(1) {
            assert!(
                link.starts_with("data:") || link.starts_with('#'),
                "{}",
                &link[..40]
            );
        }
    }
    assert!(!page.contains("@import") && !page.contains("url(http") && !page.contains("import("));
    assert!(page.contains("default-src 'none'"));
    // Data, three.js, and the module of models, scene and player; nothing inside them ends a script early or opens a
    // comment in one.
    assert_eq!(page.matches("<script").count(), 3);
    assert_eq!(page.matches("</script").count(), 3);
    assert!(!page.contains("<!--"));
    for tag in ["section", "table", "svg", "figure", "div", "dl"] {
        let opened = page.matches(&format!("<{tag} ")).count() + page.matches(&format!("<{tag}>")).count();
        assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
    }
    for shown in [
        "Thirteen flights",
        "Lemniscate, period 10 s, IS",
        "12.5 % diverged",
        "ES_train",
        "converged",
    ] {
        assert!(page.contains(shown), "{shown}");
    }
}

#[test]
fn markup_in_names_stays_text() {
    let attack = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'{{style}}";
    let mut results = results();
    results.summary.title = attack.into();
    results.summary.notes.push(attack.into());
    results.findings[0].what = attack.into();
    results.rollouts[0].path = attack.into();
    for experiment in &mut results.experiments {
        experiment.name = attack.into();
        experiment.label = attack.into();
        experiment.remark = Some(attack.into());
        experiment.solver.status = attack.into();
    }
    results.training[0].name = attack.into();
    let page = html(&results).unwrap();
    assert_eq!(page.matches("<script").count(), 3);
    assert!(!page.contains("<img") && !page.contains("alert(1)</script"));
    assert!(page.contains("{{style}}"), "braces in a value are text");
    for figure in figures(&results) {
        roxmltree::Document::parse(&figure.svg).unwrap();
        assert!(
            figure
                .name
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || "-_".contains(c)),
            "{}",
            figure.name
        );
    }
}

#[test]
fn the_replay_holds_tenths_of_millimetres_and_gaps() {
    let mut results = results();
    let rows = results.experiments[0].flight.samples.len();
    results.experiments[0].arm = vec![vec![[0.0, 0.0, 1.5], [0.1, 0.0, 1.1], [0.12345, 0.0, 0.8]]; rows];
    let page = html(&results).unwrap();
    let (_, after) = page.split_once("id=\"replay-data\">").unwrap();
    let data: serde_json::Value = serde_json::from_str(after.split_once("</script>").unwrap().0).unwrap();
    assert_eq!(data["experiments"].as_array().unwrap().len(), 13);
    let first = &data["experiments"][0];
    let tip = first["tip"].as_array().unwrap();
    assert_eq!(tip.len(), 3 * rows);
    assert_eq!(tip[..3], [0.into(), 0.into(), serde_json::json!(8300)]);
    assert!(
        tip[12..15].iter().all(serde_json::Value::is_null),
        "row 4 was missed"
    );
    assert_eq!(
        first["arm"][0],
        serde_json::json!([0, 0, 15000, 1000, 0, 11000, 1235, 0, 8000])
    );
    assert_eq!(first["configurations"], serde_json::json!([[0.7, 0.0]]));
    assert!(first.get("target").is_none());
    let swing = &data["experiments"][8];
    assert_eq!(
        (&swing["target"], &swing["targetKnot"]),
        (&serde_json::json!([1.5, 1.0]), &serde_json::json!(25))
    );
}

#[test]
fn an_aborted_flight_is_shown_without_a_score() {
    let mut results = results();
    results.experiments[0].flight.samples.truncate(10);
    results.experiments[0].score = None;
    results.experiments[0].remark = Some("aborted at 0.45 s: pose older than 400 ms".into());
    let page = html(&results).unwrap();
    assert!(page.contains("not scored") && page.contains("pose older than 400 ms"));
}

#[test]
fn nothing_run_is_still_a_page() {
    let empty = Results {
        summary: RunSummary::default(),
        ..Results::default()
    };
    let page = html(&empty).unwrap();
    assert!(page.contains("Flight report") && !page.contains("<script"));
    assert!(figures(&empty).is_empty());
}

#[test]
fn lists_that_do_not_belong_together_are_named() {
    let broken = |change: &dyn Fn(&mut Experiment)| {
        let mut results = results();
        change(&mut results.experiments[0]);
        html(&results).unwrap_err()
    };
    let error = broken(&|e| e.predicted_end_effector.truncate(5));
    assert!(
        matches!(
            error,
            ReportError::KnotCount {
                found: 5,
                knots: 60,
                ..
            }
        ),
        "{error}"
    );
    let error = broken(&|e| e.flight.samples.clear());
    assert!(matches!(error, ReportError::EmptyFlight { .. }), "{error}");
    let error = broken(&|e| {
        let last = e.flight.samples[59];
        e.flight.samples.push(last);
    });
    assert!(
        matches!(
            error,
            ReportError::RowCount {
                rows: 61,
                knots: 60,
                ..
            }
        ),
        "{error}"
    );
    let error = broken(&|e| e.arm = vec![vec![[0.0; 3]; 3]; 59]);
    assert!(
        matches!(
            error,
            ReportError::ArmCount {
                found: 59,
                rows: 60,
                ..
            }
        ),
        "{error}"
    );
    let error = broken(&|e| {
        e.arm = vec![vec![[0.0; 3]; 3]; 60];
        e.arm[7].pop();
    });
    assert!(
        matches!(
            error,
            ReportError::ArmNodes {
                row: 7,
                found: 2,
                expected: 3,
                ..
            }
        ),
        "{error}"
    );
}
