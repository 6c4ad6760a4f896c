#!/usr/bin/env python3
"""CasADi + IPOPT on the physical family: the model's step written anew in CasADi, checked against flyvine's, then timed.

    peer_physical.py PROBLEM.json

PROBLEM.json is what `cargo run --release -p flyvine --example physical_problem` prints: parameters, problem, and states
along the solution. Multiple shooting with exact derivatives of the step, from the same initial commands and their rollout,
by CasADi's interpreter: compiled, the second derivatives are a hundred megabytes of C.

Prints one JSON object when it is ready, and another for every line that it reads: one solve each.
"""
import json
import os
import sys
import time

os.environ["OMP_NUM_THREADS"] = "1"
import casadi as ca
import numpy as np

GRAVITY, DT, SUBSTEPS, CLEAR = 9.81, 0.05, 5, -18.0
H = DT / SUBSTEPS


def cross(a, b):
    return ca.cross(a, b)


def rotate(w, v, x):
    t = 2 * cross(v, x)
    return x + t * w + cross(v, t)


def rotate_back(w, v, x):
    t = 2 * cross(x, v)
    return x + t * w + cross(t, v)


def norm(x):
    return ca.sqrt(ca.dot(x, x) + 1e-300)


def softplus(x):
    return ca.fmax(x, 0) + ca.log1p(ca.exp(-ca.fabs(x)))


def limit_from_above(magnitude, limit):
    width = 0.04 * limit
    excess = (magnitude - limit) / width
    return ca.if_else(excess < CLEAR, magnitude, magnitude - width * softplus(excess))


def limit_from_below(value, limit, width):
    shortfall = (limit - value) / width
    return ca.if_else(shortfall < CLEAR, value, value + width * softplus(shortfall))


def limit_length(vector, limit):
    length = norm(vector)
    small = length < limit * (1 + CLEAR * 0.04)
    return ca.if_else(small, vector, vector * (limit_from_above(length, limit) / length))


def perpendicular(x, axis):
    return x - axis * ca.dot(x, axis)


def per_axis(horizontal, vertical, v):
    return ca.vertcat(v[0] * horizontal, v[1] * horizontal, v[2] * vertical)


def attitude_from_up(up):
    cos_roll = ca.sqrt(up[0] ** 2 + up[2] ** 2)

    def half(cos, sin):
        half_cos = ca.sqrt((cos + 1) * 0.5)
        return half_cos, sin / half_cos * 0.5

    cp, sp = half(up[2] / cos_roll, up[0] / cos_roll)
    cr, sr = half(cos_roll, -up[1])
    return cp * cr, ca.vertcat(cp * sr, sp * cr, -(sp * sr))


