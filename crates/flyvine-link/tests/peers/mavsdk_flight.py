"""A MAVSDK client flies the simulated PX4: python mavsdk_flight.py PORT. Prints what it saw, one JSON object per line."""

import json
import sys
import threading
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.mocap import AngleBody, Covariance, Mocap, PositionBody, VisionPositionEstimate
from mavsdk.plugins.offboard import Offboard, OffboardError, PositionNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry


def say(**what):
    print(json.dumps(what), flush=True)


def refused(call, error):
    try:
        call()
    except error as reason:
        return str(reason)
    return None


def until(what, holds, limit_s=20.0):
    end = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > end:
            say(timeout=what)
            sys.exit(1)
        time.sleep(0.05)
    say(reached=what)


def main():
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{sys.argv[1]}")
    system = mavsdk.first_autopilot(10.0)
    if system is None:
        say(timeout="autopilot")
        sys.exit(1)
    action, offboard, telemetry = Action(system), Offboard(system), Telemetry(system)
    say(com_obl_rc_act=Param(system).get_param_int("COM_OBL_RC_ACT"))
    say(com_of_loss_t=Param(system).get_param_float("COM_OF_LOSS_T"))

    say(arm_without_vision=refused(action.arm, ActionError))
    mocap, flying = Mocap(system), threading.Event()

    def see():
        covariance = Covariance([float("nan")])
        while not flying.is_set():
            position = PositionBody(0.0, 0.0, -0.75)
            mocap.set_vision_position_estimate(
                VisionPositionEstimate(0, position, AngleBody(0.0, 0.0, 1.5708), covariance)
            )
            time.sleep(0.03)

    threading.Thread(target=see, daemon=True).start()
    until("position", lambda: abs(telemetry.position_velocity_ned().position.down_m + 0.75) < 0.05)
    say(offboard_without_setpoint=refused(offboard.start, OffboardError))

    offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -1.5, 90.0))
    action.arm()
    until("armed", telemetry.armed)
    offboard.start()
    say(active=offboard.is_active())
    until("height", lambda: abs(telemetry.position_velocity_ned().position.down_m + 1.5) < 0.05)
    offboard.set_position_ned(PositionNedYaw(0.5, 0.25, -1.5, 90.0))

    def is_there():
        position = telemetry.position_velocity_ned().position
        return abs(position.north_m - 0.5) < 0.05 and abs(position.east_m - 0.25) < 0.05

    until("place", is_there)
    say(hold_without_origin=refused(offboard.stop, OffboardError))
    action.set_gps_global_origin(37.4275, -122.1697, 30.0)
    time.sleep(0.2)
    offboard.stop()
    until("hold", lambda: telemetry.flight_mode().name == "HOLD")
    action.land()
    until("landed", lambda: not telemetry.armed())
    flying.set()
    say(done=True)


main()
