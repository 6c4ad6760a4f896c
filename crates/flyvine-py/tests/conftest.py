"""Recordings, a bank and plans, made once from the simulated vehicle."""

import numpy as np
import pytest

import flyvine

CONFIGURATION = (0.7, 0.0)

LEMNISCATE = """
name = "lemniscate"
[configuration]
length_m = 0.7
pressure_kpa = 0.0
[lemniscate]
period_s = 10.0
ramp_s = 2.0
"""

SWING = """
name = "swing"
[configuration]
length_m = 0.7
pressure_kpa = 0.0
[swing]
target_m = [1.5, 1.0]
"""


def training_commands(seed: int) -> np.ndarray:
    """A lemniscate whose period shrinks, then steps: commands (rows × 3), m."""
    random = np.random.default_rng(seed)
    t = np.arange(0, 40, flyvine.DT)
    phase = np.cumsum(2 * np.pi * flyvine.DT / np.linspace(12.0, 5.0 + seed, t.size))
    curve = np.column_stack([np.sin(phase), np.cos(phase) * np.sin(phase), 1.5 + 0.15 * np.sin(0.7 * t)])
    corners = np.column_stack([random.uniform(-0.8, 0.8, (12, 2)), random.uniform(1.4, 1.7, 12)])
    steps = np.repeat(corners, 30, axis=0)
    # No faster than 2 m/s between one corner and the next.
    reachable = [curve[-1]]
    for target in steps:
        change = target - reachable[-1]
        reachable.append(reachable[-1] + change * min(1.0, 0.1 / max(np.linalg.norm(change), 1e-9)))
    return np.vstack([curve, reachable[1:]])


def record(commands: np.ndarray, seed: int) -> flyvine.Flight:
    """Flies bare commands on the simulated vehicle."""
    vehicle = flyvine.Vehicle()
    observations = [vehicle.reset(*CONFIGURATION, seed=seed)]
    observations += [vehicle.step(command, *CONFIGURATION) for command in commands[:-1]]
    quadrotor = np.array([o.quadrotor for o in observations])
    tip = np.array([o.end_effector for o in observations])
    rows = len(commands)
    columns = {
        "t_s": np.arange(rows) * flyvine.DT,
        "length_m": np.full(rows, CONFIGURATION[0]),
        "pressure_kpa": np.full(rows, CONFIGURATION[1]),
        **{f"cmd_{axis}": commands[:, i] for i, axis in enumerate("xyz")},
        **{f"qr_{name}": quadrotor[:, i] for i, name in enumerate(["x", "y", "z", "qw", "qx", "qy", "qz"])},
        **{f"ee_{axis}": tip[:, i] for i, axis in enumerate("xyz")},
    }
    return flyvine.Flight.from_arrays(columns, name=f"training_{seed}")


@pytest.fixture(scope="session")
def recordings() -> list[flyvine.Flight]:
    return [record(training_commands(seed), seed).clean()[0] for seed in range(4)]


@pytest.fixture(scope="session")
def bank(recordings):
    return flyvine.fit(recordings, family="lag")[0]


@pytest.fixture(scope="session")
def physical_bank(recordings):
    """On the first seconds of two recordings: enough for a controller to have something to do."""
    short = [flyvine.Flight.from_arrays({k: v[:300] for k, v in f.arrays().items()}, f.name) for f in recordings[:2]]
    return flyvine.fit(short, family="physical")[0]


@pytest.fixture(scope="session")
def swing(bank):
    return flyvine.make_plan(flyvine.Task.parse(SWING), bank)


@pytest.fixture(scope="session")
def lemniscate(bank):
    return flyvine.make_plan(flyvine.Task.parse(LEMNISCATE), bank)


@pytest.fixture(scope="session")
def physical_lemniscate(physical_bank):
    return flyvine.make_plan(flyvine.Task.parse(LEMNISCATE), physical_bank)