class Model:
    def __init__(self, parameters, length_m):
        self.__dict__.update(parameters)
        self.arm_length = length_m
        length = length_m - self.base_offset
        self.lengths = [length * self.joint_fraction, length * (1 - self.joint_fraction)]
        self.offset = ca.DM([0, 0, -self.base_offset])

    def base(self, s):
        w, v = s["w"], s["attitude"]
        position = s["position"] + rotate(w, v, self.offset)
        return position, s["velocity"] + rotate(w, v, cross(s["body_rate"], self.offset))

    def mobility(self):
        """How a unit torque at each joint accelerates the angles of the joints, with the arm straight."""
        inner, outer = 1 / self.lengths[0], 1 / self.lengths[1]
        joint, tip, gain = 1 / self.joint_mass, 1 / self.tip_mass, self.arm_torque_gain
        lever = self.base_offset * inner
        at_base = (joint + 1) * inner**2 + gain * (lever + 1) ** 2
        across = -(joint * inner * (inner + outer) + inner**2 + gain * (lever + 1) * lever)
        at_joint = tip * outer**2 + joint * (inner + outer) ** 2 + inner**2 + gain * lever**2
        return np.array([[at_base, across], [across, at_joint]])

    def autopilot(self, s, setpoint, setpoint_velocity, setpoint_acceleration):
        v = per_axis(self.position_gain_xy, self.position_gain_z, setpoint - s["position"])
        v = ca.vertcat(
            limit_length(v[:2], self.horizontal_speed_limit), limit_length(v[2], self.vertical_speed_limit)
        )
        error = v + setpoint_velocity * self.velocity_feedforward - s["velocity"]
        acceleration = (s["velocity"] - s["filtered_velocity"]) / self.derivative_time_constant
        wanted = (
            per_axis(self.velocity_gain_xy, self.velocity_gain_z, error)
            + s["integrator"]
            - per_axis(self.derivative_gain_xy, self.derivative_gain_z, acceleration)
            + setpoint_acceleration * self.acceleration_feedforward
        )
        tilt = limit_length(wanted[:2], np.tan(self.tilt_limit) * GRAVITY)
        direction = ca.vertcat(tilt, GRAVITY)
        up = direction / norm(direction)
        lifted = limit_from_below((wanted[2] + GRAVITY) / up[2], 1.0, 0.4)
        total = self.joint_mass + self.tip_mass + 1
        thrust = limit_from_above(lifted, self.thrust_maximum / total)
        excess = ca.vertcat(wanted[:2] - tilt, 0)
        integrator = per_axis(self.integral_gain_xy, self.integral_gain_z, error - excess * (2 / self.velocity_gain_xy))
        ow, ov = attitude_from_up(up)
        r = ov * s["w"] - s["attitude"] * ow - cross(s["attitude"], ov)
        r = ca.vertcat(r[0], r[1], 0.4 * r[2]) * (2 * self.attitude_gain)
        rate_error = limit_length(r, self.rate_limit) - s["body_rate"]
        return dict(
            rate_integrator=rate_error * self.rate_integral_gain,
            integrator=integrator,
            filtered_velocity=acceleration,
            thrust=thrust,
            angular=rate_error * self.rate_gain + s["rate_integrator"],
        )

    def accelerations(self, s):
        w, v, rate = s["w"], s["attitude"], s["body_rate"]
        up = ca.vertcat(2 * (v[0] * v[2] + w * v[1]), 2 * (v[1] * v[2] - w * v[0]), 1 - 2 * (v[0] ** 2 + v[1] ** 2))
        masses, drags = [self.joint_mass, self.tip_mass], [self.joint_drag, self.tip_drag]
        stiffness, damping = [self.base_stiffness, self.joint_stiffness], [self.base_damping, self.joint_damping]
        rotational = rotate(w, v, cross(s["angular_acceleration"], self.offset) + cross(rate, cross(rate, self.offset)))
        inner, links = self.base(s), []
        for i in range(2):
            outer = s["points"][i], s["point_velocities"][i]
            span = outer[0] - inner[0]
            direction = span / ca.sqrt(ca.dot(span, span) + 1e-12)
            relative = outer[1] - inner[1]
            links.append((direction, relative / self.lengths[i], relative))
            inner = outer
        neighbours = [-up, links[0][0]]
        offset = rotate(w, v, self.offset)
        total = self.joint_mass + self.tip_mass + 1
        gravity = ca.DM([0, 0, -GRAVITY])
        thrust = up * (s["thrust"] * total) - s["velocity"] * self.quadrotor_drag

        def bend(forces, torque, i, on_link, on_neighbour):
            force = perpendicular(on_link, links[i][0]) / self.lengths[i]
            forces[i + 1] = forces[i + 1] + force
            forces[i] = forces[i] - force
            reaction = perpendicular(on_neighbour, neighbours[i])
            if i == 0:
                return torque + cross(neighbours[0], reaction)
            forces[1] = forces[1] + reaction / self.lengths[0]
            forces[0] = forces[0] - reaction / self.lengths[0]
            return torque

        def under(forces, torque):
            """Accelerations of the quadrotor and the points, and the torque on the body."""
            free = [thrust + forces[0] + gravity] + [forces[i + 1] / masses[i] + gravity for i in range(2)]
            inverse = [1 / m for m in masses]
            curvature = [-ca.dot(links[i][2], links[i][2]) / self.lengths[i] for i in range(2)]
            diagonal = [inverse[0] + 1, inverse[1] + inverse[0]]
            coupling = -inverse[0] * ca.dot(links[1][0], links[0][0])
            right = [
                ca.dot(links[0][0], free[1] - free[0] - rotational) - curvature[0],
                ca.dot(links[1][0], free[2] - free[1]) - curvature[1],
            ]
            factor = coupling / diagonal[1]
            tension0 = (right[0] - factor * right[1]) / (diagonal[0] - factor * coupling)
            tension1 = (right[1] - coupling * tension0) / diagonal[1]
            pull = links[0][0] * tension0
            joint = free[1] + (links[1][0] * tension1 - pull) * inverse[0]
            tip = free[2] - links[1][0] * tension1 * inverse[1]
            return free[0] + pull, [joint, tip], torque + cross(offset, forces[0] + pull)

        forces, torque = [ca.DM.zeros(3)] * 3, ca.DM.zeros(3)
        for i in range(2):
            velocity = s["point_velocities"][i]
            forces[i + 1] = -velocity * (drags[i] * ca.sqrt(ca.dot(velocity, velocity) + 1e-6))
        series = [1, 2 / 3, 8 / 15, 16 / 35, 128 / 315, 256 / 693, 1024 / 3003]
        for i in range(2):
            u = (1 - ca.dot(links[i][0], neighbours[i])) * 0.5
            share = series[6]
            for coefficient in series[5::-1]:
                share = share * u + coefficient
            elastic = stiffness[i] * share
            torque = bend(forces, torque, i, neighbours[i] * elastic, links[i][0] * elastic)

        # Damping by the slip rates at the substep's end: (I + h W C) s+ = s + h s'.
        quadrotor, points, arm_torque = under(forces, torque)
        body_torque = rotate_back(w, v, arm_torque) * self.arm_torque_gain
        later_rate = rate + H * (s["angular_acceleration"] + body_torque)
        neighbour_rate = cross(rotate(w, v, later_rate), neighbours[0])
        inner = quadrotor + rotational + rotate(w, v, cross(body_torque, self.offset))
        slips = []
        for i in range(2):
            link_rate = links[i][1] + (points[i] - inner) * (H / self.lengths[i])
            slips.append(link_rate - neighbour_rate)
            inner, neighbour_rate = points[i], link_rate
        settle = np.linalg.inv(np.eye(2) + H * self.mobility() @ np.diag(damping))
        for i in range(2):
            damped = (slips[0] * settle[i, 0] + slips[1] * settle[i, 1]) * damping[i]
            torque = bend(forces, torque, i, -damped, damped)
        return under(forces, torque)

    def advance(self, s, setpoint, setpoint_velocity, setpoint_acceleration):
        w, v = s["w"], s["attitude"]
        pilot = self.autopilot(s, setpoint, setpoint_velocity, setpoint_acceleration)
        quadrotor, points, torque = self.accelerations(s)
        n = dict(s)
        n["velocity"] = s["velocity"] + H * quadrotor
        n["angular_acceleration"] = s["angular_acceleration"] + (pilot["angular"] - s["angular_acceleration"]) * (
            H / (self.rate_time_constant + H)
        )
        body_torque = rotate_back(w, v, torque) * self.arm_torque_gain
        n["body_rate"] = s["body_rate"] + H * (n["angular_acceleration"] + body_torque)
        n["attitude"] = v + H * 0.5 * (n["body_rate"] * w + cross(v, n["body_rate"]))
        n["position"] = s["position"] + H * n["velocity"]
        n["rate_integrator"] = s["rate_integrator"] + H * pilot["rate_integrator"]
        n["integrator"] = s["integrator"] + H * pilot["integrator"]
        share = self.derivative_time_constant / (self.derivative_time_constant + H)
        n["filtered_velocity"] = s["filtered_velocity"] + H * share * pilot["filtered_velocity"]
        n["thrust"] = s["thrust"] + (pilot["thrust"] - s["thrust"]) * (H / (self.thrust_time_constant + H))
        n["w"] = ca.sqrt(1 - ca.dot(n["attitude"], n["attitude"]))
        velocities = [s["point_velocities"][i] + H * points[i] for i in range(2)]
        positions = [s["points"][i] + H * velocities[i] for i in range(2)]
        inner, inner_velocity = self.base(n)
        for i in range(2):
            span = positions[i] - inner
            direction = span / ca.sqrt(ca.dot(span, span) + 1e-12)
            relative = velocities[i] - inner_velocity
            positions[i] = inner + direction * self.lengths[i]
            velocities[i] = inner_velocity + perpendicular(relative, direction)
            inner, inner_velocity = positions[i], velocities[i]
        n["points"], n["point_velocities"] = positions, velocities
        return n

    def step(self):
        x, u = ca.SX.sym("x", 43), ca.SX.sym("u", 3)
        names = ["velocity", "body_rate", "angular_acceleration", "rate_integrator", "integrator", "filtered_velocity"]
        s = dict(position=x[0:3], attitude=x[3:6], thrust=x[27])
        s.update({name: x[9 + 3 * i : 12 + 3 * i] for i, name in enumerate(names)})
        s["points"], s["point_velocities"] = [x[37:40], x[6:9]], [x[40:43], x[34:37]]
        s["w"] = ca.sqrt(1 - ca.dot(x[3:6], x[3:6]))
        before, long_before = x[28:31], x[31:34]
        newest, newer = (u, (u - before) / DT), (before, (before - long_before) / DT)
        oldest, acceleration = (long_before, newer[1]), (newest[1] - newer[1]) / DT
        for substep in range(SUBSTEPS):
            t = (substep + 1) * H

            def arrived(age):
                return min(max((age - self.command_delay) / H, 0.0), 1.0)

            def replacing(new, old, share):
                return tuple(o + (n - o) * share for n, o in zip(new, old))

            setpoint = replacing(newest, replacing(newer, oldest, arrived(t + DT)), arrived(t))
            s = self.advance(s, *setpoint, acceleration)
        states = [s["position"], s["attitude"], s["points"][1]] + [s[name] for name in names]
        states += [s["thrust"], u, before, s["point_velocities"][1], s["points"][0], s["point_velocities"][0]]
        return ca.Function("F", [x, u], [ca.vertcat(*states)])


