"""Write a folder of hidden-effect cases: ``python -m tests.hidden.generate FOLDER --seed S --cases SET``.

Every case is a folder with axis.toml, train.npz, holdout.npz and truth.json; see README.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.hidden.drives import (
    ALIKE,
    AMPLITUDES,
    EFFECTS,
    PAIRS,
    UNKNOWN,
    Drive,
    draw_drive,
    draw_effect,
    draw_several,
)  # fmt: skip
from tests.hidden.plant import numbers, simulate
from tests.hidden.programs import laps, multi_sine, wander

VOLTAGE_NOISE = 4e-3  # V
FORCE_NOISE = 0.35  # N for a 95 kg axis
NOISE_BAND = 40.0  # Hz
MOST_DRAWS = 500  # attempts at a drive that is stable with its hidden effects
SEEN = 0.75  # of the floor: an effect with a smaller share of the gap need not be found
SETS = ("quick", "all", "several", "crowded", "beside", "unknown", "small", "healthy")
AT_LIMIT = (0.1, 0.33)  # share of the samples of a crowded drive at a motor limit that no file states
SMALL = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)  # of size 1
CROWDED = -1
SKIP = 50  # samples at the start without weight
QUICK = (
    ("stribeck_friction",),
    ("position_ripple",),
    ("actuator_delay",),
    ("backlash",),
    ("mass_change",),
    ("controller_disturbance",),
    ("asymmetric_viscous_friction", "position_ripple"),
    ("unknown_wake",),
    (),
    (),
)


@dataclass(frozen=True)
class Case:
    """Effects by name, which of the two sizes (0: drawn for each), and the ``share`` of that size.

    Size ``CROWDED``: drawn for each, the limit of a motor so that it spends a share of ``AT_LIMIT`` there.
    """

    effects: tuple[str, ...]
    size: int
    number: int
    share: float = 1.0

    @property
    def name(self) -> str:
        """Folder of the case."""
        return f"{'+'.join(self.effects) or 'none'}-{self.number}"


def cases(which: str, count: int = 8, seed: int = 0) -> list[Case]:
    """The cases of a set of ``SETS``: ``quick`` 10, ``all`` 70, of the others ``count``, drawn by ``seed``."""
    if which == "quick":
        return [Case(effects, 2 - index % 2, index) for index, effects in enumerate(QUICK)]
    if which == "all":
        single = [Case((name,), size, size) for name in (*EFFECTS, *UNKNOWN) for size in (1, 2)]
        return [*single, *(Case(pair, 1, 1) for pair in PAIRS), *cases("healthy", count)]
    return [_drawn(which, number, np.random.default_rng([seed, number])) for number in range(count)]


def _drawn(which: str, number: int, rng: np.random.Generator) -> Case:
    """Case ``number`` of a set of any length: three or four effects, one beside unknown physics, a small one ...

    A crowded one combines a motor at its limit, or backlash, with two or three other effects.
    """
    physics = tuple(name for name in EFFECTS if name != "controller_disturbance")  # which the law alone shows
    strange = UNKNOWN[number % len(UNKNOWN)]
    if which == "several":
        return Case(draw_several(rng, 3 + number % 2, physics), 0, number)
    if which == "crowded":
        first = ("actuator_saturation", "backlash")[number // 2 % 2]
        others = draw_several(rng, len(physics), physics)
        fit = [name for name in others if name != first and not any({name, first} <= alike for alike in ALIKE)]
        return Case((first, *fit[: 2 + number % 2]), CROWDED, number)
    if which == "beside":
        return Case((*draw_several(rng, 1, physics), strange), 0, number)
    if which == "unknown":
        return Case((strange,), 0, number)
    if which == "small":
        return Case(draw_several(rng, 1, tuple(AMPLITUDES)), 1, number, SMALL[number % len(SMALL)])
    return Case((), 1, number)


def force_noise(rng: np.random.Generator, length: int, drive: Drive) -> np.ndarray:
    """Gaussian force below ``NOISE_BAND`` [N, or N m], rms in proportion to the mass."""
    spectrum = np.fft.rfft(rng.standard_normal(length))
    spectrum[np.fft.rfftfreq(length, drive.period) > NOISE_BAND] = 0.0
    noise = np.fft.irfft(spectrum, length)
    return noise / noise.std() * FORCE_NOISE * drive.mass / 95.0 / drive.radius


def run(
    drive: Drive, q_ref: np.ndarray, hidden: np.ndarray, rng: np.random.Generator | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and voltage [V] of the drive along ``q_ref``; noise where ``rng`` is given."""
    no_noise = np.zeros(q_ref.size)
    volts = VOLTAGE_NOISE * rng.standard_normal(q_ref.size) if rng is not None else no_noise
    force = force_noise(rng, q_ref.size, drive) if rng is not None else no_noise
    mechanics = np.array([drive.mass, drive.viscous, drive.coulomb, drive.offset, drive.gain, drive.limit])
    law = np.array([drive.kp, drive.kv])
    return simulate(q_ref, drive.period, mechanics, drive.resolution, law, hidden, volts, force)


