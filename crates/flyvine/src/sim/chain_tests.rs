//! The articulated-body algorithm against Newton's and Euler's equations of every body with explicit joint
//! forces, solved as one dense system; and conservation laws.

use super::articulated::Workspace;
use super::chain::*;
use super::integrator::RungeKutta4;
use super::state::*;
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const LINKS: usize = 3;

fn chain(base: bool) -> Chain {
    let link = Link {
        length_m: 0.12,
        mass_kg: 0.02,
        center_m: 0.05,
        inertia_transverse_kg_m2: 4e-5,
        inertia_axial_kg_m2: 3e-5,
        drag_normal: 0.006,
        drag_tangential: 0.001,
    };
    Chain {
        base: base.then_some(Base {
            mass_kg: 1.5,
            inertia_kg_m2: [0.011, 0.013, 0.019],
            clamp_offset_m: 0.1,
            drag: [0.2, 0.3, 0.4],
        }),
        links: vec![link; LINKS],
        joints: vec![
            Joint {
                stiffness: 0.8,
                damping: 0.05,
                collapse_moment: 0.2,
                hysteresis: None,
            };
            LINKS
        ],
        tip: Tip {
            mass_kg: 0.15,
            offset_m: 0.07,
            inertia_transverse_kg_m2: 2.5e-4,
            inertia_axial_kg_m2: 1.5e-4,
            drag: 0.004,
            slider: None,
        },
        growth: Growth::default(),
        gravity: 9.81,
    }
}

fn vector(random: &mut ChaCha8Rng, size: f64) -> Vector3<f64> {
    size * Vector3::from_fn(|_, _| {
        let value: f64 = StandardNormal.sample(random);
        value
    })
}

fn state(random: &mut ChaCha8Rng, base: bool) -> ChainState {
    let mut state = ChainState::hanging(Vector3::new(0.3, -0.2, 1.5), LINKS);
    if base {
        state.attitude = UnitQuaternion::from_scaled_axis(vector(random, 0.4));
        state.motion.linear = vector(random, 1.0);
        state.motion.angular = vector(random, 2.0);
    }
    for i in 0..LINKS {
        state.links[i] = UnitQuaternion::from_scaled_axis(vector(random, 0.5));
        state.motion.links[i] = vector(random, 3.0);
    }
    state
}

/// A free rigid body of the dense formulation.
struct Body {
    mass: f64,
    inertia: Matrix3<f64>,
    center: Vector3<f64>,
    rate: Vector3<f64>,
    force: Vector3<f64>,
    torque: Vector3<f64>,
}

