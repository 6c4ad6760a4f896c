"""Types of flyvine. Shapes: N knots or rows, n entries of the state z, m entries of the command u (3)."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, Protocol, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
DT: float
"""Time between commands, rows and knots: 0.05 s."""
SIGNALS: list[str]
"""Names of the nine entries of the state x."""

Array = NDArray[np.float64]
Path = Union[str, PathLike[str]]
Law = Literal["open-loop", "tracking", "mpc", "replan"]

class FlyvineError(ValueError):
    """What flyvine refuses: the message names place, what was found and what was expected."""

class FlightError(FlyvineError): ...
class ModelError(FlyvineError): ...
class TaskError(FlyvineError): ...
class PlanError(FlyvineError): ...
class VehicleError(FlyvineError): ...
class ControlError(FlyvineError): ...
class ScoreError(FlyvineError): ...
class RunError(FlyvineError): ...
class SweepError(FlyvineError): ...

class Flight:
    """One recording at 20 Hz: row k holds the poses at t_k and the command issued then. Immutable."""

    @staticmethod
    def read(path: Path, mapping: Path | None = None) -> Flight:
        """Reads a CSV or MCAP file; with a column mapping (TOML) anyone's CSV, resampled."""
    @staticmethod
    def recover(path: Path) -> Flight:
        """Reads what is whole in an MCAP file that was cut off."""
    @staticmethod
    def from_arrays(columns: Mapping[str, ArrayLike], name: str = "flight") -> Flight:
        """A flight from its columns (as in ``arrays``; a dict or a data frame); NaN poses are missing. They pass the same
        checks as a file: numbers, units, clock, quaternions."""
    @property
    def name(self) -> str: ...
    def __len__(self) -> int: ...
    def arrays(self) -> dict[str, Array]:
        """The columns of the CSV format, each (rows,): ``t_s`` (s), ``length_m``, ``pressure_kpa``, ``cmd_x`` … (m), ``qr_x``
        … (m), ``qr_qw`` …, ``ee_x`` … (m); ``cmd_vx`` … (m/s) where recorded. Missing poses are NaN. Fits
        ``pandas.DataFrame`` and ``polars.DataFrame`` as it is."""
    def states(self) -> Array:
        """x (rows × 9), NaN where a pose is missing; columns are ``SIGNALS``."""
    def commands(self) -> Array:
        """u (rows × 3), m."""
    def clean(
        self,
        *,
        jump_tolerance_m: float = 0.06,
        tip_jump_tolerance_m: float = 0.075,
        turn_tolerance: float = 0.12,
        max_excursion_rows: int = 10,
        command_spike_m: float = 0.5,
    ) -> tuple[Flight, dict[str, Any]]:
        """The flight without what motion capture got wrong, and the report of what that was."""
    def write(self, path: Path) -> None:
        """Writes .csv or .mcap, whole or not at all."""

def fit(
    flights: Sequence[Flight],
    family: Literal["auto", "lag", "physical"] = "auto",
    options: Mapping[str, Any] | None = None,
) -> tuple[Bank, dict[str, Any]]:
    """Fits models at the flown configurations; ``auto`` keeps the family that predicts held-out flights better. ``options``
    are the lag family's: ``structure``, ``lags``, ``height_ridge``, ``linear_ridge``, ``command_velocity``,
    ``positions``, ``refinement``. Returns the bank and the report."""

class Bank:
    """Models at the flown configurations and the bilinear interpolation between them. Immutable."""

    @staticmethod
    def read(path: Path, extrapolate: bool = False) -> Bank: ...
    def write(self, path: Path) -> None: ...
    def configurations(self) -> Array:
        """Of its models (models × 2): length, m, and pressure, kPa."""
    def covers(self, length_m: float, pressure_kpa: float) -> bool: ...
    def at(self, length_m: float, pressure_kpa: float) -> Model:
        """The model at one configuration."""
    def along(self, configurations: ArrayLike) -> Model:
        """The time-varying model along configurations (steps × 2): length, m, and pressure, kPa."""
    def check(self, flights: Sequence[Flight]) -> dict[str, Any]:
        """One-step errors, end-effector rollout errors at 0.5 to 10 s, spectral radii."""
    def to_dict(self) -> dict[str, Any]: ...

class Model:
    """One predictor z⁺ = f(z, u). The first nine entries of z are x. Immutable."""

    @property
    def state_len(self) -> int: ...
    @property
    def command_len(self) -> int: ...
    @property
    def lags(self) -> int:
        """States x that z is made of, the newest first; 1 where what follows is hidden."""
    def rest_state(self) -> Array:
        """z at rest, hovering at (0, 0, 1.5) (n,)."""
    def step(self, state: ArrayLike, command: ArrayLike, step: int = 0) -> Array:
        """z⁺ (n,)."""
    def jacobian(self, state: ArrayLike, command: ArrayLike, step: int = 0) -> tuple[Array, Array]:
        """A (n × n) and B (n × m)."""
    def rollout(self, state: ArrayLike, commands: ArrayLike) -> Array:
        """States from ``state`` on under ``commands`` (N × m): (N + 1) × n."""
    def spectral_radius(self) -> float:
        """Largest modulus of the eigenvalues of A at rest."""

