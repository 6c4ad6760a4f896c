"""Sweeps: the same rows and bytes as the command line's engine, whoever computes them."""

import json
import os
import pickle
import subprocess
import sys

import pytest

import flyvine

ROWS = 8


@pytest.fixture(scope="session")
def sweep_file(swing, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    swing.write(folder / "plan.json")
    path = folder / "sweep.toml"
    path.write_text(
        """
name = "payload"
plans = ["plan.json"]
seeds = 4
[grid]
"payload.tip_mass_kg" = [0.0, 0.02]
[spread]
"arm.tip_mass_kg" = { relative = 0.1 }
"""
    )
    return path


@pytest.fixture(scope="session")
def whole(sweep_file):
    """The folder of the sweep, run by the engine itself."""
    folder = sweep_file.parent / "whole"
    sweep = flyvine.Sweep.read(sweep_file, folder)
    assert sweep.run(folder) == ROWS
    sweep.merge(folder)
    return folder


def table(folder) -> bytes:
    return (folder / "results.parquet").read_bytes()


def test_rows_computed_elsewhere_make_the_same_table(sweep_file, whole, tmp_path):
    sweep = pickle.loads(pickle.dumps(flyvine.Sweep.read(sweep_file, tmp_path)))
    assert len(sweep) == ROWS
    sweep.keep(tmp_path, sweep.compute([5, 1]))
    assert list(sweep.missing(tmp_path)) == [0, 2, 3, 4, 6, 7]
    with pytest.raises(flyvine.SweepError, match="6 of 8 rows are missing"):
        sweep.merge(tmp_path)
    assert sweep.run(tmp_path) == 6
    sweep.merge(tmp_path)
    assert table(tmp_path) == table(whole)


def test_a_row_says_what_is_flown_and_its_flight_agrees(sweep_file, whole, swing):
    sweep = flyvine.Sweep.read(sweep_file, whole)
    row = sweep.row(6)
    assert row["controller"] == "open-loop" and row["payload.tip_mass_kg"] == 0.02 and row["seed"] == 3
    vehicle = flyvine.Vehicle(
        f"[payload]\ntip_mass_kg = 0.02\n[arm]\ntip_mass_kg = {row['arm.tip_mass_kg']!r}\n"
    )
    flight = flyvine.fly(swing, vehicle, seed=3).flight.clean()[0]
    [(key, result)] = sweep.compute([6])
    assert key == sweep.key(6)
    assert json.loads(result)["score"] == flyvine.score(flight, swing)
    with pytest.raises(flyvine.FlyvineError, match="row: found 8, expected less than 8"):
        sweep.compute([8])


def test_a_summary_counts_every_flight(sweep_file, whole):
    summary = flyvine.Sweep.read(sweep_file, whole).summary(whole)
    [group] = summary["groups"]
    assert (group["flights"], summary["flights"]) == (ROWS, ROWS)
    assert len(summary["worst"]) == ROWS
    errors = [row["error_m"] for row in summary["worst"]]
    ended = [error for error in errors if error is not None]
    assert ended == sorted(ended, reverse=True)


def test_sql_over_tables(whole):
    pytest.importorskip("duckdb")
    from flyvine.query import query

    sql = "SELECT payload_tip_mass_kg, count(*), min(seed), max(seed) FROM rows GROUP BY 1 ORDER BY 1"
    assert query([str(whole)], sql).fetchall() == [(0.0, 4, 1, 4), (0.02, 4, 1, 4)]
    command = [sys.executable, "-m", "flyvine.query"]
    listed = subprocess.run(
        [*command, "--json", str(whole), "SELECT key, ee_vs_reference_mean_m AS e FROM rows WHERE seed = 1"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert len(listed.stdout.splitlines()) == 2
    refused = subprocess.run([*command, str(whole), "SELECT nothing FROM rows"], capture_output=True, text=True)
    assert refused.returncode == 2 and "nothing" in refused.stderr


def test_ray_computes_the_same_bytes(sweep_file, whole, tmp_path):
    if os.environ.get("FLYVINE_REQUIRE_RAY") != "1":
        pytest.importorskip("ray")
    environment = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
    subprocess.run(
        [sys.executable, "-m", "flyvine.ray", sweep_file, "--out", tmp_path, "--rows-per-task", "3"],
        check=True,
        env=environment,
    )
    assert table(tmp_path) == table(whole)