/// Accelerations by unknowns (a, α) of every body's centre and one force per joint.
fn dense_accelerations(chain: &Chain, state: &ChainState, load: &Load) -> Motion {
    let gravity = Vector3::new(0.0, 0.0, -chain.gravity);
    let down = Vector3::new(0.0, 0.0, -1.0);
    let mut nodes = vec![];
    chain.for_each_node(state, |node| nodes.push(node));
    let mut bodies = vec![];
    let mut velocity = Vector3::zeros();
    let (mut parent, mut parent_rate) = (UnitQuaternion::identity(), Vector3::zeros());
    if let Some(base) = &chain.base {
        let rotation = state.attitude.to_rotation_matrix();
        let rate = state.motion.angular;
        let air = state.attitude.inverse() * (load.wind - state.motion.linear);
        let drag = air.component_mul(&Vector3::from(base.drag));
        bodies.push(Body {
            mass: base.mass_kg,
            inertia: rotation.matrix()
                * Matrix3::from_diagonal(&Vector3::from(base.inertia_kg_m2))
                * rotation.matrix().transpose(),
            center: state.position,
            rate,
            force: state.attitude * (Vector3::new(0.0, 0.0, load.thrust) + drag) + base.mass_kg * gravity,
            torque: state.attitude * load.torque,
        });
        velocity = state.motion.linear + rate.cross(&(nodes[0] - state.position));
        (parent, parent_rate) = (state.attitude, rate);
    }
    for i in 0..LINKS {
        let (link, joint, rate) = (&chain.links[i], &chain.joints[i], state.motion.links[i]);
        let d = state.links[i] * down;
        let rotation = state.links[i].to_rotation_matrix();
        let body_inertia = |transverse: f64, axial: f64| {
            rotation.matrix()
                * Matrix3::from_diagonal(&Vector3::new(transverse, transverse, axial))
                * rotation.matrix().transpose()
        };
        let mut parts = vec![(
            link.mass_kg,
            nodes[i] + link.center_m * d,
            body_inertia(link.inertia_transverse_kg_m2, link.inertia_axial_kg_m2),
        )];
        let air = load.wind - velocity - rate.cross(&(link.center_m * d));
        let along = air.dot(&d) * d;
        let mut pushes = vec![(
            parts[0].1,
            link.drag_normal * (air - along).norm() * (air - along)
                + link.drag_tangential * along.norm() * along,
        )];
        if i + 1 == LINKS {
            let center = nodes[i + 1] + chain.tip.offset_m * d;
            let inertia = body_inertia(chain.tip.inertia_transverse_kg_m2, chain.tip.inertia_axial_kg_m2);
            parts.push((chain.tip.mass_kg, center, inertia));
            let air = load.wind - velocity - rate.cross(&(center - nodes[i]));
            pushes.push((center, chain.tip.drag * air.norm() * air + load.tip_force));
        }
        let mass: f64 = parts.iter().map(|part| part.0).sum();
        let center = parts.iter().map(|part| part.0 * part.1).sum::<Vector3<f64>>() / mass;
        let mut inertia = Matrix3::zeros();
        for (mass, at, own) in &parts {
            let arm = (at - center).cross_matrix();
            inertia += own - *mass * arm * arm;
        }
        // Joint torque on this link, and its reaction on the parent.
        let bend = (state.links[i] * parent.inverse()).scaled_axis();
        let softening = (1.0 + (joint.stiffness * bend.norm() / joint.collapse_moment).powi(2)).sqrt();
        let moment = -joint.stiffness / softening * bend - joint.damping * (rate - parent_rate);
        if let Some(previous) = bodies.last_mut() {
            previous.torque -= moment;
        }
        let mut force = mass * gravity;
        let mut torque = moment;
        for (at, push) in pushes {
            force += push;
            torque += (at - center).cross(&push);
        }
        bodies.push(Body {
            mass,
            inertia,
            center,
            rate,
            force,
            torque,
        });
        velocity += rate.cross(&(nodes[i + 1] - nodes[i]));
        (parent, parent_rate) = (state.links[i], rate);
    }

    let (count, first) = (bodies.len(), bodies.len() - LINKS);
    let size = 6 * count + 3 * LINKS;
    let (mut matrix, mut rhs) = (DMatrix::zeros(size, size), DVector::zeros(size));
    for (b, body) in bodies.iter().enumerate() {
        let row = 6 * b;
        matrix.view_mut((row, row), (3, 3)).fill_diagonal(body.mass);
        matrix
            .view_mut((row + 3, row + 3), (3, 3))
            .copy_from(&body.inertia);
        rhs.rows_mut(row, 3).copy_from(&body.force);
        let gyroscopic = body.rate.cross(&(body.inertia * body.rate));
        rhs.rows_mut(row + 3, 3).copy_from(&(body.torque - gyroscopic));
    }
    for joint in 0..LINKS {
        let column = 6 * count + 3 * joint;
        let child = joint + first;
        // The joint's force acts on the child and, reversed, on the parent; both move alike at the joint.
        for (body, sign) in [(Some(child), 1.0), (child.checked_sub(1), -1.0)] {
            let Some(b) = body else { continue };
            let arm = nodes[joint] - bodies[b].center;
            let rate = bodies[b].rate;
            let row = 6 * b;
            matrix.view_mut((row, column), (3, 3)).fill_diagonal(-sign);
            matrix
                .view_mut((row + 3, column), (3, 3))
                .copy_from(&(-sign * arm.cross_matrix()));
            matrix.view_mut((column, row), (3, 3)).fill_diagonal(sign);
            matrix
                .view_mut((column, row + 3), (3, 3))
                .copy_from(&(-sign * arm.cross_matrix()));
            let centripetal = rate.cross(&rate.cross(&arm));
            for k in 0..3 {
                rhs[column + k] -= sign * centripetal[k];
            }
        }
    }
    let solution = matrix.lu().solve(&rhs).expect("regular");
    let part = |row: usize| Vector3::new(solution[row], solution[row + 1], solution[row + 2]);
    let mut result = Motion::zeros(LINKS);
    if first == 1 {
        result.linear = part(0);
        result.angular = part(3);
    }
    for i in 0..LINKS {
        result.links[i] = part(6 * (i + first) + 3);
    }
    result
}