def regress(
    regressors: ArrayLike,
    response: ArrayLike,
    names: Sequence[str] | None = None,
    intercept: bool = False,
) -> dict[str, Any]:
    """Ordinary least squares of ``response`` (rows,) on ``regressors`` (rows × columns), by QR, with its statistics;
    ``intercept`` says that column 0 is the constant."""

def regulate(a: Array, b: Array, state_weights: ArrayLike, command_weights: ArrayLike) -> Array:
    """Gains K_k (N × m × n) of the linear-quadratic regulator u = K_k z for z⁺ = A_k z + B_k u, A (N × n × n), B (N × n × m),
    minimizing Σ zᵀ Q z + uᵀ R u with diagonal Q (n,) and R (m,)."""

class Task:
    """What the end effector shall do. Immutable."""

    @staticmethod
    def read(path: Path) -> Task: ...
    @staticmethod
    def parse(text: str, name: str = "task") -> Task: ...
    @property
    def name(self) -> str: ...
    @property
    def knots(self) -> int: ...
    def to_dict(self) -> dict[str, Any]: ...

def make_plan(task: Task, bank: Bank) -> Plan:
    """The commands that do the task best by the bank's models."""

class Plan:
    """The optimized motion for one task on one bank. Immutable."""

    @staticmethod
    def read(path: Path) -> Plan: ...
    def write(self, path: Path) -> None: ...
    def write_csv(self, path: Path) -> None:
        """Commands and configurations, for another base station."""
    @property
    def name(self) -> str: ...
    @property
    def knots(self) -> int: ...
    @property
    def commands(self) -> Array:
        """u*_k ((N − 1) × 3), m."""
    @property
    def states(self) -> Array:
        """z*_k (N × n)."""
    @property
    def gains(self) -> Array:
        """K_k ((N − 1) × 3 × n) in u = u*_k + K_k (z − z*_k)."""
    @property
    def reference(self) -> Array:
        """End-effector reference (N × 3), m."""
    @property
    def configurations(self) -> Array:
        """Length, m, and pressure, kPa (N × 2)."""
    @property
    def converged(self) -> bool: ...
    @property
    def solve(self) -> dict[str, Any]:
        """How the solve ended."""
    @property
    def bank(self) -> Bank: ...

class Observation:
    """What a vehicle reports; None for a pose that motion capture missed. Immutable."""

    def __init__(
        self, t_s: float, quadrotor: ArrayLike | None = None, end_effector: ArrayLike | None = None
    ) -> None: ...
    @property
    def t_s(self) -> float: ...
    @property
    def quadrotor(self) -> Array | None:
        """x, y, z, m, and the attitude w, x, y, z (7,)."""
    @property
    def end_effector(self) -> Array | None:
        """x, y, z, m (3,)."""

class Vehicle:
    """The simulated vehicle: quadrotor, autopilot, soft arm, motion capture."""

    def __init__(self, toml: str = "") -> None:
        """From the text of a vehicle's TOML; what is left out is as calibrated."""
    @staticmethod
    def read(path: Path) -> Vehicle: ...
    @property
    def parameters(self) -> dict[str, Any]: ...
    def reset(self, length_m: float = 0.7, pressure_kpa: float = 0.0, seed: int = 1) -> Observation: ...
    def step(
        self,
        command: ArrayLike,
        length_m: float = 0.7,
        pressure_kpa: float = 0.0,
        *,
        velocity: ArrayLike | None = None,
    ) -> Observation:
        """Holds ``command`` (3,), m, for ``DT``; ``velocity`` (3,), m/s, is fed forward."""
    def truth(self) -> dict[str, Any]:
        """Without noise: ``t_s``, ``quadrotor`` (7,), ``end_effector`` (3,), ``nodes`` of the arm (links + 1, 3),
        ``configuration`` (2,)."""

class VehicleLike(Protocol):
    """Anybody's vehicle: :func:`fly` flies it in lockstep."""

    def reset(self, length_m: float, pressure_kpa: float, seed: int) -> Observation:
        """Hover at (0, 0, 1.5) with the arm at rest."""
    def step(self, command: Array, length_m: float, pressure_kpa: float) -> Observation:
        """Hold ``command`` (3,), m, for ``DT``. Plans with ``feedforward = "velocity"`` pass ``velocity`` (3,), m/s, as a
        keyword; others do not."""

