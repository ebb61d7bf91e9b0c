"""From a crossover and a phase margin to gains that also work in the sampled loop.

Run it: python examples/01_gains.py [figure.svg]
"""

import sys

import numpy as np

from emps_design.control import (
    design_velocity_loop,
    margins_under_mismatch,
    relative_mismatch,
    retune_velocity_loop,
    sample_axis,
    sweep_sampled_margins,
    sweep_velocity_loop,
)
from emps_design.machines import machine

axis = machine("emps2018")

# The paper's design: 100 rad/s and 60 deg, asked of the loop broken at the velocity error, (7).
design = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)
print(f"k_v1 = {design.k_v1:.3f} V/(m/s), t_v = {1e3 * design.t_v:.4f} ms, -3 dB at {design.bandwidth:.1f} rad/s")

# The same gains, seen where delay, current loop and sampling sit: at the plant input.
for name, margins in (("continuous", design.plant_input), ("sampled", design.sampled.margins)):
    print(
        f"{name:>10} plant input: {margins.phase_margin_deg:.1f} deg at {margins.crossover:.0f} rad/s, "
        f"delay margin {1e3 * margins.delay_margin:.2f} ms"
    )

# One more sample of delay, and a specification that looks better: stability first, always.
late = axis.replace(sampling={"computation_delay": 1})
steep = design_velocity_loop(late, crossover=100.0, phase_margin_deg=80.0)
print(f"80 deg and a sample of delay: stable {steep.sampled.stable}, nearest that is: {steep.nearest_stable}")

# Gains with which the sampled loop has the margin.
retuned = retune_velocity_loop(late, crossover=100.0, phase_margin_deg=50.0)
print(
    f"retuned: k_v1 = {retuned.k_v1:.3f} V/(m/s), t_v = {1e3 * retuned.t_v:.3f} ms, sampled "
    f"{retuned.sampled.margins.phase_margin_deg:.2f} deg at {retuned.sampled.margins.crossover:.2f} rad/s"
)

# A model that is 2 % wrong.
study = margins_under_mismatch(design, relative_mismatch(0.02))
low, high = study["phase_margin_deg"]
print(f"+-2 % on mass, friction and gain: {low:.1f} to {high:.1f} deg in the sampled loop")

# The whole map: phase margin of the sampled loop over what was asked for.
crossover, phase = np.geomspace(20.0, 400.0, 100), np.linspace(20.0, 85.0, 100)
sweep = sweep_velocity_loop(axis, crossover[:, None], phase[None, :])
sampled = sweep_sampled_margins(sample_axis(axis), sweep.k_v1, sweep.t_v)
print(f"{sweep.k_v1.size} designs: {100 * np.mean(sampled['stable']):.1f} % are stable when sampled")

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
    contours = axes.contourf(phase, crossover, sampled["phase_margin_deg"], levels=np.arange(0, 91, 10))
    figure.colorbar(contours, label="phase margin of the sampled loop at the plant input [deg]")
    axes.set(
        xlabel="phase margin asked for [deg]",
        ylabel="crossover asked for [rad/s]",
        yscale="log",
        title="What sampling, current loop and estimator leave (white: unstable)",
    )
    figure.savefig(sys.argv[1])
    print(f"figure: {sys.argv[1]}")
