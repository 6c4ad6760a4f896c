use super::innovations::REFUSALS_MAX;
use super::layout::NOT_ESTIMATED;
use super::*;
use crate::flight::{Configuration, Pose};
use crate::model::physical::offset;
use crate::model::physical::{ArmLength, Parameters, PhysicalModel, Surroundings};
use crate::model::{Bank, BankModel, BankProvenance, ModelDiagnostics};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

const CONFIGURATION: Configuration = Configuration {
    length_m: 0.8,
    pressure_kpa: 0.0,
};
const KNOTS: usize = 300;

fn model() -> ScheduledModel {
    let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
    let model = BankModel {
        configuration: CONFIGURATION,
        model: Model::Physical(Box::new(model)),
        diagnostics: ModelDiagnostics::default(),
    };
    let bank = Bank::new(vec![model], BankProvenance::default()).unwrap();
    bank.scheduled(&[CONFIGURATION]).unwrap()
}

fn command(knot: usize) -> [f64; 3] {
    let phase = 0.15 * knot as f64;
    [
        0.8 * phase.sin(),
        0.5 * (0.7 * phase).sin(),
        1.5 + 0.1 * phase.cos(),
    ]
}

/// What the estimator is not told.
#[derive(Clone, Copy)]
struct World {
    delay_knots: usize,
    /// On the tip, m/s per knot.
    push: f64,
    around: Surroundings,
}

impl World {
    fn calm() -> Self {
        Self {
            delay_knots: 0,
            push: 0.0,
            around: Surroundings::calm(),
        }
    }
}

/// Flies the model itself, in that world, and lets the estimator watch.
struct Watched {
    truth: Vec<f64>,
    error: f64,
    refused: u32,
}

fn watch<'a>(
    model: &'a ScheduledModel,
    noise: &NoiseLevels,
    world: World,
    mut tamper: impl FnMut(usize, Observation) -> Observation,
) -> (Estimator<'a>, Watched) {
    let n = model.state_len();
    let mut truth = model.at_knot(0).rest_state(CONFIGURATION);
    // What flies is the model itself: its attitude needs no more process noise than the rest.
    let mut noise = *noise;
    noise.process.attitude = 1.0;
    let mut estimator = Estimator::new(model, &noise, &truth, command(0)).unwrap();
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let normal = Normal::new(0.0, 3e-4).unwrap();
    let mut watched = Watched {
        truth: Vec::new(),
        error: 0.0,
        refused: 0,
    };
    for knot in 0..KNOTS {
        let sent = command(knot);
        let felt = command(knot.saturating_sub(world.delay_knots));
        let mut next = vec![0.0; n];
        model.step_in(knot, &world.around, &truth, &felt, &mut next);
        next[offset::TIP_VELOCITY] += world.push;
        next[offset::JOINTS + 3] += 0.5 * world.push;
        truth = next;
        let mut noisy = |i: usize| truth[i] + normal.sample(&mut random);
        let attitude = [noisy(3), noisy(4), noisy(5)];
        let w = (1.0 - attitude.iter().map(|x| x * x).sum::<f64>()).sqrt();
        let observation = Observation {
            t_s: (knot + 1) as f64 * crate::DT,
            quadrotor: Some(Pose {
                position: [noisy(0), noisy(1), noisy(2)],
                attitude: [w, attitude[0], attitude[1], attitude[2]],
            }),
            end_effector: Some([noisy(6), noisy(7), noisy(8)]),
        };
        estimator.update(&Tick {
            knot: knot + 1,
            observation: tamper(knot, observation),
            held_command: sent,
        });
        watched.refused += estimator.surprise().refused;
        if knot >= KNOTS / 2 {
            let error = (6..9)
                .map(|i| (estimator.state()[i] - truth[i]).powi(2))
                .sum::<f64>();
            watched.error = watched.error.max(error.sqrt());
        }
    }
    watched.truth = truth;
    (estimator, watched)
}

