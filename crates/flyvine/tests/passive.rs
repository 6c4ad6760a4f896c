//! The arm alone, clamped at its base, against an independent simulation (MuJoCo at 1e-5 s); see
//! `data/passive/README.md`.

#[path = "common/passive_arm.rs"]
mod passive_arm;

use flyvine::sim::chain::{Chain, Load};
use flyvine::sim::hysteresis::ElastoSlip;
use flyvine::sim::integrator::{LinearlyImplicit, RungeKutta4};
use flyvine::sim::state::ChainState;
use nalgebra::{UnitQuaternion, Vector3};
use passive_arm::{PassiveArm, bent};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Parameters {
    gravity: f64,
    n_links: usize,
    configs: BTreeMap<String, Configuration>,
}

#[derive(Deserialize)]
struct Configuration {
    #[serde(flatten)]
    arm: PassiveArm,
    initial_ball_quaternions_wxyz: BTreeMap<String, Vec<f64>>,
}

impl Configuration {
    fn start(&self, case: &str) -> ChainState {
        bent(&self.initial_ball_quaternions_wxyz[case])
    }
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/passive")
}

fn parameters() -> Parameters {
    let text = std::fs::read_to_string(folder().join("passive_params.json")).expect("bundled parameters");
    serde_json::from_str(&text).expect("bundled parameters are JSON")
}

/// Tip positions every 10 ms for `duration_s`.
fn swing(chain: &Chain, state: &mut ChainState, step: f64, duration_s: f64) -> Vec<Vector3<f64>> {
    let mut integrator = LinearlyImplicit::new(chain.links.len());
    let every = (0.01 / step).round() as usize;
    let mut tips = vec![chain.end_effector(state)];
    for k in 1..=(duration_s / step).round() as usize {
        integrator.step(chain, state, &[Load::default(); 2], step);
        if k % every == 0 {
            tips.push(chain.end_effector(state));
        }
    }
    tips
}

fn reference(name: &str) -> Vec<Vector3<f64>> {
    let mut reader = csv::Reader::from_path(folder().join(format!("{name}.csv"))).expect("bundled file");
    reader
        .deserialize::<[f64; 4]>()
        .map(|row| row.expect("four numbers"))
        .map(|[_, x, y, z]| Vector3::new(x, y, z))
        .collect()
}