class ControllerLike(Protocol):
    """Anybody's control law: :func:`fly` asks it at every knot."""

    def propose(
        self, knot: int, quadrotor: Array | None, end_effector: Array | None, held_command: Array
    ) -> ArrayLike | None:
        """The command (3,), m; None if there is none within the tick."""

class Controller:
    """A control law on a plan, stepped by the caller, knot by knot from 0. It proposes; keeping the vehicle inside its room is
    the caller's: :func:`fly` has a supervisor for that."""

    def __init__(
        self,
        plan: Plan,
        law: Law = "open-loop",
        *,
        mpc: Mapping[str, Any] | None = None,
        limits: Mapping[str, Any] | None = None,
        step_limit_ms: float | None = None,
        reference: ArrayLike | None = None,
    ) -> None: ...
    @property
    def law(self) -> str: ...
    @property
    def steps(self) -> int:
        """Commands to propose: one for each knot but the last."""
    def step(
        self,
        knot: int,
        quadrotor: ArrayLike | None,
        end_effector: ArrayLike | None,
        held_command: ArrayLike,
    ) -> Array | None:
        """The command u_k (3,), m, for the poses at t_k: quadrotor (7,): x, y, z, m, and w, x, y, z; end effector (3,), m; None
        for what motion capture missed. ``held_command`` (3,), m, was held until t_k. None: no answer within the tick."""
    def report(self) -> dict[str, Any] | None:
        """What a controller that optimizes says of its last step."""

class Outcome:
    """What became of a flight. Immutable."""

    @property
    def flight(self) -> Flight: ...
    @property
    def completed(self) -> bool: ...
    @property
    def cause(self) -> str | None:
        """Why it was cut short."""
    @property
    def events(self) -> list[str]:
        """What the supervisor had to say."""
    @property
    def step_ms(self) -> Array:
        """Wall-clock times of a controller that optimizes (steps,), ms."""

def fly(
    plan: Plan,
    vehicle: Vehicle | VehicleLike | str | None = None,
    controller: Law | ControllerLike | None = None,
    *,
    seed: int = 1,
    mpc: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
    step_limit_ms: float | None = None,
    reference: ArrayLike | None = None,
) -> Outcome:
    """Flies a plan. A supervisor owns every command. ``vehicle``: the simulated one (default), ``exec:PROGRAM ARGS``, or any
    object with ``reset`` and ``step``."""

def fly_many(
    plan: Plan,
    seeds: Sequence[int],
    vehicles: Sequence[Vehicle] | None = None,
    controller: Law = "open-loop",
    *,
    mpc: Mapping[str, Any] | None = None,
    limits: Mapping[str, Any] | None = None,
) -> list[Outcome]:
    """Flies many simulated vehicles on all cores, one per seed; the results do not depend on the number of threads."""

def score(flight: Flight, plan: Plan) -> dict[str, Any]:
    """Mean, RMS and greatest 3-D distance, m, of the end effector to the reference and to the prediction."""

def add_experiment(run: Path, plan: Plan, flight: Flight) -> None:
    """Writes a plan and its flight into a run folder."""

def report(run: Path) -> str:
    """Makes report.html and figures/*.svg from a run folder; returns the page's path."""

class Sweep:
    """Flights of plans on many simulated vehicles. It can be pickled, and carries everything that its rows need."""

    @staticmethod
    def read(path: Path, folder: Path) -> Sweep:
        """Reads a sweep's file; its tasks are planned, once, into ``folder``/plans."""
    @staticmethod
    def from_bytes(bytes: bytes) -> Sweep: ...
    def to_bytes(self) -> bytes: ...
    @property
    def name(self) -> str: ...
    def __len__(self) -> int: ...
    def row(self, index: int) -> dict[str, Any]:
        """What is flown in a row."""
    def key(self, index: int) -> str:
        """Hash of everything that determines a row."""
    def missing(self, folder: Path) -> NDArray[np.uint64]:
        """Indices of the rows that no journal in ``folder`` has."""
    def compute(self, indices: Sequence[int]) -> list[tuple[str, str]]:
        """Flies rows, on all cores of this process: (key, result as JSON) each."""
    def keep(self, folder: Path, rows: Sequence[tuple[str, str]]) -> None:
        """Appends computed rows to the journal in ``folder``."""
    def run(self, folder: Path, shard: tuple[int, int] = (1, 1)) -> int:
        """Computes every row of shard (i, n) that no journal in ``folder`` has; returns how many."""
    def merge(self, folder: Path, others: Sequence[Path] = ()) -> str:
        """Writes ``folder``/results.parquet from the journals of ``folder`` and ``others``."""
    def summary(self, folder: Path) -> dict[str, Any]:
        """Shares of success, quantiles of errors, and the worst flights."""
