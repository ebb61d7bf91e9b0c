"""Eight hidden machines compensated, on the second simulator: ``python -m benchmarks.compensation [--diagnose]``.

Drives and effects are drawn as in ``tests/hidden``, at its larger size; the simulator shares no code with the package.
The feed-forward is that of the true numbers (``--diagnose``: of what ``diagnose`` names in the case's own record), and
of numbers that are 2 % wrong with phases 10 degrees wrong, eight times; the rigid one is tried with right numbers and
with those same errors. Writes ``benchmarks/compensation.json``.
``--measured DATA_EMPS.mat`` takes the measured axis: what a model of laps 1 to 3 leaves to the feedback on lap 4.
"""

from __future__ import annotations

import argparse
import datetime
import json
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from emps_design.axis import Axis
from emps_design.compensation import compensate
from emps_design.compensation.feedforward import BASELINE, FeedForward, terms_of
from emps_design.compensation.study import Trial, _changes
from emps_design.laws import law_of
from tests.hidden.drives import TURNING, draw_drive, draw_effect, turning
from tests.hidden.generate import run
from tests.hidden.plant import numbers, simulate
from tests.hidden.programs import laps

MACHINES = (
    "position_ripple",
    "asymmetric_viscous_friction",
    "stribeck_friction",
    "gravity",  # of an axis that turns
    "position_dependent_friction",
    "nonlinear_viscous_friction",
    "load_dependent_friction",
    "actuator_delay",
)
MISMATCH, PHASE_DEG = 0.02, 10.0
RADIUS = 0.1  # m of travel for each rad of the axis that turns
SKIP = 50
AT_REST = 1.0  # s after the program, of whose second half nothing may be left of the motion
MODELS = ("symmetric", "asymmetric")  # of ``identify``, beside which the model of ``diagnose`` stands
CUTOFF, REST = 60.0, 1e-3  # Hz and m/s, of the measured motion


def axis_of(drive, effects) -> Axis:
    """The drive as an axis that knows its effects."""
    return Axis.from_dict(
        {
            "name": "hidden",
            "motion": "linear" if drive.radius == 1.0 else "rotary",
            "mechanics": {key: getattr(drive, key) for key in ("mass", "viscous", "coulomb", "offset")},
            "drive": {"force_gain": drive.gain, "voltage_limit": drive.limit},
            "sampling": {"period": drive.period, "encoder_resolution": drive.resolution},
            "controller": {"kind": "position_pd", "kp": drive.kp, "kv": drive.kv},
            "effects": [{"kind": kind, **parameters} for kind, parameters in effects.items()],
        }
    )


