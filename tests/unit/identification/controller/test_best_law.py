"""Of laws that a record cannot tell apart the simplest comes first."""

from dataclasses import replace

import numpy as np

from emps_design.identification.controller.best_law import AS_GOOD, most_often
from emps_design.identification.controller.fit import Fit
from emps_design.identification.controller.regressors import Timing
from emps_design.identification.controller.structures import PROPORTIONAL

FOUND = Fit(PROPORTIONAL, Timing(every=2), (), 0.0, np.ones(1), 100.0, 1000)


def other(every: int, worse: float, **timing) -> Fit:
    """A fit whose criterion is ``worse`` by so much than that of ``FOUND``."""
    one = replace(FOUND, timing=replace(FOUND.timing, every=every, **timing))
    return replace(one, cost=one.cost * float(np.exp((worse - one.criterion + FOUND.criterion) / one.samples)))


def test_a_position_loop_in_every_sample_where_its_rate_cannot_be_told():
    every = other(1, 0.5)
    best, rivals = most_often(FOUND, [every, other(4, 2.0)])
    assert best is every
    assert rivals[0] is FOUND
    assert len(rivals) == 2


def test_a_rate_that_is_told_stays():
    rivals = [other(1, 2.0 * AS_GOOD), other(4, 0.5), other(1, 0.5, velocity_estimator="two_tap")]
    assert most_often(FOUND, rivals) == (FOUND, rivals)
