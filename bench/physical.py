#!/usr/bin/env python3
"""The lemniscate on the physical family: flyvine beside CasADi + IPOPT, same model, same integrator, one run.

    cargo build --release -p flyvine --example physical_problem
    bench/physical.py SCRATCH_FOLDER BANK.json [TASK.toml [ROUNDS]]

SCRATCH_FOLDER is the one of `compare.py`, BANK.json a bank of the physical family (`flyvine fit --family physical`), the
task the 10 s lemniscate unless named. The peer's step is checked to agree with flyvine's to 1e-10 at every knot before
anything is timed; costs are recomputed by its own rollout. Solves alternate, flyvine's and the peer's; process-CPU ms,
medians of ROUNDS (3).
"""
import json
import os
import statistics
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


class Peer:
    """CasADi and IPOPT, ready to solve."""

    def __init__(self, scratch, problem):
        program = [scratch / "venv" / "bin" / "python", BENCH / "peers" / "peer_physical.py", problem]
        self.process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=scratch)
        self.about = self.read()

    def read(self):
        line = self.process.stdout.readline()
        return json.loads(line) if line else sys.exit("the peer failed")

    def solve(self):
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self.read()


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    scratch, bank = Path(sys.argv[1]).resolve(), sys.argv[2]
    task = sys.argv[3] if len(sys.argv) > 3 else TASK
    rounds = int(sys.argv[4]) if len(sys.argv) > 4 else 3
    own = flyvine(bank, task)
    problem = scratch / "physical.json"
    problem.write_text(json.dumps(own))
    peer = Peer(scratch, problem)
    own_ms, peer_ms = [], []
    for _ in range(rounds):
        own_ms.append(statistics.median(flyvine(bank, task)["solve_ms_all"]))
        answer = peer.solve()
        peer_ms.append(answer["ms"])
    peer.process.stdin.close()
    peer.process.wait()

    print(f"{own['name']}: N = {own['N']}, 43 states; the steps agree to {peer.about['step_difference']:.0e}")
    steps = f"{own['iterations']} steps, {own['status']}"
    print(f"flyvine        {statistics.median(own_ms):9.1f} ms  J {peer.about['flyvine_cost']:.6f}  {steps}")
    steps = f"{answer['iterations']} steps, {'solved' if answer['solved'] else 'not solved'}"
    print(f"CasADi + IPOPT {statistics.median(peer_ms):9.1f} ms  J {answer['cost']:.6f}  {steps}")
    ratios = [theirs / ours for ours, theirs in zip(own_ms, peer_ms)]
    print(f"flyvine is faster by {statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})")


if __name__ == "__main__":
    main()
