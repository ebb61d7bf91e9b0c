"""The verdict on a design: the stability of its worst loop, over all plants on which the controller must run.

These plants are the nominal axis in both directions, the loads of a range, and the corners of a mismatch.

The document of ``gains`` holds the verdict, and the same gains in each structure: IP, PI, and PI with a reference
filter, with the overshoot of their step responses. Overshoot, rise and settling time exist for stable loops only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.advice import SAFE_GAIN_MARGIN, SAFE_PHASE_MARGIN_DEG, where_in_words
from emps_design.axis import Axis
from emps_design.control.linear_plant import linear_plant
from emps_design.control.sampled import (
    VELOCITY_LOOP,
    NestedLoop,
    loop_in_words,
    margins_in_words,
    nested_loops,
    safety,
    worst_loop,
)
from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import STRUCTURES
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.velocity.load_range import (
    LoadRange,
    corners,
    loaded,
    margins_over_range,
    margins_under_mismatch,
    with_errors,
)
from emps_design.errors import SpecificationError
from emps_design.messages import Message, grave, warning

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign

NOMINAL = {"inertia": 1.0, "compliance": 1.0, "delay": 0.0}

SLOWER = 0.9  # ratio of the frequencies of two successive loops in a search
KEPT = 0.8  # least share of the velocity loop's safety with a position loop, if the velocity loop itself is not safe
SLOWEST = 1e-3  # slowest loop of a search, relative to the first

SETTLED = 0.02  # band around the final value, as a share of it


@dataclass(frozen=True)
class Case:
    """An ``axis`` with its controller, linearised at ``velocity`` [m/s], with an additional ``delay`` [s].

    ``where`` holds its differences from the nominal axis, see :func:`~emps_design.advice.where_in_words`.
    """

    axis: Axis
    velocity: float = 0.1
    delay: float = 0.0
    where: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def loops(self) -> tuple[NestedLoop, ...]:
        """The loops of the controller, innermost first and the whole loop last."""
        return self._loops(delay_margins=True)

    @cached_property
    def judged(self) -> tuple[NestedLoop, ...]:
        """:attr:`loops` without the delay margins that are slow to compute; sufficient for a verdict."""
        return self._loops(delay_margins=False)

    @property
    def backward(self) -> Case:
        """The same machine in the other direction."""
        return replace(self, velocity=-self.velocity, where={**self.where, "velocity": -self.velocity})

    def _loops(self, delay_margins: bool) -> tuple[NestedLoop, ...]:
        loops = nested_loops(self.axis, self.velocity, self.delay, delay_margins)
        return tuple(replace(loop, where=self.where) for loop in loops)


def where_of(point: Mapping[str, float]) -> dict[str, float]:
    """Return the differences of a ``point`` of a load range from the nominal axis.

    >>> where_of({"inertia": 3.0, "compliance": 1.0, "delay": 0.0})
    {'inertia': 3.0}
    """
    return {name: point[name] for name, nominal in NOMINAL.items() if point[name] != nominal}


def cases_of(
    axis: Axis,
    velocity: float = 0.1,
    span: LoadRange | None = None,
    errors: Mapping[str, float] | None = None,
) -> tuple[Case, ...]:
    """Return the plants on which the controller of ``axis`` runs, the nominal axis first.

    An axis with effects is included at -``velocity`` [m/s] too. ``span`` adds the loads of a range, its ends and
    several in between; ``errors`` the corners of these relative errors of the parameters. They are tried in both
    directions if the effects differ in them.

    >>> from emps_design.machines import machine
    >>> [dict(case.where) for case in cases_of(machine("emps2019"), errors={"mass": 0.1})]
    [{}, {'mass': -0.1}, {'mass': 0.1}]
    """
    here, others = Case(axis, velocity), []
    for point in span.points(span.enough) if span is not None else ():
        where = where_of(point)
        if where:
            others.append(Case(loaded(axis, point["inertia"], point["compliance"]), velocity, point["delay"], where))
    others += [
        Case(with_errors(axis, shares), velocity, where=shares) for shares in (corners(errors) if errors else ())
    ]
    if not axis.effects:
        return (here, *others)
    back = [case.backward for case in (here, *(others if _differs_backward(axis, velocity) else ()))]
    return (here, back[0], *others, *back[1:])


def _differs_backward(axis: Axis, velocity: float) -> bool:
    """Whether the linear plant of ``axis`` at -``velocity`` [m/s] is another than at ``velocity``."""
    there, back = linear_plant(axis, velocity), linear_plant(axis, -velocity)
    pairs = [(getattr(there, name), getattr(back, name)) for name in ("A", "B", "C", "delay")]
    return not all(np.allclose(one, other, rtol=1e-6, atol=0.0) for one, other in pairs)


def worst_loop_of(axis: Axis) -> NestedLoop:
    """Return the loop of the controller of ``axis`` with the smallest margins, in either direction.

    Raises :class:`~emps_design.errors.AxisError` if the axis has no controller, or one that is not linear.

    >>> from emps_design.machines import machine
    >>> worst_loop_of(machine("emps2019")).name
    'whole loop'
    """
    return worst_loop(loop for case in cases_of(axis) for loop in case.loops)


@dataclass(frozen=True)
class DesignVerdict:
    """The loops of the controller with a velocity loop ``design``, and the worst of them.

    ``around`` is the position loop designed around it; without one a cascade keeps that of the axis file. ``span`` is a
    range of loads, ``errors`` are relative errors of the parameters, ``measured`` are loops around measured plants.
    """

    design: VelocityLoopDesign
    around: PositionLoopDesign | None = None
    span: LoadRange | None = None
    errors: Mapping[str, float] | None = None
    measured: Sequence[NestedLoop] = ()

    @cached_property
    def axis(self) -> Axis:
        """The axis with the designed controller."""
        return self.design.axis_that_runs if self.around is None else self.around.axis()

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        """The plants on which the controller will run."""
        return cases_of(self.axis, self.design.velocity, self.span, self.errors)

    @cached_property
    def loops(self) -> tuple[NestedLoop, ...]:
        """Every loop on every plant, those of the nominal axis first; delay margins may be missing."""
        return (*(loop for case in self.cases for loop in case.judged), *self.measured)

    @cached_property
    def worst(self) -> NestedLoop:
        """The loop with the smallest margins."""
        return self._with_all_margins(worst_loop(self.loops))

    def _with_all_margins(self, loop: NestedLoop) -> NestedLoop:
        """One of :attr:`loops` with all of its margins."""
        case = next((case for case in self.cases if any(judged is loop for judged in case.judged)), None)
        return loop if case is None else case.loops[case.judged.index(loop)]

    @property
    def stable(self) -> bool:
        """Whether all loops are stable."""
        return self.worst.margins.stable

    @property
    def _keeps_position_loop(self) -> bool:
        """Whether the position loop is that of the axis file, not one designed for this velocity loop."""
        return self.around is None and self.axis.controller.position is not None

    @cached_property
    def nearest(self) -> dict[str, Any]:
        """The nearest specification that is stable on every plant, with ``position_kp`` [1/s].

        {} if there is none, and if the design is stable.
        """
        if self.stable or "response" in self.worst.where:
            return {}
        if self.design.reason:
            return self.design.nearest_stable
        if self.worst.name == VELOCITY_LOOP:
            return self._slower_request()
        kp = self.position_kp
        return {} if kp is None else {"position_kp": kp}

    @cached_property
    def position_kp(self) -> float | None:
        """The gain [1/s] of a slower position loop with which all loops are safe on every plant, to three digits.

        If the velocity loop itself is not safe, a gain that hardly reduces its margins. None if there is no position
        loop or no stable gain.
        """
        if self.axis.controller.position is None:
            return None
        least = min(1.0, self._share_of_the_velocity_loop)
        return _position_gain(self.cases, least) if least > 0.0 else None

    @property
    def _share_of_the_velocity_loop(self) -> float:
        """The share :data:`KEPT` of the smallest safety of the velocity loop over all plants."""
        return KEPT * min(safety(loop.margins) for loop in self.loops if loop.name == VELOCITY_LOOP)

    def _slower_request(self) -> dict[str, Any]:
        """The specification at a lower frequency whose velocity loop is safe or at least stable on every plant."""
        design, stable = self.design, dict[str, Any]()
        if not design.requested:
            return {}
        name, requested = next(iter(design.requested.items()))
        frequency = requested
        while frequency > SLOWEST * requested:
            frequency = float(f"{SLOWER * frequency:.3g}")
            try:
                slower = redesigned(design, frequency)
            except SpecificationError:
                continue
            specification = {**design.requested, name: frequency}
            verdict = DesignVerdict(slower, None, self.span, self.errors)
            least = min(safety(loop.margins) for loop in verdict.loops if loop.name == VELOCITY_LOOP)
            if least >= 1.0:
                kp = verdict.position_kp
                return specification if kp is None else {**specification, "position_kp": kp}
            stable = stable or (specification if least > -math.inf else {})
        return stable

    @property
    def reason(self) -> str:
        """The reason why the design must not run, in one line; empty if every loop is stable."""
        if self.stable:
            return ""
        if self.design.reason:
            return self.design.reason
        where = where_in_words(self.worst.where, self.axis.units)
        if "response" in self.worst.where:
            return f"the {self.worst.name} with these gains is unstable {where}; specify a slower one"
        if self.worst.name == VELOCITY_LOOP:
            return f"the velocity loop with these gains is unstable {where}; {self._nearest_in_words}"
        kp = self.axis.controller.parameters["position"]["kp"]
        whose = "the axis file's" if self._keeps_position_loop else "the"
        return (
            f"{whose} position loop with kp = {kp:g} is unstable around this velocity loop{where and ' '}{where}; "
            f"{self._nearest_in_words}"
        )

    @property
    def _nearest_in_words(self) -> str:
        nearest = dict(self.nearest)
        kp = nearest.pop("position_kp", None)
        words = []
        if nearest:
            name = next(iter(nearest))
            words.append(f"{nearest['phase_margin_deg']:.7g} deg at a {name} of {nearest[name]:.5g} rad/s")
        if kp is not None:
            words.append(f"`position_kp={kp:g}`")
        return f"nearest that is stable: {' with '.join(words)}" if words else "no slower one is stable"

    @property
    def warnings(self) -> tuple[Message, ...]:
        """A message if the worst loop is stable but not safe, with the position gain that makes all loops safe."""
        worst = self.worst
        if not self.stable or safety(worst.margins) >= 1.0:
            return ()
        words = f"the {loop_in_words(worst, self.axis.units)} has only {margins_in_words(worst.margins)}"
        kp = self.position_kp if worst.name != VELOCITY_LOOP and "response" not in worst.where else None
        present = self.axis.controller.parameters["position"]["kp"] if kp is not None else 0.0
        slower = ""
        if kp is not None and kp < present:
            safe = f"{SAFE_PHASE_MARGIN_DEG:g} deg and a gain margin of {SAFE_GAIN_MARGIN:g}"
            margins = safe if self._share_of_the_velocity_loop >= 1.0 else "more"
            slower = f"; `position_kp={kp:g}` instead of {present:.4g} gives {margins}"
        return (warning("small-margins", words + slower),)

    def at(self, where: Mapping[str, Any]) -> list[NestedLoop]:
        """The loops on the plant that differs from the axis by ``where``."""
        return [loop for case in self.cases if case.where == where for loop in case.loops]

    @cached_property
    def _corners(self) -> list[NestedLoop]:
        """The worst loop at each corner of ``errors``, in either direction."""
        loops: dict[tuple[float, ...], list[NestedLoop]] = {}
        for case in self.cases:
            if self.errors and case.where.keys() >= self.errors.keys():
                loops.setdefault(tuple(case.where[name] for name in self.errors), []).extend(case.judged)
        return [worst_loop(of_corner) for of_corner in loops.values()]

    @property
    def worst_corner(self) -> NestedLoop:
        """The worst loop at any corner of ``errors``."""
        return self._with_all_margins(worst_loop(self._corners))

    @property
    def stable_share(self) -> float:
        """Share of the corners of ``errors`` at which all loops are stable."""
        return sum(loop.margins.stable for loop in self._corners) / len(self._corners)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: ``stable``, ``worst_loop``, and ``reason`` and ``nearest`` if unstable."""
        document = {"stable": self.stable, "worst_loop": self.worst.to_dict()}
        return document if self.stable else {**document, "reason": self.reason, "nearest": self.nearest}


