"""Records damaged on purpose: is what `identify` finds wrong, and was there a warning?

    python -m benchmarks.damaged_records [--axes tuning|final] [--seed N] [--count N] [--healthy N] [--without-law]

Every damage meets every axis, ``count`` times. An estimate is wrong where it is off by more than 5 % and by more than
three deviations, the largest of its ``std*`` and of a quarter of its interval; a record that is refused is a warning.
``--healthy`` counts warnings on records that nothing was done to. The axes of ``tuning`` and ``second`` were looked
at while the checks were made; those of ``final``, and seeds from 9000 on, were not.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.identification import identify
from emps_design.importing import import_record
from emps_design.records import Record
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps

WRONG, DEVIATIONS = 0.05, 3.0


@dataclass(frozen=True)
class Bench:
    """An axis, and the stroke [m or rad], speed and acceleration of its trapezoids."""

    axis: Axis
    stroke: float
    speed: float
    acceleration: float

    def record(self, seed: int) -> Record:
        """A healthy record; every seed has a motion of its own."""
        random = np.random.default_rng((seed, 7))
        stroke, speed, acceleration = np.array((self.stroke, self.speed, self.acceleration)) * random.uniform(
            0.7, 1.3, 3
        )
        q_ref = trapezoid_laps(self.axis.sampling.period, stroke, speed, acceleration, 1)
        return synthetic_record(self.axis, seed, q_ref=q_ref)


def bench(name: str, mechanics, drive, sampling, controller, motion, kind: str = "linear") -> Bench:
    """An axis of these tables and its motion."""
    mechanics = dict(zip(("mass", "viscous", "coulomb", "offset"), mechanics, strict=True))
    tables = {"mechanics": mechanics, "drive": drive, "sampling": sampling, "controller": controller}
    return Bench(Axis.from_dict({"name": name, "motion": kind, **tables}), *motion)


TUNING = (
    bench(
        "stage", (1.4, 6.0, 1.1, 0.2), {"force_gain": 3.5, "voltage_limit": 24.0},
        {"period": 0.5e-3, "encoder_resolution": 1e-6},
        {"kind": "position_pd", "kp": 60.0, "kv": 55.0}, (0.15, 0.25, 3.0),
    ),
    bench(
        "gantry", (240.0, 700.0, 90.0, -15.0),
        {"command": "torque", "command_unit": "%", "force_gain": 16.0, "command_limit": 200.0},
        {"period": 1e-3, "encoder_resolution": 1e-6},
        {"kind": "cascade", "position": {"kp": 25.0, "every": 2}, "velocity": {"kp": 900.0, "ti": 0.05},
         "feedforward": {"velocity": 1.0, "acceleration": 12.0, "coulomb": 4.0},
         "filters": [{"kind": "lowpass", "frequency": 200.0}]},
        (0.6, 0.5, 1.5),
    ),
    bench(
        "wrist", (0.012, 0.05, 0.15, 0.02), {"command": "current", "force_gain": 1.1, "command_limit": 6.0},
        {"period": 1e-3, "encoder_resolution": 4e-5},
        {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 1.2, "ti": 0.08}}, (1.8, 3.0, 25.0), "rotary",
    ),
    bench(
        "servo", (0.03, 0.6, 0.25, -0.03), {"force_gain": 0.8, "voltage_limit": 12.0},
        {"period": 2e-3, "encoder_resolution": 2e-4},
        {"kind": "p", "kp": 22.0}, (1.2, 2.0, 12.0), "rotary",
    ),
    bench(
        "press", (3000.0, 9000.0, 700.0, 80.0), {"command": "force", "force_gain": 1.0, "command_limit": 20000.0},
        {"period": 4e-3, "encoder_resolution": 5e-7},
        {"kind": "position_pd", "kp": 8.0, "kv": 60000.0, "velocity_estimator": "backward"}, (0.9, 0.4, 0.8),
    ),
)  # fmt: skip
SECOND = (
    bench(
        "needle", (0.02, 0.08, 0.03, 0.004), {"force_gain": 0.5, "voltage_limit": 40.0},
        {"period": 0.25e-3, "encoder_resolution": 2e-7},
        {"kind": "position_pd", "kp": 90.0, "kv": 14.0, "velocity_estimator": "backward"}, (0.05, 0.3, 8.0),
    ),
    bench(
        "table", (38.0, 150.0, 25.0, 4.0), {"command": "current", "force_gain": 60.0, "command_limit": 8.0},
        {"period": 0.5e-3, "encoder_resolution": 5e-6},
        {"kind": "cascade", "position": {"kp": 40.0, "every": 4}, "velocity": {"kp": 90.0, "ti": 0.03, "form": "ip"},
         "filters": [{"kind": "notch", "frequency": 180.0, "damping": 0.5, "depth": 0.1}]}, (0.3, 0.35, 2.5),
    ),
    bench(
        "turret", (2.6, 9.0, 6.0, -0.8),
        {"command": "torque", "command_unit": "N m", "force_gain": 30.0, "command_limit": 4.0},
        {"period": 1e-3, "encoder_resolution": 1e-5},
        {"kind": "cascade", "position": {"kp": 18.0}, "velocity": {"kp": 5.0},
         "feedforward": {"velocity": 0.8, "acceleration": 0.08}},
        (2.4, 1.6, 6.0), "rotary",
    ),
    bench(
        "finger", (4e-4, 0.003, 0.006, 0.0008), {"force_gain": 0.02, "voltage_limit": 9.0},
        {"period": 1e-3, "encoder_resolution": 1.5e-3},
        {"kind": "p", "kp": 12.0}, (1.0, 2.5, 20.0), "rotary",
    ),
    bench(
        "crane", (5000.0, 4000.0, 900.0, -200.0), {"command": "force", "force_gain": 1.0, "command_limit": 30000.0},
        {"period": 4e-3, "encoder_resolution": 1e-5},
        {"kind": "position_pd", "kp": 3.0, "kv": 40000.0}, (3.0, 0.8, 0.7),
    ),
)  # fmt: skip
FINAL = (
    bench(
        "probe", (0.35, 1.2, 0.4, -0.06), {"command": "current", "force_gain": 2.2, "command_limit": 10.0},
        {"period": 0.2e-3, "encoder_resolution": 1e-7},
        {"kind": "cascade", "position": {"kp": 70.0, "every": 5}, "velocity": {"kp": 25.0, "ti": 0.012},
         "filters": [{"kind": "lowpass", "frequency": 800.0},
                     {"kind": "notch", "frequency": 310.0, "damping": 0.4, "depth": 0.2}]},
        (0.08, 0.2, 4.0),
    ),
    bench(
        "sledge", (620.0, 1500.0, 160.0, 30.0), {"command": "voltage", "force_gain": 140.0, "voltage_limit": 48.0},
        {"period": 2e-3, "encoder_resolution": 2e-6},
        {"kind": "position_pd", "kp": 12.0, "kv": 55.0}, (0.8, 0.45, 0.9),
    ),
    bench(
        "spindle", (0.15, 0.4, 1.3, 0.15),
        {"command": "torque", "command_unit": "N m", "force_gain": 5.0, "command_limit": 3.0},
        {"period": 0.5e-3, "encoder_resolution": 5e-6},
        {"kind": "cascade", "position": {"kp": 50.0}, "velocity": {"kp": 4.0, "ti": 0.06, "form": "ip"},
         "feedforward": {"velocity": 0.0, "acceleration": 0.02, "coulomb": 0.2}},
        (3.0, 4.0, 30.0), "rotary",
    ),
    bench(
        "gripper", (0.004, 0.05, 0.04, -0.005), {"force_gain": 0.15, "voltage_limit": 7.4},
        {"period": 1e-3, "encoder_resolution": 5e-4},
        {"kind": "p", "kp": 9.0}, (1.4, 3.0, 25.0), "rotary",
    ),
    bench(
        "lift", (1100.0, 2500.0, 300.0, 60.0),
        {"command": "torque", "command_unit": "%", "force_gain": 55.0, "command_limit": 150.0},
        {"period": 1e-3, "encoder_resolution": 1e-6},
        {"kind": "cascade", "position": {"kp": 8.0, "every": 8}, "velocity": {"kp": 600.0, "ti": 0.1},
         "anti_windup": "none"},
        (1.5, 0.6, 0.8),
    ),
)  # fmt: skip
AXES = {"tuning": TUNING, "second": SECOND, "final": FINAL}

Columns = dict[str, np.ndarray]
Damage = Callable[[Columns, np.random.Generator, Columns], Columns]


def low_pass(x: np.ndarray, hz: float, period: float) -> np.ndarray:
    """First order, as a logger does it."""
    keep = float(np.exp(-2.0 * np.pi * hz * period))
    return lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0]


def period_of(c: Columns) -> float:
    return float(c["t"][1] - c["t"][0])


def filtered(name: str, hz: float) -> Damage:
    return lambda c, r, o: {**c, name: low_pass(c[name], hz, period_of(c))}


def rows(c: Columns, kept: np.ndarray) -> Columns:
    """The rows ``kept``, with their time numbered anew."""
    n = len(kept)
    return {**{name: values[kept] for name, values in c.items()}, "t": np.arange(n) * period_of(c)}


def lost(share: float) -> Damage:
    def damage(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
        n = c["t"].size
        return rows(c, np.flatnonzero(r.random(n) >= share))

    return damage


def lost_regularly(every: int) -> Damage:
    return lambda c, r, o: rows(c, np.flatnonzero(np.arange(c["t"].size) % every != every - 1))


def repeated(share: float) -> Damage:
    def damage(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
        n = c["t"].size
        return rows(c, np.repeat(np.arange(n), 1 + (r.random(n) < share)))

    return damage


def held(name: str, samples: int) -> Damage:
    return lambda c, r, o: {**c, name: c[name][np.arange(c["t"].size) // samples * samples]}


def other(c: Columns, o: Columns) -> np.ndarray:
    """The command of another axis, as large as this one's."""
    u = np.resize(o["u"], c["u"].size)
    return u / np.std(u) * np.std(c["u"])


