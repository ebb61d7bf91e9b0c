"""From an experiment to margins on the measured plant: excite, measure in closed loop, design, judge.

Run: python examples/13_frequency_response.py [figure.png]. The drive is simulated: a carriage with a load behind a
coupling of 60 Hz, which the model that designs the experiment and the gains knows nothing of.
"""

import sys

import numpy as np

from emps_design.control import design_velocity_loop
from emps_design.frequency_response import (
    Limits,
    design_experiment,
    estimate_response,
    measured_margins,
    retune_on_response,
)
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

model = machine("emps2019")
drive = model.replace(effects=[{"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.02, "share": 0.4}])

# 1. The experiment: a multi-sine on a carriage that runs to and fro, so that dry friction is a constant.
plan = design_experiment(model, Limits(stroke=0.5), speed=0.05, high=200.0, resolution=0.5)
print(f"{plan.frequency.size} lines, {plan.passes} passes of {plan.periods} periods, limited by the {plan.bound_by}")
print(f"command at most {plan.peaks['command']:.2f} V, speed {plan.peaks['slowest']:.3f} m/s or more")

# 2. The record, with noise on the force.
noise = 5.0 * np.random.default_rng(1).standard_normal(plan.q_ref.size)
run = Plant.of(drive).closed_loop(plan.q_ref, disturbance=noise, voltage_noise=plan.excitation)
record = Record.from_arrays(plan.period, run.q_ref, run.q, run.u, name="measured", excitation=plan.excitation)

# 3. The response, with its deviations; feedback does not bias it.
found = estimate_response(record, model)
print(f"{len(found.response)} lines by the {found.instrument}, {found.method}; median deviation", end=" ")
print(f"{100 * np.median(found.response.std):.2f} %")
for one in found.resonances:
    print(f"{one.kind} at {one.frequency:.2f} Hz, 95 % within {2 * one.std:.2f} Hz")

chain = found.comparison.chain  # masses behind springs, as many as the response asks for
print(f"fitted: {chain.label}", {name: round(value, 3) for name, (value, _, _) in chain.parameters.items()})
print(found.comparison.agreement.sentence)

# 4. Gains from the model, judged on the measurement, and gains from the measurement.
for label, design in (
    ("model", design_velocity_loop(model, crossover=40.0, phase_margin_deg=60.0)),
    ("measurement", retune_on_response(found.response, model, crossover=80.0, phase_margin_deg=55.0)),
):
    margins = measured_margins(found.response, model.replace(controller=design.controller_table()))
    low, high = margins.bands["phase_margin_deg"]
    print(f"gains from the {label}: k_v1 {design.k_v1:.1f}, t_v {1e3 * design.t_v:.2f} ms; on the measured plant")
    print(f"    {margins.values['phase_margin_deg']:.1f} deg [{low:.1f}, {high:.1f}]", end=", ")
    print(
        f"delay margin {1e3 * margins.values['delay_margin']:.2f} ms, disk margin {margins.values['disk_margin']:.2f}"
    )

if len(sys.argv) > 1:
    from emps_design.report import response_figure

    response_figure(found.comparison, found.spectral_ratio).savefig(sys.argv[1])
