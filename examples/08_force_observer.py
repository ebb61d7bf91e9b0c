"""A force that the drive does not know of, seen by three observers.

Run: python examples/08_force_observer.py [DATA_EMPS.mat DATA_EMPS_PULSES.mat [figure.png]]. In PULSES a square wave of
about 1.014 V was added behind the controller; taking it out of ``vir`` makes it an unknown force of 178 N. Without the
records the same is done with a simulated machine.
"""

import sys

import numpy as np

from emps_design.identification import identify, observe, with_known_push
from emps_design.machines import machine
from emps_design.observer import kalman_trade_off
from emps_design.records import Record, read_record
from emps_design.simulation import Plant, synthetic_record, trapezoid_laps

VOLTS_PER_PULSE = 1.0139  # V for a unit of pulses_N: regressed from the record, residual 4.7 mV

axis = machine("emps2019")
if len(sys.argv) > 2:
    found = identify(read_record(sys.argv[1]), axis)
    pulses = read_record(sys.argv[2])
    wave = VOLTS_PER_PULSE * np.ravel(np.asarray(pulses.extra["pulses_N"], dtype=float))
else:
    found = identify(synthetic_record(axis, laps=1), axis)
    q_ref = trapezoid_laps(1e-3, laps=1)
    wave = VOLTS_PER_PULSE * 5.0 * (np.arange(q_ref.size) // 500 % 2)
    noise = np.random.default_rng(0).normal(0.0, 4e-3, q_ref.size)
    run = Plant.of(machine("emps2019")).closed_loop(q_ref, voltage_noise=wave + noise)
    pulses = Record.from_arrays(1e-3, q_ref, run.q, run.u, name="simulated")

axis, std = found.to_axis(), np.array([one.std_long_run for one in found.parameters.values()])
seen = observe(with_known_push(pulses, wave, axis.drive.force_gain), axis, parameter_std=std)
judged = seen.methods["offline"].judged
print(f"{seen.record}: a square wave of {np.ptp(seen.f_ext):.2f} N; errors from {judged[0]:.2f} to {judged[1]:.2f} s")
for name, result in seen.methods.items():
    steps, smallest = result.steps, result.smallest
    print(
        f"{name:8} rms error {result.rms_error:6.2f} N, away from edges {steps.rms_error_away_from_edges:.2f} N; "
        f"plateau {steps.plateau_error_percent:+.2f} %; delay {1e3 * result.delay:.2f} ms as designed, "
        f"{1e3 * steps.delay:.2f} ms to half a step; rise {1e3 * steps.rise_time:.1f} ms"
    )
    print(
        f"         smallest force {smallest.value:.1f} N, set by {smallest.bound.replace('_', '-')}: "
        + ", ".join(f"{bound.replace('_', '-')} {value:.2f} N" for bound, value in smallest.bounds.items())
    )

table = kalman_trade_off(axis, np.array([5.0, 10.0, 20.0, 50.0, 100.0]))
print("\nKalman observer: bandwidth [Hz], delay [ms], noise from the encoder alone [N]")
for bandwidth, delay, noise in zip(table["bandwidth_hz"], table["delay"], table["noise_std"], strict=True):
    print(f"{bandwidth:8.1f} {1e3 * delay:8.2f} {noise:10.4f}")

if len(sys.argv) > 3:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 1, figsize=(9, 7), layout="constrained")
    for panel, (start, stop) in zip(axes, ((0.0, seen.t[-1]), (2.3, 2.45)), strict=True):
        shown = (seen.t >= start) & (seen.t <= stop)
        panel.plot(seen.t[shown], seen.f_ext[shown], "k", lw=1.5, label="force that acts")
        for name, result in seen.methods.items():
            panel.plot(seen.t[shown], result.force[shown], lw=0.8, label=name)
        panel.set(xlabel="time [s]", ylabel=r"external force $\tau_e$ [N]")
    axes[0].set_title("A force the drive does not know of, and what three observers see of it")
    axes[1].legend()
    figure.savefig(sys.argv[3], dpi=120)
