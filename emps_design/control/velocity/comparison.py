"""Compare structures with the same gains, IP, PI, and PI with a reference filter, and measure step responses.

Overshoot, rise and settling time are measured for stable loops only.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.velocity.gains import STRUCTURES
from emps_design.control.velocity.load_range import margins_over_range, margins_under_mismatch
from emps_design.control.verdict import DesignVerdict, where_of
from emps_design.messages import grave

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

SETTLED = 0.02  # band around the final value, as a share of it


@dataclass(frozen=True)
class StepResponse:
    """A unit step response ``y`` (n,) over ``t`` (n,) [s] with its overshoot [%], 10-90 % rise and 2 % settling [s].

    ``peak`` is the largest value and ``peak_time`` [s] its instant; ``settling_time`` is None if the window ends before
    the response stays inside the band.
    """

    t: np.ndarray
    y: np.ndarray
    overshoot_percent: float
    rise_time: float | None
    settling_time: float | None
    peak: float
    peak_time: float

    def to_dict(self) -> dict[str, float | None]:
        """The numbers without the arrays."""
        return {key: value for key, value in asdict(self).items() if key not in ("t", "y")}


def measure_step(t: np.ndarray, y: np.ndarray, final: float = 1.0) -> StepResponse:
    """Read overshoot, rise and settling off ``y`` (n,) over ``t`` (n,) [s] that tends to ``final``.

    >>> t = np.linspace(0.0, 10.0, 100_001)
    >>> first_order = measure_step(t, 1.0 - np.exp(-t))
    >>> round(first_order.rise_time, 3), round(first_order.settling_time, 3)  # ln 9, ln 50
    (2.197, 3.912)
    """
    y = np.asarray(y, dtype=float)
    share = y / final
    peak = int(np.argmax(share))
    low, high = _first_crossing(t, share, 0.1), _first_crossing(t, share, 0.9)
    outside = np.flatnonzero(np.abs(share - 1.0) > SETTLED)
    if not outside.size:
        settling: float | None = float(t[0])
    elif outside[-1] == share.size - 1:
        settling = None
    else:
        last = outside[-1]
        bound = 1.0 + SETTLED * np.sign(share[last] - 1.0)
        settling = float(np.interp(bound, *_ascending(share[last : last + 2], t[last : last + 2])))
    return StepResponse(
        t,
        y,
        float(max(0.0, 100.0 * (share[peak] - 1.0))),
        None if low is None or high is None else high - low,
        settling,
        float(y[peak]),
        float(t[peak]),
    )


def second_order_step(omega_0: float, z: float, t: np.ndarray, zero: float = 0.0) -> np.ndarray:
    """Unit step response of (1 + zero s)/(1 + 2 z s/omega_0 + s^2/omega_0^2) at ``t`` [s], any damping ratio ``z`` > 0.

    >>> round(float(second_order_step(1.0, 1.0, np.array([1.0]))[0]), 6)  # 1 - 2/e
    0.264241
    """
    x = omega_0 * np.asarray(t, dtype=float)
    root = np.sqrt(complex(1.0 - z * z))
    if abs(root) < 1e-9:
        return 1.0 - (1.0 + x - zero * omega_0 * x) * np.exp(-x)
    slope = (z - zero * omega_0) / root
    # exp(-z x) (cos(root x) + slope sin(root x)) by the two poles, of which neither power overflows.
    poles = np.exp((1j * root - z) * x), np.exp((-1j * root - z) * x)
    return 1.0 - (0.5 * (poles[0] + poles[1]) + slope / 2j * (poles[0] - poles[1])).real


def continuous_step(design: VelocityLoopDesign, points: int = 2001) -> StepResponse:
    """Step response of the continuous closed loop (9) with its structure's zero, from velocity reference to velocity.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> step = continuous_step(design_velocity_loop(machine("emps2018"), 100.0, phase_margin_deg=60.0))
    >>> round(step.overshoot_percent, 2)  # 100 exp(-pi z/sqrt(1 - z^2))
    8.77
    """
    t = np.linspace(0.0, step_horizon(design), points)
    zero = design.structure.zero(design.t_v)
    return measure_step(t, second_order_step(design.omega_0v, design.z_v, t, zero))


def sampled_step(design: VelocityLoopDesign) -> StepResponse:
    """Step response of the sampled loop: true carriage velocity at the sampling instants."""
    period = design.axis.sampling.period
    samples = max(20, round(step_horizon(design) / period))
    t, v, _ = design.sampled.step_response(samples)
    return measure_step(t, v)


def step_responses(design: VelocityLoopDesign, points: int = 2001) -> tuple[StepResponse, StepResponse | None]:
    """Step response of the continuous loop and of the sampled loop, None for the latter if it is unstable."""
    return continuous_step(design, points), sampled_step(design) if design.sampled.stable else None


def step_horizon(design: VelocityLoopDesign) -> float:
    """Window [s] that shows rise and settling: 12 radians of the natural frequency, more when overdamped."""
    return 12.0 * max(1.0, design.z_v) / design.omega_0v


def _first_crossing(t: np.ndarray, y: np.ndarray, level: float) -> float | None:
    above = np.flatnonzero(y >= level)
    if not above.size:
        return None
    k = int(above[0])
    if k == 0:
        return float(t[0])
    return float(t[k - 1] + (t[k] - t[k - 1]) * (level - y[k - 1]) / (y[k] - y[k - 1]))


def _ascending(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(x)
    return x[order], y[order]


def gains_document(design: VelocityLoopDesign, verdict: DesignVerdict | None = None) -> dict[str, Any]:
    """Return the JSON document of ``gains``: ``design`` as plain data, its ``verdict``, its gains in each structure.

    ``stable`` and ``worst_loop`` are the verdict over all loops and machines; ``reason`` says why a design is refused,
    ``nearest`` is the nearest that is not. ``position_loop`` is the one designed around it, ``kept_position_loop`` the
    loops with that of the axis file. ``load_range`` and ``mismatch`` are there if the verdict has them.
    """
    verdict = verdict or DesignVerdict(design)
    document = {**design.to_dict(), **verdict.to_dict(), "structures": structures_side_by_side(design)}
    document["warnings"] += verdict.warnings
    if verdict.around is not None:
        document["position_loop"] = verdict.around.to_dict()
    else:
        document |= kept_position_loop(design)
    if verdict.span is not None:
        document["load_range"] = study = margins_over_range(design, verdict.span)
        for point in study["points"]:
            point["loops"] = [loop.to_dict() for loop in verdict.at(where_of(point))]
    if verdict.errors is not None:
        document["mismatch"] = study = margins_under_mismatch(design, verdict.errors)
        study["stable_share"] = share = verdict.stable_share
        study["worst_loop"] = verdict.worst_corner.to_dict()
        if share < 1.0:
            text = f"unstable at {100 * (1 - share):.3g} % of the mismatch corners"
            document["warnings"].append(grave("unstable-at-corners", text, share=1 - share))
    return document


def kept_position_loop(design: VelocityLoopDesign) -> dict[str, Any]:
    """The loops of ``design`` with the axis file's position loop, under that key; empty if it has none."""
    loops = [loop.to_dict() for loop in design.kept_loops]
    return {"kept_position_loop": {"loops": loops}} if loops else {}


def structures_side_by_side(design: VelocityLoopDesign) -> list[dict[str, Any]]:
    """Return bandwidth [rad/s], overshoot [%] and margins of the gains of ``design`` in each structure.

    ``phase_margin_deg`` and ``crossover`` are those of T_vo, continuous; at the plant input all structures are the same
    loop. ``sampled`` is the sampled loop, None if it is unstable.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> for row in structures_side_by_side(design):
    ...     print(row["label"], round(row["bandwidth"], 1), round(row["overshoot_percent"], 1))
    IP 159.9 8.8
    PI 269.3 23.5
    PI with reference filter 159.9 8.8
    """
    rows = []
    for structure in STRUCTURES:
        variant = replace(design, structure=structure)
        continuous, sampled = step_responses(variant)
        rows.append(
            {
                "label": structure.label,
                "structure": structure.form,
                "reference_filter": structure.reference_filter,
                "bandwidth": variant.bandwidth,
                "overshoot_percent": continuous.overshoot_percent,
                "crossover": variant.crossover,
                "phase_margin_deg": variant.phase_margin_deg,
                "sampled": {"bandwidth": variant.sampled.bandwidth, "overshoot_percent": sampled.overshoot_percent}
                if sampled
                else None,
            }
        )
    return rows
