//! One knot of the model: semi-implicit Euler substeps of quadrotor, autopilot and arm.

use super::arm::{ArmLength, base, link_lengths, unit};
use super::autopilot::{Setpoint, autopilot};
use super::hanging::Hanging;
use super::parameters::Parameters;
use super::scalar::Scalar;
use super::state::{LINKS, State};
use super::surroundings::Surroundings;
use super::vector::Vector;
use crate::DT;
use pulp::{Simd, WithSimd};

/// Substeps per knot.
pub const SUBSTEPS: usize = 5;
/// Length of a substep, s.
pub const SUBSTEP_S: f64 = DT / SUBSTEPS as f64;

/// The state [`DT`] later, under `command` issued now and held.
///
/// The command arrives after the transport delay; within the substep of its arrival the old and the new one
/// are averaged by their shares of time, so that the delay has a derivative.
pub fn step<S: Scalar>(
    parameters: &Parameters<S>,
    arm: ArmLength,
    state: &State<S>,
    command: &Vector<S>,
) -> State<S> {
    step_in(parameters, arm, &Surroundings::calm(), state, command)
}

/// [`step`] in moving air and with a load at the tip.
pub fn step_in<S: Scalar>(
    parameters: &Parameters<S>,
    arm: ArmLength,
    around: &Surroundings<S>,
    state: &State<S>,
    command: &Vector<S>,
) -> State<S> {
    S::vectorize(Knot {
        parameters,
        arm,
        around,
        state,
        command,
    })
}

/// What happens during one knot.
struct Knot<'a, S> {
    parameters: &'a Parameters<S>,
    arm: ArmLength,
    around: &'a Surroundings<S>,
    state: &'a State<S>,
    command: &'a Vector<S>,
}

impl<S: Scalar> WithSimd for Knot<'_, S> {
    type Output = State<S>;

    // Everything below is inlined into here, where the compiler knows which vectors there are.
    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> State<S> {
        let Knot {
            parameters,
            arm,
            around,
            state,
            command,
        } = self;
        let wind = Vector(around.wind_m_s);
        let parameters = &Parameters {
            tip_mass: parameters.tip_mass * (around.tip_load + 1.0),
            ..*parameters
        };
        let mut now = *state;
        for substep in 0..SUBSTEPS {
            let setpoint = setpoint_in_force(parameters, state, command, (substep + 1) as f64 * SUBSTEP_S);
            let length = ArmLength {
                length_m: arm.length_m + arm.rate_m_s * (substep + 1) as f64 * SUBSTEP_S,
                ..arm
            };
            now = advance(parameters, length, &wind, &now, &setpoint);
        }
        now.commands.rotate_right(1);
        now.commands[0] = *command;
        now
    }
}

/// The set-point in force during the substep that ends at `t_s` after the knot: the transport delay after a command was
/// sent it begins to replace the one before, by its share of the substep.
#[inline(always)]
fn setpoint_in_force<S: Scalar>(
    parameters: &Parameters<S>,
    state: &State<S>,
    command: &Vector<S>,
    t_s: f64,
) -> Setpoint<S> {
    let [before, long_before] = state.commands;
    let velocities =
        [(*command, before), (before, long_before)].map(|(new, old)| (new - old).scale(1.0 / DT));
    // The latest one, for older set-points too: about the middle one that is the central difference.
    let acceleration = (velocities[0] - velocities[1]).scale(1.0 / DT);
    let setpoint = |position, velocity| Setpoint {
        position,
        velocity,
        acceleration,
    };
    let setpoints = [setpoint(*command, velocities[0]), setpoint(before, velocities[1])];
    let oldest = setpoint(long_before, velocities[1]);
    let [newest, newer] = setpoints;
    let newer = newer.replacing(oldest, arrived(parameters, t_s + DT));
    newest.replacing(newer, arrived(parameters, t_s))
}

/// The share of a substep, ended `age_s` after a command was sent, in which that command was in force: 0 to 1.
#[inline(always)]
fn arrived<S: Scalar>(parameters: &Parameters<S>, age_s: f64) -> S {
    let share = (-parameters.command_delay + age_s) * (1.0 / SUBSTEP_S);
    if share.value() <= 0.0 {
        S::from(0.0)
    } else if share.value() > 1.0 {
        S::from(1.0)
    } else {
        share
    }
}

impl<S: Scalar> Setpoint<S> {
    #[inline(always)]
    fn replacing(self, older: Self, share: S) -> Self {
        Setpoint {
            position: older.position + (self.position - older.position) * share,
            velocity: older.velocity + (self.velocity - older.velocity) * share,
            acceleration: self.acceleration,
        }
    }
}