def solver_of(problem, step):
    """A function that solves once. Multiple shooting: z_1 … z_{N−1} and u_0 … u_{N−2} are the variables."""
    n, m, knots = 43, 3, problem["N"]
    z0 = np.array(problem["z0"])
    zref = np.array(problem["zref"]).reshape(knots, n)
    uref = np.array(problem["uref"]).reshape(knots - 1, m)
    guess = np.array(problem["u_init"]).reshape(knots - 1, m)
    q, r = np.array(problem["Q"]), np.array(problem["R"])
    z, u = ca.MX.sym("z", n, knots - 1), ca.MX.sym("u", m, knots - 1)
    before = ca.horzcat(ca.DM(z0), z[:, :-1])
    defects = ca.vec(z - step.map(knots - 1)(before, u))
    dz, du = z - ca.DM(zref[1:].T), u - ca.DM(uref.T)
    start_cost = float(((z0 - zref[0]) ** 2 * q).sum())
    cost = start_cost + ca.dot(ca.DM(q), ca.sum2(dz * dz)) + ca.dot(ca.DM(r), ca.sum2(du * du))
    states = [z0]
    for command in guess:
        states.append(np.array(step(states[-1], command)).ravel())
    variables = ca.vertcat(ca.vec(z), ca.vec(u))
    x0 = np.concatenate([np.array(states[1:]).ravel(), guess.ravel()])
    bounds = [np.concatenate([np.full((knots - 1) * n, side), np.tile(problem[key], knots - 1)])
              for side, key in ((-np.inf, "umin"), (np.inf, "umax"))]
    options = dict(print_time=False, error_on_fail=False, ipopt=dict(print_level=0, sb="yes", tol=1e-6, max_iter=300))
    solver = ca.nlpsol("S", "ipopt", dict(x=variables, f=cost, g=defects), options)

    def solve():
        started = time.process_time()
        result = solver(x0=x0, lbx=bounds[0], ubx=bounds[1], lbg=0, ubg=0)
        ms = 1e3 * (time.process_time() - started)
        stats = solver.stats()
        found = np.array(result["x"]).ravel()[(knots - 1) * n :].reshape(knots - 1, m)
        return dict(ms=ms, solved=bool(stats["success"]), iterations=stats["iter_count"], cost=cost_of(problem, step, found))

    return solve


