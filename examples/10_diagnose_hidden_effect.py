"""Hide an effect in a simulated machine, and let the diagnosis find it.

Run: python examples/10_diagnose_hidden_effect.py [figure.png]. The record comes from a machine with Stribeck friction;
the axis file knows nothing of it, and its mass is 3 % off. A second record, along another program, confirms.
"""

import sys

import numpy as np

from emps_design.discrepancy import diagnose
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant, trapezoid_laps

HIDDEN = {"kind": "stribeck_friction", "excess": 8.0, "stribeck_velocity": 0.008, "exponent": 1.0}

# 1. The machine as it is, and what its data sheet says.
truth = machine("emps2019").replace(effects=[HIDDEN])
sheet = machine("emps2019").replace(mechanics={"mass": 98.0, "offset": 0.0})


def record(name: str, q_ref: np.ndarray, seed: int) -> Record:
    """One run of the true machine, with 4 mV of voltage noise."""
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(truth).closed_loop(q_ref, voltage_noise=noise)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name=name)


train = record("train", trapezoid_laps(1e-3, stroke=0.12, speed=0.2, laps=3), seed=1)
holdout = record("holdout", trapezoid_laps(1e-3, stroke=0.10, speed=0.12, laps=1), seed=2)

# 2. Where do simulation and machine disagree?
diagnosis = diagnose(train, sheet, holdout=holdout)
print(diagnosis.verdict)
print(diagnosis.sentence)

# 3. The numbers that were hidden, and those that were found.
for finding in diagnosis.findings:
    for name, found in finding.parameters.items():
        hidden = f"{HIDDEN[name]:.4g}" if finding.effect == HIDDEN["kind"] else "not hidden"
        print(
            f"{finding.effect}.{name}: found {found['value']:.4g} +- {found['std']:.1g} {found['unit']}, "
            f"hidden {hidden}"
        )

# 4. The better axis goes on to every other part of the package: this is the file.
print(diagnosis.axis.to_toml())

if len(sys.argv) > 1:
    from emps_design.report import before_after_figure

    before_after_figure(diagnosis).savefig(sys.argv[1])
