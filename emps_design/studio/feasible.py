"""Which specifications can be reached: for the controls that must not leave them, and for the plane that shows them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from emps_design.studio.state import CHOICES, State

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.control.velocity.sweeps import VelocityLoopSweep

STEP = 0.5  # deg
UNSTABLE, NO_GAIN = "the sampled loop is unstable", "(7) has no positive gain"


KINDS = ("no gains by (7)", "sampled loop unstable", "below the required margin", "meets it")


@dataclass(frozen=True)
class Plane:
    """What happens, ``kind`` (m, n) as places in ``KINDS``, at the centres of the cells of a plane.

    ``x`` (n,) [rad/s] is evenly spaced in its logarithm, ``y`` (m,) are phase margins [deg].
    """

    x: np.ndarray
    y: np.ndarray
    kind: np.ndarray


@dataclass(frozen=True)
class Feasible:
    """Frequencies [rad/s] with any design, phase margins [deg] to be had at one of them, and why not more or less.

    ``low`` and ``high`` are None where that frequency has nothing, ``frequencies`` where none has anything.
    """

    frequencies: tuple[float, float] | None
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
        return f"Above {highest:g} rad/s every phase margin is unstable." * (highest < CHOICES["frequency"].upper)

    def nearest(self, phase_margin_deg: float) -> float | None:
        """The reachable phase margin [deg] next to ``phase_margin_deg``; None where nothing can be had."""
        return None if self.low is None else float(np.clip(phase_margin_deg, self.low, self.high))

    def nearest_frequency(self, frequency: float) -> float:
        """The frequency [rad/s] with any design next to ``frequency``, itself where there is none."""
        return frequency if self.frequencies is None else float(np.clip(frequency, *self.frequencies))


def crossover_of(specification: str, frequency: np.ndarray, phase_margin_deg: np.ndarray) -> np.ndarray:
    """The crossover [rad/s] that ``frequency`` means: itself, or that of a -3 dB bandwidth at the phase margin."""
    from emps_design.control.velocity.gains import crossover_of_bandwidth

    if specification == "crossover":
        return np.broadcast_to(frequency, np.broadcast_shapes(np.shape(frequency), np.shape(phase_margin_deg)))
    return crossover_of_bandwidth(frequency, phase_margin_deg)


def _designs(
    axis: Axis, specification: str, frequency: np.ndarray, phases: np.ndarray
) -> tuple[VelocityLoopSweep, np.ndarray]:
    """Gains of every specification, and whether they give a stable sampled loop."""
    from emps_design.control.plant.discretisation import sample_axis
    from emps_design.control.velocity.sweeps import sweep_stability, sweep_velocity_loop

    sweep = sweep_velocity_loop(axis, crossover_of(specification, frequency, phases), phases)
    stable = sweep_stability(sample_axis(axis), sweep.k_v1.ravel(), sweep.t_v.ravel())
    return sweep, stable.reshape(phases.shape)


def feasible(state: State) -> Feasible:
    """Return what gains by (7) with a stable sampled loop can reach around the state's specification.

    Of several intervals of the phase margin it is the one nearest to the state's.

    >>> from emps_design.machines import machine
    >>> found = feasible(State.of(machine("emps2018")).changed(computation_delay=1))
    >>> found.low, found.high
    (15.0, 77.5)
    """
    choice = CHOICES["phase_margin_deg"]
    phases = np.arange(choice.lower, choice.upper + STEP / 2, STEP)
    sweep, good = _designs(state.axis, state.specification, np.full(phases.size, state.frequency), phases)
    frequencies = reachable_frequencies(state.axis, state.specification)
    where = f"at {state.specification} {state.frequency:g} rad/s"
    if not good.any():
        reason = f"{UNSTABLE} with every phase margin" if sweep.feasible.any() else NO_GAIN
        return Feasible(frequencies, None, None, f"Nothing can be reached {where}: {reason}.")
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    middle = state.phase_margin_deg
    first, last = min(
        ((a, b - 1) for a, b in runs), key=lambda run: max(phases[run[0]] - middle, middle - phases[run[1]], 0.0)
    )
    low, high = float(phases[first]), float(phases[last])
    below = None if first == 0 else UNSTABLE if sweep.feasible[first - 1] else NO_GAIN
    above = None if last == phases.size - 1 else UNSTABLE
    if below and below == above:
        text = f"outside {low:g}° to {high:g}° {UNSTABLE}"
    else:
        text = " and ".join(
            [*([f"below {low:g}° {below}"] if below else []), *([f"above {high:g}° {above}"] if above else [])]
        )
    return Feasible(frequencies, low, high, f"A{where[1:]}, {text}." if text else "")


@lru_cache(maxsize=16)
def _reachable(table: str, specification: str) -> tuple[float, float] | None:
    from emps_design.axis import Axis

    choice, phase = CHOICES["frequency"], CHOICES["phase_margin_deg"]
    frequencies = np.arange(choice.lower, choice.upper + choice.step / 2, choice.step)
    X, Y = np.meshgrid(frequencies, np.arange(phase.lower, phase.upper + STEP, 2 * STEP))
    good = _designs(Axis.from_toml(table), specification, X, Y)[1].any(axis=0)
    return (float(frequencies[good][0]), float(frequencies[good][-1])) if good.any() else None


def reachable_frequencies(axis: Axis, specification: str) -> tuple[float, float] | None:
    """Lowest and highest frequency [rad/s] of the control at which any phase margin can be reached; None for none."""
    return _reachable(axis.to_toml(), specification)


def plane(axis: Axis, specification: str, required_phase_deg: float, columns: int = 90, rows: int = 60) -> Plane:
    """Return what happens at frequencies, as ``specification`` means them, and phase margins."""
    from emps_design.control.plant.discretisation import sample_axis
    from emps_design.control.velocity.sweeps import sweep_sampled_margins, sweep_velocity_loop

    frequency = CHOICES["frequency"]
    edges = np.geomspace(frequency.lower, frequency.upper, columns + 1)
    x = np.sqrt(edges[1:] * edges[:-1])
    y = (np.arange(rows) + 0.5) * 90.0 / rows
    X, Y = np.meshgrid(x, y)
    sweep = sweep_velocity_loop(axis, crossover_of(specification, X, Y), Y)
    margins = sweep_sampled_margins(sample_axis(axis), sweep.k_v1, sweep.t_v, 60)
    phase = np.nan_to_num(margins["phase_margin_deg"], nan=180.0)
    kind = np.select([~sweep.feasible, ~margins["stable"], phase < required_phase_deg], [0, 1, 2], 3)
    return Plane(x, y, kind.astype(np.uint8))
