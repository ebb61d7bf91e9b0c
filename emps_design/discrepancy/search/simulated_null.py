"""The healthy reference by brute force: simulated healthy records, each searched like the real one.

:mod:`~emps_design.discrepancy.search.null_distribution` lays signatures over resampled noise, which takes no time and
leaves out that proposals, too, adapt to the noise. Here the fitted baseline is simulated, resampled noise is laid over
its voltage, and baseline fit, proposals, screening and fits run as on the record itself: one search per record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.discrepancy.model.fit import Fit, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.extension import extensions
from emps_design.discrepancy.search.noise_floor import Floor
from emps_design.discrepancy.search.null_distribution import Healthy, blocks, resampled
from emps_design.discrepancy.search.starts import screen, tangent
from emps_design.effects import Effect


def healthy_runs(
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
        alone = fit(_healthy_records(baseline, floor, generator))
        absorbed = tangent(alone)
        found, gains = extensions(alone, screen(alone, library, absorbed), absorbed)
        largest[i] = max([0.0, *gains.values(), *(alone.cost_fit - f.cost_fit for f in found)])
        progress(0.1 * (i + 1) / runs)
    return Healthy(np.sort(largest), searched=True)


def _healthy_records(baseline: Fit, floor: Floor, generator: np.random.Generator) -> Hypothesis:
    """The baseline, and what it would have recorded with resampled noise over its voltage."""
    gain, records = baseline.problem.axis.drive.gain, []
    for record, run in zip(baseline.problem.records, baseline.runs(), strict=True):
        noise = floor.whitening.undo(
            resampled(floor.draws, len(record), *blocks(floor.draws.size, len(record), generator))
        )
        records.append(replace(record, q=run.q, u=run.u + noise / gain))
    return Hypothesis(replace(baseline.problem, records=tuple(records)), baseline.model)
