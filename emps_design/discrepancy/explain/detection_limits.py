"""What could not be excluded: the smallest size at which each effect would have been a finding on these records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.search.calibration import Calibration
from emps_design.discrepancy.search.starts import Start, Tangent, tangent
from emps_design.effects import Effect, Parameter
from emps_design.errors import SimulationError
from emps_design.quantities import display_unit, inside

ABSURD = 1e3  # times the typical size of a parameter
HIDDEN = "any size: these records do not bring it out"
NO_START = "not looked for: nothing in these records to start from"
FAR = 300.0  # times a parameter that shapes an effect, where the effect has faded
CLOSE = 1.1  # ratio to which the limit of what is seen is sought


def not_excluded(calibration: Calibration, found: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each effect that is not among ``found``: its size just seen, None where no size would have been."""
    baseline = calibration.baseline
    gain = max(calibration.healthy.threshold, rules.WORTH_AT_FLOOR * baseline.problem.samples("fit"))
    least = rules.AUDIBLE * calibration.floor.force
    absorbed, screened = tangent(baseline), {s[0].model.names[-1]: s for s in calibration.screened}

    def row(effect: Effect) -> dict[str, Any]:
        starts, side = screened.get(effect.name, ()), "or more"
        if not starts:
            parameter, size, text = effect.parameters[0], None, NO_START
        elif effect.linear:
            parameter, size = _by_amplitude(starts, gain, least)
        else:
            parameter, size, grows = _by_shape(baseline, absorbed, starts, gain)
            side = "or less" if grows else "or more"
        if starts:
            text = HIDDEN if size is None else f"{_rounded(parameter, size)} {side}"
        return {"effect": effect.name, "label": effect.label, "size": size, "unit": parameter.unit, "text": text}

    library = calibration.preparation.library
    absent = [effect for effect in library if effect.name not in found and not effect.after]
    slowest_first = sorted(absent, key=lambda effect: bool(effect.linear))  # those that need simulations
    rows = {one["effect"]: one for one in side_by_side(row, [(effect,) for effect in slowest_first])}
    return [rows[effect.name] for effect in absent]


def _rounded(parameter: Parameter, size: float) -> str:
    unit, factor = display_unit(size, parameter.unit)
    return f"{parameter.name.replace('_', ' ')} {float(f'{size * factor:.2g}'):g} {unit}".rstrip()


def least_visible(rows: Sequence[Mapping[str, Any]]) -> str | None:
    """The largest force that may be there unseen, for a sentence; None where no row tells one."""
    bounded = [row for row in rows if row["size"] is not None and row["unit"] == "N"]
    if not bounded:
        return None
    row = max(bounded, key=lambda row: row["size"])
    return f"{row['text'].removesuffix(' or more')} ({inside(row['label'])})"


def _by_amplitude(starts: Sequence[Start], gain: float, least: float) -> tuple[Parameter, float | None]:
    """The amplitude of an effect that is linear in it, from its signatures; a force is ``least`` [N] at least."""
    effect = starts[0].model.effects[-1]
    place = [p.name for p in effect.parameters].index(effect.linear[0])
    parameter = effect.parameters[place]
    amplitudes = [float(np.abs(s.model.values[-1][:, place]).max() * np.sqrt(gain) / s.size) for s in starts]
    # Some shapes hide completely, such as an event at the record's end, or a speed that it does not have.
    most = min(ABSURD * parameter.scale if parameter.scale else np.inf, parameter.upper)
    sane = [
        amplitude
        for amplitude, start in zip(amplitudes, starts, strict=True)
        if max(amplitude, float(np.abs(start.model.values[-1][:, place]).max())) <= most
    ]
    if not sane:
        return parameter, None
    size = float(np.median(sane))
    return parameter, max(size, least) if parameter.unit == "N" else size


def _by_shape(
    baseline: Fit, absorbed: Tangent, starts: Sequence[Start], gain: float
) -> tuple[Parameter, float | None, bool]:
    """The first parameter of an effect without an amplitude, moved from the faintest shape seen until it is not.

    Judged against the end at which the effect fades, which may be another effect: play without its gap is an elastic
    coupling. Also returns whether the effect fades as the parameter grows, as a stiffness does.
    """
    effect = starts[0].model.effects[-1]
    parameter = effect.parameters[0]
    seen = [start for start in starts if start.size**2 >= gain]
    if not seen:
        return parameter, None, False
    faintest = min(seen, key=lambda start: start.size).model.values[-1]

    def innovations(value: float) -> np.ndarray:
        values = faintest.copy()
        values[:, 0] = value
        return baseline.with_model(baseline.model.with_effect(effect, values)).residual("fit")

    def apart(one: np.ndarray, other: np.ndarray) -> float:
        return float(np.sum(absorbed.free(one - other) ** 2))

    value = float(faintest[0, 0])
    try:
        ends = [min(max(value * far, parameter.lower), parameter.upper) for far in (FAR, 1 / FAR)]
        there = [innovations(end) for end in ends]
        grows = apart(there[0], absorbed.whole) < apart(there[1], absorbed.whole)
        unseen, faded = ends[not grows], there[not grows]
        if apart(innovations(value), faded) < gain:
            return parameter, None, grows
        while max(value, unseen) > CLOSE * min(value, unseen):
            middle = float(np.sqrt(value * unseen))
            value, unseen = (middle, unseen) if apart(innovations(middle), faded) >= gain else (value, middle)
    except SimulationError:
        return parameter, None, False
    return parameter, value, grows
