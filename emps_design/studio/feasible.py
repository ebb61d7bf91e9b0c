"""Which specifications can be reached: for the controls that must not leave them, and for the plane that shows them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.stretches import stretches
from emps_design.studio.ranges import CHOICES, choices_of
from emps_design.studio.state import State

if TYPE_CHECKING:
    from emps_design.control.velocity.specification import Pairs

STEP = 0.5  # deg
UNSTABLE, NO_GAIN = "the sampled loop is unstable", "no gains are positive"


KINDS = ("no positive gains", "sampled loop unstable", "below the required margin", "meets it")


@dataclass(frozen=True)
class Plane:
    """What happens, ``kind`` (m, n) as places in ``KINDS``, at the centres of the cells of a plane.

    ``x`` (n,) [rad/s] is evenly spaced in its logarithm, from end to end of ``range``; ``y`` (m,) are phase margins
    [deg].
    """

    range: tuple[float, float]
    x: np.ndarray
    y: np.ndarray
    kind: np.ndarray


@dataclass(frozen=True)
class Feasible:
    """Frequencies [rad/s] with any design, phase margins [deg] to be had at one of them, and why not more or less.

    ``low`` and ``high`` are None where that frequency has nothing, ``frequencies`` where none has anything; ``upper``
    [rad/s] is the end of the control.
    """

    frequencies: tuple[float, float] | None
    upper: float
    low: float | None
    high: float | None
    text: str

    @property
    def empty(self) -> bool:
        """Whether nothing can be had at that frequency."""
        return self.low is None

    @property
    def beyond(self) -> str:
        """What ends the frequencies."""
        if self.frequencies is None:
            return "Sample faster or remove delay."
        highest = self.frequencies[1]
        return f"Above {highest:g} rad/s every phase margin is unstable." * (highest < self.upper)

    def nearest(self, phase_margin_deg: float) -> float | None:
        """The reachable phase margin [deg] next to ``phase_margin_deg``; None where nothing can be had."""
        return None if self.low is None else float(np.clip(phase_margin_deg, self.low, self.high))

    def nearest_frequency(self, frequency: float) -> float:
        """The frequency [rad/s] with any design next to ``frequency``, itself where there is none."""
        return frequency if self.frequencies is None else float(np.clip(frequency, *self.frequencies))


def _pairs(state: State) -> Pairs:
    """What pairs of a frequency and a phase margin mean on the axis of ``state``, with its structure and filters."""
    from emps_design.control.velocity.specification import pairs_by_closed_form

    asked = state.requested
    return pairs_by_closed_form(state.axis, asked, structure=asked["structure"], filters=asked["filters"])


def _designs(state: State, frequency: np.ndarray, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether each specification has gains, and whether they give a stable sampled loop; arrays of one shape."""
    from emps_design.control.velocity.sweeps import sweep_stability

    pairs = _pairs(state)
    k_v1, t_v = pairs.gains(frequency.ravel(), phases.ravel())
    stable = sweep_stability(pairs.plant, k_v1, t_v)
    return np.isfinite(k_v1).reshape(phases.shape), stable.reshape(phases.shape)


def feasible(state: State) -> Feasible:
    """Return what positive gains with a stable sampled loop can reach around the state's specification.

    Of several intervals of the phase margin it is the one nearest to the state's.

    >>> from emps_design.machines import machine
    >>> found = feasible(State.of(machine("emps2018")).changed(computation_delay=1))
    >>> found.low, found.high
    (15.0, 77.5)
    """
    choice = CHOICES["phase_margin_deg"]
    phases = np.arange(choice.lower, choice.upper + STEP / 2, STEP)
    gains, good = _designs(state, np.full(phases.size, state.frequency), phases)
    frequencies, upper = reachable_frequencies(state), choices_of(state.axis)["frequency"].upper
    where = f"at {state.specification} {state.frequency:g} rad/s"
    if not good.any():
        reason = f"{UNSTABLE} with every phase margin" if gains.any() else NO_GAIN
        return Feasible(frequencies, upper, None, None, f"Nothing can be reached {where}: {reason}.")
    middle = state.phase_margin_deg
    first, last = min(
        ((start, stop - 1) for start, stop in stretches(good)),
        key=lambda run: max(phases[run[0]] - middle, middle - phases[run[1]], 0.0),
    )
    low, high = float(phases[first]), float(phases[last])
    below = None if first == 0 else UNSTABLE if gains[first - 1] else NO_GAIN
    above = None if last == phases.size - 1 else UNSTABLE if gains[last + 1] else NO_GAIN
    if below and below == above:
        text = f"outside {low:g}° to {high:g}° {UNSTABLE}"
    else:
        text = " and ".join(
            [*([f"below {low:g}° {below}"] if below else []), *([f"above {high:g}° {above}"] if above else [])]
        )
    return Feasible(frequencies, upper, low, high, f"A{where[1:]}, {text}." if text else "")


@lru_cache(maxsize=16)
def _reachable(table: str) -> tuple[float, float] | None:
    state = State.from_toml(table)
    choice, phase = choices_of(state.axis)["frequency"], CHOICES["phase_margin_deg"]
    frequencies = np.arange(choice.lower, choice.upper + choice.step / 2, choice.step)
    X, Y = np.meshgrid(frequencies, np.arange(phase.lower, phase.upper + STEP, 2 * STEP))
    good = _designs(state, X, Y)[1].any(axis=0)
    return (float(frequencies[good][0]), float(frequencies[good][-1])) if good.any() else None


def reachable_frequencies(state: State) -> tuple[float, float] | None:
    """Lowest and highest frequency [rad/s] of the control at which any phase margin can be reached; None for none."""
    return _reachable(_question(state).to_toml())


def _question(state: State, **kept: Any) -> State:
    """``state`` with what its velocity loop is made of alone, so that equal questions are equal."""
    law: dict[str, Any] = {"specification": state.specification, "structure": state.structure, "filters": state.filters}
    return replace(State.plain(state.axis), **law, **kept)


@lru_cache(maxsize=16)
def _plane(table: str, columns: int, rows: int) -> Plane:
    from emps_design.control.velocity.sweeps import sweep_sampled_margins

    state = State.from_toml(table)
    frequency = choices_of(state.axis)["frequency"]
    edges = np.geomspace(frequency.lower, frequency.upper, columns + 1)
    x = np.sqrt(edges[1:] * edges[:-1])
    y = (np.arange(rows) + 0.5) * 90.0 / rows
    X, Y = np.meshgrid(x, y)
    pairs = _pairs(state)
    k_v1, t_v = (gain.reshape(X.shape) for gain in pairs.gains(X.ravel(), Y.ravel()))
    margins = sweep_sampled_margins(pairs.plant, k_v1, t_v, 60, exact_delay=False)
    phase = np.nan_to_num(margins["phase_margin_deg"], nan=180.0)
    kind = np.select([np.isnan(k_v1), ~margins["stable"], phase < state.required_phase_deg], [0, 1, 2], 3)
    return Plane((frequency.lower, frequency.upper), x, y, kind.astype(np.uint8))


def plane(state: State, columns: int = 90, rows: int = 60) -> Plane:
    """Return what happens at frequencies, as the specification of ``state`` means them, and phase margins."""
    return _plane(_question(state, required_phase_deg=state.required_phase_deg).to_toml(), columns, rows)
