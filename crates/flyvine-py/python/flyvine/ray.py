"""Sweeps on a Ray cluster: ``python -m flyvine.ray SWEEP.toml --address HOST:PORT --out DIR``.

Every task computes a few rows by the same engine as ``flyvine sweep``, and the journal and the table are the same, to the
last byte. The driver keeps rows as they come: kill it, or lose a worker, and the same command computes what is missing.
"""

import argparse
import sys
import time

from . import FlyvineError, Sweep


def compute_rows(sweep: Sweep, indices: list[int]) -> list[tuple[str, str]]:
    """Rows of a sweep, on one worker."""
    return sweep.compute(indices)


def run(sweep: Sweep, folder: str, rows_per_task: int = 16) -> int:
    """Computes the rows of a sweep that ``folder`` lacks on the Ray cluster that is connected; returns how many."""
    import ray

    missing = [int(index) for index in sweep.missing(folder)]
    shared = ray.put(sweep)
    # A worker that dies costs its rows one more try, as often as it takes.
    task = ray.remote(num_cpus=1, max_retries=-1)(compute_rows)
    pieces = iter([missing[i : i + rows_per_task] for i in range(0, len(missing), rows_per_task)])
    # Enough tasks under way to keep every worker busy, not so many that their results pile up.
    at_once = 4 * max(1, int(ray.cluster_resources().get("CPU", 1)))
    under_way: list = []
    started, done = time.monotonic(), 0
    while True:
        while len(under_way) < at_once and (piece := next(pieces, None)) is not None:
            under_way.append(task.remote(shared, piece))
        if not under_way:
            return done
        ready, under_way = ray.wait(under_way)
        for rows in ray.get(ready):
            sweep.keep(folder, rows)
            done += len(rows)
        rest_s = (time.monotonic() - started) / done * (len(missing) - done)
        print(f"{done}/{len(missing)} rows, done in {rest_s:.0f} s", file=sys.stderr)


def main() -> int:
    """The command."""
    import ray

    parser = argparse.ArgumentParser(prog="python -m flyvine.ray", description=__doc__)
    parser.add_argument("sweep", metavar="SWEEP.toml")
    parser.add_argument("--out", default="run-sweep", metavar="DIR", help="the sweep's folder (default: run-sweep)")
    parser.add_argument("--address", help="of the cluster; without it, one is started on this machine")
    parser.add_argument("--rows-per-task", type=int, default=16, metavar="N")
    arguments = parser.parse_args()
    if arguments.rows_per_task < 1:
        parser.error("--rows-per-task: expected a whole number ≥ 1")
    try:
        sweep = Sweep.read(arguments.sweep, arguments.out)
        # One thread per task: Ray counts a task as one core.
        environment = {"env_vars": {"RAYON_NUM_THREADS": "1"}}
        if arguments.address:
            ray.init(address=arguments.address, runtime_env=environment)
        else:
            ray.init(include_dashboard=False, _node_ip_address="127.0.0.1", runtime_env=environment)
        run(sweep, arguments.out, arguments.rows_per_task)
        print(sweep.merge(arguments.out))
    except FlyvineError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
