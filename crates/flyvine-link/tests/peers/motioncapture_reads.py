"""Reads rigid bodies with the `motioncapture` package and prints the first complete set as JSON.

usage: motioncapture_reads.py TYPE KEY=VALUE ...
"""

import json
import sys

import motioncapture

connection = motioncapture.connect(sys.argv[1], dict(pair.split("=", 1) for pair in sys.argv[2:]))
bodies = {}
for _ in range(2000):
    connection.waitForNextFrame()
    for name, body in connection.rigidBodies.items():
        rotation = body.rotation
        bodies[name] = {
            "position": [float(x) for x in body.position],
            "rotation": [rotation.w, rotation.x, rotation.y, rotation.z],
        }
    if len(bodies) >= 2:
        break
print(json.dumps(bodies))
