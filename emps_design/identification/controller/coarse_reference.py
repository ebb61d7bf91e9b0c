"""A reference that is recorded in coarser steps than the drive has it: what is fed forward is then hidden by them.

Its derivatives are part of the command. Where their rounding is about as loud as what tells derivatives of the profile
from differences, and as loud as what the law leaves, filters and gains make up for noise that no drive has. A drive
whose own reference has those steps leaves far less.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.identification.controller.best_law import Found
from emps_design.identification.controller.noise import resolution
from emps_design.identification.controller.regressors import regressors
from emps_design.identification.controller.structures import PLACE

LOUD = 0.5  # of the difference between the sources
ALIKE = 5.0  # times: what is left is of the size of this noise
FED_FORWARD = [PLACE["slip"], PLACE["acceleration"]]


def too_coarse(found: Found) -> float:
    """The step of the reference where it hides what is fed forward, 0 where it does not."""
    signals, law = found.signals, found.fit
    step = 0.0 if signals.velocity_reference or not law.structure.feeds_forward else resolution(signals.reference)
    if not step:
        return 0.0
    difference, profile = (replace(law.timing, profile=source) for source in (False, True))
    rounding = step * np.random.default_rng(0).uniform(-0.5, 0.5, len(signals))
    steps = replace(signals, reference=rounding, position=np.zeros(len(signals)))
    gains = law.beta[FED_FORWARD]

    def rms(table: np.ndarray) -> float:
        return float(np.sqrt(np.mean((table[:, FED_FORWARD] @ gains)[signals.used] ** 2)))

    noise, left = (rms(regressors(steps, timing)) for timing in (difference, law.timing))
    apart = rms(regressors(signals, profile) - regressors(signals, difference))
    own = max(apart**2 - noise**2, 0.0) ** 0.5
    return step if noise > LOUD * own and left / ALIKE < found.rms < ALIKE * left else 0.0
