#!/usr/bin/env bash
# The wheel of the Python package, tried where nothing else is installed:
#
#   scripts/wheel.sh [OUT_DIR]        default: target/dist
#
# One wheel serves every CPython from 3.9 on (abi3) on this platform. Needs a network for maturin and numpy; PYTHON names the
# interpreter.
set -euo pipefail
cd "$(dirname "$0")/.."
mkdir -p "${1:-target/dist}"
out=$(cd "${1:-target/dist}" && pwd)
python=${PYTHON:-python3}

"$python" -m pip wheel --quiet --no-deps --wheel-dir "$out" ./crates/flyvine-py
wheel=$(ls -t "$out"/flyvine-*.whl | head -1)

fresh=$(mktemp -d)
trap 'rm -rf "$fresh"' EXIT
"$python" -m venv "$fresh/venv"
"$fresh/venv/bin/pip" install --quiet "$wheel"
cd "$fresh"
venv/bin/python - <<'CHECK'
import flyvine

vehicle = flyvine.Vehicle()
seen = vehicle.reset(0.7, 0.0, seed=1)
for _ in range(20):
    seen = vehicle.step([0.2, 0.0, 1.5], 0.7, 0.0)
assert seen.quadrotor[0] > 0.02, seen.quadrotor
CHECK
echo "$wheel"
