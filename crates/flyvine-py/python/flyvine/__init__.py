"""flyvine: from motion-capture logs to flights of a drone with a soft arm whose tip goes where it is told.

World frame ENU, metres, seconds, radians, kilograms; pressure in kPa gauge; quaternions Hamilton, world from body,
scalar first. Commands are quadrotor positions every ``DT`` = 0.05 s.

    flights = [flyvine.Flight.read(path).clean()[0] for path in paths]
    bank, report = flyvine.fit(flights)
    plan = flyvine.make_plan(flyvine.Task.read("swing.toml"), bank)
    outcome = flyvine.fly(plan, controller="mpc")
    print(flyvine.score(outcome.flight, plan))
"""

from ._flyvine import (
    DT,
    SIGNALS,
    Bank,
    ControlError,
    Controller,
    Flight,
    FlightError,
    FlyvineError,
    Model,
    ModelError,
    Observation,
    Outcome,
    Plan,
    PlanError,
    RunError,
    ScoreError,
    Sweep,
    SweepError,
    Task,
    TaskError,
    Vehicle,
    VehicleError,
    __version__,
    add_experiment,
    fit,
    fly,
    fly_many,
    make_plan,
    regress,
    regulate,
    report,
    score,
)

__all__ = [
    "DT",
    "SIGNALS",
    "Bank",
    "ControlError",
    "Controller",
    "Flight",
    "FlightError",
    "FlyvineError",
    "Model",
    "ModelError",
    "Observation",
    "Outcome",
    "Plan",
    "PlanError",
    "RunError",
    "ScoreError",
    "Sweep",
    "SweepError",
    "Task",
    "TaskError",
    "Vehicle",
    "VehicleError",
    "__version__",
    "add_experiment",
    "fit",
    "fly",
    "fly_many",
    "make_plan",
    "regress",
    "regulate",
    "report",
    "score",
]