def cost_of(problem, step, commands):
    """J by an independent rollout."""
    knots = problem["N"]
    zref = np.array(problem["zref"]).reshape(knots, 43)
    uref = np.array(problem["uref"]).reshape(knots - 1, 3)
    z, cost = np.array(problem["z0"]), 0.0
    for k in range(knots):
        cost += ((z - zref[k]) ** 2 * problem["Q"]).sum()
        if k < knots - 1:
            cost += ((commands[k] - uref[k]) ** 2 * problem["R"]).sum()
            z = np.array(step(z, commands[k])).ravel()
    return float(cost)


def main():
    problem = json.load(open(sys.argv[1]))
    step = Model(problem["parameters"], problem["length_m"]).step()
    states = np.array(problem["states"]).reshape(problem["N"], 43)
    commands = np.array(problem["u"]).reshape(problem["N"] - 1, 3)
    worst = max(np.abs(np.array(step(states[k], commands[k])).ravel() - states[k + 1]).max() for k in range(len(commands)))
    if not worst <= 1e-10:
        sys.exit(f"the step differs from flyvine's by {worst:.1e}")
    solve = solver_of(problem, step)
    print(json.dumps(dict(step_difference=float(worst), flyvine_cost=cost_of(problem, step, commands))), flush=True)
    for _ in sys.stdin:
        print(json.dumps(solve()), flush=True)


if __name__ == "__main__":
    main()
