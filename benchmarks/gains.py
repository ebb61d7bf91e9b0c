"""Gains against brute force and the simulated drive: `python -m benchmarks.gains [../shared/data/servo]`.

Axes drawn at random, of 0.05 kg to 20 t, sampled at 100 Hz to 8 kHz, rigid or of two masses, with up to two samples of
delay, filtered or not, IP or PI. Brute force puts gain, phase, delay or gain and phase at once (the disk margin) into
the loop until a pole leaves the unit circle, and knows nothing of frequency responses; where `retune` cannot reach what
was asked, every pair nearer than the one it names is tried, on a grid over the whole plane. The simulated drive is
nonlinear, quantised and limited. Written to benchmarks/gains.json, with the date. The seed is for this alone: nothing
was chosen with it.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import IP, PI
from emps_design.control.velocity.limits import (
    reach,
    retune_velocity_loop,
    retuned_gains,
    retuned_pairs,
    suggest_filter,
)
from emps_design.control.velocity.load_range import LoadRange, loaded, margins_over_range
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.verdict import sampled_step
from emps_design.errors import SpecificationError
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine
from emps_design.simulation import Plant

AXES, SEED = 100, 60218
STEPS = 60  # of brute force, up to a fifth beyond what is stated
PLANE, STEP = 101, 0.012  # pairs each way that are tried for a nearer one, and the search's own step
SPEED = 0.1  # m/s, so that dry friction is a constant


def random_axis(rng):
    """An axis, its filters and a structure."""
    mass = float(np.exp(rng.uniform(np.log(0.05), np.log(2e4))))
    period = 1.0 / float(np.exp(rng.uniform(np.log(100.0), np.log(8000.0))))
    effects = [{"kind": "actuator_delay", "delay": float(rng.uniform(0.0, 2.0)) * period}]
    if rng.random() < 0.5:
        frequency = float(np.clip(rng.uniform(0.02, 0.3) / period, 5.0, 400.0))
        damping, share = float(np.exp(rng.uniform(np.log(0.005), np.log(0.1)))), float(rng.uniform(0.1, 0.8))
        effects.append({"kind": "flexible_coupling", "frequency": frequency, "damping": damping, "share": share})
    axis = machine("emps2018").replace(
        mechanics={"mass": mass, "viscous": mass * float(rng.uniform(0.0, 5.0)), "coulomb": 0.0, "offset": 0.0},
        drive={"force_gain": mass, "current_time_constant": float(rng.uniform(0.0, 0.5)) * period},
        sampling={"period": period},
        effects=effects,
    )
    corner = float(rng.uniform(0.05, 0.3)) / period
    filters = (Filter(kind="lowpass", frequency=corner),) if rng.random() < 0.5 else ()
    return axis, filters, PI if rng.random() < 0.5 else IP


def brute_force(loop):
    """What gain [ratio], phase [deg] and delay [s] bring a pole out, each as a share of what is stated."""
    opened, column, row = loop.loop.opened
    margins = loop.margins

    def closed(factor):
        return np.abs(np.linalg.eigvals(opened + factor * np.outer(column, row))).max() <= 1.0 + 1e-9

    def later(delay):
        return SampledVelocityLoop(loop.plant.delayed(delay), loop.k_v1, loop.t_v, loop.structure).stable

    tried = {
        "gain_margin": (lambda by: closed(by), 1.0, margins.gain_margin),
        "phase_margin_deg": (lambda by: closed(np.exp(-1j * np.radians(by))), 0.0, margins.phase_margin_deg),
        "delay_margin": (later, 0.0, margins.delay_margin),
    }
    found = {}
    for name, (stable, start, stated) in tried.items():
        if stated is None:
            continue
        grid = start + (1.2 * stated - start) * np.arange(1, STEPS + 1) / STEPS
        low = start
        for high in map(float, grid):
            if not stable(high):
                for _ in range(30):
                    middle = 0.5 * (low + high)
                    low, high = (middle, high) if stable(middle) else (low, middle)
                break
            low = high
        found[name] = low / stated
    if margins.disk_margin is not None:
        found["disk_margin"] = least_change(opened, np.outer(column, row), margins.disk_margin) / margins.disk_margin
    return found


def least_change(opened, fed_back, stated):
    """The least |d| of all complex d for which a factor (1 + d/2)/(1 - d/2) at the plant input brings a pole out.

    Along rays of the complex plane, up to a fifth beyond what is ``stated``, and along more of them beside the best.
    """

    def first(angles, radii):
        d = radii * np.exp(1j * angles)[:, None]
        factors = (1.0 + 0.5 * d) / (1.0 - 0.5 * d)
        poles = np.abs(np.linalg.eigvals(opened + factors[..., None, None] * fed_back)).max(axis=-1)
        out = poles > 1.0 + 1e-9
        return np.where(out.any(axis=1), out.argmax(axis=1), radii.shape[1] - 1)

    angles, best = np.linspace(0.0, np.pi, 91), np.inf
    for _ in range(3):
        rows = np.arange(angles.size)
        low, high = np.zeros(angles.size), np.full(angles.size, min(1.2 * stated, 1.999))
        for _ in range(7):  # each time to the first of 12 places that is out
            radii = low[:, None] + (high - low)[:, None] * np.arange(1, 13) / 12.0
            place = first(angles, radii)
            low, high = np.where(place > 0, radii[rows, place - 1], low), radii[rows, place]
        here, best = angles[np.argmin(high)], min(best, float(high.min()))
        angles = np.linspace(here - np.ptp(angles) / 45.0, here + np.ptp(angles) / 45.0, 21)
    return best


def random_loops(count, seed=SEED):
    """Margins and retune on ``count`` axes: one row each."""
    rng, rows = np.random.default_rng(seed), []
    while len(rows) < count:
        axis, filters, structure = random_axis(rng)
        phase, share = float(rng.uniform(30.0, 65.0)), float(rng.uniform(0.2, 1.4))
        plant = sample_axis(axis, filters=filters)
        fastest = reach(plant, phase)
        if not fastest.crossover:
            continue
        w = min(share, 0.9) * fastest.crossover
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase))
        loop = SampledVelocityLoop(plant, k_v1, t_v, structure)
        row = {"mass": axis.mechanics.mass, "rate": 1.0 / plant.period, "effects": len(axis.effects)}
        row["brute"] = brute_force(loop) if np.isfinite(k_v1) and loop.stable else {}
        rows.append({**row, **retuned(axis, share * fastest.crossover, phase, structure, filters)})
    return rows


def retuned(axis, crossover, phase, structure, filters):
    """Whether the loop reached what was asked, or the nearest is one, and nothing nearer in the whole plane is."""
    try:
        design = retune_velocity_loop(axis, crossover, phase_margin_deg=phase, structure=structure, filters=filters)
    except SpecificationError as error:
        nearest, words = error.nearest, str(error)
    else:
        margins = design.sampled.margins
        met = design.sampled.stable and abs(margins.phase_margin_deg - phase) < 1e-5
        return {"retune": "reached" if met else "WRONG"}
    pairs = retuned_pairs(sample_axis(axis, filters=filters), {"crossover": crossover}, "plant-input", structure)
    found = np.array([nearest["crossover"]]), np.array([nearest["phase_margin_deg"]])
    works = pairs.judge(*found)[0] == 2

    def apart(w, angle):
        return np.abs(np.log(w / crossover)) + np.abs(angle - phase) / 45.0

    # every pair nearer than the one found by more than a step of the search (1 %, 0.5 deg)
    far = float(apart(*found)[0])
    spread = np.linspace(-far, far, PLANE)
    w, angle = (axis.ravel() for axis in np.meshgrid(crossover * np.exp(spread), phase + 45.0 * spread))
    inside = (apart(w, angle) < far - STEP) & (angle > 0.0) & (angle < 180.0)
    nearer = int(np.count_nonzero(pairs.judge(w[inside], angle[inside]) == 2)) if inside.any() else 0
    named = any(word in words for word in ("binds", "at most", "unstable", "crosses 0 dB"))
    done = "nearest" if works and named and not nearer else "WRONG"
    return {"retune": done, "message": words, "tried": int(np.count_nonzero(inside)), "nearer": nearer}


def measured_step(design, top=0.02):
    """-3 dB [rad/s] and overshoot [%] of the simulated drive in motion, the velocity as the drive estimates it."""
    plant, T = Plant.of(design.loop_axis), design.axis.sampling.period

    def run(reference):
        q = plant.closed_loop(np.zeros(reference.size), reference=reference).q
        return np.diff(q, prepend=q[:1]) / T

    settle = int(np.ceil(40.0 / design.crossover / T))
    count = int(np.ceil(12.0 / design.crossover / T))
    v = run(np.concatenate([np.full(settle, SPEED), np.full(count, SPEED + top)]))
    overshoot = 100.0 * (v[settle:].max() - SPEED - top) / top
    ratios, tones = [], design.sampled.bandwidth * np.array([0.94, 0.97, 1.0, 1.03, 1.06])
    for w in tones:
        turns = max(int(np.ceil(20.0 * 2.0 * np.pi / w / T)), 200)
        t = T * np.arange(settle + turns)
        v = run(SPEED + top * np.sin(w * t))[settle:]
        basis = np.column_stack([np.sin(w * t[settle:]), np.cos(w * t[settle:]), np.ones(turns)])
        ratios.append(np.hypot(*np.linalg.lstsq(basis, v, rcond=None)[0][:2]) / top)
    return float(np.interp(10 ** (-3 / 20), ratios[::-1], tones[::-1])), float(overshoot)


def gantry(folder):
    """PI for 30 Hz on the gantry, in the simulated drive, against what the page says."""
    axis = Axis.from_toml((Path(folder) / "gantry-none-0" / "axis.toml").read_text(encoding="utf-8"))
    design = retune_velocity_loop(axis, bandwidth=60.0 * np.pi, phase_margin_deg=60.0, structure=PI)
    bandwidth, overshoot = measured_step(design)
    return {
        "page": {"bandwidth": design.sampled.bandwidth, "overshoot_percent": sampled_step(design).overshoot_percent},
        "drive": {"bandwidth": bandwidth, "overshoot_percent": overshoot},
    }


def notch():
    """A load behind 48 Hz, with the notch that is suggested and without: at equal margins, and within equal limits."""
    coupling = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}
    found = suggest_filter(machine("emps2018").replace(effects=[coupling]), 50.0, PI)
    sides = {name: found[name] for name in ("without", "with_equal_margins", "with")}
    gained = {
        name: sides[name]["crossover"] / sides["without"]["crossover"] - 1.0 for name in ("with_equal_margins", "with")
    }
    shown = {name: {key: side[key] for key in ("crossover", "margins")} for name, side in sides.items()}
    return {"filter": found["filter"], "gained": gained, **shown}


def load_range():
    """The one design for 1:5, at both ends in the simulated drive: it bears 0.98 of its margins and not 1.02."""
    axis = machine("emps2018").replace(drive={"voltage_limit": 1e6}, sampling={"encoder_resolution": 1e-9})
    first = design_velocity_loop(axis, crossover=60.0, phase_margin_deg=50.0, structure=PI)
    one, rows = margins_over_range(first, LoadRange(inertia=(1.0, 5.0)))["one"], []
    for factor in (1.0, 5.0):
        end = loaded(axis, factor, 1.0)
        design = VelocityLoopDesign(end, one["k_v1"], one["t_v"], {}, structure=PI)
        margins, row = design.sampled.margins, {"inertia": factor}
        row |= {"phase_margin_deg": margins.phase_margin_deg, "delay_margin": margins.delay_margin}
        for by in (0.98, 1.02):
            late = [{"kind": "actuator_delay", "delay": by * margins.delay_margin}]
            strong = {"force_gain": by * margins.gain_margin * end.drive.gain}
            row[f"delay {by}"] = _settles(design.loop_axis.replace(effects=late), margins.crossover)
            row[f"gain {by}"] = _settles(design.loop_axis.replace(drive=strong), margins.gain_margin_frequency)
        rows.append(row)
    return rows


def _settles(axis, w):
    """Whether a small step in motion dies away in the simulated drive; ``w`` [rad/s] is where it would ring."""
    T = axis.sampling.period
    settle, watched = int(20.0 / w / T) + 50, int(800.0 / w / T) + 200
    reference = np.concatenate([np.full(settle, SPEED), np.full(watched, SPEED * 1.01)])
    v = Plant.of(axis).closed_loop(np.zeros(reference.size), reference=reference).v[settle:]
    parts = [float(np.ptp(part)) for part in np.array_split(v, 4)[1:]]
    return parts[-1] < parts[0]


def summary(rows):
    """Worst of the rows: by how much a margin is off, by how much one is optimistic, what ``retune`` did."""
    shares = np.array([share for row in rows for share in row["brute"].values()])
    done = [row["retune"] for row in rows]
    return {
        "axes": len(rows),
        "margins": int(shares.size),
        "largest_error": float(np.abs(shares - 1.0).max()),
        "most_optimistic": float(max(0.0, (1.0 - shares).max())),
        "by_name": {
            name: float(max(abs(row["brute"][name] - 1.0) for row in rows if name in row["brute"]))
            for name in sorted({name for row in rows for name in row["brute"]})
        },
        "retune": {word: done.count(word) for word in sorted(set(done))},
        "nearer_pairs": {key: sum(row.get(key, 0) for row in rows) for key in ("tried", "nearer")},
    }


def main():
    rows = random_loops(AXES)
    document = {"date": datetime.now(UTC).date().isoformat(), "seed": SEED, "random": summary(rows)}
    document |= {"notch": notch(), "load_range": load_range()}
    if len(sys.argv) > 1:
        document["gantry"] = gantry(sys.argv[1])
    document["wrong"] = [
        row for row in rows if row["retune"] == "WRONG" or any(abs(s - 1) > 0.01 for s in row["brute"].values())
    ]
    text = json.dumps(document, indent=1)
    Path(__file__).with_name("gains.json").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
