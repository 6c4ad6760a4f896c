"""Plans, flights and controllers."""

import numpy as np
import pytest

import flyvine
from conftest import LEMNISCATE


def test_a_plan_is_the_models_own_rollout(lemniscate, bank, tmp_path):
    assert lemniscate.converged
    n = lemniscate.states.shape[1]
    assert lemniscate.commands.shape == (lemniscate.knots - 1, 3)
    assert lemniscate.gains.shape == (lemniscate.knots - 1, 3, n)
    rolled = bank.at(0.7, 0.0).rollout(lemniscate.states[0], lemniscate.commands)
    np.testing.assert_allclose(rolled, lemniscate.states, atol=1e-9)
    path = tmp_path / "plan.json"
    lemniscate.write(path)
    again = flyvine.Plan.read(path)
    np.testing.assert_array_equal(again.commands, lemniscate.commands)
    lemniscate.write_csv(tmp_path / "plan.csv")
    table = np.genfromtxt(tmp_path / "plan.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["cmd_x"][:-1], lemniscate.commands[:, 0])


def test_scores_are_mean_rms_and_greatest_distance(lemniscate):
    outcome = flyvine.fly(lemniscate, seed=3)
    assert outcome.completed and outcome.cause is None
    score = flyvine.score(outcome.flight, lemniscate)
    distance = np.linalg.norm(outcome.flight.states()[:, 6:9] - lemniscate.reference, axis=1)
    assert score["ee_vs_reference"]["mean_m"] == pytest.approx(distance.mean(), rel=1e-12)
    assert score["ee_vs_reference"]["rms_m"] == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-12)
    assert score["ee_vs_reference"]["max_m"] == pytest.approx(distance.max(), rel=1e-12)
    assert score["ee_vs_reference"]["mean_m"] < 0.1


def test_many_flights_are_the_single_ones_in_order(swing):
    seeds = [5, 6, 7]
    vehicles = [flyvine.Vehicle(f"[payload]\ntip_mass_kg = {mass}") for mass in (0.0, 0.02, 0.04)]
    many = flyvine.fly_many(swing, seeds, vehicles)
    for seed, vehicle, outcome in zip(seeds, vehicles, many):
        assert outcome.flight == flyvine.fly(swing, vehicle, seed=seed).flight
    assert many[0].flight != many[2].flight


class Wrapped:
    """A vehicle of one's own: the simulated one behind Python."""

    def __init__(self):
        self.vehicle = flyvine.Vehicle()

    def reset(self, length_m, pressure_kpa, seed):
        return self.vehicle.reset(length_m, pressure_kpa, seed)

    def step(self, command, length_m, pressure_kpa):
        return self.vehicle.step(command, length_m, pressure_kpa)


class OwnOpenLoop:
    """A controller of one's own."""

    def __init__(self, plan):
        self.commands = plan.commands

    def propose(self, knot, quadrotor, end_effector, held_command):
        return self.commands[knot]


def test_own_vehicles_and_controllers_fly_as_the_built_in_ones(swing):
    built_in = flyvine.fly(swing, seed=2).flight
    assert flyvine.fly(swing, Wrapped(), seed=2).flight == built_in
    assert flyvine.fly(swing, None, OwnOpenLoop(swing), seed=2).flight == built_in


def test_exceptions_of_own_vehicles_and_controllers_come_through(swing):
    class Broken(Wrapped):
        def step(self, command, length_m, pressure_kpa):
            raise KeyError("the rig is gone")

    with pytest.raises(KeyError, match="the rig is gone"):
        flyvine.fly(swing, Broken())

    class Lost(OwnOpenLoop):
        def propose(self, *arguments):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        flyvine.fly(swing, None, Lost(swing))
    with pytest.raises(flyvine.FlyvineError, match="flyvine.Observation"):
        flyvine.fly(swing, type("Mute", (), {"reset": lambda *a: None})())


def test_a_nan_from_a_controller_is_an_abort_with_its_recording(swing):
    class NotANumber(OwnOpenLoop):
        def propose(self, knot, *rest):
            return self.commands[knot] if knot < 10 else [np.nan, 0.0, 1.5]

    outcome = flyvine.fly(swing, None, NotANumber(swing))
    assert not outcome.completed and outcome.cause
    assert len(outcome.flight) >= 10


@pytest.mark.parametrize("law", ["open-loop", "tracking", "mpc"])
def test_a_controller_stepped_by_hand_flies_the_same_flight(physical_lemniscate, law):
    """The caller's own loop and the library's, to the last bit, for two seconds."""
    plan = physical_lemniscate
    expected = flyvine.fly(plan, controller=law, seed=4)
    knots = 40
    assert len(expected.flight) > knots
    vehicle, controller = flyvine.Vehicle(), flyvine.Controller(plan, law)
    seen = vehicle.reset(0.7, 0.0, seed=4)
    held, commands = plan.states[0, :3], []
    for knot in range(knots):
        held = controller.step(knot, seen.quadrotor, seen.end_effector, held)
        commands.append(held)
        seen = vehicle.step(held, 0.7, 0.0)
    np.testing.assert_array_equal(commands, expected.flight.commands()[:knots])
    assert (controller.report() is not None) == (law == "mpc")


def test_what_cannot_be_flown_is_refused_in_words(swing):
    with pytest.raises(flyvine.FlyvineError, match="found pid, expected open-loop, tracking, mpc, replan"):
        flyvine.Controller(swing, "pid")
    with pytest.raises(flyvine.FlyvineError, match="unknown field `stage`"):
        flyvine.Controller(swing, "open-loop", mpc={"stage": 3})
    with pytest.raises(flyvine.VehicleError, match="wind.gust_m_s = -1"):
        flyvine.Vehicle("[wind]\ngust_m_s = -1.0")
    with pytest.raises(flyvine.VehicleError, match="length 5 m"):
        flyvine.Vehicle().reset(5.0, 0.0)
    with pytest.raises(flyvine.TaskError, match="exactly one"):
        flyvine.Task.parse(LEMNISCATE.split("[lemniscate]")[0])
    controller = flyvine.Controller(swing)
    with pytest.raises(flyvine.FlyvineError, match="quadrotor: found NaN"):
        controller.step(0, [np.nan] * 7, [0, 0, 0.8], [0, 0, 1.5])
    with pytest.raises(flyvine.FlyvineError, match="end_effector: found 2 numbers, expected 3"):
        controller.step(0, None, [0, 0], [0, 0, 1.5])


def test_a_run_makes_a_report(lemniscate, tmp_path):
    flyvine.add_experiment(tmp_path, lemniscate, flyvine.fly(lemniscate).flight)
    page = flyvine.report(tmp_path)
    text = open(page, encoding="utf-8").read()
    assert "lemniscate" in text and "<svg" in text
    with pytest.raises(flyvine.RunError, match="not a run folder"):
        flyvine.report(tmp_path / "figures")
