"""A server of the VRPN project's own library, as the package `motioncapture` carries it for its client: the same two bodies as
tests/common, at 100 Hz, until stdin ends.

usage: vrpn_serves.py PORT

The package wraps the client alone, so the library's classes are called by their symbols (Itanium C++ ABI, VRPN 7.38,
vrpn_Connection.h and vrpn_Tracker.h).
"""

import ctypes
import math
import select
import sys
import time

import motioncapture

Pointer, Double = ctypes.c_void_p, ctypes.c_double


class Timeval(ctypes.Structure):
    _fields_ = [("tv_sec", ctypes.c_long), ("tv_usec", ctypes.c_long)]


library = ctypes.CDLL(motioncapture.__file__)


def function(symbol, result, *arguments):
    found = library[symbol]
    found.restype, found.argtypes = result, arguments
    return found


create_connection = function("_Z29vrpn_create_server_connectionPKcS0_S0_", Pointer, *[ctypes.c_char_p] * 3)
connection_mainloop = function("_ZN18vrpn_Connection_IP8mainloopEPK7timeval", ctypes.c_int, Pointer, Pointer)
construct = function("_ZN19vrpn_Tracker_ServerC1EPKcP15vrpn_Connectioni", None, Pointer, ctypes.c_char_p, Pointer, ctypes.c_int)
tracker_mainloop = function("_ZN19vrpn_Tracker_Server8mainloopEv", None, Pointer)
report = function(
    "_ZN19vrpn_Tracker_Server11report_poseEi7timevalPKdS2_j",
    ctypes.c_int, Pointer, ctypes.c_int, Timeval, Double * 3, Double * 4, ctypes.c_uint32,
)  # fmt: skip

LOW_LATENCY = 1 << 2
connection = create_connection(f"127.0.0.1:{sys.argv[1]}".encode(), None, None)
assert connection, "no connection"


def tracker(name):
    # Larger than the class, whose size nobody exports.
    memory = ctypes.create_string_buffer(1 << 16)
    construct(memory, name.encode(), connection, 1)
    return memory


bodies = [(tracker("drone"), 1.5), (tracker("tip"), 0.8)]
print("ready", flush=True)
while not select.select([sys.stdin], [], [], 0.01)[0]:
    now = time.time()
    stamp = Timeval(int(now), int(1e6 * (now % 1.0)))
    angle = now % 1000.0
    for memory, height in bodies:
        position = (Double * 3)(math.cos(angle), math.sin(angle), height)
        # The scalar last.
        quaternion = (Double * 4)(0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
        report(memory, 0, stamp, position, quaternion, LOW_LATENCY)
        tracker_mainloop(memory)
    connection_mainloop(connection, None)
