"""When something happened: the instants that a record cannot tell apart, and the middle of them.

A mass put on while the carriage runs at constant speed shows at the next acceleration: any instant of that stretch
leaves as little, and a fit stops at the one where it happened to begin. What is said then is the middle of them, and a
deviation of which two reach to either end.
"""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.fit import Fit, evaluate
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.errors import SimulationError

RISE = 4.0  # of the whitened cost, of noise 1 a sample: two deviations of a number that the cost is square in
FIRST = 2.0  # samples, the first step to both sides
HALVINGS = 7  # by which the end of a range is found within the last step


def centred(fitted: Fit) -> Fit:
    """``fitted`` with every instant in the middle of those that leave as little."""
    model = fitted.model
    for index, place, record in _instants(fitted):
        low, high = indistinct(fitted.with_model(model), index, place, record)
        if high > low:
            model = _moved(model, index, place, record, 0.5 * (low + high))
    if model is fitted.model:
        return fitted
    moved = evaluate(fitted.with_model(model), fitted.slots, fitted.covariance)
    return moved if moved.cost < fitted.cost + RISE * _unit(fitted) else fitted


def deviation_in_time(fitted: Fit, index: int, place: int, record: int) -> float:
    """Standard deviation [s] of an instant of effect ``index``: two reach from the middle to either end; else 0."""
    if (index, place, record) not in _instants(fitted):
        return 0.0
    low, high = indistinct(fitted, index, place, record)
    return 0.25 * (high - low)


def indistinct(fitted: Hypothesis, index: int, place: int, record: int) -> tuple[float, float]:
    """The range of instants [s] around that of effect ``index`` on ``record``, all else equal, that leave as little.

    Empty where two samples to either side leave more.
    """
    problem, now = fitted.problem, float(fitted.model.values[index][record, place])
    residual = fitted.residual("used")
    limit = float(residual @ residual) + RISE * _unit(fitted)

    def leaves_as_little(instant: float) -> bool:
        try:
            left = fitted.with_model(_moved(fitted.model, index, place, record, instant)).residual("used")
        except SimulationError:
            return False
        return float(left @ left) < limit

    def end(way: float, bound: float) -> float:
        reached, step = now, FIRST * problem.period
        while reached != bound:
            further = min(reached + step, bound) if way > 0.0 else max(reached - step, bound)
            if not leaves_as_little(further):
                break
            reached, step = further, 2.0 * step
        else:
            return bound
        if reached == now:
            return now
        for _ in range(HALVINGS):
            middle = 0.5 * (reached + further)
            reached, further = (middle, further) if leaves_as_little(middle) else (reached, middle)
        return reached

    duration = len(problem.records[record]) * problem.period
    low, high = side_by_side(end, [(-1.0, 0.0), (1.0, max(duration, now))])
    return low, high


def _unit(fitted: Hypothesis) -> float:
    """Whitened cost of a sample, at least that of noise."""
    residual = fitted.residual("used")
    return max(1.0, float(residual @ residual) / residual.size)


def _instants(fitted: Fit) -> list[tuple[int, int, int]]:
    """Effect, place and record of every free number that is an instant; at its lower bound, 0, it is switched off."""
    values = fitted.model.values
    return [
        (slot.effect, slot.place, slot.record)
        for slot in fitted.model.slots()
        if slot.effect >= 0
        and slot.record is not None
        and slot.quantity.unit == "s"
        and values[slot.effect][slot.record, slot.place] > slot.quantity.lower
    ]


def _moved(model: Candidate, index: int, place: int, record: int, instant: float) -> Candidate:
    """``model`` with another instant of effect ``index`` on ``record``."""
    values = list(model.values)
    values[index] = values[index].copy()
    values[index][record, place] = instant
    return replace(model, values=tuple(values))
