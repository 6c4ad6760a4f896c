"""The swinging arm in flyvine and in MuJoCo's own C loop, interleaved in one run: tip error against process-CPU time.

    cargo build --release -p flyvine --example vehicle_speed
    python bench/vehicle.py [ROUNDS]

Needs numpy and mujoco. Both step the same clamped arm of eight links (`data/passive`, all four configurations, two
starts) for 5 s; MuJoCo with its two integrators that take the joints' damping implicitly (its RK4 does not, and is
unstable on the damped arms at 0.25 ms), by `mj_step` with `nstep`, so that Python is entered once per 10 ms of swing. The reference is the
bundled converged swing (MuJoCo, step 1e-5 s). Printed: per program and step the fastest round of each swing, summed,
and the largest RMS tip error of the eight swings; then each program's cheapest setting below 1 mm, and their ratio.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time

import mujoco
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
PASSIVE = ROOT / "data" / "passive"
PROGRAM = ROOT / "target" / "release" / "examples" / "vehicle_speed"
DURATION_S = 5.0
SAMPLE_S = 0.01
CASES = ("tilt30", "bent")
FLYVINE_STEPS = (0.01, 0.005, 0.0025, 0.001)
MUJOCO_STEPS = {
    "implicitfast": (0.01, 0.005, 0.0025, 0.01 / 6, 0.001),
    "Euler": (0.01, 0.005, 0.0025, 0.01 / 6, 0.001),
}
BAR_M = 1e-3


def mujoco_model(arm, gravity, step, integrator):
    """The arm as MJCF: ball joints with stiffness and damping, no contacts, no constraints."""
    links = len(arm["start"]) // 4

    def body(i):
        joint0 = i == 0
        stiffness = arm["joint0_stiffness_Nm_per_rad" if joint0 else "joint_stiffness_Nm_per_rad"]
        damping = arm["joint0_damping_Nms_per_rad" if joint0 else "joint_damping_Nms_per_rad"]
        transverse, axial = arm["link_inertia_transverse"], arm["link_inertia_axial"]
        offset = 0.0 if joint0 else -arm["link_length_m"]
        if i + 1 < links:
            child = body(i + 1)
        else:
            t, a = arm["tip_inertia_transverse"], arm["tip_inertia_axial"]
            child = (
                f'<body name="tip" pos="0 0 {-arm["link_length_m"] - arm["h_tip_m"]!r}">'
                f'<inertial pos="0 0 0" mass="{arm["tip_mass_kg"]!r}" diaginertia="{t!r} {t!r} {a!r}"/></body>'
            )
        return (
            f'<body pos="0 0 {offset!r}"><joint type="ball" stiffness="{stiffness!r}" damping="{damping!r}"/>'
            f'<inertial pos="0 0 {-arm["link_com_from_upper_joint_m"]!r}" mass="{arm["link_mass_kg"]!r}" '
            f'diaginertia="{transverse!r} {transverse!r} {axial!r}"/>{child}</body>'
        )

    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step!r}" gravity="0 0 {-gravity!r}" integrator="{integrator}">'
        f'<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{body(0)}</worldbody></mujoco>"
    )


def swing_mujoco(model, arm):
    """Process-CPU seconds and the tip every 10 ms."""
    data = mujoco.MjData(model)
    data.qpos[:] = arm["start"]
    mujoco.mj_forward(model, data)
    tip = model.body("tip").id
    samples = round(DURATION_S / SAMPLE_S)
    per_sample = round(SAMPLE_S / model.opt.timestep)
    tips = np.empty((samples + 1, 3))
    tips[0] = data.xpos[tip]
    spent = 0.0
    for k in range(samples):
        before = time.process_time()
        mujoco.mj_step(model, data, nstep=per_sample)
        spent += time.process_time() - before
        # mj_step leaves the body positions of the last step's beginning; the new ones cost it nothing here.
        mujoco.mj_kinematics(model, data)
        tips[k + 1] = data.xpos[tip]
    return spent, tips


def swing_flyvine(path, step):
    out = subprocess.run(
        [PROGRAM, "arm", path, repr(step), repr(DURATION_S)], check=True, capture_output=True, text=True
    )
    result = json.loads(out.stdout)
    return result["cpu_s"], np.array(result["tips"])


def main():
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    parameters = json.loads((PASSIVE / "passive_params.json").read_text())
    swings = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, configuration in parameters["configs"].items():
            for case in CASES:
                arm = configuration | {
                    "gravity": parameters["gravity"],
                    "start": configuration["initial_ball_quaternions_wxyz"][case],
                }
                path = pathlib.Path(scratch) / f"{name}_{case}.json"
                path.write_text(json.dumps(arm))
                reference = np.loadtxt(PASSIVE / f"{name}_{case}.csv", delimiter=",", skiprows=1)[:, 1:]
                swings.append((path, arm, reference))
        settings = [("flyvine", step) for step in FLYVINE_STEPS]
        settings += [(f"MuJoCo {kind}", step) for kind, steps in MUJOCO_STEPS.items() for step in steps]
        fastest = {setting: [float("inf")] * len(swings) for setting in settings}
        errors = {setting: 0.0 for setting in settings}
        for _ in range(rounds):
            for s, (path, arm, reference) in enumerate(swings):
                for program, step in settings:
                    if program == "flyvine":
                        spent, tips = swing_flyvine(path, step)
                    else:
                        model = mujoco_model(arm, arm["gravity"], step, program.split()[1])
                        spent, tips = swing_mujoco(model, arm)
                    error = np.sqrt(np.mean(np.sum((tips - reference) ** 2, axis=1)))
                    fastest[program, step][s] = min(fastest[program, step][s], spent)
                    errors[program, step] = max(errors[program, step], error if np.isfinite(error) else np.inf)

    print(f"| program | step, ms | tip error, mm (worst of {len(swings)} swings) | CPU, ms per 5 s | CPU, µs per step |")
    print("| --- | --- | --- | --- | --- |")
    best = {}
    for program, step in settings:
        spent = sum(fastest[program, step]) / len(swings)
        error = errors[program, step]
        print(
            f"| {program} | {1e3 * step:.3g} | {1e3 * error:.3f} | {1e3 * spent:.2f} | "
            f"{1e6 * spent * step / DURATION_S:.2f} |"
        )
        family = program.split()[0]
        if error <= BAR_M and spent < best.get(family, (np.inf,))[0]:
            best[family] = (spent, program, step)
    for spent, program, step in best.values():
        print(f"cheapest within {1e3 * BAR_M:g} mm: {program}, step {1e3 * step:.3g} ms, {1e3 * spent:.2f} ms per 5 s")
    if len(best) == 2:
        print(f"flyvine's share of MuJoCo's CPU: {best['flyvine'][0] / best['MuJoCo'][0]:.3f}")


if __name__ == "__main__":
    main()
