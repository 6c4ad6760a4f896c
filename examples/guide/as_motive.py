"""A flight in flyvine's CSV as a log that a laboratory might have: `as_motive.py flight.csv log.csv`.

OptiTrack Motive's axes (y up) and millimetres, time in milliseconds at 120 Hz, commands in metres where one was sent,
pressure in psi: what examples/mappings/motive_mm.toml reads. For the guide, which has no laboratory.
"""
import csv, sys

STEPS = 6  # rows per 50 ms


def main(source, target):
    with open(source, newline="") as file:
        rows = list(csv.DictReader(file))
    columns = ["time_ms", "setpoint.x", "setpoint.y", "setpoint.z"]
    columns += [f"drone.{c}" for c in ["x", "y", "z", "qx", "qy", "qz", "qw"]] + [f"tip.{c}" for c in "xyz"]
    columns += ["arm_length_mm", "pressure_psi"]
    with open(target, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row, after in zip(rows, rows[1:]):
            for step in range(STEPS):
                writer.writerow(log_row(row, after, step))


def log_row(row, after, step):
    def between(name):
        a, b = row[name], after[name]
        return None if "" in (a, b) else float(a) + step / STEPS * (float(b) - float(a))

    def position(prefix, scale):
        x, y, z = (between(f"{prefix}_{axis}") for axis in "xyz")
        return ["", "", ""] if x is None else [f"{scale * v:.4f}" for v in (x, z, -y)]  # y up

    w, x, y, z = (between(f"qr_q{part}") for part in "wxyz")
    attitude = [""] * 4 if w is None else [f"{v:.6f}" for v in (x, z, -y, w)]
    command = [row["cmd_x"], row["cmd_z"], str(-float(row["cmd_y"]))] if step == 0 else ["", "", ""]
    time_ms = 1e3 * float(row["t_s"]) + 50.0 * step / STEPS
    configuration = [1e3 * float(row["length_m"]), float(row["pressure_kpa"]) / 6.894757]
    return [f"{time_ms:.3f}", *command, *position("qr", 1e3), *attitude, *position("ee", 1e3), *configuration]


main(*sys.argv[1:])
