"""Makes the logs of PX4 in this folder, and what is in them by pyulog and numpy:

    python make_ulogs.py sample-small.ulg      (pip install pyulog==1.3.0)

px4_flight.ulg is a real flight: sample-small.ulg of the crate ulog-rs 0.0.4 (MIT), a quadrotor with PX4 1.14, of which pyulog
keeps the topics that make a flight. Its last set-points with a position, five a second, are those of AUTO.LAND.
px4_flight.csv is that flight as flyvine should read it, with poses up to 0.25 s apart interpolated.

px4_offboard.ulg is made here, by the description of the format (docs.px4.io, "ULog File Format"): 6 s at 1 s to 7 s after boot,
OFFBOARD from 2 s on. pyulog reads it back.
"""

import struct
import sys

import numpy as np
from pyulog import ULog

TOPICS = ["vehicle_local_position", "vehicle_attitude", "trajectory_setpoint", "vehicle_status"]


def topic(log, name):
    return next(data for data in log.data_list if data.name == name).data


def real(path):
    log = ULog(path, message_name_filter_list=TOPICS)
    log._msg_info_multiple_dict.clear()
    log._message_formats = {name: form for name, form in log._message_formats.items() if name in TOPICS}
    log.write_ulog("px4_flight.ulg")
    log = ULog("px4_flight.ulg")
    command = topic(log, "trajectory_setpoint")
    u = np.stack([command[f"position[{i}]"] for i in range(3)], axis=1).astype(float)
    (good,) = np.where(np.isfinite(u).all(axis=1))
    assert (np.diff(good) == 1).all()
    stamps, u = command["timestamp"][good] * 1e-6, u[good]
    position, attitude = topic(log, "vehicle_local_position"), topic(log, "vehicle_attitude")
    where = np.stack([position[i] for i in "xyz"], axis=1).astype(float)
    q = np.stack([attitude[f"q[{i}]"] for i in range(4)], axis=1).astype(float)
    q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1, 1))[:, None]
    t = stamps[0] + 0.05 * np.arange(int((stamps[-1] - stamps[0]) / 0.05) + 1)
    seen, turned = position["timestamp_sample"] * 1e-6, attitude["timestamp_sample"] * 1e-6
    # The attitude at the positions' times, and then both at the flight's: as a flight's poses are.
    q = np.stack([np.interp(seen, turned, q[:, i]) for i in range(4)], axis=1)
    ned = np.stack([np.interp(t, seen, where[:, i]) for i in range(3)], axis=1)
    q = np.stack([np.interp(t, seen, q[:, i]) for i in range(4)], axis=1)
    # A row's command is the mean of those that acted until the next row: the integral of what is held, which is linear in between.
    ends = np.append(stamps, t[-1] + 1.0)
    integral = np.vstack([np.zeros(3), np.cumsum(u * np.diff(ends)[:, None], axis=0)])
    u = np.stack([np.interp(t + 0.05, ends, i) - np.interp(t, ends, i) for i in integral.T], axis=1) / 0.05
    with open("px4_flight.csv", "w") as out:
        out.write("t_s,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,forward_x,forward_y,forward_z\n")
        for k in range(len(t)):
            w, x, y, z = q[k] / np.linalg.norm(q[k])
            forward = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
            rows = [enu(u[k]), enu(ned[k]), enu(forward)]
            out.write(f"{0.05 * k:.2f}," + ",".join(f"{number:.6f}" for row in rows for number in row) + "\n")


def enu(ned):
    return [ned[1], ned[0], -ned[2]]


def message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def offboard():
    formats = [
        "vehicle_local_position:uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;bool xy_valid;bool z_valid",
        "vehicle_attitude:uint64_t timestamp;uint64_t timestamp_sample;float[4] q",
        "vehicle_visual_odometry:uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q",
        "vehicle_local_position_setpoint:uint64_t timestamp;float x;float y;float z",
        "trajectory_setpoint:uint64_t timestamp;float[3] position",
        "vehicle_status:uint64_t timestamp;uint8_t nav_state",
    ]
    body = b"ULog\x01\x12\x35" + struct.pack("<BQ", 1, 1_000_000) + message("B", bytes(40))
    body += b"".join(message("F", form.encode()) for form in formats)
    for index, form in enumerate(formats):
        body += message("A", struct.pack("<BH", 0, index) + form.split(":")[0].encode())
    body += message("O", struct.pack("<H", 25))
    for us in range(1_000_000, 7_000_001, 10_000):
        s = us * 1e-6
        # North and a heading of 90 degrees at rest; the sample is 5 ms older than the message, as x says.
        x, seen = np.sin(s - 0.005), us - 5_000
        if us % 20_000 == 0:
            body += message("D", struct.pack("<HQQfff??", 0, us, seen, x, 0.5, -1.5, True, not 3.0 <= s < 3.1))
        turned = struct.pack("<4f", np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
        body += message("D", struct.pack("<HQQ", 1, us, seen) + turned)
        if us % 30_000 == 0:
            vision = (float("nan"), 0.5, -1.5) if s >= 6.9 else (x + 0.01, 0.5, -1.5)
            body += message("D", struct.pack("<HQQ3f", 2, us, seen, *vision) + turned)
        if us % 50_000 == 0:
            body += message("D", struct.pack("<HQ3f", 3, us, x, 0.5, -1.5))
            # The base station's: every 50 ms, without a position from 6 s on, of which one came late.
            command = [np.cos(s), 0.5, -1.5] if s < 6.0 else [float("nan")] * 3
            body += message("D", struct.pack("<HQ3f", 4, us, *command))
        if us % 500_000 == 0:
            body += message("D", struct.pack("<HQB", 5, us, 14 if s >= 2.0 else 2))
    with open("px4_offboard.ulg", "wb") as out:
        out.write(body)
    log = ULog("px4_offboard.ulg")
    assert not log.file_corruption and len(log.data_list) == len(formats)
    assert len(topic(log, "trajectory_setpoint")["timestamp"]) == 121
    assert np.isclose(topic(log, "vehicle_visual_odometry")["position[0]"][0], np.sin(1.015) + 0.01, atol=1e-6)


real(sys.argv[1])
offboard()