#[test]
fn a_steady_push_and_late_commands_are_found() {
    let model = model();
    for delay_knots in [0, 1, 2] {
        let world = World {
            delay_knots,
            push: 0.02,
            ..World::calm()
        };
        // A push on the tip alone is no wind: without wind and load to choose from, it is found where it is.
        let noise = NoiseLevels {
            surroundings: NOT_ESTIMATED,
            ..NoiseLevels::PHYSICAL
        };
        let (estimator, watched) = watch(&model, &noise, world, |_, seen| seen);
        let (delay, deviation) = estimator.delay_knots();
        assert!(
            (delay - delay_knots as f64).abs() < 0.3,
            "{delay} ± {deviation} knots, in truth {delay_knots}"
        );
        let push = estimator.disturbance()[6] + estimator.gust()[6];
        assert!((push - 0.02).abs() < 5e-3, "{push} m/s per knot on the tip");
        assert!(watched.error < 2e-3, "tip off by {} m", watched.error);
    }
}

#[test]
fn wind_and_load_are_found_and_their_uncertainty_is_honest() {
    let model = model();
    let around = Surroundings {
        wind_m_s: [0.9, -0.5, 0.0],
        tip_load: 0.3,
    };
    let world = World {
        around,
        ..World::calm()
    };
    let (estimator, watched) = watch(&model, &NoiseLevels::PHYSICAL, world, |_, seen| seen);
    let prior = NoiseLevels::PHYSICAL.surroundings;
    let found = estimator.surroundings();
    let (wind, deviations) = (found.wind_m_s, found.wind_deviation_m_s);
    for axis in 0..2 {
        let error = (wind[axis] - around.wind_m_s[axis]).abs();
        let bound = (3.0 * deviations[axis]).min(0.3);
        assert!(error < bound, "{wind:?} ± {deviations:?} m/s");
        assert!(deviations[axis] < 0.7 * prior.wind_m_s, "± {deviations:?} m/s");
    }
    let (load, deviation) = (found.tip_load, found.tip_load_deviation);
    assert!(
        (load - around.tip_load).abs() < 3.0 * deviation,
        "{load} ± {deviation}"
    );
    assert!(deviation < prior.tip_load, "± {deviation}");
    assert!(watched.error < 5e-3, "tip off by {} m", watched.error);
}

#[test]
fn a_model_of_another_vehicle_is_noticed() {
    let model = model();
    let (own, _) = watch(&model, &NoiseLevels::PHYSICAL, World::calm(), |_, seen| seen);
    assert!(own.inconsistency() < 2.0, "{}", own.inconsistency());
    let (other, _) = watch(&model, &NoiseLevels::PHYSICAL, World::calm(), |_, mut seen| {
        // A tip that swings twice as far.
        if let (Some(quadrotor), Some(tip)) = (seen.quadrotor, &mut seen.end_effector) {
            for axis in 0..2 {
                tip[axis] += tip[axis] - quadrotor.position[axis];
            }
        }
        seen
    });
    assert!(other.inconsistency() > 20.0, "{}", other.inconsistency());
}

#[test]
fn the_noise_of_the_pose_before_a_flight_is_not_taken_for_load_and_wind() {
    let model = model();
    let rest = model.at_knot(0).rest_state(CONFIGURATION);
    let command = [rest[0], rest[1], rest[2]];
    let settled = |z: &[f64]| {
        let mut estimator = Estimator::new(&model, &NoiseLevels::PHYSICAL, &rest, command).unwrap();
        let vector = [z[3], z[4], z[5]];
        let scalar = (1.0 - vector.iter().map(|v| v * v).sum::<f64>()).sqrt();
        estimator.settle(&Observation {
            t_s: 0.0,
            quadrotor: Some(Pose {
                position: [z[0], z[1], z[2]],
                attitude: [scalar, vector[0], vector[1], vector[2]],
            }),
            end_effector: Some([z[6], z[7], z[8]]),
        });
        estimator.surroundings()
    };
    let mut noisy = rest.clone();
    noisy[6] += 1e-3;
    noisy[8] -= 1e-3;
    let noisy = settled(&noisy);
    assert_eq!(noisy.tip_load, 0.0);
    assert!(noisy.wind_m_s[0].abs() < 0.15, "{:?}", noisy.wind_m_s);

    // A wind that holds the vehicle askew is far beyond noise.
    let wind = Surroundings {
        wind_m_s: [1.0, 0.0, 0.0],
        ..Surroundings::calm()
    };
    let mut blown = rest.clone();
    for _ in 0..400 {
        let before = blown.clone();
        model.step_in(0, &wind, &before, &command, &mut blown);
    }
    let found = settled(&blown).wind_m_s;
    assert!(
        found[0] > 0.1 && found[0] > 10.0 * noisy.wind_m_s[0].abs(),
        "{found:?}, {:?}",
        noisy.wind_m_s
    );
}

