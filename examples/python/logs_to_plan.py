"""From logs to a plan. Cells are marked by `# %%`: Jupyter (with jupytext), VS Code and Spyder open this as a notebook.

    python logs_to_plan.py [FLIGHT.csv …]

Without files, it flies four training flights on the simulated vehicle first, and works on those.
"""

# %% [markdown]
# # From your logs to a plan
# Recordings in, models out, and a plan on them: what `flyvine fit`, `check` and `plan` do, with everything in arrays.

# %%
import sys
import tempfile
from pathlib import Path

import numpy as np

import flyvine

folder = Path(tempfile.mkdtemp(prefix="flyvine-"))
files = [Path(name) for name in sys.argv[1:] if Path(name).suffix in (".csv", ".mcap")]

# %% [markdown]
# ## Recordings
# Yours, or four made here: lemniscates whose period shrinks, at several heights, on the simulated vehicle.


# %%
def fly_and_record(seed: int) -> flyvine.Flight:
    t = np.arange(0.0, 40.0, flyvine.DT)
    phase = np.cumsum(2 * np.pi * flyvine.DT / np.linspace(12.0, 4.0 + seed, t.size))
    commands = np.column_stack(
        [np.sin(phase), np.cos(phase) * np.sin(phase), 1.5 + 0.1 * np.sin((0.5 + 0.2 * seed) * t)]
    )
    vehicle = flyvine.Vehicle()
    seen = [vehicle.reset(0.7, 0.0, seed=seed)]
    seen += [vehicle.step(command, 0.7, 0.0) for command in commands[:-1]]
    columns = {"t_s": t, "length_m": np.full_like(t, 0.7), "pressure_kpa": np.zeros_like(t)}
    columns |= dict(zip(["cmd_x", "cmd_y", "cmd_z"], commands.T))
    quadrotor = np.array([s.quadrotor for s in seen]).T
    columns |= dict(zip(["qr_x", "qr_y", "qr_z", "qr_qw", "qr_qx", "qr_qy", "qr_qz"], quadrotor))
    columns |= dict(zip(["ee_x", "ee_y", "ee_z"], np.array([s.end_effector for s in seen]).T))
    return flyvine.Flight.from_arrays(columns, name=f"training_{seed}")


if not files:
    for seed in range(4):
        files.append(folder / f"training_{seed}.csv")
        fly_and_record(seed).write(files[-1])

# %% [markdown]
# ## Reading and cleaning
# What motion capture got wrong is found, reported and kept out of every fit.

# %%
flights = []
for file in files:
    flight, report = flyvine.Flight.read(file).clean()
    print(f"{flight.name}: {report['rows_with_state']} of {report['rows']} rows, {len(report['findings'])} findings")
    flights.append(flight)

# %% [markdown]
# ## Models
# The last recording is held out, and judges.

# %%
bank, fitted = flyvine.fit(flights[:-1], family="lag")
checked = bank.check(flights[-1:])
for window in checked["flights"][0]["rollout"]:
    print(f"{window['horizon_s']:4.1f} s ahead: median {100 * (window['median_m'] or np.nan):.1f} cm")

# %% [markdown]
# ## A plan, flown and scored

# %%
task = flyvine.Task.parse(
    """
name = "lemniscate_10s"
[configuration]
length_m = 0.7
pressure_kpa = 0.0
[lemniscate]
period_s = 10.0
ramp_s = 2.0
"""
)
plan = flyvine.make_plan(task, bank)
print(plan, plan.commands.shape, plan.gains.shape)
outcome = flyvine.fly(plan, seed=1)
score = flyvine.score(outcome.flight, plan)
print(f"flown open loop: {100 * score['ee_vs_reference']['mean_m']:.1f} cm mean error")

# %% [markdown]
# ## Files for the others
# The plan for `flyvine fly`, a table for a base station, and a report.

# %%
plan.write(folder / "plan.json")
plan.write_csv(folder / "commands.csv")
flyvine.add_experiment(folder / "run", plan, outcome.flight)
print("report:", flyvine.report(folder / "run"))
