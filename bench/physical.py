#!/usr/bin/env python3
"""The lemniscate on the physical family: flyvine beside CasADi + IPOPT, same model, same integrator, one run.

    cargo build --release -p flyvine --example physical_problem
    bench/physical.py SCRATCH_FOLDER BANK.json [TASK.toml]

SCRATCH_FOLDER is the one of `compare.py`, BANK.json a bank of the physical family (`flyvine fit --family physical`), the
task the 10 s lemniscate unless named. The peer's step is checked to agree with flyvine's to 1e-10 at every knot before
anything is timed; costs are recomputed by its own rollout. flyvine runs before and after. Process-CPU ms, minimum.
"""
import json
import os
import subprocess
import sys
from pathlib import Path

BENCH = Path(__file__).resolve().parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", BENCH.parent / "target")) / "release"
TASK = BENCH.parent / "examples" / "tasks" / "lemniscate_10s_ES.toml"


def flyvine(bank, task):
    output = subprocess.run([TARGET / "examples" / "physical_problem", bank, task], capture_output=True, text=True)
    if output.returncode != 0:
        sys.exit(output.stderr)
    return json.loads(output.stdout)


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    scratch, bank = Path(sys.argv[1]).resolve(), sys.argv[2]
    task = sys.argv[3] if len(sys.argv) > 3 else TASK
    own = flyvine(bank, task)
    problem = scratch / "physical.json"
    problem.write_text(json.dumps(own))
    # CasADi compiles derivatives in the folder that it runs in, a hundred megabytes of C.
    peer = subprocess.run(
        [scratch / "venv" / "bin" / "python", BENCH / "peers" / "peer_physical.py", problem],
        capture_output=True,
        text=True,
        cwd=scratch,
    )
    if peer.returncode != 0:
        sys.exit(peer.stderr)
    peer = json.loads(peer.stdout)
    times = own["solve_ms_all"] + flyvine(bank, task)["solve_ms_all"]
    print(f"{own['name']}: N = {own['N']}, 43 states; the steps agree to {peer['step_difference']:.0e}")
    print(f"flyvine        {min(times):9.1f} ms  J {peer['flyvine_cost']:.6f}  {own['iterations']} steps, {own['status']}")
    status = "solved" if peer["solved"] else "not solved"
    print(f"CasADi + IPOPT {peer['min_ms']:9.1f} ms  J {peer['cost']:.6f}  {peer['iterations']} steps, {status}")
    print(f"flyvine is faster by {peer['min_ms'] / min(times):.1f}")


if __name__ == "__main__":
    main()