#[test]
fn outliers_are_refused_and_gaps_bridged() {
    let model = model();
    let (clean, undisturbed) = watch(&model, &NoiseLevels::PHYSICAL, World::calm(), |_, seen| seen);
    assert_eq!(undisturbed.refused, 0);
    let (estimator, watched) = watch(&model, &NoiseLevels::PHYSICAL, World::calm(), |knot, mut seen| {
        if knot % 40 == 20 {
            seen.end_effector = seen.end_effector.map(|[x, y, z]| [x + 0.15, y, z]);
        }
        if (165..171).contains(&knot) {
            (seen.quadrotor, seen.end_effector) = (None, None);
        }
        seen
    });
    assert_eq!(
        watched.refused,
        3 * (KNOTS as u32 / 40),
        "each outlier, and nothing else"
    );
    // Six knots without poses: the filter coasts.
    assert!(watched.error < 8e-3, "tip off by {} m", watched.error);
    assert!((estimator.state()[0] - clean.state()[0]).abs() < 1e-3);
    assert_eq!(watched.truth, undisturbed.truth);
}

#[test]
fn a_body_that_really_moved_is_believed_after_a_while() {
    let model = model();
    let (estimator, watched) = watch(&model, &NoiseLevels::PHYSICAL, World::calm(), |knot, mut seen| {
        if knot > 200 {
            seen.end_effector = seen.end_effector.map(|[x, y, z]| [x + 0.3, y, z]);
        }
        seen
    });
    assert!(watched.refused >= 3 * REFUSALS_MAX);
    assert!((estimator.state()[6] - watched.truth[6] - 0.3).abs() < 0.1);
}

/// A marker that slipped is where no arm of the model's can be: the estimate cannot be right, but it stays a sensible one.
#[test]
fn a_body_seen_where_it_cannot_be_throws_nothing_out() {
    let model = model();
    let mut gusty = NoiseLevels::PHYSICAL;
    gusty.surroundings.gust_m_s = 0.7;
    let slips = [(0, 0.3), (1, -1.0), (2, 0.2), (2, -0.2), (2, 0.5), (2, -1.0)];
    for (noise, body) in [
        (NoiseLevels::PHYSICAL, 0),
        (NoiseLevels::PHYSICAL, 1),
        (gusty, 0),
        (gusty, 1),
    ] {
        for (axis, slip) in slips {
            let (estimator, watched) = watch(&model, &noise, World::calm(), |knot, mut seen| {
                if knot > 150 {
                    match (body, &mut seen.quadrotor, &mut seen.end_effector) {
                        (0, Some(quadrotor), _) => quadrotor.position[axis] += slip,
                        (_, _, Some(tip)) => tip[axis] += slip,
                        _ => unreachable!("both are seen"),
                    }
                }
                seen
            });
            let what = format!("body {body} axis {axis}, {slip} m");
            assert!(watched.refused >= 3 * REFUSALS_MAX, "{what}: {}", watched.refused);
            for (entry, value) in estimator.state().iter().enumerate() {
                assert!(
                    value.is_finite() && value.abs() < 100.0,
                    "{what}: entry {entry} is {value}"
                );
            }
        }
    }
}

#[test]
fn what_cannot_be_estimated_is_named() {
    let model = model();
    let start = model.at_knot(0).rest_state(CONFIGURATION);
    let refused = |noise: &NoiseLevels, start: &[f64]| {
        Estimator::new(&model, noise, start, [0.0; 3])
            .unwrap_err()
            .to_string()
    };
    assert!(refused(&NoiseLevels::PHYSICAL, &start[1..]).contains("42 entries; expected the model's 43"));
    let mut noise = NoiseLevels::PHYSICAL;
    noise.process.attitude = f64::NAN;
    assert!(refused(&noise, &start).contains("process: found NaN, expected a positive number"));
    let mut noise = NoiseLevels::PHYSICAL;
    noise.surroundings.tip_load = -0.1;
    assert!(refused(&noise, &start).contains("surroundings.tip_load: found -0.1, expected a number ≥ 0"));
}
