import numpy as np
import pytest

import flyvine


def test_arrays_come_back_to_the_last_bit(recordings, tmp_path):
    flight = recordings[0]
    again = flyvine.Flight.from_arrays(flight.arrays(), flight.name)
    assert again == flight
    for suffix in ("csv", "mcap"):
        path = tmp_path / f"training_0.{suffix}"
        flight.write(path)
        assert flyvine.Flight.read(path) == flight


def test_arrays_own_their_memory_and_fit_a_data_frame(recordings):
    columns = recordings[0].arrays()
    states = recordings[0].states()
    assert states.shape == (len(recordings[0]), 9) and states.flags["C_CONTIGUOUS"]
    # Handed over, not copied into a buffer of Python's: numpy frees them through Rust.
    assert states.base is not None
    np.testing.assert_array_equal(states[:, 6], columns["ee_x"])
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns)
    assert len(frame) == len(recordings[0]) and frame["qr_z"].between(1.0, 2.2).all()
    assert flyvine.Flight.from_arrays(frame, recordings[0].name) == recordings[0]


def test_hygiene_finds_what_was_put_in(recordings):
    columns = recordings[0].arrays()
    columns["ee_x"][100] += 0.5
    for name in ("ee_x", "ee_y", "ee_z"):
        columns[name][300:303] = np.nan
    flight, report = flyvine.Flight.from_arrays(columns).clean()
    rejected = np.flatnonzero(np.isnan(flight.states()).any(axis=1))
    assert set(rejected) >= {100, 300, 301, 302}
    bodies = {finding["body"] for finding in report["findings"]}
    assert "end_effector" in bodies


def test_errors_say_file_line_and_column(recordings, tmp_path):
    path = tmp_path / "bad.csv"
    recordings[0].write(path)
    lines = path.read_text().splitlines()
    lines[5] = "x" + lines[5][1:]
    path.write_text("\n".join(lines))
    with pytest.raises(flyvine.FlightError, match=r"bad\.csv.*6.*t_s") as error:
        flyvine.Flight.read(path)
    assert isinstance(error.value, ValueError)
    with pytest.raises(flyvine.FlightError, match="nothing.csv"):
        flyvine.Flight.read(tmp_path / "nothing.csv")
    columns = recordings[0].arrays()
    columns["cmd_x"][3] = np.inf
    with pytest.raises(flyvine.FlightError, match="cmd_x"):
        flyvine.Flight.from_arrays(columns)
    columns = recordings[0].arrays()
    columns["ee_z"] = columns["ee_z"][:-1]
    with pytest.raises(flyvine.FlyvineError, match="column ee_z"):
        flyvine.Flight.from_arrays(columns)
    with pytest.raises(flyvine.FlyvineError, match="unknown field"):
        recordings[0].clean(jump_m=1.0)
