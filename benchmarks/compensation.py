"""Eight hidden machines compensated, on the second simulator: ``python -m benchmarks.compensation [--diagnose]``.

Drives and effects are drawn as in ``tests/hidden``, at its larger size; the simulator shares no code with the package.
The feed-forward is that of the true numbers (``--diagnose``: of what ``diagnose`` names in the case's own record), and
of numbers that are 2 % wrong with phases 10 degrees wrong. Writes ``benchmarks/compensation.json``.
"""

from __future__ import annotations

import argparse
import datetime
import json
import zlib
from pathlib import Path

import numpy as np

from emps_design.axis import Axis
from emps_design.compensation import compensate
from emps_design.compensation.feedforward import BASELINE, FeedForward
from emps_design.compensation.study import Trial, _changes
from tests.hidden.drives import draw_drive, draw_effect
from tests.hidden.generate import run
from tests.hidden.plant import numbers, simulate
from tests.hidden.programs import laps

MACHINES = (
    "position_ripple",
    "asymmetric_viscous_friction",
    "stribeck_friction",
    "elastic_force",  # gravity along the stroke: this simulator knows no turning axis
    "position_dependent_friction",
    "nonlinear_viscous_friction",
    "load_dependent_friction",
    "actuator_delay",
)
MISMATCH, PHASE_DEG = 0.02, 10.0
SKIP = 50


def axis_of(drive, effects) -> Axis:
    """The drive as an axis that knows its effects."""
    return Axis.from_dict(
        {
            "name": "hidden",
            "mechanics": {key: getattr(drive, key) for key in ("mass", "viscous", "coulomb", "offset")},
            "drive": {"force_gain": drive.gain, "voltage_limit": drive.limit},
            "sampling": {"period": drive.period, "encoder_resolution": drive.resolution},
            "controller": {"kind": "position_pd", "kp": drive.kp, "kv": drive.kv},
            "effects": [{"kind": kind, **parameters} for kind, parameters in effects.items()],
        }
    )


def tracking(drive, q_ref, hidden, ahead) -> float:
    """Rms tracking error [m] on the second simulator, ``ahead`` (n,) [V] added to the controller's voltage."""
    mechanics = np.array([drive.mass, drive.viscous, drive.coulomb, drive.offset, drive.gain, drive.limit])
    law, quiet = np.array([drive.kp, drive.kv]), np.zeros(q_ref.size)
    q, _ = simulate(q_ref, drive.period, mechanics, drive.resolution, law, hidden, ahead, quiet)
    return float(np.sqrt(np.mean((q_ref - q)[SKIP:] ** 2)))


def wrong(ahead: FeedForward, rng: np.random.Generator) -> FeedForward:
    """``ahead`` with every parameter off by the mismatch, and every phase, each to a side drawn."""
    for change in _changes(ahead, MISMATCH, PHASE_DEG, None):
        ahead = change(float(rng.choice([-1.0, 1.0])), ahead)
    return ahead


def diagnosed(axis: Axis, drive, hidden, rng) -> Axis:
    """The axis that ``diagnose`` makes of a record of the machine and a data sheet without effects."""
    from emps_design.discrepancy import diagnose
    from emps_design.records import Record

    q_ref = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 3, drive.period)
    q, u = run(drive, q_ref, numbers(**hidden), rng)
    record = Record.from_arrays(drive.period, q_ref, q, u, name="train")
    return diagnose([record], axis.replace(effects=[])).axis


def machine(name: str, seed: int, found: bool) -> dict[str, object]:
    """One machine: its tracking errors without, with rigid and with all feed-forward, and with wrong numbers."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    drive = draw_drive(rng)
    program = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 1, drive.period)
    peak = float(np.abs(run(drive, program, numbers())[1][SKIP:]).max())
    hidden, truth = draw_effect(name, rng, drive, 2, peak)
    plant, axis = numbers(**hidden), axis_of(drive, truth)
    known = diagnosed(axis, drive, hidden, rng) if found else axis
    result = compensate(known, program, MISMATCH, PHASE_DEG)
    rigid = FeedForward.of(replace_effects(known), tuple(BASELINE))
    errors = {
        "without": tracking(drive, program, plant, np.zeros(program.size)),
        "rigid": tracking(drive, program, plant, rigid.along(program)),
        "with": tracking(drive, program, plant, result.feedforward.along(program)),
        "wrong": max(tracking(drive, program, plant, wrong(result.feedforward, rng).along(program)) for _ in range(8)),
    }
    rows = {key: 1e6 * value for key, value in errors.items()}
    return {
        "machine": name, "kept": list(result.feedforward.terms), "rms_um": rows,
        "against_none": errors["without"] / errors["with"], "against_rigid": errors["rigid"] / errors["with"],
        "predicted_um": 1e6 * Trial(known, program).rms(result.feedforward),
    }  # fmt: skip


def replace_effects(axis: Axis) -> Axis:
    """The axis without effects: what a rigid feed-forward knows."""
    return axis.replace(effects=[])


def main() -> None:
    """Run every machine, print a table, write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=2019)
    parser.add_argument("--diagnose", action="store_true")
    options = parser.parse_args()
    rows = []
    for name in MACHINES:
        rows.append(machine(name, options.seed, options.diagnose))
        errors = rows[-1]["rms_um"]
        print(f"{name:30s}", *(f"{key} {value:9.2f}" for key, value in errors.items()), rows[-1]["kept"][4:])
    document = {
        "date": datetime.date.today().isoformat(),
        "seed": options.seed,
        "model": "diagnosed" if options.diagnose else "true numbers",
        "median_against_none": float(np.median([row["against_none"] for row in rows])),
        "median_against_rigid": float(np.median([row["against_rigid"] for row in rows])),
        "never_above": all(min(row["against_none"], row["against_rigid"]) >= 1.0 for row in rows),
        "wrong_still_below_none": all(row["rms_um"]["wrong"] < row["rms_um"]["without"] for row in rows),
        "wrong_below_rigid": sum(row["rms_um"]["wrong"] < row["rms_um"]["rigid"] for row in rows),
        "rows": rows,
    }
    name = f"compensation{'_diagnosed' if options.diagnose else ''}.json"
    (Path(__file__).parent / name).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print({key: value for key, value in document.items() if key != "rows"})


if __name__ == "__main__":
    main()
