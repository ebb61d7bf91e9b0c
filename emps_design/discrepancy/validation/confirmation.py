"""Which effects the confirming data withdraw, and which stand on their own evidence beside something unknown."""

from __future__ import annotations

from emps_design.discrepancy import rules
from emps_design.discrepancy.checks.preparation import HeldOut
from emps_design.discrepancy.model.fit import Fit, bounds_met, evaluate, fit
from emps_design.discrepancy.model.problem import Hypothesis
from emps_design.discrepancy.search.acceptance import Judge
from emps_design.discrepancy.validation.evidence import Asked, asked_for
from emps_design.discrepancy.validation.holdout import adapted
from emps_design.discrepancy.validation.robust import robust


def confirm(judge: Judge, held_out: HeldOut, extended: Fit) -> tuple[Fit, list[Asked], tuple[Asked, ...]]:
    """Withdraw from ``extended`` what the confirming data refute, or hardly want, one by one, and refit the rest.

    Also returns how much of the rest they ask for, and what was withdrawn. An effect of the controller has its evidence
    in the law, and is not asked for.
    """
    refuted: list[Asked] = []
    asked = claims_on(held_out, extended)
    while doubtful := [a for a in asked if a.refuted or a.hardly_wanted]:
        worst = max(doubtful, key=lambda a: abs(a.share - 1) / a.std)
        refuted.append(worst)
        extended = judge.refitted(extended.with_model(extended.model.without_named([worst.name])))
        asked = claims_on(held_out, extended)
    return extended, asked, tuple(refuted)


def standing(held_out: HeldOut | None, extended: Fit) -> tuple[Fit, tuple[Asked, ...]]:
    """The robust fit of those effects of ``extended`` that stand on their own evidence, and what was withdrawn.

    An effect that the confirming data do not exercise must stand on the training records. What the model leaves counts
    as noise here, so that an effect may stand beside something unknown. A refit after each withdrawal would bend the
    rest to the unknown: all numbers stay until what is left is wanted. An effect whose share is not known well takes
    the unknown's part till then, lest the others take it; then those that stand are fitted robustly without it, and
    asked for again. A size that now depends on how the rest is weighed was lent by the rest, however alike two records
    are in that; so was a number that now ends where its physics does. A curve through knots, or one element of a
    hysteresis, has no shape of its own to be recognised by: beside something unknown it is part of that.
    """
    extended = _less(extended, [effect.name for effect in extended.model.effects if effect.general or effect.element])
    withdrawn: list[Asked] = []
    refitted = False
    while _plant(extended):
        judged = _judged(held_out, extended)
        on_bound = {extended.model.names[slot.effect] for slot in bounds_met(extended)}
        doubtful = [a for a in judged if not a.wanted or a.name in on_bound]
        if refitted and not doubtful:
            doubtful = [a for a in judged if not _size_known(extended, a.name)]
            if not doubtful:
                break
        gone = [max(doubtful, key=lambda a: a.astray)] if doubtful else [a for a in judged if not a.stands]
        withdrawn += gone
        extended = _less(extended, [one.name for one in gone])
        refitted = refitted or not doubtful
        if refitted and _plant(extended):
            extended = robust(fit(extended, part="used"))  # the numbers were those of a model with more effects
    return extended, tuple(withdrawn)


def _size_known(fitted: Fit, name: str) -> bool:
    """Whether a size of the effect is known as well as the share of it has to be; a shape alone has none."""
    index = fitted.model.names.index(name)
    effect, values = fitted.model.effects[index], fitted.model.values[index]
    known = [
        fitted.std(index, place) / max(abs(float(values[0, place])), 1e-30)
        for place, parameter in enumerate(effect.parameters)
        if parameter.linear and parameter.unit != "rad"
    ]
    return not known or min(known) <= rules.SHARE_KNOWN


def _judged(held_out: HeldOut | None, extended: Fit) -> list[Asked]:
    """How much of each effect is asked for by the confirming data, by the training records where they tell nothing."""
    asked = [] if held_out is None else claims_on(held_out, extended)
    if asked and all(one.exercised for one in asked):
        return asked
    trained = {one.name: one for one in _claims(asked_for(extended), extended)}
    return [one if one.exercised else trained[one.name] for one in asked or trained.values()]


def claims_on(held_out: HeldOut, extended: Fit) -> list[Asked]:
    """How much of each effect of the plant the confirming data ask for."""
    model = extended.model
    return _claims(asked_for(Hypothesis(held_out.problem, adapted(held_out, model, model))), extended)


def _claims(asked: tuple[Asked, ...], fitted: Fit) -> list[Asked]:
    """Those of ``asked`` that act on the plant: what the controller does is known from its law."""
    return [one for one in asked if one.name in _plant(fitted)]


def _plant(fitted: Fit) -> list[str]:
    return [effect.name for effect in fitted.model.effects if effect.channel != "controller"]


def _less(fitted: Fit, names: list[str]) -> Fit:
    """``fitted`` without the effects called ``names``, all other numbers as they are."""
    return evaluate(fitted.with_model(fitted.model.without_named(names))) if names else fitted
