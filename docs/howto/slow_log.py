"""What stands in for the log of a robot on the page "My record is slow, irregular, from a robot".

``python slow_log.py`` simulates a joint with a weight under a drive of 1 kHz and writes what its controller logs at
100 Hz, by a clock of its own: ``joint.csv``. ``python slow_log.py axis`` writes what is known of it: ``joint.toml``.
"""

import sys
from pathlib import Path

import numpy as np

from emps_design import Axis
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import point_to_point

JOINT = Axis.from_dict(
    {
        "name": "joint",
        "motion": "rotary",
        "mechanics": {"mass": 3.2, "viscous": 9.0, "coulomb": 5.5},
        "drive": {"command": "current", "command_unit": "A", "force_gain": 8.5, "command_limit": 30.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 1e-5},
        "controller": {"kind": "position_pd", "kp": 25.0, "kv": 9.4},
        "effects": [{"kind": "gravity", "torque": 31.0, "angle": 0.3}],
    }
)
AXIS = """name = "joint"
motion = "rotary"
[mechanics]              # guesses
mass = 2.5               # kg m^2
viscous = 5.0            # N m/(rad/s)
coulomb = 5.0            # N m
[drive]
command = "current"
command_unit = "A"
force_gain = 8.5         # N m/A: torque constant times gear ratio
command_limit = 30.0     # A
[sampling]
period = 0.01            # s, of the log
encoder_resolution = 1e-5
[controller]
kind = "none"            # nobody knows it
[record]
time = { column = "timestamp", unit = "s" }
position = { column = "actual_q", unit = "rad" }
command = { column = "actual_current" }
"""
SPEEDS, ACCELERATION, REST = (0.3, 0.6, 1.0, 1.4), 3.0, 0.2  # rad/s, rad/s^2, s


def programme(random: np.random.Generator, strokes: int = 16) -> np.ndarray:
    """A reference to and fro, by an arbitrary way at each speed in turn."""
    parts, here = [], 0.0
    for number in range(strokes):
        there = (-1.0) ** number * random.uniform(0.5, 1.3)
        way = point_to_point(1e-3, abs(there - here), SPEEDS[number % len(SPEEDS)], ACCELERATION)
        parts += [here + np.sign(there - here) * way, np.full(round(REST / 1e-3), there)]
        here = there
    return np.concatenate(parts)


def log() -> str:
    """What the controller logs of a run: instants of position and current, up to 3 ms late by their own stamps."""
    random = np.random.default_rng(4)
    run = Plant.of(JOINT).closed_loop(programme(random))
    stamps = 10 * np.arange(len(run.q) // 10 - 1) + random.integers(0, 4, len(run.q) // 10 - 1)
    current = run.u[stamps] + 0.05 * random.standard_normal(stamps.size)
    rows = zip(1e-3 * stamps, run.q[stamps], current, strict=True)
    lines = ["timestamp,actual_q,actual_current", *(f"{t:.3f},{q:.6f},{i:.4f}" for t, q, i in rows)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    if sys.argv[1:2] == ["axis"]:
        Path("joint.toml").write_text(AXIS, encoding="utf-8")
        print(AXIS)
    else:
        text = log()
        Path("joint.csv").write_text(text, encoding="utf-8")
        print("\n".join(text.splitlines()[:4]))
