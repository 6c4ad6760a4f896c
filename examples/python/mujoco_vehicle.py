"""flyvine's model-predictive control on a MuJoCo vehicle that this file defines.

    pip install ./crates/flyvine-py mujoco
    python examples/python/mujoco_vehicle.py

The vehicle is a quadrotor under a cascaded position controller, with a limp arm of five links below it. Nothing of it is
known to flyvine but what it shows: it is flown by training commands, a model of the physical family is fitted to what was
recorded, a lemniscate is planned on the model, and flown open loop and with feedback.
"""

import mujoco
import numpy as np

import flyvine

LENGTH_M, PRESSURE_KPA = 0.7, 0.0  # rest distance from quadrotor to tip; the arm is not inflated
LINKS, CLAMP_M = 5, 0.1
LINK_M = (LENGTH_M - CLAMP_M) / LINKS


def arm(links: int) -> str:
    """The chain of links from the clamp downwards, as MJCF; the last carries the tip."""
    tip = '<site name="tip" pos="0 0 {0}"/><geom type="sphere" size="0.03" pos="0 0 {0}" mass="0.13"/>'
    inner = arm(links - 1) if links > 1 else tip.format(-LINK_M)
    return f"""
    <body pos="0 0 {-CLAMP_M if links == LINKS else -LINK_M}">
      <joint type="ball" stiffness="0.05" damping="0.004"/>
      <geom type="capsule" fromto="0 0 0 0 0 {-LINK_M}" size="0.02" mass="0.008"/>
      {inner}
    </body>"""


MODEL = f"""
<mujoco>
  <option timestep="0.0025" integrator="implicitfast" density="1.2"/>
  <worldbody>
    <body name="quadrotor" pos="0 0 1.5">
      <freejoint/>
      <geom type="box" size="0.12 0.12 0.04" mass="1.5"/>
      {arm(LINKS)}
    </body>
  </worldbody>
</mujoco>"""


class MujocoVehicle:
    """What :func:`flyvine.fly` asks of a vehicle: ``reset`` and ``step``."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)
        self.quadrotor = self.model.body("quadrotor").id
        self.tip = self.model.site("tip").id
        self.weight_n = 9.81 * self.model.body_subtreemass[self.quadrotor]

    def reset(self, length_m, pressure_kpa, seed):
        mujoco.mj_resetData(self.model, self.data)
        self.random = np.random.default_rng(seed)
        self.wind_up = np.zeros(3)
        mujoco.mj_forward(self.model, self.data)
        return self.observe()

    def step(self, command, length_m, pressure_kpa):
        for _ in range(round(flyvine.DT / self.model.opt.timestep)):
            self.autopilot(np.asarray(command))
            mujoco.mj_step(self.model, self.data)
        return self.observe()

    def autopilot(self, command):
        """Position P, velocity PI, attitude P, rate P: thrust along the body's z axis, and a torque."""
        position, velocity = self.data.qpos[:3], self.data.qvel[:3]
        rotation = self.data.xmat[self.quadrotor].reshape(3, 3)
        error = np.clip(1.2 * (command - position), -3.0, 3.0) - velocity
        self.wind_up = np.clip(self.wind_up + 0.6 * error * self.model.opt.timestep, -2.0, 2.0)
        wanted = np.clip(3.0 * error + self.wind_up, -6.0, 6.0) + [0.0, 0.0, 9.81]
        thrust = self.weight_n / 9.81 * max(wanted @ rotation[:, 2], 0.0)
        tilt = rotation.T @ np.cross(rotation[:, 2], wanted / np.linalg.norm(wanted))
        heading = np.array([0.0, 0.0, -rotation[1, 0]])
        rates = 8.0 * tilt + 2.0 * heading - self.data.qvel[3:6]
        torque = np.array([0.012, 0.012, 0.018]) * 20.0 * rates
        self.data.xfrc_applied[self.quadrotor, :3] = thrust * rotation[:, 2]
        self.data.xfrc_applied[self.quadrotor, 3:] = rotation @ torque

    def observe(self):
        """Poses as motion capture sees them: 0.3 mm of noise."""
        noise = 3e-4 * self.random.normal(size=(2, 3))
        pose = np.concatenate([self.data.qpos[:3] + noise[0], self.data.qpos[3:7]])
        if pose[3] < 0.0:
            pose[3:] *= -1.0
        return flyvine.Observation(self.data.time, pose, self.data.site_xpos[self.tip] + noise[1])


def record(commands, seed):
    """A training flight: the caller's own loop."""
    vehicle = MujocoVehicle()
    seen = [vehicle.reset(LENGTH_M, PRESSURE_KPA, seed)]
    seen += [vehicle.step(command, LENGTH_M, PRESSURE_KPA) for command in commands[:-1]]
    rows = len(commands)
    columns = {"t_s": flyvine.DT * np.arange(rows)}
    columns |= {"length_m": np.full(rows, LENGTH_M), "pressure_kpa": np.full(rows, PRESSURE_KPA)}
    columns |= dict(zip(["cmd_x", "cmd_y", "cmd_z"], np.transpose(commands)))
    quadrotor = np.transpose([s.quadrotor for s in seen])
    columns |= dict(zip(["qr_x", "qr_y", "qr_z", "qr_qw", "qr_qx", "qr_qy", "qr_qz"], quadrotor))
    columns |= dict(zip(["ee_x", "ee_y", "ee_z"], np.transpose([s.end_effector for s in seen])))
    return flyvine.Flight.from_arrays(columns, name=f"mujoco_{seed}").clean()[0]


def training_commands(seed):
    """Lemniscates whose period shrinks, while the height goes up and down."""
    t = np.arange(0.0, 15.0, flyvine.DT)
    phase = np.cumsum(2 * np.pi * flyvine.DT / np.linspace(10.0, 5.0, t.size))
    size = min(1.0, 0.7 + 0.3 * seed)
    return np.column_stack(
        [size * np.sin(phase), np.cos((seed + 1) * phase) * np.sin(phase), 1.5 + 0.1 * np.sin((1 + seed) * t)]
    )


TASK = f"""
name = "lemniscate"
[configuration]
length_m = {LENGTH_M}
pressure_kpa = {PRESSURE_KPA}
[lemniscate]
period_s = 8.0
ramp_s = 2.0
"""


def main():
    flights = [record(training_commands(seed), seed) for seed in range(3)]
    bank, _ = flyvine.fit(flights, family="physical")
    plan = flyvine.make_plan(flyvine.Task.parse(TASK), bank)
    errors = {}
    for controller in ("open-loop", "mpc"):
        # The supervisor stands between the controller and the vehicle, as in every flight.
        outcome = flyvine.fly(plan, MujocoVehicle(), controller, seed=10)
        assert outcome.completed, outcome.cause
        errors[controller] = flyvine.score(outcome.flight, plan)["ee_vs_reference"]["mean_m"]
        print(f"{controller}: {100 * errors[controller]:.2f} cm mean end-effector error")
    return errors


if __name__ == "__main__":
    main()