def redesigned(design: VelocityLoopDesign, frequency: float) -> VelocityLoopDesign:
    """Return ``design`` for another ``frequency`` [rad/s], with the same method and the rest of its specification.

    Raises :class:`SpecificationError` if there are no gains for it.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> slower = redesigned(design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=50.0), 40.0)
    >>> slower.requested
    {'crossover': 40.0, 'phase_margin_deg': 50.0}
    """

    request: dict[str, Any] = {**design.requested, next(iter(design.requested)): frequency}
    request |= {"velocity": design.velocity, "structure": design.structure, "filters": design.filters}
    if design.retuned_at:
        return retune_velocity_loop(design.axis, at=design.retuned_at, **request)
    return design_velocity_loop(design.axis, **request)


def _position_gain(cases: Sequence[Case], least: float) -> float | None:
    """Return the largest gain [1/s] of the position loop, to three digits, with a safety of ``least`` in all ``cases``.

    The gain is reduced in steps, for one plant after the other, since only a few of them bind.
    """

    def with_gain(case: Case, kp: float) -> Case:
        position = case.axis.controller.parameters["position"]
        return replace(case, axis=case.axis.replace(controller={"position": {**position, "kp": kp}}))

    def holds(case: Case, kp: float) -> bool:
        return safety(worst_loop(with_gain(case, kp).judged).margins) >= least

    kp = float(cases[0].axis.controller.parameters["position"]["kp"])
    slowest = SLOWEST * kp
    hardest_first = sorted(cases, key=lambda case: safety(worst_loop(case.judged).margins))
    for _ in range(2):  # twice, since a lower gain may violate the limit of an earlier plant
        for case in hardest_first:
            while kp > slowest and not holds(case, kp):
                kp = float(f"{SLOWER * kp:.3g}")
    return kp if kp > slowest else None


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


