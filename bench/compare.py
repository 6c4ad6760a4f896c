#!/usr/bin/env python3
"""Runs flyvine and the best existing solvers on the same problems in one run and prints the ratio table.

    cargo build --release && bench/compare.py SCRATCH_FOLDER [PROBLEM...]

The first run installs the peers from the Python package registry into SCRATCH_FOLDER (some minutes). Everything is
single-threaded. Peers: process-CPU time of one solve, minimum of several. flyvine: CPU time of the whole process with
`--repeat 101` minus that with `--repeat 1`, over 100, so nothing escapes the clock. Only ratios within one run count.
"""
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

BENCH = Path(__file__).resolve().parent
FLYVINE = BENCH.parent / "target" / "release" / "flyvine"
PROBLEMS = ["lem5_ES", "lem10_ES", "grow", "kick_ES", "kick_IS", "kick_EL", "linlem5_ES", "linkick_ES"]
ACADOS_CONDENSING = ["20", "0", "-1"]  # blocks; 0 is full, -1 none: the best one counts


def run_peer(scratch, environment, script, *arguments):
    command = [scratch / environment / "bin" / "python", BENCH / "peers" / script, *arguments]
    variables = dict(os.environ, BENCH_ROOT=str(scratch), OMP_NUM_THREADS="1")
    result = subprocess.run(command, env=variables, capture_output=True, text=True)
    if result.returncode != 0:
        print(f"{script} {' '.join(arguments)} failed:\n{result.stderr[-500:]}", file=sys.stderr)


def run_peers(scratch, problem):
    if problem.startswith("lin"):
        run_peer(scratch, "venv", "peer_qp.py", problem)
        return
    run_peer(scratch, "venv", "peer_casadi2.py", "ipopt", "lag", problem)
    if not problem.startswith("kick"):  # hard equality knots defeat its SQP
        for blocks in ACADOS_CONDENSING:
            run_peer(scratch, "venv_acados", "peer_acados.py", blocks, problem)


def child_cpu_ms(command):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = subprocess.run(command, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    elapsed = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return 1e3 * elapsed, json.loads(output)


def run_flyvine(problem):
    def solve(repeat):
        path = BENCH / "problems" / f"{problem}.json"
        return child_cpu_ms([FLYVINE, "solve", path, "--json", "--repeat", str(repeat)])

    many, report = min((solve(101) for _ in range(3)), key=lambda pair: pair[0])
    once = min(solve(1)[0] for _ in range(3))
    return (many - once) / 100, report


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    scratch = Path(sys.argv[1]).resolve()
    if not (scratch / "venv_acados").exists():
        subprocess.run([BENCH / "peers" / "setup.sh", scratch], check=True)
    print("| problem | flyvine ms | J | violation | steps | peer | ms | J | times faster |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for problem in sys.argv[2:] or PROBLEMS:
        for stale in (scratch / "results").glob(f"*__{problem}.json"):
            stale.unlink()
        run_peers(scratch, problem)
        ms, report = run_flyvine(problem)
        ours = f"| {problem} | {ms:.2f} | {report['cost']:.5f} | {report['max_violation']:.0e} | {report['iterations']} |"
        results = [json.loads(path.read_text()) for path in (scratch / "results").glob(f"*__{problem}.json")]
        for peer in sorted(results, key=lambda result: result["min_ms"]):
            cost = peer["extra"].get("cost", peer["extra"].get("obj", float("nan")))
            outcome = f"{cost:.5f}" if peer["solved"] else "not solved"
            print(f"{ours} {peer['peer']} | {peer['min_ms']:.2f} | {outcome} | {peer['min_ms'] / ms:.1f} |", flush=True)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(f"\nLargest child process: {peak / 1024:.0f} MB", file=sys.stderr)


if __name__ == "__main__":
    main()
