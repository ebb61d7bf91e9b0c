"""The sampled loop: any law around any plant, with hold, delays, current loop, effects, environment and sensor.

A law in its linear form and a plant discretised exactly form one state-space system,

    s[k+1] = A s[k] + B w[k],    y[k] = C s[k] + D w[k].

The poles decide stability; an unstable loop has no margins. Three kinds of states are removed: the position of the
carriage, if nothing depends on it (every free loop would have its pole at 1); a memory cell of the law without input or
without output, such as that of an unused position loop; and a cell that equals a state of the plant when both start at
rest, as does the current model of the impedance law while the drive follows its command.

A controller has nested loops, each broken at one place. The velocity loop is broken at the plant input with the
position loop open. The position loop is broken at the position error with the velocity loop closed, at its own rate, so
that it is one sampled loop whatever the inner rate. The last one is the whole loop at the plant input, where a delay or
a current loop acts; with different rates it is periodic. The worst of these loops decides on a design.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.advice import SAFE_GAIN_MARGIN, SAFE_PHASE_MARGIN_DEG, where_in_words
from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, law_peaks, peaks_of_roots, sample_axis
from emps_design.control.linear_plant import POSITION, VELOCITY, Felt
from emps_design.control.margins import (
    LOOP_NAMES,
    MARGINAL as MARGINAL,
    Margins,
    lifted,
    loop_margins,
    monodromy,
    periodic_margins,
    periodic_response,
    transfer,
)
from emps_design.errors import InputError
from emps_design.laws import get_law, law_of, table_of
from emps_design.laws.linear import LinearLaw, linear_law
from emps_design.units import LINEAR, Units

if TYPE_CHECKING:
    import control

SAME = 1e-9  # relative difference of the coefficients of two equal states
OUTPUTS = ("velocity", "mean_velocity", "force", "voltage")
_REFERENCE, _FORCE, _MORE = range(3)
_POSITION = 1  # place of the position among the inputs of a law; the reference is the first of both

PLANT_INPUT, POSITION_ERROR = "plant input", "position error"
VELOCITY_LOOP, WHOLE = "velocity loop", "whole loop"


@dataclass(frozen=True)
class SampledLoop:
    """A closed loop at its samples; arrays may have leading axes, for many loops at once.

    ``A`` (..., n, n), ``B`` (..., n, i), ``C`` (..., 4, n), ``D`` (..., 4, i). ``inputs``: ``reference`` [m or m/s],
    external ``force`` [N], held over each period so that the supplied energy is exactly force times position step, and
    optionally signals of the law and ``voltage`` [V] added at the plant input. Outputs: the true velocity at the sample
    and its mean over the following period [m/s], the force that the law reads [N], the voltage of the law [V].

    With loops of different rates the loop repeats after ``cycle`` samples: the matrices of the samples are stacked
    along the first axis, and the poles are those of a whole cycle.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    period: float
    inputs: tuple[str, ...]
    cycle: int = 1

    @property
    def samples(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C and D of the samples of a cycle, along the first axis: one of a loop of one rate."""
        A, B, C, D = self.A, self.B, self.C, self.D
        return (A, B, C, D) if self.cycle > 1 else (A[None], B[None], C[None], D[None])

    @cached_property
    def _eigenvalues(self) -> np.ndarray:
        return np.linalg.eigvals(monodromy(self.samples[0]))

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles in the z plane (..., n), largest first; of ``cycle`` samples, so z is exp(s T cycle)."""
        return sorted_poles(self._eigenvalues)

    @property
    def radius(self) -> Any:
        """Largest modulus of the poles, per sample: a float, (...) for many loops."""
        modulus = np.abs(self._eigenvalues).max(axis=-1) ** (1.0 / self.cycle)
        return modulus if modulus.ndim else float(modulus)

    @property
    def stable(self) -> Any:
        """Whether no pole lies outside the unit circle, within :data:`MARGINAL`: a bool, (...) for many loops.

        A force that depends on position has a pole at z = 1 that the velocity does not show, and so has an apparent
        damping of zero.
        """
        return self.radius <= 1.0 + MARGINAL

    def response(self, w: np.ndarray, output: str = "mean_velocity", by: str = "force") -> np.ndarray:
        """Frequency response from the input ``by`` to ``output`` at ``w`` (f,) [rad/s], shape (..., f)."""
        place, row, angle = self.inputs.index(by), OUTPUTS.index(output), np.asarray(w) * self.period
        matrices = self.A, self.B[..., place], self.C[..., row, :], self.D[..., row, place]
        return transfer(*matrices, np.exp(1j * angle)) if self.cycle == 1 else periodic_response(*matrices, angle)

    def position_response(self, w: np.ndarray, by: str) -> np.ndarray:
        """Position over the input ``by`` at ``w`` (f,) [rad/s], from the mean velocity of each period, (..., f)."""
        z = np.exp(1j * np.asarray(w) * self.period)
        return self.response(w, "mean_velocity", by) * self.period / (z - 1.0)

    def admittance(self, w: np.ndarray) -> np.ndarray:
        """Mean velocity over held force at ``w`` (f,) [rad/s], shape (..., f) [m/s/N]."""
        return self.response(w)

    def loop_gain(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input, which must be among the inputs, at ``w`` [rad/s], (..., *w.shape)."""
        opened, column, row = self.opened
        if self.cycle > 1:
            raise InputError(
                f"loop gain: found loops of different rates, periodic with {self.cycle} samples, expected one rate; "
                "nested_loops has the margins of such a law"
            )
        return -transfer(opened, column, row, np.zeros(column.shape[:-1]), np.exp(1j * np.asarray(w) * self.period))

    @property
    def opened(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Matrix, column and row of the loop broken at the plant input, from the voltage there to the law's."""
        if "voltage" not in self.inputs:
            raise InputError("plant input: the loop was closed without it, expected close(..., plant_input=True)")
        column, row = self.B[..., self.inputs.index("voltage")], self.C[..., OUTPUTS.index("voltage"), :]
        return self.A - column[..., :, None] * row[..., None, :], column, row

    def loop_gain_to_ss(self) -> control.StateSpace:
        """The loop broken at the plant input as a discrete ``control.StateSpace``, for negative feedback."""
        import control

        A, column, row = self.opened
        return control.ss(A, column[:, None], -row[None], [[0.0]], self.period, **LOOP_NAMES)

    def simulate(self, w: np.ndarray) -> np.ndarray:
        """Outputs (k, 4) of a single loop from rest under inputs ``w`` (k, i)."""
        w = np.asarray(w, dtype=float)
        samples = list(zip(*self.samples, strict=True))
        size, count = self.A.shape[-1], self.cycle
        states, outputs = np.zeros((len(w) + 1, size)), np.empty((len(w), len(OUTPUTS)))
        for j, (_, B, _, _) in enumerate(samples):
            states[1:][j::count] = (B @ w[j::count, :, None])[..., 0]
        # Only the state needs a loop over the samples.
        for k in range(len(w)):
            states[k + 1] += samples[k % count][0] @ states[k]
        for j, (_, _, C, D) in enumerate(samples):
            outputs[j::count] = (C @ states[:-1][j::count, :, None] + D @ w[j::count, :, None])[..., 0]
        return outputs

    def to_ss(self) -> control.StateSpace:
        """The loop as a discrete ``control.StateSpace`` with named inputs and outputs.

        Loops of different rates are lifted: one step is a whole ``cycle``, with one input and output per sample of it,
        ``reference[0]`` and so on.
        """
        import control

        inputs, outputs = list(self.inputs), list(OUTPUTS)
        if self.cycle > 1:
            inputs, outputs = ([f"{n}[{k}]" for k in range(self.cycle) for n in names] for names in (inputs, outputs))
        return control.ss(*lifted(*self.samples), self.cycle * self.period, inputs=inputs, outputs=outputs, name="loop")

    def to_tf(self, output: str = "mean_velocity", by: str = "force") -> control.TransferFunction:
        """The transfer function in z from the input ``by`` to ``output``."""
        import control

        if self.cycle > 1:
            raise InputError("transfer function: found loops of different rates, which have none; use to_ss()")
        channel = self.to_ss()[OUTPUTS.index(output), self.inputs.index(by)]
        return control.ss2tf(channel, inputs=[by], outputs=[output], name=f"{output}_by_{by}")


def close(
    plant: SampledPlant,
    law: LinearLaw,
    felt: Felt | None = None,
    sensor_delay: int = 0,
    plant_input: bool = False,
    keep_position: bool = False,
) -> SampledLoop:
    """Close the loop of ``law`` around ``plant``; its force sensor reads ``felt`` with a delay of ``sensor_delay``.

    Without ``felt`` the sensor reads the external force; ``sensor_delay`` is in samples. ``plant_input`` adds the input
    ``voltage``, which a current model in the law does not read. With ``keep_position`` the position remains among the
    states, of which those of the plant come first. Leading axes of ``plant`` and ``law`` broadcast.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.laws import law_of
    >>> from emps_design.laws.linear import linear_law
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018").replace(controller={"kind": "ip_velocity", "k_v1": 556.766, "t_v": 8.45505e-3})
    >>> loop = close(sample_axis(axis), linear_law(law_of(axis, 1e-3), 1e-3))
    >>> loop.stable, round(float(abs(loop.response([1e-3], "velocity", "reference")[0])), 6)
    (True, 1.0)
    """
    n, cells = plant.Phi.shape[-1], law.A.shape[-1]
    felt = Felt(np.zeros(n)) if felt is None else felt
    shape = np.broadcast_shapes(plant.Phi.shape[:-2], law.A.shape[:-2], np.shape(felt.state)[:-1])
    split, reads_voltage = bool(np.any(plant.G1)), bool(np.any(felt.voltage))
    history = plant.delay + (1 if split or reads_voltage else 0)
    # s = [x, memory of the law, u[k-1] ... u[k-history], f[k-1] ... f[k-sensor_delay]], then the inputs
    memory, past, late = n, n + cells, n + cells + history
    size = late + sensor_delay
    inputs = ("reference", "force", *law.inputs[3:], *(["voltage"] if plant_input else []))
    signals = slice(size + _MORE, size + _MORE + len(law.inputs) - 3)

    def line(place: int, value: Any = 1.0) -> np.ndarray:
        row = np.zeros((*shape, size + len(inputs)))
        row[..., place] = value
        return row

    encoder, reading = line(0, 0.0), line(size + _FORCE, felt.force)
    encoder[..., :n], reading[..., :n] = plant.C, felt.state
    past_u, past_f = [line(past + i) for i in range(history)], [line(late + i) for i in range(sensor_delay)]
    if reads_voltage:  # the voltage that acted up to this sample
        reading[..., past + plant.delay] += felt.voltage
    read = past_f[-1] if sensor_delay else reading

    def computed(from_memory: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Rows (..., size + inputs) of a quantity that the law computes from its memory and its inputs."""
        rows = by[..., 1, None] * encoder + by[..., 2, None] * read
        rows[..., memory:past] += from_memory
        rows[..., size + _REFERENCE] += by[..., 0]
        rows[..., signals] += by[..., 3:]
        return rows

    voltage = computed(law.C, law.D)
    newest = voltage.copy()
    if plant_input:
        newest[..., -1] += 1.0
    arriving = [newest, *past_u]
    rows = np.zeros((*shape, size, size + len(inputs)))
    rows[..., :n, :n] = plant.Phi
    rows[..., :n, :] += plant.G0[..., :, None] * arriving[plant.delay][..., None, :]
    if split:
        rows[..., :n, :] += plant.G1[..., :, None] * arriving[plant.delay + 1][..., None, :]
    rows[..., :n, size + _FORCE] += plant.H
    for i in range(cells):
        rows[..., memory + i, :] = computed(law.A[..., i, :], law.B[..., i, :])
    for place, values in ((past, arriving[:history]), (late, [reading, *past_f][:sensor_delay])):
        for i, row in enumerate(values):
            rows[..., place + i, :] = row
    step = rows[..., POSITION, :] / plant.period
    step[..., POSITION] -= 1.0 / plant.period
    out = np.stack([line(VELOCITY), step, read, voltage], axis=-2)

    free = (
        not keep_position
        and bool(np.all(plant.integrates))
        and not np.any(felt.state[..., POSITION])
        and law.keeps_to_changes
    )
    if free:  # positions in the memory become relative to the carriage
        moved = law.moved * plant.C[..., POSITION, None]
        for table in (rows, out):
            table[..., POSITION] += np.sum(table[..., memory:past] * moved[..., None, :], axis=-1)
        rows[..., memory:past, :] -= moved[..., :, None] * rows[..., POSITION, None, :]
    used = law.used(moved=free)
    keep = [i for i in range(size) if not (free and i == POSITION) and (i not in range(memory, past) or used[i - n])]
    keep = _without_repetitions(rows, out, keep, range(memory, past))
    ends = list(range(size, size + len(inputs)))
    A, B = rows[..., keep, :][..., keep], rows[..., keep, :][..., ends]
    return SampledLoop(A, B, out[..., keep], out[..., ends], plant.period, inputs, law.cycle)


def axis_loop(axis: Axis, velocity: float = 0.1) -> SampledLoop:
    """Close the loop of the controller of ``axis``, its effects linearised at ``velocity`` [m/s].

    The plant input is among the inputs of the loop. Raises :class:`~emps_design.errors.AxisError` without a controller.

    >>> from emps_design.machines import machine
    >>> loop = axis_loop(machine("emps2019"))
    >>> loop.stable, round(float(abs(loop.loop_gain([242.1])[0])), 3)
    (True, 0.488)
    """
    period = axis.sampling.period
    return close(
        sample_axis(axis, velocity),
        linear_law(law_of(axis, period), period, float(np.sign(velocity))),
        plant_input=True,
    )


def _without_repetitions(rows: np.ndarray, out: np.ndarray, keep: list[int], cells: range) -> list[int]:
    """Return ``keep`` without ``cells`` that equal another state from rest on; its columns absorb theirs."""
    while (pair := _repetition(rows, keep, cells)) is not None:
        cell, other = pair
        for table in (rows, out):
            table[..., other] += table[..., cell]
        keep = [i for i in keep if i != cell]
    return keep


def _repetition(rows: np.ndarray, keep: list[int], cells: range) -> tuple[int, int] | None:
    """Return the first of the ``cells`` that remains equal to another state, and that state; None if there is none."""
    candidates, others = [index for index in keep if index in cells], [index for index in keep if index not in cells]
    if not candidates or not others:
        return None
    columns = np.array([*keep, *range(rows.shape[-2], rows.shape[-1])])
    own, rest = rows[..., candidates, :], rows[..., others, :]
    gap = rest[..., None, :, :] - own[..., :, None, :]
    cell, other = np.ix_(range(len(candidates)), range(len(others)))
    to_own, to_other = gap[..., cell, other, np.array(candidates)[:, None]], gap[..., cell, other, np.array(others)]
    aside = (columns == np.array(candidates)[:, None, None]) | (columns == np.array(others)[None, :, None])
    scale = SAME * np.abs(own).max(axis=-1)[..., None]
    alike = np.all((np.abs(gap[..., columns]) <= scale[..., None]) | aside, axis=-1)
    alike &= np.abs(to_own + to_other) <= scale
    pairs = np.argwhere(np.all(alike.reshape(-1, len(candidates), len(others)), axis=0))
    return (candidates[pairs[0, 0]], others[pairs[0, 1]]) if len(pairs) else None


def sorted_poles(poles: np.ndarray) -> np.ndarray:
    """Return poles (..., n) sorted by descending modulus, then by imaginary part, for a reproducible order."""
    poles = np.asarray(poles, dtype=complex)
    return np.take_along_axis(poles, np.lexsort((-poles.imag, -np.round(np.abs(poles), 12)), axis=-1), axis=-1)


@dataclass(frozen=True)
class NestedLoop:
    """One loop of a controller: its ``name``, where it is ``broken``, and its margins there.

    ``where`` holds the differences of its plant from the axis, see :func:`where_in_words`.
    """

    name: str
    broken: str
    margins: Margins
    where: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: name, place, margins, and the plant if it differs from the axis."""
        where = {"where": dict(self.where)} if self.where else {}
        return {"name": self.name, "broken": self.broken, **where, **self.margins.to_dict()}


def nested_loops(
    axis: Axis, velocity: float = 0.1, delay: float = 0.0, delay_margins: bool = True
) -> tuple[NestedLoop, ...]:
    """Return the loops of the controller of ``axis``, innermost first and the whole loop last.

    The axis is linearised at ``velocity`` [m/s]; ``delay`` [s] adds to that of the command. A controller with only a
    velocity loop has one loop. ``delay_margins`` False omits the delay margins of loops of different rates, which are
    slow to compute. Raises :class:`~emps_design.errors.AxisError` if the axis has no controller.

    >>> from emps_design.machines import machine
    >>> cascade = {"kind": "cascade", "position": {"kp": 30.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    >>> for loop in nested_loops(machine("emps2019").replace(controller=cascade)):
    ...     print(loop.name, "broken at the", loop.broken, round(loop.margins.phase_margin_deg))
    velocity loop broken at the plant input 71
    position loop broken at the position error 77
    whole loop broken at the plant input 57
    """
    period, direction = axis.sampling.period, float(np.sign(velocity))
    plant = sample_axis(axis, velocity, delay=delay)
    whole = law_of(axis, period)
    kind = get_law(axis.controller.kind)
    loops = []
    for name, table in kind.loops(table_of(axis)) if kind.loops else ():
        law = kind.law(table, axis, period)
        form = linear_law(law, period, direction)
        if law.follows == "velocity":
            loops.append(NestedLoop(name, PLANT_INPUT, at_plant_input(plant, form)))
        else:
            loops.append(NestedLoop(name, POSITION_ERROR, at_position_error(plant, form)))
    if len(loops) != 1:
        name = VELOCITY_LOOP if not loops and whole.follows == "velocity" else WHOLE
        margins = at_plant_input(plant, linear_law(whole, period, direction), delay_margins)
        loops.append(NestedLoop(name, PLANT_INPUT, margins))
    return tuple(loops)


def at_plant_input(plant: SampledPlant, form: LinearLaw, delay_margins: bool = True) -> Margins:
    """Margins of the loop of ``form`` around ``plant``, broken at the plant input with all inner loops closed.

    ``delay_margins`` False omits the delay margin of a loop of different rates.
    """
    loop = close(plant, form, plant_input=True)
    if form.cycle > 1:

        def delayed(delay: float) -> float:
            return float(np.abs(close(plant.delayed(delay), form, plant_input=True).poles).max())

        return periodic_margins(*loop.opened, plant.period, delayed if delay_margins else None)

    return loop_margins(
        loop.loop_gain,
        plant.frequencies(peaks=law_peaks(form, plant.period)),
        loop.stable,
        plant.period,
        lambda w, delay: loop.loop_gain(w) * plant.delayed_response(w, delay) / plant.response(w),
    )


def at_position_error(plant: SampledPlant, form: LinearLaw) -> Margins:
    """Margins of the position loop broken at the position error, at its own rate.

    ``form`` must read position and reference only through their difference, except for its velocity estimates.
    """
    A, b, c = position_loop(plant, form)
    period, stable = form.cycle * plant.period, close(plant, form).stable
    inner = [*peaks_of_roots(np.linalg.eigvals(A), period), *law_peaks(form, plant.period)]
    grid = replace(plant, period=period, filters=()).frequencies(peaks=inner)
    return loop_margins(lambda w: transfer(A, b, c, 0.0, np.exp(1j * np.asarray(w) * period)), grid, stable, period)


def position_loop(plant: SampledPlant, form: LinearLaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The position loop broken at the position error: ``x[i+1] = A x + b e``, ``q = c x``, one step per law cycle.

    With ``reference + q`` as the reference, the reference is the position error; the law reads it once per cycle.
    """
    B, D = form.B.copy(), form.D.copy()
    for columns in (B, D):
        columns[..., _POSITION] += columns[..., _REFERENCE]
    loop = close(plant, replace(form, B=B, D=D), keep_position=True)
    row = np.zeros(loop.A.shape[-1])
    row[: plant.C.size] = plant.C
    A, by_inputs, C, through = loop.samples
    place = loop.inputs.index("reference")
    moves, driven, _, _ = lifted(A, by_inputs[..., [place]], C, through[..., [place]])
    return moves, driven[:, 0], row


def safety(margins: Margins) -> float:
    """Return the smaller of phase margin over 30 deg and gain margin in octaves; a loop is safe from 1 on.

    It is minus infinity for an unstable loop, and plus infinity if both margins are unbounded.

    >>> from emps_design.control.margins import Margins
    >>> safety(Margins(stable=True, phase_margin_deg=60.0, gain_margin=2.0)), safety(Margins(stable=False))
    (1.0, -inf)
    """
    if not margins.stable:
        return -math.inf
    phase, gain = margins.phase_margin_deg, margins.gain_margin
    return min(
        math.inf if phase is None else phase / SAFE_PHASE_MARGIN_DEG,
        math.inf if gain is None else math.log(gain) / math.log(SAFE_GAIN_MARGIN),
    )


def worst_loop(loops: Iterable[NestedLoop]) -> NestedLoop:
    """Return the loop with the smallest :func:`safety`, the first of equal ones.

    So an unstable loop precedes every stable one, and of several unstable loops the innermost is returned.

    >>> from emps_design.control.margins import Margins
    >>> from emps_design.control.sampled import NestedLoop
    >>> inner = NestedLoop("velocity loop", "plant input", Margins(stable=True, phase_margin_deg=60.0))
    >>> outer = NestedLoop("position loop", "position error", Margins(stable=True, phase_margin_deg=6.4))
    >>> worst_loop([inner, outer]).name
    'position loop'
    """
    return min(loops, key=lambda loop: safety(loop.margins))


def margins_in_words(margins: Margins) -> str:
    """Phase and gain margin of a stable loop in words.

    >>> from emps_design.control.margins import Margins
    >>> margins_in_words(Margins(stable=True, phase_margin_deg=6.41, gain_margin=1.234))
    '6.4 deg of phase margin and a gain margin of 1.23'
    """
    phase = "unbounded" if margins.phase_margin_deg is None else f"{margins.phase_margin_deg:.1f} deg of"
    gain = "an unbounded gain margin" if margins.gain_margin is None else f"a gain margin of {margins.gain_margin:.3g}"
    return f"{phase} phase margin and {gain}"


def loop_in_words(loop: NestedLoop, units: Units = LINEAR) -> str:
    """The name of a loop and its plant in words, in the units of its axis.

    >>> from emps_design.control.margins import Margins
    >>> from emps_design.control.sampled import NestedLoop
    >>> loop_in_words(NestedLoop("whole loop", "plant input", Margins(stable=False), {"inertia": 3.0}))
    'whole loop with 3 times the inertia'
    """
    return " ".join(filter(None, (units.words(loop.name), where_in_words(loop.where, units))))
