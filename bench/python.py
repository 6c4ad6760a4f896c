"""What Python costs: one controller step, and a whole study beside the command line's.

    pip install ./crates/flyvine-py
    python bench/python.py FLYVINE_BINARY TASK.toml FLIGHT.csv … [--flights 1000] [--controller tracking]

The step: a controller stepped from Python, less its own time as the library measures it. The study: fit the recordings,
plan, fly so many seeds with feedback; from Python by `fit`, `make_plan`, `fly_many` and `score`, on the command line by
`fit`, `plan` and `sweep`.
"""

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import flyvine


def step_overhead(plan: flyvine.Plan, law: str) -> tuple[float, float]:
    """Median time of one step from Python and of the library's own, µs."""
    native = 1e3 * np.median(flyvine.fly(plan, controller=law).step_ms) if law == "mpc" else 0.0
    times = []
    for seed in range(20 if law != "mpc" else 2):
        vehicle, controller = flyvine.Vehicle(), flyvine.Controller(plan, law)
        length, pressure = plan.configurations[0]
        seen, held = vehicle.reset(length, pressure, seed), plan.states[0, :3]
        for knot in range(controller.steps):
            quadrotor, tip = seen.quadrotor, seen.end_effector
            start = time.perf_counter()
            held = controller.step(knot, quadrotor, tip, held)
            times.append(time.perf_counter() - start)
            if law == "mpc":
                seen = vehicle.step(held, length, pressure)
    return 1e6 * float(np.median(times)), native


def study_in_python(arguments, folder: Path) -> flyvine.Plan:
    flights = [flyvine.Flight.read(path).clean()[0] for path in arguments.flight]
    bank, _ = flyvine.fit(flights, family="lag")
    plan = flyvine.make_plan(flyvine.Task.read(arguments.task), bank)
    outcomes = flyvine.fly_many(plan, range(1, arguments.flights + 1), controller=arguments.controller)
    errors = [flyvine.score(outcome.flight, plan)["ee_vs_reference"]["mean_m"] for outcome in outcomes]
    print(f"mean error {100 * np.mean(errors):.2f} cm over {len(errors)} flights")
    plan.write(folder / "plan.json")
    return plan


def study_on_the_command_line(arguments, folder: Path) -> None:
    def run(*words):
        subprocess.run([arguments.binary, *map(str, words)], check=True, capture_output=True)

    run("fit", *arguments.flight, "--family", "lag", "--out", folder / "bank.json")
    run("plan", arguments.task, "--bank", folder / "bank.json", "--out", folder / "cli_plan.json")
    (folder / "sweep.toml").write_text(
        f'name = "study"\nplans = ["cli_plan.json"]\nseeds = {arguments.flights}\n'
        f'controllers = ["{arguments.controller}"]\n'
    )
    with tempfile.TemporaryDirectory(dir=folder) as fresh:  # a sweep never computes a row twice
        run("sweep", folder / "sweep.toml", "--out", fresh)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("task")
    parser.add_argument("flight", nargs="+")
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--controller", default="tracking")
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="flyvine-bench-"))
    # Alternating, so that other load on the machine hits both alike; CPU time is what counts on a shared one.
    for _ in range(2):
        for name, study in (("python", study_in_python), ("command line", study_on_the_command_line)):
            wall, cpu = time.perf_counter(), sum(os.times()[:4])
            study(arguments, folder)
            cpu = sum(os.times()[:4]) - cpu
            print(f"{name}: {time.perf_counter() - wall:.1f} s, CPU {cpu:.1f} s")
    plan = flyvine.Plan.read(folder / "plan.json")
    for law in ("open-loop", "tracking"):
        total, _ = step_overhead(plan, law)
        print(f"{law}: {total:.2f} µs per step from Python, the law's own time included")


if __name__ == "__main__":
    main()