#[test]
fn accelerations_match_the_dense_formulation() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for trial in 0..50 {
        let with_base = trial % 2 == 0;
        let (chain, state) = (chain(with_base), state(&mut random, with_base));
        let load = Load {
            thrust: 17.0,
            torque: vector(&mut random, 0.3),
            wind: vector(&mut random, 2.0),
            tip_force: vector(&mut random, 0.5),
        };
        let expected = dense_accelerations(&chain, &state, &load);
        let mut found = Motion::zeros(LINKS);
        Workspace::new(LINKS).accelerations(&chain, &state, &load, 0.0, &state.motion, &mut found);
        let close = |a: Vector3<f64>, b: Vector3<f64>| (a - b).norm() < 1e-8 * (1.0 + b.norm());
        assert!(close(found.linear, expected.linear), "{found:?} {expected:?}");
        assert!(close(found.angular, expected.angular), "{found:?} {expected:?}");
        for (a, b) in found.links.iter().zip(&expected.links) {
            assert!(close(*a, *b), "{found:?} {expected:?}");
        }
    }
}

/// Momentum of the whole material, wall material that the nodes slide along included.
fn momentum(chain: &Chain, state: &ChainState) -> Vector3<f64> {
    let base = chain.base.expect("floating");
    let down = |q: &UnitQuaternion<f64>| q * Vector3::new(0.0, 0.0, -1.0);
    let mut total = base.mass_kg * state.motion.linear;
    let mut velocity = state.motion.linear
        + state
            .motion
            .angular
            .cross(&(base.clamp_offset_m * down(&state.attitude)));
    for (i, link) in chain.links.iter().enumerate() {
        let (d, rate) = (down(&state.links[i]), state.motion.links[i]);
        let slide = i as f64 * chain.growth.link_rate * d;
        total += link.mass_kg * (velocity + rate.cross(&(link.center_m * d)) - slide);
        velocity += rate.cross(&(link.length_m * d)) + chain.growth.link_rate * d;
        if i + 1 == chain.links.len() {
            total += chain.tip.mass_kg * (velocity + rate.cross(&(chain.tip.offset_m * d)));
        }
    }
    total
}

