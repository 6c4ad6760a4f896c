"""A server of the VRPN project's own library, as the package `motioncapture` carries it for its client.

The package wraps the client alone, so the library's classes are called by their symbols (Itanium C++ ABI, VRPN 7.38,
vrpn_Connection.h and vrpn_Tracker.h).
"""

import ctypes

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
report_pose = function(
    "_ZN19vrpn_Tracker_Server11report_poseEi7timevalPKdS2_j",
    ctypes.c_int, Pointer, ctypes.c_int, Timeval, Double * 3, Double * 4, ctypes.c_uint32,
)  # fmt: skip

LOW_LATENCY = 1 << 2


class Server:
    """Serves the bodies of these names on 127.0.0.1:port."""

    def __init__(self, port, *names):
        self.connection = create_connection(f"127.0.0.1:{port}".encode(), None, None)
        assert self.connection, "no connection"
        self.trackers = {name: self._tracker(name) for name in names}

    def _tracker(self, name):
        # Larger than the class, whose size nobody exports.
        memory = ctypes.create_string_buffer(1 << 16)
        construct(memory, name.encode(), self.connection, 1)
        return memory

    def report(self, now, position_of, quaternion):
        """One frame, captured at `now`: the position of every body by its name, m, and one attitude for all, scalar last."""
        stamp = Timeval(int(now), int(1e6 * (now % 1.0)))
        for name, tracker in self.trackers.items():
            report_pose(tracker, 0, stamp, (Double * 3)(*position_of[name]), (Double * 4)(*quaternion), LOW_LATENCY)
            tracker_mainloop(tracker)
        connection_mainloop(self.connection, None)
