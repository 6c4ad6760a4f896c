"""The examples run, and do what they say."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples" / "python"


def run(name: str, monkeypatch, *arguments) -> dict:
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    return runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_from_logs_to_a_plan(recordings, tmp_path, monkeypatch):
    paths = [tmp_path / f"{flight.name}.csv" for flight in recordings]
    for flight, path in zip(recordings, paths):
        flight.write(path)
    done = run("logs_to_plan.py", monkeypatch, *paths)
    assert done["plan"].converged
    assert done["score"]["ee_vs_reference"]["mean_m"] < 0.1
    assert (done["folder"] / "run" / "report.html").exists()


def test_data_frames(recordings, tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas")
    pytest.importorskip("polars")
    recordings[0].write(tmp_path / "flight.mcap")
    run("data_frames.py", monkeypatch, tmp_path / "flight.mcap")
    assert "faster than 1 m/s" in capsys.readouterr().out


def test_mpc_flies_a_mujoco_vehicle(monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import mujoco_vehicle

    errors = mujoco_vehicle.main()
    assert errors["open-loop"] < 0.15 and errors["mpc"] < 0.05
