"""Words and numbers of a diagnosis in the units of the axis at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from emps_design.axis import BASELINE
from emps_design.effects import Effect, get_effect, kind_of
from emps_design.quantities import inside
from emps_design.units import Units


def filled(text: str, units: Units) -> str:
    """``text`` with {mass}, {force}, {forces} and {voltage} replaced by the words of an axis.

    >>> filled("each {voltage} and the {forces}", Units("rotary", "current", "A"))
    'each current and the torques'
    """
    return text.format(**{name: units.word(name) for name in ("mass", "force", "forces", "voltage")})


def worded(effect: Effect, units: Units) -> Effect:
    """The ``effect`` with its label, experiment and remedy in the words of an axis.

    >>> worded(get_effect("external_force"), Units("rotary", "current", "A")).label
    'External torque'
    """
    if units.plain:
        return effect
    experiment, remedy = units.words(effect.words.experiment), units.words(effect.words.remedy)
    return replace(
        effect, label=units.words(effect.label), words=replace(effect.words, experiment=experiment, remedy=remedy)
    )


def label_of(name: str, units: Units) -> str:
    """Label of the effect ``name`` in the words of an axis; a further line of an effect has the label of the first."""
    return units.words(get_effect(kind_of(name)).label)


def listed(names: Sequence[str], units: Units) -> str:
    """The labels of the effects ``names``, separated by commas, for use inside a sentence.

    >>> listed(("mass_change", "backlash"), Units("rotary"))
    'inertia change, backlash'
    """
    return ", ".join(inside(label_of(name, units)) for name in names)


def changed(before: np.ndarray, after: np.ndarray, places: Sequence[int], units: Units) -> str:
    """The baseline parameters ``before`` -> ``after``, (4,) each, at the indices ``places``, as text.

    >>> changed(np.array([1.15, 8.0, 7.0, 0.0]), np.array([1.2, 8.0, 7.1, 0.0]), [0, 2], Units("rotary"))
    'inertia 1.15 -> 1.2 kg m^2, coulomb 7 -> 7.1 N m'
    """
    return ", ".join(
        f"{units.words(BASELINE[i].name.replace('_', ' '))} {before[i]:.5g} -> "
        f"{units.quantity(float(after[i]), BASELINE[i].unit, '.5g')}"
        for i in sorted(places)
    )