def refit(drive: Drive, q_ref: np.ndarray, u: np.ndarray) -> Drive:
    """The baseline whose closed loop is nearest to the recorded voltage (Gauss-Newton, central differences)."""
    names, healthy = ("mass", "viscous", "coulomb", "offset"), numbers()
    x = np.array([getattr(drive, name) for name in names])
    step = np.array([0.004 * drive.mass, 0.02 * drive.viscous, 0.02 * drive.coulomb, 0.02 * drive.coulomb])
    lowest = np.array([0.2 * drive.mass, 0.0, 0.0, -np.inf])

    def residual(x: np.ndarray) -> np.ndarray:
        trial = replace(drive, **dict(zip(names, np.maximum(x, lowest), strict=True)))
        return (u - run(trial, q_ref, healthy)[1])[SKIP:]

    r, damping = residual(x), 0.0
    for _ in range(15):
        columns = [residual(x + s) - residual(x - s) for s in np.diag(step)]
        jacobian = np.column_stack(columns) / 2
        normal, slope = jacobian.T @ jacobian, jacobian.T @ r
        for _ in range(5):
            downhill = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            trial = np.maximum(x - step * downhill, lowest)
            trial_r = residual(trial)
            if trial_r @ trial_r < r @ r:
                break
            damping = max(10 * damping, 1e-3)
        else:
            break
        gain, x, r, damping = 1 - (trial_r @ trial_r) / (r @ r), trial, trial_r, damping / 10
        if gain < 1e-4:
            break
    return replace(drive, **dict(zip(names, x, strict=True)))


def own_gap(
    drive: Drive, q_ref: np.ndarray, u: np.ndarray, hidden: dict[str, float], effect: dict[str, float]
) -> float:
    """Rms force [N] that the plant without ``effect`` does not explain, the baseline adjusted to first order.

    ``u`` [V] is the voltage of the plant with all of ``hidden``, without noise.
    """
    rest = numbers(**{name: value for name, value in hidden.items() if name not in effect})
    without = run(drive, q_ref, rest)[1]
    columns = [
        (run(replace(drive, **{name: value + 0.02 * size}), q_ref, rest)[1] - without)[SKIP:]
        for name, value, size in (
            ("mass", drive.mass, drive.mass),
            ("viscous", drive.viscous, drive.viscous),
            ("coulomb", drive.coulomb, drive.coulomb),
            ("offset", drive.offset, drive.coulomb),
        )
    ]
    design, error = np.column_stack(columns), (u - without)[SKIP:]
    return float(drive.gain * np.std(error - design @ np.linalg.lstsq(design, error, rcond=None)[0]))


def limit_at_share(drive: Drive, q_ref: np.ndarray, hidden: dict[str, float], share: float) -> float:
    """The limit [V] at which the motor of a plant with ``hidden`` effects spends ``share`` of its samples (bisection).

    A motor at its limit falls behind, and the command grows: a quantile of the free command would be too low.
    """
    low, high = 0.0, drive.limit
    for _ in range(12):
        limit = 0.5 * (low + high)
        u = run(drive, q_ref, numbers(**{**hidden, "clip": limit}))[1]
        beyond = float(np.mean(np.abs(u[SKIP:]) >= limit)) > share or not np.all(np.isfinite(u))
        low, high = (limit, high) if beyond else (low, limit)
    return high


def misfit(drive: Drive, u: np.ndarray, other: np.ndarray) -> float:
    """Rms difference of two voltages as a force [N]."""
    return float(drive.gain * np.std((u - other)[SKIP:]))


def axis_file(rng: np.random.Generator, drive: Drive) -> str:
    """An axis file with numbers a few percent off, as of a data sheet."""
    off = {
        "mass": drive.mass * (1 + rng.uniform(-0.04, 0.04)),
        "viscous": drive.viscous * (1 + rng.uniform(-0.08, 0.08)),
        "coulomb": drive.coulomb * (1 + rng.uniform(-0.1, 0.1)),
    }
    mechanics = "".join(f"{key} = {value:.4g}\n" for key, value in off.items())
    return (
        f'name = "hidden"\n[mechanics]\n{mechanics}offset = 0.0\n'
        f"[drive]\nforce_gain = {drive.gain!r}\nvoltage_limit = {drive.limit!r}\n"
        f"[sampling]\nperiod = {drive.period!r}\nencoder_resolution = {drive.resolution!r}\n"
        f'[controller]\nkind = "position_pd"\nkp = {drive.kp!r}\nkv = {drive.kv!r}\n'
    )


def train_program(rng: np.random.Generator, drive: Drive, repeats: bool) -> np.ndarray:
    """Three identical laps, or 25 s in which nothing repeats: strokes at random, or a multi-sine."""
    if repeats:
        return laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 3, drive.period)
    if rng.random() < 0.5:
        return wander(rng, drive.travel, list(drive.speeds), drive.acceleration, 25000, drive.period)
    return multi_sine(rng, drive.travel, 0.5 * drive.acceleration, 25000, drive.period)


