"""Changes of the feedback for what no feed-forward compensates: a filter for a coupling, a gain limit for a play.

A play transmits no force within its gap. For an oscillation it acts as a spring and a damper of which the share N is
effective: its describing function, from N = 0 (the oscillation stays within the gap) to N = 1 (the gap is negligible),
without the phase of the damper. No limit cycle is expected as long as the sampled loop with such a coupling is stable
for every N; the gain limit is the gain at which it first is not. Dry friction is neglected, which is conservative.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.effects.two_mass import LOWEST, RESONANCES, has_play, is_coupling, linear_coupling
from emps_design.errors import EmpsError

if TYPE_CHECKING:
    from emps_design.axis import Axis

PHASE_MARGIN_DEG = 60.0
SHARES = 12  # of the describing function, between the slowest coupling that an axis may have and the whole one
HIGHEST = 100.0  # factors of the gain looked at, and its inverse


def feedback_cures(axis: Axis) -> list[dict[str, Any]]:
    """Return one cure for each coupling and each play among the effects of ``axis``: numbers and a line of advice.

    >>> from emps_design.machines import machine
    >>> play = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.1, "share": 0.4}
    >>> (cure,) = feedback_cures(machine("emps2019").replace(effects=[play]))
    >>> cure["gain"], cure["limit"] > cure["now"] > 243.0
    ('kv', True)
    """
    cures = []
    for place, entry in enumerate(axis.effects):
        if is_coupling(entry.effect):
            try:
                cure = _gain(axis, place) if has_play(entry.effect) else _filter(axis)
            except EmpsError as error:  # a user's law may have no linear form
                cure = {"cure": None, "advice": f"no advice, {error}"}
            cures.append({"effect": entry.kind, **cure, "advice": f"{entry.kind}: {cure['advice']}"})
    return cures


def _filter(axis: Axis) -> dict[str, Any]:
    """The command filter that gives a velocity loop of ``axis`` its largest crossover."""
    from emps_design.control.velocity.gains import own_filters, own_structure
    from emps_design.control.velocity.limits import suggest_filter

    structure = own_structure(axis)
    suggestion = suggest_filter(axis, PHASE_MARGIN_DEG, structure, own_filters(axis))
    loop = f"a velocity loop ({structure.label}) of {PHASE_MARGIN_DEG:g} deg phase margin"
    before, added = suggestion["without"], suggestion["filter"]
    reached = "has no crossover" if before["crossover"] is None else f"reaches {before['crossover']:.4g} rad/s"
    if added is None:
        advice = f"{loop} {reached}, and no one filter more raises that by a tenth"
    else:
        shape = f", damping {added['damping']:g}, depth {added['depth']:g}" if added["kind"] == "notch" else ""
        advice = (
            f"{loop} {reached} without, and {suggestion['with']['crossover']:.4g} rad/s with a {added['kind']} at "
            f"{added['frequency']:.4g} Hz{shape}"
        )
    return {"cure": "filter", "structure": structure.form, **suggestion, "advice": advice}


def _gain(axis: Axis, place: int) -> dict[str, Any]:
    """The gain of the law of ``axis`` up to which no limit cycle is expected from its play at ``place``."""
    from emps_design.laws import get_law, table_of

    factor, name = largest_factor(axis, place), get_law(axis.controller.kind).gain
    now: Any = table_of(axis) if name else None
    for part in name.split(".") if name else ():
        now = getattr(now, part)
    number = now if isinstance(now, int | float) else None
    limit = factor * number if number is not None and 0.0 < factor < math.inf else None
    own = name or "the gain of the law"
    if not factor:
        advice = (
            f"a limit cycle is possible with every {own} down to 1/{HIGHEST:g} of what it is, dry friction left "
            "out; lower the gain of the position or the integral, or preload the play"
        )
    elif factor == math.inf:
        advice = f"no limit cycle is expected with {own} up to {HIGHEST:g} times what it is"
    else:
        bound = f"{factor:.3g} times what it is" if limit is None else f"{limit:.4g}, now {number:.4g}"
        advice = f"keep {own} below {bound}; from there on a limit cycle is possible, dry friction left out"
    return {
        "cure": "limit of the gain", "gain": name or None, "now": number, "limit": limit,
        "factor": factor if math.isfinite(factor) else None,
        "method": "describing function of the play in the sampled loop", "advice": advice,
    }  # fmt: skip


def largest_factor(axis: Axis, place: int) -> float:
    """Smallest factor on the gain of the law of ``axis`` that makes its loop with the play at ``place`` unstable.

    Below 1 if the loop is unstable with the present gain; infinite if it is stable up to :data:`HIGHEST` times that
    gain; 0 if it is unstable even at 1 / :data:`HIGHEST` of it.
    """
    loops = _with_shares(axis, place)

    def stable(factor: float) -> bool:
        from emps_design.control.sampled import axis_loop

        drive = {"force_gain": axis.drive.force_gain * factor, "back_emf": axis.drive.back_emf / factor}
        return all(axis_loop(loop.replace(drive=drive)).stable for loop in loops)

    ladder = np.geomspace(1.0, HIGHEST, 14)
    if stable(1.0):
        last = next((i for i, factor in enumerate(ladder) if not stable(factor)), None)
        if last is None:
            return math.inf
        low, high = ladder[last - 1], ladder[last]
    else:
        first = next((i for i, factor in enumerate(ladder) if stable(1.0 / factor)), None)
        if first is None:
            return 0.0
        low, high = 1.0 / ladder[first], 1.0 / ladder[first - 1]
    while high > 1.001 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def _with_shares(axis: Axis, place: int) -> list[Axis]:
    """Return ``axis`` with linear couplings for the play, one per share N, and once without its load (N = 0)."""
    play = axis.effects[place]
    p = dict(zip((p.name for p in play.effect.parameters), play.effect.values(play.parameters), strict=True))
    others = [{"kind": other.kind, **other.parameters} for i, other in enumerate(axis.effects) if i != place]
    softest = LOWEST if p["frequency"] > LOWEST else max(RESONANCES[0], 0.1 * p["frequency"])
    low = min(1.0, (softest / p["frequency"]) ** 2 * (1.0 + 1e-9))
    coupled = [
        axis.replace(effects=[*others, linear_coupling(p["frequency"] * n**0.5, p["damping"] * n**0.5, p["share"])])
        for n in np.geomspace(low, 1.0, SHARES)
    ]
    alone = {"mass": axis.mechanics.mass * (1.0 - p["share"])}
    return [*coupled, axis.replace(effects=others, mechanics=alone)]
