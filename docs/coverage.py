"""How often the 95 % intervals of `identify` hold the truth: simulated records whose force noise is slow."""

import numpy as np
from scipy.signal import lfilter

from emps_design import Plant, Record, identify, machine
from emps_design.simulation.practice import trapezoid_laps

RUNS, NOISE, VOLTAGE_NOISE = 100, 1.0, 4e-3  # records, N, V
axis = machine("emps2019")
period = axis.sampling.period
plant, q_ref = Plant.of(axis), trapezoid_laps(period, laps=1)
truth = dict(zip(("mass", "viscous", "coulomb", "constant_force"), axis.mechanics.array(), strict=True))

print(f"{'noise correlated over':24s}{'parameter':18s}{'95 % intervals':>16s}{'by (15) alone':>16s}")
for time in (0.03, 0.1, 0.3):
    inside, plain = dict.fromkeys(truth, 0), dict.fromkeys(truth, 0)
    a = np.exp(-period / time)
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        white = NOISE * np.sqrt(1 - a * a) * rng.standard_normal(q_ref.size)
        push = lfilter([1.0], [1.0, -a], white, zi=[a * NOISE * rng.standard_normal()])[0]
        noise = VOLTAGE_NOISE * rng.standard_normal(q_ref.size)
        run = plant.closed_loop(q_ref, disturbance=push, voltage_noise=noise)
        record = Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=period, name=f"simulated-{seed}")
        found = identify(record, axis, chain="hold", cutoff_hz=30.0)
        for name, value in truth.items():
            estimate = found.parameters[name]
            low, high = estimate.interval_95
            inside[name] += low <= value <= high
            plain[name] += abs(estimate.value - value) <= 1.96 * estimate.std
    for name in truth:
        words = f"{time * 1e3:.0f} ms" if name == "mass" else ""
        print(f"{words:24s}{name:18s}{100 * inside[name] / RUNS:>14.0f} %{100 * plain[name] / RUNS:>14.0f} %")
sure = 196 * np.sqrt(0.95 * 0.05 / RUNS)
print(f"{RUNS} records each, {NOISE:g} N of noise; a share of 95 % is known to +-{sure:.0f} %")
