"""One more effect: fits of every effect of the library added to a model, and fits to convergence.

Poor fits are abandoned early (successive halving): many starts get one step of the new effect's own parameters, the
better ones a short fit of these, and few a fit of all parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.fit import (
    Fit,
    admissible,
    bounds_met,
    evaluate,
    fit,
    plausible,
    refit_play,
    with_noise_weights,
)
from emps_design.discrepancy.least_squares import Candidate, Descent, descend, simplex
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.problem import Hypothesis
from emps_design.discrepancy.starts import Start, Tangent, bent, either_baseline, screen, starts, tangent
from emps_design.discrepancy.unknown_force import missing_force
from emps_design.effects import Effect


def extended(
    current: Fit, library: tuple[Effect, ...], rival: float = rules.HALF
) -> tuple[list[Fit], dict[str, float]]:
    """:func:`extensions` of ``current`` by the effects of ``library``.

    If the model amplifies noise, the effects are also searched with less weight on these samples.
    """
    fits, gains = _extensions_of(current, library, rival)
    quieter = with_noise_weights(current)
    if quieter is not None:
        quiet_fits, _ = _extensions_of(quieter, library, rival)
        again = [(current.with_model(fitted.model), "fit", fitted.slots) for fitted in quiet_fits if fitted.innovations]
        fits = sorted((*fits, *side_by_side(fit, again)), key=lambda f: f.cost)
    return fits, gains


def _extensions_of(current: Fit, library: tuple[Effect, ...], rival: float) -> tuple[list[Fit], dict[str, float]]:
    absorbed = tangent(current)
    return extensions(current, screen(current, library, absorbed), absorbed, rival)


def extensions(
    current: Fit, screened: list[list[Start]], absorbed: Tangent, rival: float = rules.HALF
) -> tuple[list[Fit], dict[str, float]]:
    """Fit the ``screened`` starts that promise a gain over ``current``; best first.

    A short fit changes only the parameters of the new effect; the refit of the rest is linearised by the tangent. The
    best few effects, with at least the share ``rival`` of the best gain there or to first order, are then fitted with
    all parameters free. Also returns the gain of each effect in its short fit [whitened cost].
    """
    best = max((group[0].gain for group in screened), default=0.0)
    least = max(rules.SMALLEST_GAIN, rules.SLIGHT * best)
    candidates = [start for group in screened for start in group[: rules.FEW] if start.gain >= least]
    before = float(absorbed.residual @ absorbed.residual)
    leading: dict[str, Descent] = {}
    for short in _short_fits(candidates, absorbed, before, rules.MAY_RIVAL * rival):
        name = short.model.names[-1]
        if name not in leading or short.cost < leading[name].cost:
            leading[name] = short
    gains = {group[0].model.names[-1]: group[0].gain for group in screened}
    gains |= {name: before - short.cost for name, short in leading.items()}
    shorts = [(short.cost, current.with_model(short.model)) for short in leading.values()]
    ranked = sorted(((cost, short) for cost, short in shorts if plausible(short)), key=lambda pair: pair[0])
    # If an effect replaces much of the baseline, the tangent misleads its short fit: the best are fitted in any case.
    promising = sorted(screened, key=lambda group: -group[0].gain)[: rules.FEW]
    in_any_case = {group[0].model.names[-1] for group in promising if group[0].gain >= rival * best}
    begins = [
        short
        for place, (cost, short) in enumerate(ranked)
        if (place < rules.FINALISTS and before - cost >= rival * (before - ranked[0][0]))
        or short.model.names[-1] in in_any_case
    ]
    if bent(current, before / absorbed.residual.size):
        # A baseline biased by the gap misleads short fits: the leading effects are fitted from several starts.
        leaders = sorted(screened, key=lambda group: -group[0].gain)[: rules.FEW]
        more = [start.hypothesis for group in leaders for start in group[: rules.BENT_STARTS]]
        begins += [hypothesis for hypothesis in more if plausible(hypothesis)]
    fits = side_by_side(_fit_within_bounds, [(begin,) for begin in _promising(begins)])
    return sorted(fits, key=lambda f: f.cost), gains


def free_all(fitted: Fit) -> Fit:
    """``fitted`` with all parameters free, without the effects that then end on a bound.

    If the loop was stable only with such an effect, the next effect is removed too.
    """
    while len(fitted.slots) < len(fitted.model.slots()):
        free = fit(fitted)
        met = bounds_met(free)
        fitted = fit(fitted.with_model(fitted.model.without(met[0].effect))) if met else free
        while not fitted.innovations:
            fitted = fit(fitted.with_model(fitted.model.without(0)))
    return fitted


def converged(fitted: Fit) -> Fit:
    """``fitted`` converged, with other shapes of its last effect tried; unchanged if the result is inadmissible.

    A fit that has not converged looks as if another effect were missing.
    """
    further = _try_other_shapes(_fit_until_converged(fitted))
    if fitted.surface_checked and further.cost > (1 - rules.STILL_PAYS) * fitted.cost:
        return fitted
    further = refit_play(refit_play(further))  # the second time in the neighbourhood of the first result
    return further if admissible(further) else fitted


def _short_fits(begins: list[Start], absorbed: Tangent, before: float, share: float) -> list[Descent]:
    """Short fits of ``begins``; continued if the gain of the first step, or to first order, is ``share`` of the best.

    ``before`` is the cost without any of them.
    """
    shorts = side_by_side(_short_fit, [(start, start.model, absorbed, 1) for start in begins])
    least = share * max((before - short.cost for short in shorts), default=0.0)
    go_on = [i for i, start in enumerate(begins) if max(start.gain, before - shorts[i].cost) >= least]
    more = rules.SHORT_STEPS - 1
    further = side_by_side(_short_fit, [(begins[i], shorts[i].model, absorbed, more) for i in go_on])
    for i, short in zip(go_on, further, strict=True):
        shorts[i] = short
    return shorts


def _short_fit(start: Start, begin: Candidate, absorbed: Tangent, steps: int) -> Descent:
    slots = tuple(slot for slot in begin.slots() if slot.effect == len(begin.effects) - 1)
    free = absorbed.free if start.anchored else lambda residual: residual

    def free_residual(model: Candidate) -> np.ndarray:
        return free(start.hypothesis.with_model(model).residual("fit"))

    if begin is start.model and begin.effects[-1].play:
        begin = simplex(begin, slots, free_residual, rules.SIMPLEX)
    return descend(begin, slots, free_residual, steps)


def _promising(begins: list[Hypothesis]) -> list[Hypothesis]:
    """The ``begins`` to fit further: for an effect with many starts the best few after some steps."""
    by_set: dict[tuple[str, ...], list[Hypothesis]] = {}
    for begin in begins:
        by_set.setdefault(begin.model.names, []).append(begin)
    promising: list[Hypothesis] = []
    for group in by_set.values():
        if len(group) > rules.FEW:
            promising += sorted(_first_steps(group), key=lambda f: f.cost)[: rules.FEW]
        else:
            promising += group
    return promising


def _fit_within_bounds(begin: Hypothesis) -> Fit:
    """Fit ``begin``; parameters that end on a bound are held at their start, and the rest fitted again.

    A parameter may compensate for something else that is still missing: with a delay that is not in the model yet, the
    damping of a resonance goes to zero. :func:`free_all` frees the held parameters at the end.
    """
    ended = fit(begin)
    met = {(slot.effect, slot.place, slot.record) for slot in bounds_met(ended)}
    if met:
        ended = fit(begin, slots=tuple(s for s in begin.model.slots() if (s.effect, s.place, s.record) not in met))
    # The short fit of a last effect with backlash already started with this method.
    return ended if begin.model.effects[-1].play else refit_play(ended)


def _fit_until_converged(fitted: Fit) -> Fit:
    """Fit until the cost falls by less than ``rules.STILL_PAYS``."""
    while (further := fit(fitted)).cost <= (1 - rules.STILL_PAYS) * fitted.cost:
        fitted = further
    return min(fitted, further, key=lambda f: f.cost)


def _try_other_shapes(fitted: Fit) -> Fit:
    """Try other forms and shapes of the last effect, now that all parameters are fitted.

    A descent reaches neither another exponent nor an instant in another stroke.
    """
    forms = [form for form in _in_reach(_forms(fitted), fitted) if admissible(form)]
    paying = [form for form in forms if form.cost < (1 - rules.STILL_PAYS) * fitted.cost]
    if paying:
        fitted = _fit_until_converged(min(paying, key=lambda f: f.cost))
    model = fitted.model
    effect, values = model.effects[-1], model.values[-1]
    timed = [p.per_record and p.unit == "s" for p in effect.parameters]
    shapes = [i for i, p in enumerate(effect.parameters) if timed[i] or (p.discrete and p.default is None)]
    if not shapes:
        return fitted
    rests = either_baseline(fitted.with_model(model.without(len(model.effects) - 1)))
    begins = [begin for rest in rests for begin in _other_shapes(evaluate(rest), effect, values, shapes)]
    trials = _in_reach(begins, fitted)
    best = min((fitted, *trials), key=lambda f: f.cost)
    return fitted if best is fitted or not admissible(best) else _fit_until_converged(best)


def _other_shapes(without: Fit, effect: Effect, values: np.ndarray, shapes: list[int]) -> list[Hypothesis]:
    """``without`` with ``effect`` in its best few shapes, except those in the columns ``shapes`` of ``values``."""
    if not without.innovations:
        return []
    other: dict[bytes, Hypothesis] = {}  # the best start of each shape: the fit finds the rest
    for start in starts(without, effect, missing_force(without), tangent(without)):
        shape = start.model.values[-1][:, shapes]
        if start.anchored and not np.array_equal(shape, values[:, shapes]):
            other.setdefault(shape.tobytes(), start.hypothesis)
    return list(other.values())[: rules.FINALISTS]


def _in_reach(begins: list[Hypothesis], fitted: Fit) -> list[Fit]:
    """Fits of the ``begins`` whose cost comes close to that of ``fitted`` in the first steps."""
    return side_by_side(fit, [(trial,) for trial in _first_steps(begins) if trial.cost < rules.IN_REACH * fitted.cost])


def _first_steps(begins: list[Hypothesis]) -> list[Fit]:
    """The first steps of a fit of each of ``begins``."""
    return side_by_side(fit, [(begin, "fit", None, rules.SHORT_STEPS) for begin in begins])


def _forms(fitted: Fit) -> list[Hypothesis]:
    """The model of ``fitted`` in other forms, with the same parameters.

    Forms of the last effect and, if structure remains, of any parameter at its default.
    """
    model, forms = fitted.model, list[Hypothesis]()
    structure = fitted.cost > rules.AT_FLOOR * fitted.problem.samples("used")
    for index, (effect, values) in enumerate(zip(model.effects, model.values, strict=True)):
        for place, parameter in enumerate(effect.parameters):
            now = values[0, place]
            if parameter.discrete and index < len(model.effects) - 1:
                continue
            if not parameter.discrete and (now != parameter.default or not structure):
                continue
            for other in (form for form in parameter.starts if form != now):
                row = values.copy()
                row[:, place] = other
                changed = replace(model, values=(*model.values[:index], row, *model.values[index + 1 :]))
                forms.append(fitted.with_model(changed))
    return forms
