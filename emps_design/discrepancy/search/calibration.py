"""The second stage: the fitted baseline, the noise it is judged by, and what chance alone would gain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from emps_design.discrepancy.checks.preparation import Preparation
from emps_design.discrepancy.model.fit import Fit, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.acceptance import Judge
from emps_design.discrepancy.search.cross_validated_noise import unpredicted
from emps_design.discrepancy.search.noise_floor import STROKES, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.search.null_distribution import Healthy, healthy_reference
from emps_design.discrepancy.search.simulated_null import healthy_runs
from emps_design.discrepancy.search.starts import Start, screen, tangent
from emps_design.discrepancy.search.suspects import by_signature, told
from emps_design.progress import Progress
from emps_design.simulation import Plant

BASELINE_STEPS = 20  # of the baseline's fit, which starts from the axis file


@dataclass(frozen=True)
class Calibration:
    """The baseline fitted under the noise of ``floor``, the starts on top of it, and what healthy records gain."""

    preparation: Preparation
    baseline: Fit
    floor: Floor
    healthy: Healthy
    screened: list[list[Start]]
    warnings: tuple[str, ...] = ()

    @property
    def judge(self) -> Judge:
        """What accepts a finding under this noise and this chance."""
        return Judge(self.floor, self.healthy)


def first_noise(preparation: Preparation) -> tuple[Hypothesis, Floor]:
    """Fit the baseline by plain least squares, and take the noise from what it leaves: of laps, or of other strokes."""
    # Kernels are compiled here: simulations run side by side from now on, and must not compile the same one twice.
    effects = [(effect, np.zeros(len(effect.parameters))) for effect in preparation.library]
    Plant(preparation.start.problem.axis, effects)
    rough = fit(preparation.start, steps=BASELINE_STEPS)
    floor = floor_of_laps(rough.residuals(), rough.problem.splits, rough.problem.period)
    if floor is None:
        left = unpredicted(rough, preparation.library)
        floor = floor_of_residual(left, rough.problem.period, STROKES)
    return rough, floor


def calibrate(
    preparation: Preparation, start: Hypothesis, floor: Floor, seed: int, runs: int, progress: Progress
) -> Calibration:
    """Fit the baseline from ``start`` under the noise of ``floor``; see what chance gains, on ``runs`` healthy records.

    With 0 ``runs`` chance is a linearisation: signatures over resampled noise.
    """
    progress("healthy reference", 0.0)
    weighed = Hypothesis(start.problem.with_whitening(floor.whitening), start.model)
    baseline = fit(weighed, steps=BASELINE_STEPS)
    warnings: tuple[str, ...] = ()
    absorbed = tangent(baseline)
    screened = screen(baseline, preparation.library, absorbed)
    progress(f"healthy reference{told(by_signature(screened, absorbed))}", 0.05)
    healthy = healthy_reference(screened, floor.draws, seed)
    if runs:
        try:
            report = partial(progress, "healthy records, each searched")
            healthy = healthy_runs(baseline, preparation.library, floor, runs, seed, report)
        except KeyboardInterrupt:
            warnings = ("interrupted: calibrated on resampled noise, not on healthy records searched",)
    return Calibration(preparation, baseline, floor, healthy, screened, warnings)
