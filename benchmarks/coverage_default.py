"""How often the 95 % intervals of `identify` as it is called by default hold the truth, on axes unlike the tests'.

    python -m benchmarks.coverage_default unlike --count 300

``servo``: a ball screw at 4 kHz and a geared joint under a cascade with filters, and emps2019. ``unlike``: a stage in
grease (M/F_v of 5 ms), a small motor that is told a current, a gantry of 900 kg at 250 Hz. ``viscous``: a slide and a
joint whose M/F_v is shorter than their excitation's period. A slow force acts on each,
which its loop answers, and the recorded command has white noise. Of a sample of the records the command's JSON is
compared with ``to_dict()``. Writes benchmarks/coverage_default_SET.json after every axis.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import tempfile
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks.coverage import PARAMETERS
from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.errors import EmpsError
from emps_design.files import write_text
from emps_design.identification import identify
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
STAGE = {
    "name": "stage in grease, 2 kHz, force",
    "mechanics": {"mass": 12.0, "viscous": 2600.0, "coulomb": 15.0, "offset": 2.0},
    "drive": {"command": "force", "command_unit": "N", "force_gain": 1.0, "command_limit": 900.0},
    "sampling": {"period": 0.5e-3, "encoder_resolution": 1e-7},
    "controller": {"kind": "cascade", "position": {"kp": 40.0}, "velocity": {"kp": 2400.0, "ti": 0.01}},
}
SMALL = {
    "name": "small motor, 5 kHz, current in A",
    "motion": "rotary",
    "mechanics": {"mass": 3.1e-4, "viscous": 1.5e-3, "coulomb": 0.011, "offset": -0.002},
    "drive": {"command": "current", "force_gain": 0.062, "command_limit": 8.0},
    "sampling": {"period": 0.2e-3, "encoder_resolution": 1.5e-4},
    "controller": {"kind": "cascade", "position": {"kp": 50.0}, "velocity": {"kp": 1.1, "ti": 0.02}},
}
# Strongly viscous: F_v/M of 60 and 80 1/s, so that noise of the force moves the speed at once.
SLIDE = {
    "name": "slide, 1 kHz, voltage",
    "mechanics": {"mass": 8.0, "viscous": 480.0, "coulomb": 12.0, "offset": -1.5},
    "drive": {"force_gain": 25.0, "voltage_limit": 48.0},
    "sampling": {"period": 1e-3, "encoder_resolution": 1e-6},
    "controller": {"kind": "position_pd", "kp": 25.0, "kv": 30.0},
}
DAMPED = {
    "name": "damped joint, 2 kHz, current in A",
    "motion": "rotary",
    "mechanics": {"mass": 0.02, "viscous": 1.6, "coulomb": 0.3, "offset": 0.02},
    "drive": {"command": "current", "force_gain": 0.9, "command_limit": 12.0},
    "sampling": {"period": 0.5e-3, "encoder_resolution": 1e-4},
    "controller": {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 2.0, "ti": 0.03}},
}
GANTRY = {
    "name": "gantry, 900 kg, 250 Hz",
    "mechanics": {"mass": 900.0, "viscous": 1500.0, "coulomb": 180.0, "offset": -30.0},
    "drive": {"force_gain": 310.0},
    "sampling": {"period": 4e-3, "encoder_resolution": 2e-5},
    "controller": {"kind": "position_pd", "kp": 5.0, "kv": 60.0},
}
# An axis, its stroke, speed and acceleration (m or rad), rms of the slow force and of the command's noise (N or N m).
Case = tuple[Axis, tuple[float, float, float], float, float]
SETS: dict[str, tuple[Case, ...]] = {
    "servo": (
        (Axis.from_dict(SCREW), (0.18, 0.3, 4.0), 1.5, 1.2),
        (Axis.from_dict(JOINT), (2.0, 1.6, 9.6), 0.14, 0.12),
        (machine("emps2019"), (0.24, 0.2, 1.0), 1.0, 0.5),
    ),
    "unlike": (
        (Axis.from_dict(STAGE), (0.06, 0.25, 8.0), 4.0, 4.0),
        (Axis.from_dict(SMALL), (2.5, 9.0, 150.0), 4e-4, 5e-4),
        (Axis.from_dict(GANTRY), (0.8, 0.5, 0.8), 9.0, 6.0),
    ),
    "viscous": (
        (Axis.from_dict(SLIDE), (0.2, 0.3, 3.0), 2.0, 1.5),
        (Axis.from_dict(DAMPED), (2.0, 2.5, 30.0), 0.03, 0.03),
    ),
}


def record_of(case: Case, seed: int) -> Record:
    """One record; the same seed gives the same bits."""
    from scipy.signal import lfilter

    axis, motion, push, noise = case
    period, random = axis.sampling.period, np.random.default_rng(seed)
    reference = trapezoid_laps(period, *motion, laps=1)
    decay = np.exp(-2.0 * np.pi * BAND * period)
    white = push * np.sqrt(1.0 - decay**2) * random.standard_normal(reference.size)
    force = lfilter([1.0], [1.0, -decay], white, zi=[decay * push * random.standard_normal()])[0]
    run = Plant.of(axis).closed_loop(reference, disturbance=force)
    command = run.u + noise / axis.drive.gain * random.standard_normal(reference.size)
    return Record.from_arrays(period, reference, run.q, command, name=f"{axis.name}, {seed}")


def by_command(record: Record, axis: Axis, folder: Path) -> dict:
    """The document of ``identify --json`` on the ``record``."""
    (folder / "axis.toml").write_text(axis.to_toml())
    record.save(folder / "record.npz")
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()):
        run(["identify", str(folder / "record.npz"), "--axis", str(folder / "axis.toml"), "--json"])
    return json.loads(out.getvalue())


def main() -> None:
    """Count, and write the file after every axis."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", choices=SETS)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first record")
    parser.add_argument("--without-law", action="store_true", help='with kind = "none" in the axis file that is read')
    parser.add_argument("--by-command", type=int, default=3, help="records an axis that go through the command as well")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    out = options.out or Path(__file__).with_name(
        f"coverage_default_{options.set}{'_without_law' * options.without_law}.json"
    )
    rows, held = [], []
    for case in SETS[options.set]:
        axis, errors, halves, by, said = case[0], [], [], Counter(), 0
        read = axis.replace(controller={"kind": "none"}) if options.without_law else axis
        truth = axis.mechanics.array()
        for seed in range(options.seed, options.seed + options.count):
            record = record_of(case, seed)
            try:
                found = identify(record, read)
            except EmpsError as error:
                print(f"{axis.name}, {seed}: {error}", flush=True)
                continue
            ends = np.array([p.interval_95 or (np.nan, np.nan) for p in found.parameters.values()])
            errors.append(found.values() - truth)
            halves.append(0.5 * (ends[:, 1] - ends[:, 0]))
            by[found.estimator] += 1
            said += found.extra["unexplained"]["structure"] > 0.0
            if seed - options.seed < options.by_command:
                with tempfile.TemporaryDirectory() as folder:
                    document = by_command(record, read, Path(folder))
                values = np.array([one["value"] for one in document["parameters"].values()], dtype=float)
                assert np.allclose(values, found.values(), rtol=1e-9, equal_nan=True), (axis.name, seed)
        error, half = np.array(errors), np.array(halves)
        held.append(np.abs(error) <= half)
        for i, parameter in enumerate(PARAMETERS):
            rows.append(
                {
                    "axis": axis.name,
                    "parameter": parameter,
                    "runs": len(error),
                    "not_determined": int(np.isnan(half[:, i]).sum()),
                    "estimators": dict(by),
                    "structure_named": said,
                    "identify_percent": 100.0 * float(np.mean(held[-1][:, i])),
                    "mean_error_over_half": float(np.nanmean(error[:, i] / half[:, i])),
                    "spread_over_stated": float(np.nanstd(error[:, i]) / np.nanmean(half[:, i]) * 1.965),
                    "spread_percent": 100.0 * float(np.nanstd(error[:, i]) / truth[i]) if truth[i] else None,
                    "half_percent": 100.0 * float(np.nanmean(half[:, i]) / abs(truth[i])) if truth[i] else None,
                }
            )
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in rows[-1].values()), flush=True)
        pooled = 100.0 * float(np.mean(np.concatenate(held)))
        print(f"pooled {pooled:.2f} %", flush=True)
        document = {
            "date": datetime.now(UTC).date().isoformat(),
            "first_seed": options.seed,
            "law_known": not options.without_law,
            "pooled_percent": pooled,
            "rows": rows,
        }
        write_text(out, json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
