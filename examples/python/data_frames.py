"""Flights as data frames: pandas and polars take `Flight.arrays()` as it is, and give it back.

    python data_frames.py FLIGHT.csv|FLIGHT.mcap …
"""

import sys

import numpy as np
import pandas
import polars

import flyvine

for path in sys.argv[1:]:
    flight, _ = flyvine.Flight.read(path).clean()

    # pandas: rows in which the quadrotor is faster than 1 m/s.
    frame = pandas.DataFrame(flight.arrays()).set_index("t_s")
    speed = np.linalg.norm(frame[["qr_x", "qr_y", "qr_z"]].diff() / flyvine.DT, axis=1)
    print(f"{flight.name}: {len(frame)} rows, faster than 1 m/s in {np.count_nonzero(speed > 1.0)}")

    # polars: how far the tip swings from below the quadrotor, second by second.
    swing = (
        polars.DataFrame(flight.arrays())
        .with_columns(
            second=polars.col("t_s").floor(),
            swing_m=((polars.col("ee_x") - polars.col("qr_x")) ** 2 + (polars.col("ee_y") - polars.col("qr_y")) ** 2).sqrt(),
        )
        .group_by("second", maintain_order=True)
        .agg(polars.col("swing_m").max())
    )
    print(swing.head(5))

    # And back: a data frame with the flight's columns is a flight.
    again = flyvine.Flight.from_arrays(frame.reset_index(), flight.name)
    assert again == flight