fn rms(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    assert_eq!(a.len(), b.len());
    (a.iter().zip(b).map(|(a, b)| (a - b).norm_squared()).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn tip_follows_the_reference_swings() {
    let parameters = parameters();
    let default_step = flyvine::sim::VehicleParameters::default().simulation.max_step_s;
    for (name, configuration) in &parameters.configs {
        let chain = configuration.arm.chain(parameters.n_links, parameters.gravity);
        for case in ["tilt30", "bent"] {
            let mut state = configuration.start(case);
            let tips = swing(&chain, &mut state, default_step, 5.0);
            let error = rms(&tips, &reference(&format!("{name}_{case}")));
            // The bar of the project is 1 mm; this integrator is far inside it.
            assert!(
                error < 1e-4,
                "{name} {case}: tip off by {:.4} mm RMS",
                1e3 * error
            );
        }
    }
}

/// Second order: halving the step divides the distance to the converged swing by four.
#[test]
fn error_falls_with_the_square_of_the_step() {
    let parameters = parameters();
    for (name, configuration) in &parameters.configs {
        let chain = configuration.arm.chain(parameters.n_links, parameters.gravity);
        let tips = |step| swing(&chain, &mut configuration.start("tilt60"), step, 2.0);
        let converged = tips(1e-4);
        let (coarse, fine) = (rms(&tips(2e-3), &converged), rms(&tips(1e-3), &converged));
        let order = (coarse / fine).log2();
        assert!(
            order > 1.7,
            "{name}: order {order:.2} ({coarse:.2e} m, {fine:.2e} m)"
        );
    }
}

/// Undamped, by the explicit integrator ([`RungeKutta4`]) at a step that resolves the fastest mode of the light links: the
/// total energy stays within 1e-4 of the greatest kinetic energy for 10 s, in every configuration.
#[test]
fn energy_is_kept_without_damping() {
    let parameters = parameters();
    for (name, case) in [
        ("ES", "bent"),
        ("IS", "tilt30"),
        ("EL", "tilt30"),
        ("IL", "tilt60"),
    ] {
        let configuration = &parameters.configs[name];
        let mut chain = configuration.arm.chain(parameters.n_links, parameters.gravity);
        chain.joints.iter_mut().for_each(|joint| joint.damping = 0.0);
        let mut state = configuration.start(case);
        let start = total(&chain, &state);
        let (mut drift, mut greatest) = (0.0_f64, 0.0_f64);
        let mut integrator = RungeKutta4::new(chain.links.len());
        for k in 0..160_000 {
            integrator.step(&chain, &mut state, &Load::default(), 6.25e-5);
            if k % 10 == 0 {
                drift = drift.max((total(&chain, &state) - start).abs());
                greatest = greatest.max(chain.energy(&state).0);
            }
        }
        assert!(
            drift < 1e-4 * greatest,
            "{name} {case}: energy drifts by {:.1e}",
            drift / greatest
        );
    }
}

/// Kinetic, gravitational and elastic energy, J.
fn total(chain: &Chain, state: &ChainState) -> f64 {
    let (kinetic, potential) = chain.energy(state);
    kinetic + potential
}

/// Arms that no file holds: other numbers of links, tapered masses and stiffness, wrinkling and slipping joints, a start
/// in three dimensions. The vehicle's integrator at its default step against the explicit one at a converged step.
#[test]
fn other_arms_follow_the_explicit_integrator() {
    let parameters = parameters();
    let default_step = flyvine::sim::VehicleParameters::default().simulation.max_step_s;
    for (links, name, collapse, slip) in [
        (1, "IS", f64::INFINITY, None),
        (3, "EL", 0.05, None),
        (5, "ES", f64::INFINITY, Some(0.005)),
        (8, "IL", 0.1, Some(0.01)),
    ] {
        let configuration = &parameters.configs[name];
        let mut chain = configuration.arm.chain(links, parameters.gravity);
        let mut state = ChainState::hanging(Vector3::zeros(), links);
        for i in 0..links {
            let taper = 1.0 - 0.5 * i as f64 / links as f64;
            chain.links[i].length_m *= 8.0 / links as f64;
            chain.links[i].center_m *= 8.0 / links as f64;
            chain.links[i].mass_kg *= 8.0 / links as f64 * taper;
            let joint = &mut chain.joints[i];
            joint.stiffness *= links as f64 / 8.0 * taper;
            // Light damping, which the explicit integrator can take.
            joint.damping *= 0.02;
            joint.collapse_moment = collapse;
            joint.hysteresis = slip.map(|slip_moment| ElastoSlip {
                stiffness: joint.stiffness,
                slip_moment,
            });
            let bend = 0.5 + 0.2 * i as f64;
            state.links[i] = UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * bend, -0.4 * bend, 0.1));
            state.motion.links[i] = Vector3::new(1.0, 0.5, 0.2);
        }
        let mut exact = state.clone();
        let tips = swing(&chain, &mut state, default_step, 5.0);
        let mut integrator = RungeKutta4::new(links);
        let mut converged = vec![chain.end_effector(&exact)];
        for k in 1..=100_000 {
            integrator.step(&chain, &mut exact, &Load::default(), 5e-5);
            if k % 200 == 0 {
                converged.push(chain.end_effector(&exact));
            }
        }
        let error = rms(&tips, &converged);
        assert!(
            error < 1e-3,
            "{links} links of {name}: tip off by {:.3} mm RMS",
            1e3 * error
        );
    }
}

/// Without damping, hysteresis alone brings a swing to rest: energy falls, and never rises beyond the integrator's error
/// where a joint starts to slip.
#[test]
fn hysteresis_only_takes_energy() {
    let parameters = parameters();
    let configuration = &parameters.configs["IS"];
    let mut chain = configuration.arm.chain(parameters.n_links, parameters.gravity);
    for joint in &mut chain.joints {
        joint.damping = 0.0;
        joint.hysteresis = Some(ElastoSlip {
            stiffness: joint.stiffness,
            slip_moment: 0.02,
        });
    }
    let mut state = configuration.start("bent");
    let mut integrator = RungeKutta4::new(chain.links.len());
    let start = total(&chain, &state);
    let mut last = start;
    let mut rise = 0.0_f64;
    for _ in 0..30_000 {
        integrator.step(&chain, &mut state, &Load::default(), 1e-4);
        let now = total(&chain, &state);
        rise = rise.max(now - last);
        last = now;
    }
    assert!(
        rise < 1e-6 * start.abs(),
        "energy rises by {rise:.1e} J in a step"
    );
    assert!(start - last > 0.1 * start.abs(), "{start} J, {last} J after 3 s");
}
