"""Draw docs/picture.png, the picture of the README, from a simulated machine that has an effect its model lacks."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from emps_design import design_velocity_loop, diagnose, identify, load_axis, synthetic_record

BLACK, BLUE, ORANGE, GREEN = "#222222", "#0072B2", "#D55E00", "#009E73"

axis = load_axis("emps2019")
machine = axis.replace(
    effects=[{"kind": "position_ripple", "amplitude": 3.0, "period": 0.0025, "phase": 0.5}],
)
record = synthetic_record(machine, seed=1)
holdout = synthetic_record(machine, seed=2, speed=0.08)
found = identify(record, axis)
design = design_velocity_loop(found.to_axis(), crossover=100.0, phase_margin_deg=60.0)
diagnosis = diagnose(record, axis, holdout=holdout)

figure = Figure(figsize=(12, 3.4), layout="constrained")
left, middle, right = figure.subplots(1, 3)

part = slice(0, 6000)
left.plot(record.t[part], axis.drive.force_gain * record.u[part], color=BLACK, lw=0.6)
left.set(xlabel="time [s]", ylabel="motor force [N]")
estimate = found.parameters["mass"]
left.set_title(f"record → axis: M = {estimate.value:.1f} ± {estimate.std:.1f} kg", fontsize=10)

w = np.logspace(0, 3.3, 400)
loop = design.plant_input_loop()
middle.loglog(w, np.abs(loop(1j * w)), color=BLUE)
middle.axhline(1.0, color=BLACK, lw=0.6)
crossover = design.plant_input.crossover
middle.plot([crossover], [1.0], "o", color=BLUE)
middle.annotate(f"{crossover:.0f} rad/s", (crossover, 1.0), (6, 6), textcoords="offset points", fontsize=9)
middle.set(xlabel="frequency [rad/s]", ylabel="loop gain at the plant input")
margin = design.to_dict()["sampled"]["phase_margin_deg"]
middle.set_title(f"axis → gains: {margin:.0f} deg left at 1 kHz", fontsize=10)

trace = diagnosis.trace
shown = slice(200, 1400)
right.plot(trace.t[shown], (trace.measured - trace.baseline)[shown], color=ORANGE, lw=0.7, label="without")
right.plot(trace.t[shown], (trace.measured - trace.extended)[shown], color=GREEN, lw=0.7, label="with what was found")
right.set(xlabel="time of a record it has not seen [s]", ylabel="force error [N]", ylim=(-5, 5.8))
names = ", ".join(finding.label.lower() for finding in diagnosis.findings) or "nothing"
right.set_title(f"what is missing: {names}", fontsize=10)
right.legend(fontsize=8, loc="upper right", ncols=2)

for axes in (left, middle, right):
    axes.grid(alpha=0.3)
figure.savefig(Path(__file__).with_name("picture.png"), dpi=110, metadata={"Software": None})
print(diagnosis.sentence)
