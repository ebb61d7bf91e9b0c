"""Measured frequency responses against the truth, on axes drawn at random: `python -m benchmarks.frequency_response`.

Each axis is a carriage with a load behind a coupling under its own position controller, run on passes at a steady speed
with a multi-sine added to the command and white force noise. Written to benchmarks/frequency_response.json, with the
date. Coverage counts the lines of the response inside their own 95 % circles; margins are those of the true sampled
loop, their bands from the data. Brute force adds delay, or turns gain and phase, until a pole leaves the unit circle.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from emps_design.control.discretisation import sample_axis
from emps_design.control.margins import loop_margins
from emps_design.control.sampled import axis_loop
from emps_design.errors import SpecificationError
from emps_design.frequency_response import (
    Limits,
    design_experiment,
    estimate_response,
    measured_margins,
    retune_on_response,
)
from emps_design.frequency_response.answers import periodic_answer
from emps_design.frequency_response.measured_plant import law_response
from emps_design.frequency_response.response import BAND
from emps_design.frequency_response.signals import signals_of
from emps_design.laws import law_of
from emps_design.laws.estimators import estimator_response
from emps_design.laws.linear import linear_law
from emps_design.machines import machine
from emps_design.progress import no_progress
from tests.unit.frequency_response.cases import exact, experiment, run

AXES, SEED = 50, 9157  # bands and estimator were chosen on other axes, of the seeds 2026 and 7401
SPEED = 0.05
COMPARED = ("phase_margin_deg", "crossover", "delay_margin", "gain_margin", "disk_margin")


def random_axis(rng):
    """A stable axis: 10 to 300 kg, a coupling of 25 to 90 Hz, a crossover of a share of it, delay or none."""
    while True:
        mass, frequency = float(np.exp(rng.uniform(np.log(10.0), np.log(300.0)))), float(rng.uniform(25.0, 90.0))
        share, damping = float(rng.uniform(0.15, 0.5)), float(rng.uniform(0.01, 0.06))
        crossover = 2.0 * np.pi * float(rng.uniform(8.0, 16.0))
        gain = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))) * mass
        axis = machine("emps2019").replace(
            mechanics={"mass": mass, "viscous": 2.0 * mass, "coulomb": 0.2 * mass, "offset": 0.0},
            drive={"force_gain": gain},
            sampling={"computation_delay": int(rng.integers(0, 2)), "encoder_resolution": 1e-8},
            controller={"kind": "position_pd", "kp": 0.35 * crossover, "kv": mass * crossover / gain},
            effects=[{"kind": "flexible_coupling", "frequency": frequency, "damping": damping, "share": share}],
        )
        loop = axis_loop(axis, SPEED)
        if loop.radius < 0.995:
            return axis


def true_loop(axis):
    """Open loop at the plant input as functions of frequency [rad/s] and of frequency and delay [s]."""
    period = axis.sampling.period
    plant, law = sample_axis(axis, SPEED), linear_law(law_of(axis, period), period)

    def seen(w):
        increments = estimator_response(plant.estimator, w, period) * (1.0 - np.exp(-1j * w * period))
        return law_response(law, w, period) * period / increments

    return lambda w: -seen(w) * plant.response(w), lambda w, late: -seen(w) * plant.delayed_response(w, late)


def true_margins(axis):
    """Margins of the true sampled loop, the disk margin by a fine grid."""
    L, delayed = true_loop(axis)
    nyquist = np.pi / axis.sampling.period
    grid = np.concatenate([np.geomspace(1e-4, 0.05, 500) * nyquist, np.linspace(0.0501, 0.999999, 6000) * nyquist])
    found = loop_margins(L, grid, axis_loop(axis, SPEED).stable, axis.sampling.period, delayed).to_dict()
    return {**found, "disk_margin": float(1.0 / np.max(np.abs(1.0 / (1.0 + L(grid)) - 0.5)))}


def delay_by_force(axis):
    """The delay [s] behind the plant input that makes the true loop unstable, by its poles."""
    from emps_design.control.sampled import close

    period = axis.sampling.period
    plant, law = sample_axis(axis, SPEED), linear_law(law_of(axis, period), period)

    def stable(late):
        return close(plant.delayed(late), law).stable

    step = high = 0.05 * period
    while stable(high):
        high += step
    low = high - step
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return 0.5 * (low + high)


def disk_by_force(axis):
    """The smallest |d| of a complex factor (1 + d/2)/(1 - d/2) at the plant input that makes the true loop unstable."""
    loop = axis_loop(axis, SPEED)
    column, row = loop.B[:, loop.inputs.index("voltage")], loop.C[3]
    opened = loop.A - np.outer(column, row)

    def radius(d):
        factor = (1.0 + 0.5 * d) / (1.0 - 0.5 * d)
        return np.max(np.abs(np.linalg.eigvals(opened + factor * np.outer(column, row))))

    best = 1.99
    for angle in np.linspace(0.0, np.pi, 181):
        turn, low, high = np.exp(1j * angle), 0.0, best
        if radius(high * turn) <= 1.0:
            continue
        while high - low > 1e-4 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if radius(middle * turn) <= 1.0 else (low, middle)
        best = high
    return float(best)


def one_axis(seed):
    """What one axis gives: coverage, resonances, margins in their bands."""
    rng = np.random.default_rng([SEED, seed])
    axis = random_axis(rng)
    mass, gain = axis.mechanics.mass, axis.drive.force_gain
    volts, newtons = 2.0 * mass / gain, 0.02 * mass
    record = experiment(axis, seed, samples=2000, periods=5, volts=volts, newtons=newtons, speed=SPEED, top=250.0)
    found = estimate_response(record, axis)
    truth = exact(axis, found.response.frequency, SPEED)
    error = np.abs(found.response.response / truth - 1.0)
    ratio = np.abs(found.spectral_ratio / truth - 1.0)
    effect = axis.effects[0].parameters
    wanted = {
        "antiresonance": effect["frequency"] * np.sqrt(1.0 - effect["share"]),
        "resonance": effect["frequency"],
    }
    near = {
        kind: min((abs(one.frequency / at - 1.0) for one in found.resonances if one.kind == kind), default=None)
        for kind, at in wanted.items()
    }
    chain = found.comparison.chain
    parameters = {"mass": mass, "viscous": axis.mechanics.viscous, **effect}
    off = {name: (chain.parameters[name][0] - value) / chain.parameters[name][1] for name, value in parameters.items()
           if name in chain.parameters}  # fmt: skip
    measured, true = measured_margins(found.response, axis), true_margins(axis)
    inside = {}
    for name in COMPARED:
        band = measured.bands[name]
        if band is not None and true[name] is not None:
            inside[name] = bool(band[0] <= true[name] <= band[1])
    return {
        "seed": seed,
        "lines": len(found.response),
        "covered": float(np.mean(error <= BAND * found.response.std)),
        "median_std": float(np.median(found.response.std)),
        "median_error": float(np.median(error)),
        "median_error_spectral_ratio": float(np.median(ratio)),
        "largest_error_below_30_hz": [float(np.max(e[found.response.frequency < 30.0])) for e in (error, ratio)],
        "resonance_error": near,
        "coupling": {"masses": int(chain.masses.size), "deviations_off": off},
        "stable": [measured.stable, bool(true["stable"])],
        "margins": {name: [true[name], measured.values[name], measured.bands[name]] for name in COMPARED},
        "inside": inside,
        "delay_by_force": delay_by_force(axis),
        "disk_by_force": disk_by_force(axis),
        "true": {name: true[name] for name in ("delay_margin", "disk_margin")},
    }


def exact_against_force(seed):
    """Delay and disk margin from exact lines, a hertz apart or closer, against brute force: relative differences."""
    from emps_design.frequency_response import FrequencyResponse

    axis = random_axis(np.random.default_rng([SEED, seed]))
    f = np.arange(1.0, 400.0, 0.5)
    measured = measured_margins(FrequencyResponse.of(f, exact(axis, f, SPEED)), axis)
    return {
        "delay_margin": abs(measured.values["delay_margin"] / delay_by_force(axis) - 1.0),
        "disk_margin": abs(measured.values["disk_margin"] / disk_by_force(axis) - 1.0),
    }


def gantry(seed):
    """A gantry with a load behind a coupling of 48 Hz, a cascade with low-pass and notch: the drive, and its model."""
    rng = np.random.default_rng([SEED, 48, seed])
    mass, share = float(rng.uniform(40.0, 90.0)), float(rng.uniform(0.2, 0.45))
    notch = {"kind": "notch", "frequency": 48.0, "damping": 0.6, "depth": 0.15}
    gain = 15.0
    model = machine("emps2019").replace(
        mechanics={"mass": mass, "viscous": 5.0 * mass, "coulomb": 0.8 * mass, "offset": 0.0},
        drive={"force_gain": gain, "current_time_constant": 2.5e-4, "voltage_limit": 146.0},
        sampling={"period": 5e-4, "encoder_resolution": 1e-8, "computation_delay": 1},
        controller={
            "kind": "cascade",
            "position": {"kp": 10.0, "every": 4},
            "velocity": {"kp": 40.0 * mass / gain, "ti": 0.06},
            "filters": [{"kind": "lowpass", "frequency": 350.0}, notch],
        },
    )
    coupling = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": share}
    return model.replace(effects=[coupling]), model, float(rng.uniform(60.0, 110.0)), float(rng.uniform(45.0, 60.0))


def measured_on(drive, model, seed, top):
    """The record of the simulated ``drive`` under the experiment planned on its ``model``, with force noise."""
    plan = design_experiment(model, Limits(stroke=0.8), speed=0.06, high=top, resolution=0.5, seed=seed)
    noise = 0.02 * drive.mechanics.mass * np.random.default_rng(seed).standard_normal(plan.q_ref.size)
    return run(drive, plan.q_ref, plan.excitation, noise)


def retuned(seed):
    """Crossover and phase margin asked for and achieved in the simulated drive, measured there: L = 1/S - 1."""
    drive, model, crossover, phase = gantry(seed)
    response = estimate_response(measured_on(drive, model, seed, 300.0), model).response
    refused = False
    try:
        design = retune_on_response(response, model, crossover, phase)
    except SpecificationError as error:  # what it proposes instead is asked for
        refused, crossover = True, error.nearest["crossover"]
        design = retune_on_response(response, model, crossover, phase)
    new = design.loop_axis.replace(effects=drive.effects)
    after = measured_on(new, design.loop_axis, seed + 1000, 200.0)
    answer, _ = periodic_answer([signals_of(after)], 200.0, no_progress)
    w, L = 2.0 * np.pi * answer.frequency, 1.0 / answer.z[:, 1] - 1.0
    at = np.flatnonzero((np.abs(L[:-1]) >= 1.0) & (np.abs(L[1:]) < 1.0))
    share = np.log(np.abs(L[at])) / np.log(np.abs(L[at] / L[at + 1]))
    crossings = w[at] * (w[at + 1] / w[at]) ** share
    lags = np.degrees(np.angle(-L[at]) + share * np.angle(L[at + 1] / L[at]))
    least = int(np.argmin(lags))
    achieved = {"crossover": float(crossings[least]), "phase_margin_deg": float(lags[least])}
    asked = {"crossover": crossover, "phase_margin_deg": phase}
    return {
        "refused_at_first": refused,
        "asked": asked,
        "achieved": achieved,
        "off": {name: abs(achieved[name] / asked[name] - 1.0) for name in asked},
        "gains": [design.k_v1, design.t_v],
    }


def main(axes=AXES):
    """Run the study and write it."""
    rows = []
    for seed in range(axes):
        rows.append(one_axis(seed))
        print(f"{seed}: covered {rows[-1]['covered']:.3f}, inside {rows[-1]['inside']}", file=sys.stderr)
    tuned = [retuned(seed) for seed in range(min(axes, 12))]
    fitted = [row["coupling"] for row in rows]
    held = [abs(value) < 1.96 for one in fitted if one["masses"] == 2 for value in one["deviations_off"].values()]
    forced = [exact_against_force(seed) for seed in range(min(axes, 20))]
    inside = {name: [row["inside"][name] for row in rows if name in row["inside"]] for name in COMPARED}
    near = {
        kind: [row["resonance_error"][kind] for row in rows if row["resonance_error"][kind] is not None]
        for kind in ("antiresonance", "resonance")
    }
    document = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "axes": axes,
        "coverage": {
            "lines": sum(row["lines"] for row in rows),
            "mean": float(np.average([row["covered"] for row in rows], weights=[row["lines"] for row in rows])),
            "least": min(row["covered"] for row in rows),
        },
        "median_error": {
            "joint": float(np.median([row["median_error"] for row in rows])),
            "spectral_ratio": float(np.median([row["median_error_spectral_ratio"] for row in rows])),
        },
        "resonances": {kind: {"found": len(e), "largest_error": max(e)} for kind, e in near.items()},
        "margins_inside": {name: [sum(values), len(values)] for name, values in inside.items()},
        "stability_right": sum(row["stable"][0] == row["stable"][1] for row in rows),
        "against_brute_force": {name: max(one[name] for one in forced) for name in ("delay_margin", "disk_margin")},
        "coupling": {
            "two_masses": sum(one["masses"] == 2 for one in fitted),
            "of": len(fitted),
            "parameters_inside": [sum(held), len(held)],
        },
        "retuned": {
            "drives": len(tuned),
            "refused_at_first": sum(one["refused_at_first"] for one in tuned),
            "largest": {name: max(one["off"][name] for one in tuned) for name in ("crossover", "phase_margin_deg")},
        },
        "retuned_rows": tuned,
        "rows": rows,
    }
    path = Path(__file__).with_suffix(".json")
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({key: value for key, value in document.items() if "rows" not in key}, indent=1))


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