/// An arm that grows while it swings freely in space keeps its momentum: the terms of moving material close.
#[test]
fn growth_keeps_momentum() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut state = state(&mut random, true);
    let mut chain = chain(true);
    chain.gravity = 0.0;
    chain.base.as_mut().expect("floating").drag = [0.0; 3];
    chain.tip.drag = 0.0;
    let density = 0.16;
    let (start_length, tip_mass) = (0.12, chain.tip.mass_kg);
    // Ten times the real rate, so that the terms are far above the integration error.
    let rate = 0.2 / LINKS as f64;
    chain.growth = Growth {
        link_rate: rate,
        link_acceleration: 0.0,
        linear_density: density,
    };
    let set_length = |chain: &mut Chain, length: f64| {
        for link in &mut chain.links {
            link.length_m = length;
            link.mass_kg = density * length;
            link.center_m = 0.5 * length;
            link.drag_normal = 0.0;
            link.drag_tangential = 0.0;
        }
        chain.tip.mass_kg = tip_mass - density * (length - start_length) * LINKS as f64;
    };
    set_length(&mut chain, start_length);
    let before = momentum(&chain, &state);
    let mut integrator = RungeKutta4::new(LINKS);
    let step = 1e-4;
    for k in 0..5000 {
        set_length(&mut chain, start_length + rate * (f64::from(k) + 0.5) * step);
        integrator.step(&chain, &mut state, &Load::default(), step);
    }
    set_length(&mut chain, start_length + rate * 5000.0 * step);
    let drift = (momentum(&chain, &state) - before).norm();
    assert!(
        drift < 1e-4 * before.norm(),
        "momentum drifts by {drift:.2e} of {:.2e}",
        before.norm()
    );
}

/// Undamped, with a tip that slides: kinetic, gravitational and elastic energy trade without loss.
#[test]
fn sliding_tip_keeps_energy() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut chain = chain(true);
    chain.base.as_mut().expect("floating").drag = [0.0; 3];
    for joint in &mut chain.joints {
        joint.damping = 0.0;
    }
    for link in &mut chain.links {
        link.drag_normal = 0.0;
        link.drag_tangential = 0.0;
    }
    chain.tip.drag = 0.0;
    chain.tip.slider = Some(Slider {
        rest_force: 1.4,
        slack_stiffness: 20.0,
        stretch_stiffness: 60.0,
        damping: 0.0,
    });
    let mut state = state(&mut random, true);
    state.extension = 0.02;
    state.motion.extension = -0.4;
    let total = |state: &ChainState| {
        let (kinetic, potential) = chain.energy(state);
        kinetic + potential
    };
    let (start, greatest) = (total(&state), chain.energy(&state).0);
    let mut integrator = RungeKutta4::new(LINKS);
    let mut farthest = 0.0_f64;
    for _ in 0..10_000 {
        integrator.step(&chain, &mut state, &Load::default(), 1e-4);
        farthest = farthest.max((state.extension - 0.02).abs());
    }
    let drift = (total(&state) - start).abs();
    assert!(farthest > 0.01, "the tip hardly slid: {farthest}");
    assert!(
        drift < 1e-5 * greatest,
        "energy drifts by {:.1e}",
        drift / greatest
    );
}

/// The implicit integrator converges to the explicit one at second order, slider and drag included.
#[test]
fn integrators_agree() {
    let mut random = ChaCha8Rng::seed_from_u64(13);
    let mut chain = chain(true);
    chain.tip.slider = Some(Slider {
        rest_force: 1.4,
        slack_stiffness: 20.0,
        stretch_stiffness: 20.0,
        damping: 0.5,
    });
    let start = state(&mut random, true);
    let load = Load {
        thrust: 17.0,
        wind: Vector3::new(1.0, -2.0, 0.5),
        ..Load::default()
    };
    let mut exact = start.clone();
    let mut explicit = RungeKutta4::new(LINKS);
    for _ in 0..2000 {
        explicit.step(&chain, &mut exact, &load, 1e-4);
    }
    let error = |step: f64| {
        let mut state = start.clone();
        let mut implicit = super::integrator::LinearlyImplicit::new(LINKS);
        for _ in 0..(0.2 / step).round() as usize {
            implicit.step(&chain, &mut state, &[load; 2], step);
        }
        (chain.end_effector(&state) - chain.end_effector(&exact)).norm()
    };
    let (coarse, fine) = (error(1e-3), error(5e-4));
    assert!(
        fine < 1e-4 && (coarse / fine).log2() > 1.7,
        "{coarse:.2e} {fine:.2e}"
    );
}
