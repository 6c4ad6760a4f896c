"""A vehicle for `flyvine fly --vehicle "exec:python3 examples/vehicle.py"`: the smallest that is worth flying.

The quadrotor is a point mass under a position P, velocity P controller whose acceleration follows with a lag; the arm
is a spherical pendulum with drag. Put your own simulator or rig in the place of `Vehicle`: what counts is `main`, the
protocol. One JSON object per line on stdin, one on stdout for each (flush it!), and nothing else on stdout: print
your own messages to stderr. World frame: x, y horizontal, z up; metres, seconds, kPa; quaternions [w, x, y, z].
"""
import json, math, random, sys

DT = 0.05            # time between two commands, s
SUBSTEPS = 50        # physics steps in between
G = 9.81             # gravity, m/s^2
POSITION_GAIN = 1.5  # 1/s
VELOCITY_GAIN = 4.0  # 1/s
LAG = 0.08           # of the acceleration behind the command (attitude and motors), s
ARM_DRAG = 0.6       # 1/s
NOISE = 2e-4         # of motion capture, m. Keep some: a pose that repeats to the last bit counts as frozen


def add(a, b, scale=1.0):
    return [x + scale * y for x, y in zip(a, b)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


class Vehicle:
    def __init__(self, length, seed):
        self.length, self.random = length, random.Random(seed)
        self.steps = 0
        self.position, self.velocity, self.acceleration = [0.0, 0.0, 1.5], [0.0] * 3, [0.0] * 3
        self.arm, self.arm_rate = [0.0, 0.0, -1.0], [0.0] * 3  # unit vector quadrotor -> tip, and its derivative

    def step(self, command, velocity):
        h = DT / SUBSTEPS
        for _ in range(SUBSTEPS):
            # Cascade: the position error asks for a velocity, the velocity error for an acceleration.
            error = add(command, self.position, -1)
            wanted_velocity = add(velocity, error, POSITION_GAIN)
            wanted = [VELOCITY_GAIN * (w - v) for w, v in zip(wanted_velocity, self.velocity)]
            self.acceleration = add(self.acceleration, add(wanted, self.acceleration, -1), h / LAG)
            self.velocity = add(self.velocity, self.acceleration, h)
            self.position = add(self.position, self.velocity, h)
            # Pendulum: n'' = P (g - a) / l - |n'|^2 n - drag n', where P = I - n n^T takes the part across the arm.
            pull = add([0.0, 0.0, -G], self.acceleration, -1)
            across = add(pull, self.arm, -dot(pull, self.arm))
            turn = [f / self.length - ARM_DRAG * r for f, r in zip(across, self.arm_rate)]
            turn = add(turn, self.arm, -dot(self.arm_rate, self.arm_rate))
            self.arm_rate = add(self.arm_rate, turn, h)
            self.arm = add(self.arm, self.arm_rate, h)
            norm = math.sqrt(dot(self.arm, self.arm))
            self.arm = [x / norm for x in self.arm]
        self.steps += 1

    def attitude(self):
        # The shortest rotation from z to the thrust direction (a + g): q ~ (1 + z.t, z x t) = (1 + t_z, -t_y, t_x, 0).
        x, y, z = add(self.acceleration, [0.0, 0.0, G])
        thrust = math.sqrt(x * x + y * y + z * z)
        q = [1 + z / thrust, -y / thrust, x / thrust, 0.0]
        return [c / math.sqrt(dot(q, q)) for c in q]

    def seen(self, position):
        return [x + self.random.gauss(0, NOISE) for x in position]


def main():
    vehicle = None
    for line in sys.stdin:
        request = json.loads(line)
        if "reset" in request:  # start over, hovering at (0, 0, 1.5)
            vehicle = Vehicle(request["reset"]["length_m"], request["reset"]["seed"])
        elif "cmd" in request:  # hold the command for 50 ms; the arm's length and pressure are told along with it
            vehicle.length = request["length_m"]
            # "cmd_velocity" is there only in flights of plans that send velocities: feed it forward, or refuse them.
            vehicle.step(request["cmd"], request.get("cmd_velocity", [0.0] * 3))
        elif request.get("close"):  # exit 0 within 2 s
            return
        tip = add(vehicle.position, vehicle.arm, vehicle.length)
        # A body that motion capture misses is null ("qr" and "q" together); further keys are ignored.
        poses = {"qr": vehicle.seen(vehicle.position), "q": vehicle.attitude(), "ee": vehicle.seen(tip)}
        print(json.dumps({"t_s": vehicle.steps * DT, **poses}), flush=True)


main()
