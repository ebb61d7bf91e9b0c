"""How often the 95 % intervals of ``identify`` as it is called by default hold the truth, on three unlike servo axes.

    python -m benchmarks.coverage_servo --runs 200

A ball screw at 4 kHz and a geared joint under a cascade with filters, and emps2019; a slow force acts on each, which
its loop answers, and the recorded command has white noise. Writes benchmarks/coverage_servo.json after every axis.
"""

from __future__ import annotations

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks.coverage import PARAMETERS
from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.files import write_text
from emps_design.identification.tested import identify_tested
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps

FIRST_SEED = 50_000
BAND = 15.0  # Hz, of the slow force
SCREW = {
    "name": "ball screw, 4 kHz, torque in %",
    "mechanics": {"mass": 62.0, "viscous": 310.0, "coulomb": 48.0},
    "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.08, "command_limit": 146.0,
              "current_time_constant": 0.25e-3},
    "sampling": {"period": 0.25e-3, "encoder_resolution": 9.5e-9},
    "controller": {"kind": "cascade", "position": {"kp": 45.0, "every": 4}, "velocity": {"kp": 596.8, "ti": 0.018},
                   "feedforward": {"velocity": 1.0, "acceleration": 3.846, "coulomb": 1.989},
                   "filters": [{"kind": "lowpass", "frequency": 350.0},
                               {"kind": "notch", "frequency": 210.0, "damping": 0.6, "depth": 0.1333}]},
}  # fmt: skip
JOINT = {
    "name": "joint, 1 kHz, current in A",
    "motion": "rotary",
    "mechanics": {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2, "offset": 0.4},
    "drive": {"command": "current", "force_gain": 9.2, "command_limit": 10.3, "current_time_constant": 1e-3},
    "sampling": {"period": 1e-3, "encoder_resolution": 3e-6},
    "controller": {"kind": "cascade", "position": {"kp": 22.0}, "velocity": {"kp": 7.609, "ti": 0.05},
                   "feedforward": {"velocity": 0.9}, "filters": [{"kind": "lowpass", "frequency": 120.0}]},
}  # fmt: skip
# An axis, its stroke, speed and acceleration (m or rad), rms of the slow force and of the command's noise (N or N m).
CASES = (
    (Axis.from_dict(SCREW), (0.18, 0.3, 4.0), 1.5, 1.2),
    (Axis.from_dict(JOINT), (2.0, 1.6, 9.6), 0.14, 0.12),
    (machine("emps2019"), (0.24, 0.2, 1.0), 1.0, 0.5),
)


def record_of(axis: Axis, motion: tuple[float, float, float], push: float, noise: float, seed: int) -> Record:
    """One record; the same seed gives the same bits."""
    from scipy.signal import lfilter

    period, random = axis.sampling.period, np.random.default_rng(seed)
    reference = trapezoid_laps(period, *motion, laps=1)
    decay = np.exp(-2.0 * np.pi * BAND * period)
    white = push * np.sqrt(1.0 - decay**2) * random.standard_normal(reference.size)
    force = lfilter([1.0], [1.0, -decay], white, zi=[decay * push * random.standard_normal()])[0]
    run = Plant.of(axis).closed_loop(reference, disturbance=force)
    command = run.u + noise / axis.drive.gain * random.standard_normal(reference.size)
    return Record.from_arrays(period, reference, run.q, command, name=f"{axis.name}, {seed}")


def main() -> None:
    """Count, and write the file after every axis."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("coverage_servo.json"))
    options = parser.parse_args()
    rows = []
    for axis, motion, push, noise in CASES:
        truth, errors, halves, instruments = axis.mechanics.array(), [], [], 0
        for seed in range(options.first_seed, options.first_seed + options.runs):
            try:
                found = identify_tested(record_of(axis, motion, push, noise, seed), axis)
            except EmpsError as error:
                print(f"{axis.name}, {seed}: {error}", flush=True)
                continue
            ends = np.array([p.interval_95 for p in found.parameters.values()])
            errors.append(found.values() - truth)
            halves.append(0.5 * (ends[:, 1] - ends[:, 0]))
            instruments += found.estimator != "least_squares"
        error, half = np.array(errors), np.array(halves)
        for i, parameter in enumerate(PARAMETERS):
            rows.append(
                {
                    "axis": axis.name,
                    "parameter": parameter,
                    "runs": len(error),
                    "by_instruments": instruments,
                    "identify_percent": 100.0 * float(np.mean(np.abs(error[:, i]) <= half[:, i])),
                    "mean_error_over_half": float(np.mean(error[:, i] / half[:, i])),
                    "spread_over_stated": float(np.std(error[:, i]) / np.mean(half[:, i]) * 1.965),
                    "spread_percent": 100.0 * float(np.std(error[:, i]) / truth[i]) if truth[i] else None,
                }
            )
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in rows[-1].values()), flush=True)
        document = {"date": datetime.now(UTC).date().isoformat(), "first_seed": options.first_seed, "rows": rows}
        write_text(options.out, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