def every_second(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    return {**c, "u": np.where(np.arange(c["u"].size) % 2, c["u"], other(c, o))}


def from_half(c: Columns, factor: float) -> Columns:
    return {**c, "u": np.where(np.arange(c["u"].size) < c["u"].size // 2, 1.0, factor) * c["u"]}


def one_sample(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    u = c["u"].copy()
    u[r.integers(u.size // 5, 4 * u.size // 5)] = 450.0 * np.std(u)
    return {**c, "u": u}


def outliers(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    hit = r.random(c["u"].size) < 2e-3
    return {**c, "u": np.where(hit, 10.0 * np.std(c["u"]), c["u"])}


def late(name: str, samples: int) -> Damage:
    return lambda c, r, o: {**c, name: np.concatenate([np.full(samples, c[name][0]), c[name][:-samples]])}


def in_steps(name: str, share: float) -> Damage:
    def damage(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
        step = share * np.std(c[name])
        return {**c, name: np.round(c[name] / step) * step}

    return damage


def clipped(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    top = 0.5 * np.max(np.abs(c["u"]))
    return {**c, "u": np.clip(c["u"], -top, top)}


def without_a_piece(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    n = c["t"].size
    start = int(r.integers(n // 4, n // 2))
    return rows(c, np.r_[0:start, start + n // 10 : n])


def turned(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    return {**c, "u": np.where(np.arange(c["u"].size) < 2 * c["u"].size // 3, 1.0, -1.0) * c["u"]}


def exchanged(c: Columns, r: np.random.Generator, o: Columns) -> Columns:
    return {**c, "q": c["q_ref"], "q_ref": c["q"]}


DAMAGES: dict[str, Damage] = {
    "position low-passed at 5 Hz": filtered("q", 5.0),
    "command low-passed at 5 Hz": filtered("u", 5.0),
    "position low-passed at 20 Hz": filtered("q", 20.0),
    "command in steps of a quarter of its deviation": in_steps("u", 0.25),
    "command in steps of half its deviation": in_steps("u", 0.5),
    "1 sample in 100 lost, time renumbered": lost(0.01),
    "1 sample in 5 lost, time renumbered": lost(0.2),
    "every fifth sample lost, time renumbered": lost_regularly(5),
    "1 row in 50 repeated": repeated(0.02),
    "position held for 10 samples": held("q", 10),
    "command held for 10 samples": held("u", 10),
    "every second command of another axis": every_second,
    "all commands of another axis": lambda c, r, o: {**c, "u": other(c, o)},
    "reference and position exchanged": exchanged,
    "gain of the command doubled half-way": lambda c, r, o: from_half(c, 2.0),
    "gain of the command 1.2 from half-way on": lambda c, r, o: from_half(c, 1.2),
    "command turned round in the last third": turned,
    "one command 450 times as large": one_sample,
    "1 command in 500 ten times as large": outliers,
    "command 20 samples late": late("u", 20),
    "position 10 samples late": late("q", 10),
    "command clipped by the logger": clipped,
    "a tenth lost in one piece, time renumbered": without_a_piece,
    "position in steps of 1/200 of its deviation": in_steps("q", 0.005),
}


def columns_of(record: Record) -> Columns:
    return {name: np.array(getattr(record, name)) for name in ("t", "q_ref", "q", "u")}


def wrong(found, axis: Axis) -> list[str]:
    """The parameters that are wrong."""
    m = axis.mechanics
    truth = {"mass": m.mass, "viscous": m.viscous, "coulomb": m.coulomb, "constant_force": m.offset}
    names = []
    for name, estimate in found.to_dict()["parameters"].items():
        if estimate["value"] is None or name not in truth:
            continue
        low, high = estimate.get("interval_95") or (0.0, 0.0)
        stds = [value for key, value in estimate.items() if key.startswith("std") and value is not None]
        deviation = max([*stds, (high - low) / 4.0])
        error = abs(estimate["value"] - truth[name])
        if error > WRONG * abs(truth[name]) and error > DEVIATIONS * deviation:
            names.append(name)
    return names


def judge(path: Path, own: Axis, read_by: Axis) -> tuple[str, str, list[str]]:
    """What the check at the door says, what else is said, and the parameters that are wrong."""
    try:
        record = import_record(path, read_by)
        found = identify(record, read_by)
    except EmpsError as error:
        return f"refused: {error}", "", []
    others = [text for text in found.warnings if text not in record.contradictions]
    return "; ".join(record.contradictions), "; ".join(others), wrong(found, own)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", choices=tuple(AXES), default="final")
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--count", type=int, default=1, help="records of each damage and axis")
    parser.add_argument("--healthy", type=int, default=0, help="healthy records in all")
    parser.add_argument("--without-law", action="store_true", help='read with kind = "none"')
    parser.add_argument("--only", default="", help="damages whose name has this in it")
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    benches = AXES[given.axes]
    none = {"kind": "none"}
    readers = [
        Axis.from_dict({**b.axis.to_dict(), "controller": none}) if given.without_law else b.axis for b in benches
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.npz"
        false = 0
        for number in range(given.healthy):
            which = number % len(benches)
            record = benches[which].record(given.seed + number)
            random = np.random.default_rng((given.seed + number, 11))
            if random.random() < 0.3:  # cut out of a longer one
                cut = int(random.integers(1, len(record) // 3))
                record = record.part(cut, len(record))
            record.save(path)
            said = import_record(path, readers[which]).contradictions
            false += bool(said)
            if said:
                print(f"healthy {benches[which].axis.name} {given.seed + number}: {said[0]}", flush=True)
        if given.healthy:
            print(f"false warnings on healthy records: {false} of {given.healthy}", flush=True)
        total = silent = quiet = bad = 0
        for name, damage in DAMAGES.items():
            if given.only not in name or not given.count:
                continue
            line = []
            for which, one in enumerate(benches):
                for number in range(given.count):
                    seed = given.seed + 100_000 + 97 * number + which
                    random = np.random.default_rng((seed, 13))
                    columns = columns_of(one.record(seed))
                    beside = columns_of(benches[(which + 1) % len(benches)].record(seed + 1))
                    columns = damage(columns, random, beside)
                    np.savez(path, **columns)
                    door, rest, names = judge(path, one.axis, readers[which])
                    total += 1
                    bad += bool(names)
                    quiet += bool(names) and not door
                    silent += bool(names) and not door and not rest
                    line.append(
                        ("R" if door.startswith("refused") else "w" if door else "o" if rest else ".")
                        + ("X" if names else " ")
                    )
                    if given.verbose or (names and not door):
                        print(f"    {one.axis.name}: {', '.join(names) or 'right'}: {door or '-'} | {rest}", flush=True)
            print(f"{name:50} {' '.join(line)}", flush=True)
        print("R refused, w warned at the door, o other warning only, . none; X wrong by 5 % and three deviations")
        print(f"wrong: {bad} of {total}; of these without a warning at the door {quiet}, without any {silent}")


if __name__ == "__main__":
    main()
