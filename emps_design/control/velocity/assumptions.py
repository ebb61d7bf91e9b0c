"""What the closed forms assume of an axis, held against what its effects make of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from emps_design.axis import Axis
from emps_design.control.loop.margins import Margins
from emps_design.control.loop.worst import margins_in_words
from emps_design.control.plant.discretisation import SampledPlant, sample_axis
from emps_design.control.plant.environment import Environment, attached
from emps_design.control.plant.linear_plant import LinearPlant
from emps_design.control.plant.peaks import oscillations
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.velocity.specification import ROOM

NO_FILTERS = "the closed forms know no filters: what they cost is in the sampled loop"


def room_in_words(loop: SampledVelocityLoop) -> list[str]:
    """Say where a stable sampled ``loop`` bears less than ``ROOM`` samples of delay.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> [len(room_in_words(SampledVelocityLoop(plant, k_v1, 0.05))) for k_v1 in (550.0, 2500.0)]
    [0, 1]
    """
    margins = loop.margins
    if not loop.stable or margins.delay_margin_samples is None or margins.delay_margin_samples >= ROOM:
        return []
    return [
        f"the sampled loop is barely stable: {margins.delay_margin_samples:.2g} samples more delay make it unstable "
        f"(phase margin {margins.phase_margin_deg:.3g} deg at the plant input)"
    ]


def law_in_words(loop: SampledVelocityLoop, by_closed_form: bool) -> list[str]:
    """Say what structure and filters of ``loop`` mean for the numbers of a design and for the drive."""
    notes = []
    if loop.plant.filters and by_closed_form:
        notes.append(f"{NO_FILTERS}; `retune` meets the request there")
    if loop.structure.reference_filter:
        notes.append(
            f"the axis file has no reference filter: set 1/(1 + t_v s), {1e3 * loop.t_v:.4g} ms, in the drive, or "
            'take form = "ip", which answers alike'
        )
    return notes


def ideal_loop_in_words(left_out: Sequence[str], with_lags: Margins) -> str:
    """Say what the closed forms leave out, and what the continuous loop has at the velocity error ``with_lags``.

    >>> ideal_loop_in_words((), Margins(stable=True))
    "the continuous loop's gain margin is unbounded: its phase never reaches -180 deg"
    """
    ideal = "the continuous loop's gain margin is unbounded: its phase never reaches -180 deg"
    if not left_out:
        return ideal
    has = f"it has {margins_in_words(with_lags)}" if with_lags.stable else "it is unstable"
    return f"{ideal}; that is without {' and '.join(left_out)}; with every lag {has} at the velocity error"


def effects_in_words(axis: Axis, loop: SampledVelocityLoop, velocity: float) -> list[str]:
    """Say what the effects of ``axis`` change: (7) knows mass and viscous friction, the sampled ``loop`` all of them.

    ``loop`` is linearised at ``velocity`` [m/s]; the other direction is looked at as well.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018-two-quadrant")
    >>> loop = SampledVelocityLoop(sample_axis(axis), 550.0, 8.5e-3)
    >>> effects_in_words(axis, loop, 0.1)[0][:72]
    'with its effects the carriage has 115.7 kg and a friction slope of 475 N'
    """
    if not axis.effects:
        return []
    closed_form = "(7)" if loop.structure.form == "ip" else "the closed form"
    notes = carriage_in_words(axis, loop.plant.linear, velocity, closed_form)
    if loop.stable:
        back = replace(loop, plant=sample_axis(axis, -velocity, loop.plant.filters))
        here, there = loop.margins.phase_margin_deg, back.margins.phase_margin_deg
        if not back.stable:
            notes.append(f"the sampled loop is unstable at {-velocity:g} m/s")
        elif here is not None and there is not None and there < here - 0.5:
            notes.append(f"at {-velocity:g} m/s the sampled loop has {there:.3g} deg of phase margin only")
        notes += _where_it_is_steepest(loop)
    return notes


def carriage_in_words(axis: Axis, linear: LinearPlant, velocity: float, closed_form: str = "(7)") -> list[str]:
    """Say what ``closed_form`` does not know of ``linear``: another mass and friction slope, resonances.

    Mass and slope are those of all that moves, slowly; of two masses the one that the motor drives first is named too.

    >>> from emps_design.control.plant.linear_plant import linear_plant
    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> axis = machine("emps2018").replace(effects=bent)
    >>> carriage_in_words(axis, linear_plant(axis), 0.1)
    ['(7) takes one rigid mass of 115.7 kg; the sampled loop has the resonance at 47.99 Hz, 34.72 kg before it']
    """
    notes, mass, damping = [], axis.mechanics.mass, axis.damping
    moved, slope = linear.in_slow_motion
    if abs(moved - mass) > 0.01 * mass or abs(slope - damping) > 0.01 * damping:
        notes.append(
            f"with its effects the carriage has {moved:.4g} kg and a friction slope of {slope:.4g} "
            f"N/(m/s) at {velocity:g} m/s; {closed_form} takes {mass:.4g} kg and {damping:.4g} N/(m/s), the sampled "
            "loop takes all"
        )
    for w, _ in oscillations(linear.A):
        before = f", {linear.mass:.4g} kg before it" if linear.mass < 0.99 * moved else ""
        notes.append(
            f"{closed_form} takes one rigid mass of {mass:.4g} kg; the sampled loop has the resonance at "
            f"{w / (2.0 * math.pi):.4g} Hz{before}"
        )
    return notes


def closed_form_in_words(axis: Axis, plant: SampledPlant, velocity: float) -> list[str]:
    """Say what a closed form of mass and viscous friction leaves out of ``plant``: effects and filters.

    >>> from emps_design.machines import machine
    >>> late = machine("emps2018").replace(effects=[{"kind": "actuator_delay", "delay": 1e-3}])
    >>> closed_form_in_words(late, sample_axis(late), 0.1)
    ['the closed form knows no effects of the axis, the sampled loop takes all']
    """
    notes = [NO_FILTERS] if plant.filters else []
    if not axis.effects:
        return notes
    said = carriage_in_words(axis, plant.linear, velocity, "the closed form")
    return notes + (said or ["the closed form knows no effects of the axis, the sampled loop takes all"])


def _where_it_is_steepest(loop: SampledVelocityLoop) -> list[str]:
    """Say whether slow motion is less stable: there the loop sees the slope that averages out in faster motion."""
    steepest = loop.plant.linear.steepest
    if steepest == 0.0:
        return []
    here, found = loop.margins.phase_margin_deg, []
    for stiffness in (steepest, -steepest):
        linear = attached(loop.plant.linear, Environment(stiffness=stiffness))
        slow = replace(loop, plant=loop.plant.sampling(linear))
        where = f"in slow motion, where the force over position has its slope of {stiffness:.3g} N/m,"
        there = slow.margins.phase_margin_deg
        if not slow.stable:
            found.append(f"{where} the sampled loop is unstable")
        elif here is not None and there is not None and there < here - 0.5:
            found.append(f"{where} the sampled loop has {there:.3g} deg of phase margin only")
    return found