def measure_step(t: np.ndarray, y: np.ndarray) -> StepResponse:
    """Return overshoot, rise and settling time of ``y`` (n,) over ``t`` (n,) [s], which tends to 1.

    >>> t = np.linspace(0.0, 10.0, 100_001)
    >>> first_order = measure_step(t, 1.0 - np.exp(-t))
    >>> round(first_order.rise_time, 3), round(first_order.settling_time, 3)  # ln 9, ln 50
    (2.197, 3.912)
    """
    y = np.asarray(y, dtype=float)
    peak = int(np.argmax(y))
    low, high = _first_crossing(t, y, 0.1), _first_crossing(t, y, 0.9)
    outside = np.flatnonzero(np.abs(y - 1.0) > SETTLED)
    if not outside.size:
        settling: float | None = float(t[0])
    elif outside[-1] == y.size - 1:
        settling = None
    else:
        last = outside[-1]
        bound = 1.0 + SETTLED * np.sign(y[last] - 1.0)
        settling = float(np.interp(bound, *_ascending(y[last : last + 2], t[last : last + 2])))
    return StepResponse(
        t,
        y,
        float(max(0.0, 100.0 * (y[peak] - 1.0))),
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
    # exp(-z x) (cos(root x) + slope sin(root x)) by the two poles, so that no power overflows.
    poles = np.exp((1j * root - z) * x), np.exp((-1j * root - z) * x)
    return 1.0 - (0.5 * (poles[0] + poles[1]) + slope / 2j * (poles[0] - poles[1])).real


def continuous_step(design: VelocityLoopDesign, points: int = 2001) -> StepResponse:
    """Step response of the continuous closed loop (9) with the zero of its structure, from reference to velocity.

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
    """Window [s] for rise and settling: 12 radians of the natural frequency, more if overdamped."""
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

    ``stable`` and ``worst_loop`` are the verdict over all loops and plants; ``reason`` says why a design must not run,
    ``nearest`` is the nearest stable one. ``position_loop`` is the one designed around it, ``kept_position_loop`` has
    the loops with that of the axis file. ``load_range`` and ``mismatch`` are included if the verdict has them.
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
        document["mismatch"] = mismatch_document(verdict)
        share = document["mismatch"]["stable_share"]
        if share < 1.0:
            text = f"unstable at {100 * (1 - share):.3g} % of the mismatch corners"
            document["warnings"].append(grave("unstable-at-corners", text, share=1 - share))
    return document


def mismatch_document(verdict: DesignVerdict) -> dict[str, Any]:
    """The velocity loop over the corners of the errors of ``verdict``; of all loops the stable share and the worst."""
    whole = {"stable_share": verdict.stable_share, "worst_loop": verdict.worst_corner.to_dict()}
    return margins_under_mismatch(verdict.design, verdict.errors or {}) | whole


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
