"""Verdicts of `gains` against the simulated drive: `python -m benchmarks.verdicts [--seed 59] [--count 60]`.

Drives drawn at random, of 0.02 kg to 5 t, sampled at 250 Hz to 16 kHz, with a current lag, up to two samples of delay,
a cascade of PI in P in every first to fourth sample, and one in three with a second mass behind a coupling. `gains`
keeps the position loop, over 1 to 3 times the inertia. Each verdict is tried on the drive at 1, 1.3, 1.7, 2.2 and 3
times the inertia, linear: no dry friction, no limit, no quantisation. After a small step of the reference the error
dies away or it does not. Prints the counts, and every drive whose verdict is not what happened.
"""

from __future__ import annotations

import argparse

import numpy as np

from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.load_range import LoadRange, loaded
from emps_design.control.verdict import DesignVerdict
from emps_design.errors import SimulationError
from emps_design.machines import machine
from emps_design.simulation import Plant

FACTORS = (1.0, 1.3, 1.7, 2.2, 3.0)
STEP = 1e-6  # m
PERIODS = 60.0  # of the position loop, that are simulated


def random_drive(rng):
    """A drive and the crossover [rad/s] and phase margin [deg] asked of its velocity loop."""
    mass = float(np.exp(rng.uniform(np.log(0.02), np.log(5e3))))
    period = 1.0 / float(np.exp(rng.uniform(np.log(250.0), np.log(16e3))))
    crossover = float(np.exp(rng.uniform(np.log(0.005), np.log(0.08)))) / period
    effects = []
    if rng.random() < 1.0 / 3.0:
        frequency = float(rng.uniform(3.0, 12.0)) * crossover / (2.0 * np.pi)
        frequency = min(frequency, 0.3 / period)
        effects = [{"kind": "flexible_coupling", "frequency": frequency, "damping": 0.03, "share": 0.4}]
    kp = crossover * float(np.exp(rng.uniform(np.log(0.05), np.log(2.0))))
    axis = machine("emps2018").replace(
        mechanics={"mass": mass, "viscous": mass * float(rng.uniform(0.0, 5.0)), "coulomb": 0.0, "offset": 0.0},
        drive={
            "force_gain": mass,
            "current_time_constant": float(rng.uniform(0.0, 2.0)) * period,
            "voltage_limit": 1e6,
        },
        sampling={"period": period, "computation_delay": int(rng.integers(0, 3))},
        effects=effects,
    )
    drive = {
        "kind": "cascade",
        "position": {"kp": kp, "every": int(rng.integers(1, 5))},
        "velocity": {"kp": 1.0, "ti": 1.0},
    }
    return axis.model_copy(update={"controller": type(axis.controller).model_validate(drive)}), crossover, 60.0


def dies_away(axis) -> bool:
    """Whether the error after a small step of the reference is smaller late than early."""
    period, kp = axis.sampling.period, axis.controller.position["kp"]
    samples = int(np.clip(PERIODS * 2.0 * np.pi / (kp * period), 2000, 120_000))
    reference = np.full(samples, STEP)
    reference[0] = 0.0
    try:
        q = Plant.of(axis).closed_loop(reference, quantise=False).q
    except SimulationError:  # it left every bound
        return False
    error = np.abs(q - STEP)
    fifth = samples // 5
    late, before = error[-fifth:].max(), error[-2 * fifth : -fifth].max()
    return bool(np.isfinite(late) and (late < 1e-3 * STEP or late < before))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=59)
    parser.add_argument("--count", type=int, default=60)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    counts = {(said, was): 0 for said in ("stable", "unstable") for was in ("stable", "unstable")}
    for number in range(asked.count):
        axis, crossover, phase = random_drive(rng)
        design = design_velocity_loop(axis, crossover, phase_margin_deg=phase)
        found = DesignVerdict(design, span=LoadRange(inertia=(1.0, 3.0)))
        runs = design.axis_that_runs
        away = [dies_away(loaded(runs, factor, 1.0)) for factor in FACTORS]
        said, was = ("stable" if one else "unstable" for one in (found.stable, all(away)))
        counts[said, was] += 1
        if said != was:
            worst = found.worst
            print(f"drive {number}: said {said} ({worst.name} {dict(worst.where)} {worst.margins}), was {away}")
    print("verdict over 1 to 3 times the inertia, and what the simulated drive did:")
    for (said, was), count in counts.items():
        print(f"  said {said:>8}, was {was:>8}: {count}")


if __name__ == "__main__":
    main()
