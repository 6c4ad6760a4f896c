#!/usr/bin/env python3
"""Least squares on a million rows: `flyvine fit --stream` beside numpy.linalg.lstsq, in one run.

    bench/streaming.py FLYVINE FOLDER [--rows 1000000] [--threads 1] [--repeat 1]

writes flights into FOLDER (once), fits them with FLYVINE, and solves the same least squares of the height row (496
columns, about rest) with numpy, whose matrix is made beforehand and not counted. flyvine's time is that of the whole
process: reading the recordings, hygiene, hashes, sums, solution, bank. Prints process CPU time, wall time and peak
memory of both, and the ratio of the residuals' norms, both computed here from the coefficients.

Needs numpy, and memory for three times the matrix (4 GB for a million rows).
"""
import argparse, json, os, resource, subprocess, time
from pathlib import Path

arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
arguments.add_argument("flyvine")
arguments.add_argument("folder", type=Path)
arguments.add_argument("--rows", type=int, default=1_000_000)
arguments.add_argument("--threads", type=int, default=1)
arguments.add_argument("--repeat", type=int, default=1)
arguments = arguments.parse_args()
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = str(arguments.threads)
import numpy as np

FLIGHT_ROWS = 4000  # 200 s
LENGTH_M, HOVER_M, DT = 0.7, 1.5, 0.05


def flight(seed, rows):
    """Smooth random commands, a quadrotor that follows and a tip that swings below it; 1 mm of noise."""
    random = np.random.default_rng(seed)
    t = np.arange(rows) * DT
    waves = [random.normal(size=(8, 3)) * [0.3, 0.3, 0.05] for _ in range(2)]
    rates = random.uniform(0.3, 4.0, size=8)
    command = np.sin(np.outer(t, rates)) @ waves[0] + np.cos(np.outer(t, rates)) @ waves[1] + [0, 0, HOVER_M]
    lag = lambda x, share: np.stack([_filter(column, share) for column in x.T], 1)
    quadrotor = lag(lag(command, 0.25), 0.3)
    acceleration = np.gradient(np.gradient(quadrotor, DT, axis=0), DT, axis=0)
    tilt = 0.5 * np.tanh(0.1 * acceleration[:, [1, 0, 2]] * [-1, 1, 0.1])
    swing = quadrotor - lag(quadrotor, 0.2)
    tip = quadrotor - 1.2 * swing
    tip[:, 2] -= LENGTH_M - 0.5 * (swing**2).sum(1)
    noise = lambda x, sigma: x + random.normal(scale=sigma, size=x.shape)
    quadrotor, tilt, tip = noise(quadrotor, 1e-3), noise(tilt, 1e-3), noise(tip, 1e-3)
    w = np.sqrt(1 - (tilt**2).sum(1, keepdims=True))
    constant = np.tile([LENGTH_M, 0.0], (rows, 1))
    return np.concatenate([t[:, None], constant, command, quadrotor, w, tilt, tip], 1)


def _filter(x, share):
    y = np.empty_like(x)
    state = x[0]
    for k, value in enumerate(x):
        state += share * (value - state)
        y[k] = state
    return y


HEADER = "t_s,length_m,pressure_kpa,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,qr_qw,qr_qx,qr_qy,qr_qz,ee_x,ee_y,ee_z"
arguments.folder.mkdir(parents=True, exist_ok=True)
files = []
for number in range(-(-arguments.rows // FLIGHT_ROWS)):
    files.append(arguments.folder / f"flight_{number:05}.csv")
    if not files[-1].exists():
        np.savetxt(files[-1], flight(number, FLIGHT_ROWS), fmt="%.6f", delimiter=",", header=HEADER, comments="")


def usage(children=False):
    found = resource.getrusage(resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF)
    return found.ru_utime + found.ru_stime


def columns(path):
    """Rows [1, d, d d | height increment] of a flight, and [w | increments]."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    state, command = table[:, [6, 7, 8, 10, 11, 12, 13, 14, 15]], table[:, 3:6]
    k = np.arange(2, len(table) - 1)
    x = [state[k - lag] for lag in range(3)]
    v = [x[0].copy(), x[0] - x[1], x[0] - 2 * x[1] + x[2], command[k] - x[0][:, :3]]
    v[0][:, 6:] -= x[0][:, :3]
    d = np.concatenate(v, 1)
    d[:, 2] -= HOVER_M
    d[:, 8] += LENGTH_M
    i, j = np.triu_indices(30)
    terms = np.concatenate([np.ones((len(k), 1)), d, d[:, i] * d[:, j]], 1)
    return terms, np.concatenate([*x, command[k]], 1), state[k + 1, 8], state[k, 8]


bank_file = arguments.folder / "bank.json"
command = ["/usr/bin/env", arguments.flyvine, "fit", "--stream", *map(str, files), "--out", str(bank_file), "--json"]
ours = []
for _ in range(arguments.repeat):
    before, clock = usage(children=True), time.perf_counter()
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    report = json.loads(child.stdout.read())
    _, status, spent = os.wait4(child.pid, 0)
    assert status == 0, status
    ours.append((spent.ru_utime + spent.ru_stime, time.perf_counter() - clock, spent.ru_maxrss / 1024))
model = json.loads(bank_file.read_text())["models"][0]["model"]
print(f"flyvine: {report['corners'][0]['rows']} rows, condition number {report['corners'][0]['condition_number']:.2e}")

rows = report["corners"][0]["rows"]
matrix, target = np.empty((rows, 496)), np.empty(rows)
at, our_square = 0, 0.0
linear = np.array(model["linear"]).reshape(9, 30)[8]
quadratic = np.zeros((30, 30))
quadratic[np.triu_indices(30)] = model["quadratic"][0]["upper_triangle"]
for path in files:
    terms, w, after, before = columns(path)
    matrix[at : at + len(terms)], target[at : at + len(terms)] = terms, after - before
    at += len(terms)
    predicted = model["offset"][8] + w @ linear + np.einsum("ki,ij,kj->k", w, quadratic, w)
    our_square += ((after - predicted) ** 2).sum()
assert at == rows, (at, rows)
theirs = []
for _ in range(arguments.repeat):
    before, clock = usage(), time.perf_counter()
    theta = np.linalg.lstsq(matrix, target, rcond=None)[0]
    theirs.append((usage() - before, time.perf_counter() - clock))
their_square = sum(
    ((target[start : start + 10_000] - matrix[start : start + 10_000] @ theta) ** 2).sum()
    for start in range(0, rows, 10_000)
)
cpu, wall, memory = map(min, zip(*ours))
their_cpu, their_wall = map(min, zip(*theirs))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(f"{'':12}{'CPU s':>10}{'wall s':>10}{'peak MB':>10}")
print(f"{'flyvine':12}{cpu:10.2f}{wall:10.2f}{memory:10.0f}")
print(f"{'lstsq':12}{their_cpu:10.2f}{their_wall:10.2f}{peak:10.0f}")
print(f"lstsq / flyvine: {their_cpu / cpu:.2f} in CPU time; residual norm of flyvine / lstsq - 1: "
      f"{np.sqrt(our_square / their_square) - 1:.1e}")
