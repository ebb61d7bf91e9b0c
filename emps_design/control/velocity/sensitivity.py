"""What a wrong model does to a design: the same gains on other plants, and the gains those plants would get."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from emps_design.axis import Axis
from emps_design.control.plant.discretisation import sample_axis
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.errors import InputError

PARAMETERS = {"mass": "mechanics", "viscous": "mechanics", "force_gain": "drive"}


def relative_mismatch(mismatch: float) -> dict[str, float]:
    """The same relative error for mass, viscous friction and force gain; :class:`InputError` outside [0, 1).

    >>> relative_mismatch(0.02)
    {'mass': 0.02, 'viscous': 0.02, 'force_gain': 0.02}
    """
    if not 0.0 <= mismatch < 1.0:
        raise InputError(f"mismatch: found {mismatch:g}, expected a share of the parameters in [0, 1), such as 0.02")
    return dict.fromkeys(PARAMETERS, mismatch)


def identified_mismatch(axis: Axis, parameters: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """What identified ``parameters`` may be off by, as shares of the axis's own: the half of their 95 % intervals.

    ``parameters`` is that member of ``identify --json``: name -> {value, std, interval_95 ...}, of one record or of
    several. Mass and viscous friction count. The interval holds what is known of a filter's error; where there are
    several (a bootstrap's, two directions), or only deviations (2 std, the spread between records), the largest is
    taken. :class:`InputError` where mass or viscous has none.

    >>> from emps_design.machines import machine
    >>> found = {"mass": {"std": 0.29}, "viscous": {"std": 8.8, "interval_95": [455.0, 493.0]}}
    >>> round(identified_mismatch(machine("emps2018"), found)["viscous"], 3)
    0.04
    """
    found: dict[str, float] = {}
    for name in ("mass", "viscous"):
        entries = [parameters[key] for key in (name, f"{name}_positive", f"{name}_negative") if key in parameters]
        halves = [half for entry in entries for key, value in entry.items() if (half := _half(key, value)) is not None]
        if not halves:
            raise InputError(f"identified parameters: {name} has no std, expected those of an identification as JSON")
        own = getattr(axis.mechanics, name)
        found[name] = max(halves) / own if own > 0.0 else 0.0
        if found[name] >= 1.0:
            raise InputError(
                f"identified parameters: the interval of {name} is +-{found[name]:.3g} of its value, expected below 1"
            )
    return found


def _half(key: str, value: Any) -> float | None:
    """Half of the 95 % interval that an entry of an identified parameter speaks of; None for other entries."""
    if key.startswith("interval_95") and isinstance(value, Sequence) and len(value) == 2:
        low, high = value
        half = 0.5 * (high - low) if all(isinstance(end, int | float) for end in value) else math.nan
    elif key == "spread" or key.startswith("std"):
        half = 2.0 * value if isinstance(value, int | float) else math.nan
    else:
        return None
    return half if math.isfinite(half) and half >= 0.0 else None


def margins_under_mismatch(design: VelocityLoopDesign, errors: Mapping[str, float]) -> dict[str, Any]:
    """Return margins and gains over the corners of ``errors``, the relative error of each parameter.

    The gains of ``design`` run on the plant of every corner: ``worst`` has the corner with the least phase margin of
    the sampled loop at the plant input (the first unstable one, if any). ``gains`` are the intervals of k_v1 and t_v
    that (7) would give the corners for the same crossover and phase margin.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> study = margins_under_mismatch(design, relative_mismatch(0.02))
    >>> study["stable_share"], round(study["phase_margin_deg"][0], 1), round(study["phase_margin_deg"][1], 1)
    (1.0, 39.1, 39.2)
    """
    found, k_v1s, t_vs = [], [], []
    crossover, phase = design.crossover, design.phase_margin_deg
    for shares in corners(errors):
        axis = with_errors(design.axis, shares)
        plant = sample_axis(axis, design.velocity, design.filters)
        loop = SampledVelocityLoop(plant, design.k_v1, design.t_v, design.structure)
        found.append({"parameters": shares, "bandwidth": loop.bandwidth, **loop.margins.to_dict()})
        mass, damping = axis.mechanics.mass, axis.damping
        low, high = design.structure.feasible_phase_margin(mass, damping, crossover)
        if low < phase < high:
            gain, t_v = design.structure.gains(mass, damping, crossover, phase)
            k_v1s.append(float(gain) / axis.drive.gain)
            t_vs.append(float(t_v))
    stable = [corner for corner in found if corner["stable"]]

    def goodness(corner: dict[str, Any]) -> tuple[bool, float]:
        margin = corner["phase_margin_deg"]  # None, where nothing crosses over, is unbounded
        return corner["stable"], math.inf if margin is None else margin

    worst = min(found, key=goodness)

    def interval(key: str) -> list[float] | None:
        values = [corner[key] for corner in stable if corner[key] is not None]
        return [min(values), max(values)] if values else None

    return {
        "errors": dict(errors),
        "corners": len(found),
        "stable_share": len(stable) / len(found),
        "worst": worst,
        **{key: interval(key) for key in ("phase_margin_deg", "crossover", "delay_margin", "gain_margin", "bandwidth")},
        "gains": {"k_v1": [min(k_v1s), max(k_v1s)], "t_v": [min(t_vs), max(t_vs)]} if k_v1s else None,
    }


def corners(errors: Mapping[str, float]) -> list[dict[str, float]]:
    """Every combination of plus and minus the relative ``errors``.

    >>> corners({"mass": 0.02})
    [{'mass': -0.02}, {'mass': 0.02}]
    """
    signs = itertools.product((-1.0, 1.0), repeat=len(errors))
    return [{name: sign * errors[name] for name, sign in zip(errors, each, strict=True)} for each in signs]


def with_errors(axis: Axis, shares: Mapping[str, float]) -> Axis:
    """Return ``axis`` with its parameters off by ``shares``.

    >>> from emps_design.machines import machine
    >>> round(with_errors(machine("emps2018"), {"mass": 0.02}).mechanics.mass / 115.7315, 6)
    1.02
    """
    tables: dict[str, dict[str, float]] = {}
    for name, share in shares.items():
        table = PARAMETERS[name]
        tables.setdefault(table, {})[name] = getattr(getattr(axis, table), name) * (1.0 + share)
    if "drive" in tables:  # the product of the data sheet no longer holds
        plain = axis.drive.model_dump(exclude_none=True)
        for key in ("current_gain", "reduction", "torque_constant"):
            plain.pop(key, None)
        drive = type(axis.drive)(**{**plain, **tables.pop("drive")})
        axis = axis.model_copy(update={"drive": drive})
    return axis.model_copy(update={"mechanics": axis.mechanics.model_copy(update=tables.get("mechanics", {}))})