def tracking(drive, program, hidden, ahead: FeedForward | None = None) -> tuple[float, float]:
    """Rms tracking error [m or rad] on the second simulator with ``ahead``, and how far it still moves at rest."""
    rest = round(AT_REST / drive.period)
    q_ref = np.concatenate([program, np.full(rest, program[-1])])
    mechanics = np.array([drive.mass, drive.viscous, drive.coulomb, drive.offset, drive.gain, drive.limit])
    law, quiet = np.array([drive.kp, drive.kv]), np.zeros(q_ref.size)
    added = quiet
    if ahead is not None:  # that simulator's law is told all: what it answers on its own reference is taken off
        added = ahead.along(q_ref) - law_of(ahead.axis, drive.period).commands(q_ref, q_ref, np.inf)
    q, _ = simulate(q_ref, drive.period, mechanics, drive.resolution, law, hidden, added, quiet)
    error = (q_ref - q)[SKIP : program.size]
    return float(np.sqrt(np.mean(error**2))), float(np.ptp(q[-rest // 2 :]))


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
    drive = turning(drive, RADIUS) if name in TURNING else drive
    program = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 1, drive.period)
    peak = float(np.abs(run(drive, program, numbers())[1][SKIP:]).max())
    hidden, truth = draw_effect(name, rng, drive, 2, peak)
    plant, axis = numbers(**hidden), axis_of(drive, truth)
    known = diagnosed(axis, drive, hidden, rng) if found else axis
    result = compensate(known, program, MISMATCH, PHASE_DEG)
    rigid, ahead = FeedForward.of(replace_effects(known), tuple(BASELINE)), result.feedforward
    off = [wrong(ahead, rng) for _ in range(8)]
    tried = {
        "without": [None], "rigid": [rigid], "with": [ahead], "wrong": off,
        "rigid_wrong": [replace(rigid, baseline=one.baseline) for one in off],  # by the same errors
    }  # fmt: skip
    runs = {key: [tracking(drive, program, plant, one) for one in each] for key, each in tried.items()}
    errors = {key: max(error for error, _ in each) for key, each in runs.items()}
    small = "urad" if drive.radius != 1.0 else "um"
    return {
        "machine": name, "kept": list(ahead.terms), "unit": small,
        "rms": {key: 1e6 * value for key, value in errors.items()},
        "wrong_each": [1e6 * error for error, _ in runs["wrong"]],
        "rigid_wrong_each": [1e6 * error for error, _ in runs["rigid_wrong"]],
        "against_none": errors["without"] / errors["with"], "against_rigid": errors["rigid"] / errors["with"],
        "predicted": 1e6 * Trial(known, program).rms(ahead),
        "still_moving": 1e6 * max(moved for each in runs.values() for _, moved in each),
    }  # fmt: skip


def measured(path: Path) -> dict[str, object]:
    """Compensation from laps 1 to 3 of a measured record, and what it leaves to the feedback on lap 4.

    The command of the model, rigid and with friction by direction (``identify``), and with all effects found
    (``diagnose``), along the motion that was measured on lap 4 (low-passed at ``CUTOFF`` without a shift), against the
    command recorded there (low-passed alike).
    """
    from emps_design.discrepancy import diagnose
    from emps_design.identification import identify
    from emps_design.machines import machine as embedded
    from emps_design.records import read_record

    record = read_record(path)
    start = 3 * len(record) // 4
    before = record.part(0, start)
    found = diagnose([before], embedded("emps2019"))
    recorded, kept = left_over(record, start, found.axis)
    rigid, asymmetric = (left_over(record, start, identify(before, model=model).to_axis())[1] for model in MODELS)
    return {
        "date": datetime.date.today().isoformat(), "record": path.name, "laps": "1 to 3, judged on 4",
        "verdict": found.to_dict()["verdict"],
        "findings": [finding["effect"] for finding in found.to_dict()["findings"]],
        "terms": list(terms_of(found.axis)[0]),
        "rms_V": {"recorded": recorded, "rigid": rigid, "asymmetric": asymmetric, "with": kept},
        "share_left": kept / recorded, "share_left_rigid": rigid / recorded,
    }  # fmt: skip


def left_over(record, start: int, axis: Axis) -> tuple[float, float]:
    """Rms from sample ``start`` on of the recorded command, and of what all terms of ``axis`` leave of it [V]."""
    from emps_design.identification.filters import low_pass, motion

    moved, u = motion(record, CUTOFF), low_pass(record.u, CUTOFF, record.period)
    ahead = replace(FeedForward.of(axis, terms_of(axis)[0]), reversal=REST)
    # A command acts for the period that follows it, and what is late behind it: it is due that much before.
    due = np.interp(record.t + ahead.wait, record.t, ahead.command(moved.q, moved.v, moved.a))
    part = slice(start, len(record) - SKIP)
    recorded, rest = (float(np.sqrt(np.mean(row[part] ** 2))) for row in (u, u - due))
    return recorded, rest


def replace_effects(axis: Axis) -> Axis:
    """The axis without effects: what a rigid feed-forward knows."""
    return axis.replace(effects=[])


def main() -> None:
    """Run every machine, print a table, write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=2019)
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--measured", type=Path, metavar="DATA_EMPS.mat", help="laps 1 to 3 of this record, and lap 4")
    options = parser.parse_args()
    if options.measured:
        document = measured(options.measured)
        text = json.dumps(document, indent=1) + "\n"
        (Path(__file__).parent / "compensation_measured.json").write_text(text, encoding="utf-8")
        print(text)
        return
    rows = []
    for name in MACHINES:
        rows.append(machine(name, options.seed, options.diagnose))
        errors = rows[-1]["rms"]
        print(f"{name:30s}", *(f"{key} {value:9.2f}" for key, value in errors.items()), rows[-1]["kept"][4:])
    document = {
        "date": datetime.date.today().isoformat(),
        "seed": options.seed,
        "model": "diagnosed" if options.diagnose else "true numbers",
        "median_against_none": float(np.median([row["against_none"] for row in rows])),
        "median_against_rigid": float(np.median([row["against_rigid"] for row in rows])),
        "never_above": all(min(row["against_none"], row["against_rigid"]) >= 1.0 for row in rows),
        "wrong_still_below_none": all(row["rms"]["wrong"] < row["rms"]["without"] for row in rows),
        "wrong_below_rigid_as_wrong": sum(
            all(a < b for a, b in zip(row["wrong_each"], row["rigid_wrong_each"], strict=True)) for row in rows
        ),
        "wrong_below_rigid": sum(row["rms"]["wrong"] < row["rms"]["rigid"] for row in rows),
        "all_at_rest": all(row["still_moving"] == 0.0 for row in rows),
        "rows": rows,
    }
    name = f"compensation{'_diagnosed' if options.diagnose else ''}.json"
    (Path(__file__).parent / name).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print({key: value for key, value in document.items() if key != "rows"})


if __name__ == "__main__":
    main()
