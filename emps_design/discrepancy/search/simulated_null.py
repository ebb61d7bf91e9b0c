"""The healthy reference by brute force: simulated healthy records, each searched like the real one.

:mod:`~emps_design.discrepancy.search.null_distribution` lays signatures over resampled noise, which takes no time and
leaves out that proposals, too, adapt to the noise. Here the fitted baseline is simulated, resampled noise is laid over
its voltage, and baseline fit, proposals, screening and fits run as on the record itself: one search per record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.discrepancy.model.problem import Fit, Problem, fit
from emps_design.discrepancy.search.beam_search import extensions, screen
from emps_design.discrepancy.search.noise_floor import Floor
from emps_design.discrepancy.search.null_distribution import Healthy, resampled
from emps_design.discrepancy.search.starts import tangent
from emps_design.effects import Effect


def healthy_runs(
    problem: Problem,
    baseline: Fit,
    library: tuple[Effect, ...],
    floor: Floor,
    runs: int,
    seed: int,
    progress: Callable[[float], None],
) -> Healthy:
    """Return the largest gain [whitened cost] of any effect of ``library`` on each of ``runs`` healthy records."""
    generator, largest = np.random.default_rng(seed), np.empty(runs)
    for i in range(runs):
        healthy = _healthy_records(problem, baseline, floor, generator)
        alone = fit(healthy, baseline.model)
        absorbed = tangent(healthy, alone)
        found, gains = extensions(healthy, alone, screen(healthy, alone, library, absorbed), absorbed)
        largest[i] = max([0.0, *gains.values(), *(alone.cost_fit - f.cost_fit for f in found)])
        progress(0.1 * (i + 1) / runs)
    return Healthy(np.sort(largest), searched=True)


def _healthy_records(problem: Problem, baseline: Fit, floor: Floor, generator: np.random.Generator) -> Problem:
    gain, records = problem.axis.drive.force_gain, []
    for record, run in zip(problem.records, problem.runs(baseline.model), strict=True):
        noise = floor.whitening.undo(resampled(floor.draws, len(record), generator))
        records.append(replace(record, q=run.q, u=run.u + noise / gain))
    return replace(problem, records=tuple(records))
