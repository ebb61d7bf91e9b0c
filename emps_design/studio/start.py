"""The requirements of a velocity loop, and the specification that a session starts with: one that meets them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.studio.ranges import choices_of

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

# Shares of the first frequency: slower ones first; faster ones for a position loop that the axis has around it.
SHARES = (1.0, 0.5, 0.2, 0.1, 0.05, 2.0, 5.0)
PHASES = (60.0, 70.0, 80.0)  # deg


@dataclass(frozen=True)
class Requirements:
    """What a stable design has of what is required: its phase margin [deg], None for any, and its overshoot [%]."""

    phase_margin_deg: float | None
    overshoot_percent: float
    phase_met: bool
    overshoot_met: bool

    @property
    def met(self) -> bool:
        """Whether it has all of it."""
        return self.phase_met and self.overshoot_met


def requirements(
    design: VelocityLoopDesign, required_phase_deg: float, required_overshoot_percent: float
) -> Requirements | None:
    """What ``design`` has of what is required of it when sampled; None where that loop is unstable."""
    from emps_design.control.velocity.step_response import sampled_step

    margins = design.sampled.margins
    if not margins.stable:
        return None
    phase, overshoot = margins.phase_margin_deg, sampled_step(design).overshoot_percent
    phase_met = phase is None or phase >= required_phase_deg
    return Requirements(phase, overshoot, phase_met, overshoot <= required_overshoot_percent)


def first_specification(axis: Axis) -> dict[str, float]:
    """The first specification on ``axis`` whose design meets the first requirements; {} where none of those tried does.

    The force gain is half of what that design bears, where it bears less than the first.
    """
    return _first(axis.to_toml())


@lru_cache(maxsize=64)
def _first(table: str) -> dict[str, float]:
    axis = Axis.from_toml(table)
    first = {name: choice.first for name, choice in choices_of(axis).items()}
    for share, phase in product(SHARES, PHASES):
        asked = {"frequency": float(f"{share * first['frequency']:.6g}"), "phase_margin_deg": phase}
        design = _met(axis, asked, first)
        if design is not None:
            return asked | _force_gain(design, first)
    return {}


def _met(axis: Axis, asked: dict[str, float], first: dict[str, float]) -> VelocityLoopDesign | None:
    """The design of what is ``asked`` where it has what is required of it and its worst loop is safe."""
    from emps_design.control.loop.worst import safety
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.verdict import DesignVerdict

    try:
        design = design_velocity_loop(axis, asked["frequency"], phase_margin_deg=asked["phase_margin_deg"])
    except EmpsError:  # no gains are positive
        return None
    found = requirements(design, first["required_phase_deg"], first["required_overshoot_percent"])
    met = found and found.met and not design.refused and safety(DesignVerdict(design).worst.margins) >= 1.0
    return design if met else None


def _force_gain(design: VelocityLoopDesign, first: dict[str, float]) -> dict[str, float]:
    from emps_design.control.force.design import design_force_loop

    force = design_force_loop(design, first["k_e1"], hand=first["hand"], environment=first["wall"] * 1e3)
    limit = force.k_e1_max_sampled
    return {} if force.stable or limit is None else {"k_e1": float(f"{0.5 * limit:.1g}")}