def make(case: Case, seed: int, repeats: bool = True) -> dict[str, object]:
    """Draw drives until the loop is stable and away from its limit; return the contents of the case's folder.

    ``repeats`` False: the training program has no laps.
    """
    rng = np.random.default_rng([seed, zlib.crc32(case.name.encode())])
    for _ in range(MOST_DRAWS):
        drive = draw_drive(rng)
        train_ref = train_program(rng, drive, repeats)
        if rng.random() < 0.5:
            hold_ref = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 3, drive.period)
        else:
            hold_ref = multi_sine(rng, drive.travel, 0.5 * drive.acceleration, 20000, drive.period)
        healthy = numbers()
        clean = [run(drive, ref, healthy)[1] for ref in (train_ref, hold_ref)]
        hidden, truth, effects = {}, {}, {}
        for name in case.effects:
            size = case.size if case.size > 0 else int(rng.integers(1, 3))
            values, words = draw_effect(name, rng, drive, size, float(np.abs(clean[0][SKIP:]).max()))
            if name in AMPLITUDES:
                inside, outside = AMPLITUDES[name]
                values[inside] *= case.share
                words[name][outside] *= case.share
            hidden.update(values)
            truth.update(words)
            effects[name] = values
        if case.size == CROWDED and "clip" in hidden:
            hidden["clip"] = effects["actuator_saturation"]["clip"] = truth["actuator_saturation"]["limit"] = (
                limit_at_share(drive, train_ref, hidden, float(rng.uniform(*AT_LIMIT)))
            )
        plant = numbers(**hidden)
        records = [run(drive, ref, plant, rng) for ref in (train_ref, hold_ref)]
        limited = max(float(np.mean(np.abs(u) > 0.99 * drive.limit)) for _, u in records)
        perfect = [run(drive, ref, plant)[1] for ref in (train_ref, hold_ref)]
        floors = [misfit(drive, u, other) for (_, u), other in zip(records, perfect, strict=True)]
        most = AT_LIMIT[1] if "clip" in hidden and case.size == CROWDED else 1e-3
        if limited <= most and max(floors) < 0.2 * drive.coulomb:
            break
    else:
        raise RuntimeError(f"{case.name}: no stable drive in {MOST_DRAWS} draws")
    fitted = refit(drive, train_ref, records[0][1])
    baseline = [
        misfit(drive, u, run(fitted, ref, healthy)[1])
        for (_, u), ref in zip(records, (train_ref, hold_ref), strict=True)
    ]
    sizes = [misfit(drive, with_it, without) for with_it, without in zip(perfect, clean, strict=True)]
    gaps = {name: own_gap(drive, train_ref, perfect[0], hidden, values) for name, values in effects.items()}
    known = [name for name in case.effects if name not in UNKNOWN]
    return {
        "axis.toml": axis_file(rng, drive),
        "train.npz": (train_ref, *records[0]),
        "holdout.npz": (hold_ref, *records[1]),
        "truth.json": {
            "effects": known + ["unknown"] * (len(known) < len(case.effects)) or ["none"],
            "share": case.share,
            "own_gap": gaps,
            "seen": [name for name in known if gaps[name] > SEEN * floors[0]],
            "parameters": truth or hidden,
            "baseline": {name: getattr(drive, name) for name in ("mass", "viscous", "coulomb", "offset")},
            "floor_closed_loop": floors[1],
            "baseline_closed_loop": baseline[1],
            "effect_size_train": sizes[0],
            "effect_size_holdout": sizes[1],
            "detectable": not case.effects or baseline[0] > 1.25 * floors[0],
        },
    }


def write(folder: Path, contents: dict[str, object], period: float = 1e-3) -> None:
    """Write the folder of one case."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "axis.toml").write_text(contents["axis.toml"], encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(contents["truth.json"], indent=1), encoding="utf-8")
    for name in ("train.npz", "holdout.npz"):
        q_ref, q, u = contents[name]
        np.savez_compressed(folder / name, t=np.arange(q.size) * period, q_ref=q_ref, q=q, u=u)


def main(arguments: list[str] | None = None) -> int:
    """Generate a set of cases from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.hidden.generate", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", choices=SETS, default="quick")
    parser.add_argument(
        "--count", type=int, default=8, help="number of cases of the other sets, and of healthy drives in `all`"
    )
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--no-laps", action="store_true", help="training programs in which nothing repeats")
    options = parser.parse_args(arguments)
    chosen = [case for case in cases(options.cases, options.count, options.seed) if options.only in case.name]
    for case in chosen:
        try:
            contents = make(case, options.seed, not options.no_laps)
        except RuntimeError as error:
            print(f"skipped: {error}", file=sys.stderr)  # for example an end stop that the limited motor does not reach
            continue
        write(options.folder / case.name, contents)
        truth = contents["truth.json"]
        print(
            f"{case.name:55s} floor {truth['floor_closed_loop']:.3f} N, baseline {truth['baseline_closed_loop']:.3f} N"
            f"{'' if truth['detectable'] else ', too small'}",
            file=sys.stderr,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