/// One substep: velocities first, positions with the new velocities, then the arm back onto its lengths.
#[inline(always)]
fn advance<S: Scalar>(
    parameters: &Parameters<S>,
    arm: ArmLength,
    wind: &Vector<S>,
    state: &State<S>,
    setpoint: &Setpoint<S>,
) -> State<S> {
    const H: f64 = SUBSTEP_S;
    let p = parameters;
    let rotation = state.rotation();
    let pilot = autopilot(p, state, &rotation, setpoint);
    let arm_now = Hanging::new(p, arm, state, &rotation, wind).accelerations();

    // First-order lags by implicit Euler: x⁺ = x + (x_sp − x) h / (τ + h).
    let thrust_share = (p.thrust_time_constant + H).recip() * H;
    let rate_share = (p.rate_time_constant + H).recip() * H;
    let derivative_share = p.derivative_time_constant / (p.derivative_time_constant + H);

    let velocity = state.velocity + arm_now.quadrotor.scale(H);
    let body_torque = rotation.rotate_back(&arm_now.torque) * p.arm_torque_gain;
    let angular_acceleration = state.angular_acceleration
        + (pilot.angular_acceleration_setpoint - state.angular_acceleration) * rate_share;
    let body_rate = state.body_rate + (angular_acceleration + body_torque).scale(H);
    let attitude = state.attitude + rotation.vector_part_rate(&body_rate).scale(H);
    let mut next = State {
        position: state.position + velocity.scale(H),
        attitude,
        velocity,
        body_rate,
        angular_acceleration,
        rate_integrator: state.rate_integrator + pilot.rate_integrator.scale(H),
        integrator: state.integrator + pilot.integrator.scale(H),
        filtered_velocity: state.filtered_velocity + (pilot.filtered_velocity * derivative_share).scale(H),
        thrust: state.thrust + (pilot.thrust_setpoint - state.thrust) * thrust_share,
        ..*state
    };
    for i in 0..LINKS {
        next.point_velocities[i] = state.point_velocities[i] + arm_now.points[i].scale(H);
        next.points[i] = state.points[i] + next.point_velocities[i].scale(H);
    }
    onto_lengths(p, arm, &mut next);
    next
}

/// Moves the links' outer ends to the links' lengths, and their velocities to what those allow.
#[inline(always)]
fn onto_lengths<S: Scalar>(parameters: &Parameters<S>, arm: ArmLength, state: &mut State<S>) {
    let (mut inner, mut inner_velocity) = base(parameters, state, &state.rotation());
    for (i, (length, length_rate)) in link_lengths(parameters, arm).into_iter().enumerate() {
        let direction = unit(&(state.points[i] - inner));
        let relative = state.point_velocities[i] - inner_velocity;
        state.points[i] = inner + direction * length;
        state.point_velocities[i] =
            inner_velocity + relative.perpendicular_to(&direction) + direction * length_rate;
        inner = state.points[i];
        inner_velocity = state.point_velocities[i];
    }
}

#[cfg(test)]
mod tests {
    use super::super::state::STATE_LEN;
    use super::*;

    #[test]
    fn rest_stays_at_rest() {
        let parameters = Parameters::defaults();
        let rest = State::rest(&parameters, 0.9, [0.3, -0.2, 1.4]);
        let mut state = rest;
        for _ in 0..100 {
            state = step(&parameters, ArmLength::constant(0.9), &state, &rest.commands[0]);
        }
        let (mut before, mut after) = ([0.0; STATE_LEN], [0.0; STATE_LEN]);
        rest.write_flat(&mut before);
        state.write_flat(&mut after);
        for (entry, (a, b)) in before.iter().zip(after).enumerate() {
            assert!((a - b).abs() < 1e-6, "entry {entry}: {a} became {b}");
        }
    }

    #[test]
    fn a_new_command_waits_for_the_transport_delay() {
        let mut parameters = Parameters::defaults();
        let rest = State::rest(&parameters, 0.7, [0.0, 0.0, 1.5]);
        let command = Vector([1.0, 0.0, 1.5]);
        let moved = |parameters: &Parameters<f64>| {
            step(parameters, ArmLength::constant(0.7), &rest, &command)
                .integrator
                .0[0]
        };
        parameters.command_delay = 0.05;
        assert!(moved(&parameters).abs() < 1e-12);
        parameters.command_delay = 0.0;
        assert!(moved(&parameters) > 1e-3);

        // From one knot to the next nothing jumps: a command that arrives 30 ms into the second knot.
        parameters.command_delay = 0.08;
        let next = step(&parameters, ArmLength::constant(0.7), &rest, &command);
        assert!((next.position.0[0] - rest.position.0[0]).abs() < 1e-8);
        let force = |t_s: f64| setpoint_in_force(&parameters, &next, &command, t_s).position.0[0];
        assert!(force(0.03).abs() < 1e-12 && (force(0.035) - 0.5).abs() < 1e-12);
        assert!((force(0.04) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_growing_arm_ends_as_long_as_it_should() {
        let parameters = Parameters::defaults();
        let mut state = State::rest(&parameters, 0.7, [0.0, 0.0, 1.5]);
        let command = state.commands[0];
        for knot in 0..200 {
            let arm = ArmLength {
                length_m: 0.7 + 0.001 * f64::from(knot),
                rate_m_s: 0.02,
            };
            state = step(&parameters, arm, &state, &command);
        }
        let [.., tip] = state.outputs();
        assert!((1.5 - tip - 0.9).abs() < 5e-3, "arm of {} m", 1.5 - tip);
    }
}
