"""A server of the VRPN project's own library: the same two bodies as tests/common, at 100 Hz, until stdin ends.

usage: vrpn_serves.py PORT
"""

import math
import select
import sys
import time

from vrpn_server import Server

server = Server(sys.argv[1], "drone", "tip")
print("ready", flush=True)
while not select.select([sys.stdin], [], [], 0.01)[0]:
    now = time.time()
    angle = now % 1000.0
    place = {name: (math.cos(angle), math.sin(angle), height) for name, height in (("drone", 1.5), ("tip", 0.8))}
    server.report(now, place, (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
