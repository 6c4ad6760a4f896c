"""A lab in which neither end of the base station's wires is ours: the autopilot's MAVLink is MAVSDK's server side, motion
capture is the VRPN project's server. Between them hangs a point that follows its set-points, with a tip straight below.

usage: lab.py AUTOPILOT_PORT VRPN_PORT LENGTH_M; prints what the autopilot went through, one JSON object per line, until
stdin ends.
"""

import collections
import json
import random
import select
import sys
import time

from mavsdk import Configuration, Mavsdk
from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.action_server import ActionServer, ActionServerResult, AllowableFlightModes, FlightMode
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkMessage
from mavsdk.plugins.param_server import ParamServer
from mavsdk.plugins.telemetry_server import (
    LandedState, PositionNed, PositionVelocityNed, TelemetryServer, VelocityNed, VtolState,
)  # fmt: skip
from vrpn_server import Server

STEP_S = 0.01
LAG_S = 0.15
NOISE_M = 2e-4
NAV_LAND = 21
PARAMETERS = {
    "EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_EV_DELAY": 20.0, "COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 4,
    "EKF2_GPS_CTRL": 0, "EKF2_MAG_TYPE": 5, "EKF2_NOAID_TOUT": 500000, "COM_RC_OVERRIDE": 3, "COM_ARM_WO_GPS": 1,
}  # fmt: skip


def say(**what):
    print(json.dumps(what), flush=True)


class Autopilot:
    """What MAVSDK's server side is told by the base station, and what it tells it."""

    def __init__(self, port):
        self.mavsdk = Mavsdk(Configuration.create_manual(1, 1, True))
        self.mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        component = self.mavsdk.server_component()
        self.actions, self.telemetry = ActionServer(component), TelemetryServer(component)
        self.direct, self.parameters = MavlinkDirectServer(component), ParamServer(component)
        for name, value in PARAMETERS.items():
            provide = self.parameters.provide_param_float if isinstance(value, float) else self.parameters.provide_param_int
            provide(name, value)
        # MAVSDK's threads put in what is to be said; the main loop says it, since MAVSDK locks while it calls back.
        self.answers = collections.deque()
        self.armed, self.mode, self.setpoint, self.setpoints, self.heard = False, FlightMode.HOLD, None, 0, set()
        self.actions.set_allowable_flight_modes(AllowableFlightModes(True, True, False))
        self.actions.set_armable(True, True)
        self.actions.set_disarmable(True, True)
        self.actions.set_flight_mode(FlightMode.HOLD)
        self.actions.subscribe_arm_disarm(self._arm)
        self.actions.subscribe_flight_mode_change(self._change_mode)
        self.direct.subscribe_command(NAV_LAND, self._land)
        self.direct.subscribe_message("", self._hear)

    def _arm(self, _result, request, _data=None):
        self.armed = request.arm
        say(armed=self.armed)

    def _change_mode(self, result, mode, _data=None):
        if result == ActionServerResult.SUCCESS and mode != self.mode:
            self.mode = FlightMode(mode)
            say(mode=self.mode.name)

    def _land(self, command, _data=None):
        # MAVSDK's side has no landing of its own; it hands the command on.
        self.answers.append(("COMMAND_ACK", {
            "command": NAV_LAND, "result": 0, "progress": 0, "result_param2": 0,
            "target_system": command.system_id, "target_component": command.component_id,
        }))  # fmt: skip
        self._change_mode(ActionServerResult.SUCCESS, FlightMode.LAND)

    def _hear(self, message, _data=None):
        if message.message_name not in self.heard:
            self.heard.add(message.message_name)
            say(heard=message.message_name)
        if message.message_name == "SET_POSITION_TARGET_LOCAL_NED":
            fields = json.loads(message.fields_json)
            self.setpoint = [fields["x"], fields["y"], fields["z"]]
            self.setpoints += 1
        elif message.message_name == "SET_GPS_GLOBAL_ORIGIN":
            fields = json.loads(message.fields_json)
            place = {name: fields[name] for name in ("latitude", "longitude", "altitude")}
            self.answers.append(("GPS_GLOBAL_ORIGIN", place | {"time_usec": 0}))

    def send(self, name, fields):
        self.direct.send_message(MavlinkMessage(name, 1, 1, 0, 0, json.dumps(fields)))

    def tell(self, place, velocity, on_ground):
        while self.answers:
            name, fields = self.answers.popleft()
            self.send(name, fields)
            if name == "COMMAND_ACK":
                self.actions.set_flight_mode(FlightMode.LAND)
        landed = LandedState.ON_GROUND if on_ground else LandedState.IN_AIR
        try:
            self.telemetry.publish_position_velocity_ned(PositionVelocityNed(PositionNed(*place), VelocityNed(*velocity)))
            self.telemetry.publish_extended_sys_state(VtolState.UNDEFINED, landed)
        except MavsdkError as nobody_there:
            say(untold=str(nobody_there))

    def introduce(self):
        """MAVSDK's own heartbeat says nothing of its make: until somebody asks a PX4 for parameters, say that it is one."""
        if "PARAM_REQUEST_READ" not in self.heard:
            # 2: a quadrotor; 12: PX4; 1: modes of its own, 4 and 3: Hold; 4: active.
            self.send("HEARTBEAT", {
                "type": 2, "autopilot": 12, "base_mode": 1, "custom_mode": 4 << 16 | 3 << 24, "system_status": 4,
                "mavlink_version": 3,
            })  # fmt: skip


def main():
    autopilot, length_m = Autopilot(sys.argv[1]), float(sys.argv[3])
    capture = Server(sys.argv[2], "drone", "tip")
    say(ready=True)
    # North, east, down, m; the arm's tip rests on the ground below the quadrotor's stand.
    ground_m = -length_m - 0.05
    place, velocity, ticks, flown = [0.0, 0.0, ground_m], [0.0] * 3, 0, False
    while not select.select([sys.stdin], [], [], STEP_S)[0]:
        before = list(place)
        target = place
        if autopilot.armed and autopilot.mode == FlightMode.OFFBOARD and autopilot.setpoint:
            target = autopilot.setpoint
        elif autopilot.armed and autopilot.mode == FlightMode.LAND:
            target = [place[0], place[1], place[2] + 0.7 * LAG_S]
        place = [x + STEP_S / LAG_S * (goal - x) for x, goal in zip(place, target)]
        place[2] = min(place[2], ground_m)
        velocity = [(x - y) / STEP_S for x, y in zip(place, before)]
        on_ground = place[2] > ground_m - 0.02
        flown = flown or not on_ground
        # East, north, up, with the noise of cameras: poses that never change are no poses.
        drone, tip = ([x + random.gauss(0.0, NOISE_M) for x in (place[1], place[0], up)]
                      for up in (-place[2], -place[2] - length_m))  # fmt: skip
        capture.report(time.time(), {"drone": drone, "tip": tip}, (0.0, 0.0, 0.0, 1.0))
        if ticks % 3 == 0:
            autopilot.tell(place, velocity, on_ground)
        if ticks % 50 == 0:
            autopilot.introduce()
        if flown and on_ground and not autopilot.armed:
            say(setpoints=autopilot.setpoints, landed=True)
            flown = False
        ticks += 1


main()
