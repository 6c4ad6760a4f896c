#!/usr/bin/env python3
"""Runs flyvine and the best existing solvers on the same problems in one run and prints the ratio tables.

    cargo build --release -p flyvine-cli && cargo build --release -p flyvine --example riccati_sweep
    bench/compare.py SCRATCH_FOLDER [PROBLEM...]

The first run installs the peers from the Python package registry into SCRATCH_FOLDER (a minute or two). Everything is
single-threaded and starts from the same guess; flyvine runs before and after every peer. Times are process-CPU ms, the
minimum of several: of a solve for the peers, for flyvine the whole process with `--repeat 101` minus that with
`--repeat 1`, over 100, so nothing escapes the clock. Cost and violation are recomputed here for everybody by rolling the
commands through the true dynamics. Peak memory is that of the whole process. Only ratios within one run count.
"""
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

BENCH = Path(__file__).resolve().parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", BENCH.parent / "target")) / "release"
PROBLEMS = ["lem5_ES", "lem10_ES", "grow", "kick_ES", "kick_IS", "kick_EL", "linlem5_ES", "linkick_ES"]
ACADOS_CONDENSING = ["20", "0", "-1"]  # blocks; 0 is full, -1 none: the best one counts


class Peers:
    """The other solvers, installed in a scratch folder."""

    def __init__(self, scratch):
        self.scratch = scratch
        if not (scratch / "venv_acados").exists():
            subprocess.run([BENCH / "peers" / "setup.sh", scratch], check=True)
        # Costs and violations are recomputed with the peers' own independent rollout.
        python = scratch / "venv" / "bin" / "python"
        if Path(sys.prefix).resolve() != (scratch / "venv").resolve():
            os.environ["BENCH_ROOT"] = str(scratch)
            os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
            os.execv(python, [str(python), *sys.argv])

    @staticmethod
    def commands(problem):
        """(environment, script, arguments) of everyone who can solve the problem."""
        if problem.startswith("lin"):
            return [("venv", "peer_qp.py", [problem])]
        commands = [("venv", "peer_casadi2.py", ["ipopt", "lag", problem])]
        if not problem.startswith("kick"):  # hard equality knots defeat its SQP
            commands += [("venv_acados", "peer_acados.py", [blocks, problem]) for blocks in ACADOS_CONDENSING]
        return commands

    def run(self, environment, script, arguments):
        command = [self.scratch / environment / "bin" / "python", BENCH / "peers" / script, *arguments]
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode != 0:
            print(f"{script} {' '.join(arguments)} failed:\n{result.stderr[-500:]}", file=sys.stderr)

    def results(self, problem):
        paths = (self.scratch / "results").glob(f"*__{problem}.json")
        results = [json.loads(path.read_text()) for path in paths]
        return sorted(results, key=lambda result: result["min_ms"])

    def forget(self, problem):
        for stale in (self.scratch / "results").glob(f"*__{problem}.json"):
            stale.unlink()


class Flyvine:
    """Fastest times so far of one problem, and its last report."""

    def __init__(self, problem):
        self.path = BENCH / "problems" / f"{problem}.json"
        self.many = self.once = float("inf")

    def run(self, rounds=3):
        for _ in range(rounds):
            elapsed, _ = self.solve(1)
            self.once = min(self.once, elapsed)
            elapsed, self.report = self.solve(101)
            self.many = min(self.many, elapsed)

    def solve(self, repeat):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [TARGET / "flyvine", "solve", self.path, "--json", "--repeat", str(repeat)]
        output = subprocess.run(command, capture_output=True, text=True).stdout
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        elapsed = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return 1e3 * elapsed, json.loads(output)

    @property
    def ms(self):
        return (self.many - self.once) / 100


def compare(problem, peers):
    import check

    peers.forget(problem)
    flyvine = Flyvine(problem)
    for command in peers.commands(problem):
        flyvine.run()
        peers.run(*command)
    flyvine.run()
    true_dynamics = check.loadp(str(flyvine.path))

    def row(name, ms, u, steps, memory, ratio, solved):
        cost, violation, _ = check.evalu(true_dynamics, u)
        outcome = f"{cost:.5f} | {violation:.0e}" if solved else "not solved | "
        print(f"| {problem} | {name} | {ms:.2f} | {ratio} | {outcome} | {steps} | {memory:.0f} |", flush=True)

    report = flyvine.report
    memory = report["peak_memory_mb"] or float("nan")
    row("**flyvine**", flyvine.ms, report["u"], report["iterations"], memory, "", report["converged"])
    for peer in peers.results(problem):
        ratio = f"{peer['min_ms'] / flyvine.ms:.1f}"
        row(peer["peer"], peer["min_ms"], peer["u"], peer["iters"], peer["rss_mb"], ratio, peer["solved"])


def compare_sweeps():
    import time

    import numpy

    sweep = json.loads(subprocess.run([TARGET / "examples" / "riccati_sweep"], capture_output=True, text=True).stdout)
    large = numpy.random.default_rng(1).random((512, 512))
    product = numpy.empty_like(large)
    times = []
    for _ in range(100):
        started = time.process_time()
        numpy.matmul(large, large, out=product)
        times.append(time.process_time() - started)
    structured = sweep["structured_us"]
    dense = {name: sweep[f"dense_{name}_us"] for name in ("faer", "nalgebra")}
    print(f"\nOne Riccati sweep, {sweep['knots']} knots, 27 states: structured {structured:.0f} µs, ", end="")
    print(", ".join(f"dense with {name} {us:.0f} µs ({us / structured:.1f}×)" for name, us in dense.items()), end="; ")
    print(f"{sweep['structured_gflops']:.0f} GFLOP/s, where dgemm (512 × 512, one thread) reaches ", end="")
    print(f"{sweep['dgemm_gflops']:.0f} (faer) and {2 * 512**3 / min(times) * 1e-9:.0f} (numpy).")


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    peers = Peers(Path(sys.argv[1]).resolve())
    sys.path.insert(0, str(BENCH / "peers"))
    print("| problem | solver | ms | flyvine is faster by | J | violation | steps | peak MB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for problem in sys.argv[2:] or PROBLEMS:
        compare(problem, peers)
    compare_sweeps()


if __name__ == "__main__":
    main()
