"""Which specifications can be reached: for the control that must not leave them, and for the plane that shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from emps_design.studio.state import CHOICES, State

if TYPE_CHECKING:
    from emps_design.axis import Axis

STEP = 0.5  # deg


@dataclass(frozen=True)
class Reach:
    """Phase margins [deg] that can be had at one frequency, and why not more or less."""

    low: float | None
    high: float | None
    text: str

    @property
    def empty(self) -> bool:
        """Whether nothing can be had at that frequency."""
        return self.low is None

    def nearest(self, phase_margin_deg: float) -> float | None:
        """The reachable phase margin [deg] next to ``phase_margin_deg``; None where nothing can be had."""
        return None if self.low is None else float(np.clip(phase_margin_deg, self.low, self.high))


def reach(state: State) -> Reach:
    """Return the phase margins that gains by (7) with a stable sampled loop give at the state's frequency.

    Of several intervals it is the one nearest to the state's phase margin.

    >>> from emps_design.machines import machine
    >>> found = reach(State.of(machine("emps2018")).changed(computation_delay=1))
    >>> found.low, found.high
    (15.0, 77.5)
    """
    from emps_design.control.discretisation import sample_axis
    from emps_design.control.gains import canonical_form, second_order_bandwidth
    from emps_design.control.sweeps import sweep_stability, sweep_velocity_loop

    choice = CHOICES["phase_margin_deg"]
    phases = np.arange(choice.lower, choice.upper + STEP / 2, STEP)
    crossover = np.full(phases.size, state.frequency)
    if state.specification == "bandwidth":
        crossover /= [second_order_bandwidth(*canonical_form(1.0, float(phase))) for phase in phases]
    sweep = sweep_velocity_loop(state.axis, crossover, phases)
    good = sweep_stability(sample_axis(state.axis), sweep.k_v1, sweep.t_v)
    where = f"at {state.specification} {state.frequency:g} rad/s"
    if not good.any():
        reason = "the sampled loop is unstable with every phase margin" if sweep.feasible.any() else "(7) has no gains"
        return Reach(None, None, f"Nothing can be reached {where}: {reason}. Lower it, sample faster or remove delay.")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    middle = state.phase_margin_deg
    first, last = min(
        ((a, b - 1) for a, b in runs), key=lambda run: max(phases[run[0]] - middle, middle - phases[run[1]], 0.0)
    )
    low, high = float(phases[first]), float(phases[last])
    unstable = "the sampled loop is unstable"
    below = None if first == 0 else unstable if sweep.feasible[first - 1] else "(7) has no positive gain"
    above = None if last == phases.size - 1 else unstable
    if below and below == above:
        text = f"outside {low:g}° to {high:g}° {unstable}"
    else:
        text = " and ".join(
            [*([f"below {low:g}° {below}"] if below else []), *([f"above {high:g}° {above}"] if above else [])]
        )
    return Reach(low, high, f"A{where[1:]}, {text}." if text else "")


def plane(axis: Axis, required_phase_deg: float, names: tuple[str, ...], columns: int = 44, rows: int = 30) -> dict:
    """Return cells of the (crossover, phase margin) plane with the name of what happens there.

    ``names``: no gains, unstable, below the requirement, meets it. Keys x [rad/s], y [deg], width, height, kind.
    """
    from emps_design.control.discretisation import sample_axis
    from emps_design.control.sweeps import sweep_sampled_margins, sweep_velocity_loop

    frequency = CHOICES["frequency"]
    edges = np.geomspace(frequency.lower, frequency.upper, columns + 1)
    x = np.sqrt(edges[1:] * edges[:-1])
    y = (np.arange(rows) + 0.5) * 90.0 / rows
    X, Y = np.meshgrid(x, y)
    sweep = sweep_velocity_loop(axis, X, Y)
    margins = sweep_sampled_margins(sample_axis(axis), sweep.k_v1, sweep.t_v, 60)
    phase = np.nan_to_num(margins["phase_margin_deg"], nan=180.0)
    kind = np.select([~sweep.feasible, ~margins["stable"], phase < required_phase_deg], [0, 1, 2], 3)
    width = np.broadcast_to(np.diff(edges), X.shape)
    return {
        "x": X.ravel(),
        "y": Y.ravel(),
        "width": width.ravel() * 1.02,
        "height": np.full(X.size, 90.0 / rows * 1.02),
        "kind": [names[k] for k in kind.ravel()],
    }
