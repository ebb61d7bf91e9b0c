"""The sampled loop: any law around any plant, with hold, delays, current loop, effects, environment and sensor.

A law in its linear form and a plant discretised exactly form one state-space system,

    s[k+1] = A s[k] + B w[k],    y[k] = C s[k] + D w[k].

Stability is judged by its poles first; an unstable loop has no margins. Three kinds of states are removed: the position
of the carriage, if nothing depends on it (its pole at 1 would be in every free loop); a memory cell of the law that
nothing drives or nothing reads, such as that of an unused position loop; and a cell that equals a state of the plant
when both start at rest, as the current model of the impedance law does while the drive follows its command.

A loop of different rates is periodic and lifted to the rate at which it repeats. The matrices of the samples of a cycle
are stacked along the first axis: ``x[k+1] = A[j] x[k] + B[j] w[k]`` with j = k modulo the length of the cycle. From
cycle to cycle the state is multiplied by the monodromy matrix ``A[-1] ... A[1] A[0]``, whose eigenvalues are the exact
poles (Bittanti, Colaneri, Periodic Systems, 2009).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.linear_plant import POSITION, VELOCITY, Felt
from emps_design.control.margins import LOOP_NAMES, Margins
from emps_design.errors import InputError
from emps_design.laws import law_of
from emps_design.laws.linear import LinearLaw, linear_law

if TYPE_CHECKING:
    import control

MOST_GAIN = 1e4  # above this a gain margin is unbounded
_NEAR = 30.0  # samples; up to this delay every tenth of a sample is tried
_TURNS, _FACTORS = np.radians(np.arange(1.0, 181.0)), np.geomspace(1.0, MOST_GAIN, 241)[1:]

AT_ONCE = 100_000  # systems solved together
ROUNDING = 32.0 * np.finfo(float).eps  # relative error of a coefficient

MARGINAL = 1e-9  # a pole this close to the unit circle counts as on it, so that rounding decides no verdict
SAME = 1e-9  # relative difference of the coefficients of two equal states
OUTPUTS = ("velocity", "mean_velocity", "force", "voltage")
_REFERENCE, _FORCE, _MORE = range(3)


def monodromy(A: np.ndarray) -> np.ndarray:
    """The product ``A[-1] ... A[0]`` (..., n, n) of the matrices (cycle, ..., n, n).

    >>> monodromy(np.array([[[0.5]], [[3.0]]])).tolist()
    [[1.5]]
    """
    product = A[0]
    for matrix in A[1:]:
        product = matrix @ product
    return product


def lifted(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return one step for a whole cycle, with the inputs and outputs of all its samples concatenated.

    (c, n, n), (c, n, i), (c, o, n), (c, o, i) -> (n, n), (n, c i), (c o, n), (c o, c i).
    """
    cycle, size, count = B.shape
    state, driven = np.eye(size), np.zeros((size, cycle * count))
    outputs, through = [], []
    for j in range(cycle):
        own = slice(j * count, (j + 1) * count)
        outputs.append(C[j] @ state)
        feedthrough = C[j] @ driven
        feedthrough[:, own] += D[j]
        through.append(feedthrough)
        state, driven = A[j] @ state, A[j] @ driven
        driven[:, own] += B[j]
    return state, driven, np.concatenate(outputs), np.concatenate(through)


def response(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the response at the input frequency, the mean over a cycle; ``angle`` (f,) [rad] per sample.

    (c, n, n), (c, n), (c, n), (c,), (f,) -> (f,). The aliases that the output contains too are left out.
    """
    cycle, size = b.shape
    turn = np.exp(1j * angle)[:, None, None]
    forth = turn ** np.arange(cycle + 1)[:, None, None, None]  # the input, sample by sample
    driven = np.zeros((angle.size, size, 1), dtype=complex)
    for j in range(cycle):
        driven = A[j] @ driven + b[j][:, None] * forth[j]
    x = np.linalg.solve(forth[cycle] * np.eye(size) - monodromy(A), driven)
    total = np.zeros((angle.size, 1, 1), dtype=complex)
    for j in range(cycle):
        total += (c[j][None] @ x + d[j] * forth[j]) / forth[j]
        x = A[j] @ x + b[j][:, None] * forth[j]
    return total.ravel() / cycle


def margins(
    opened: np.ndarray, column: np.ndarray, row: np.ndarray, period: float, delayed: Callable[[float], float] | None
) -> Margins:
    """Return the margins at one place of a periodic loop, from the poles of the loop closed with a factor there.

    ``opened`` (c, n, n), ``column`` (c, n) and ``row`` (c, n) are the loop broken at that place; ``period`` [s] of a
    sample. The factor exp(-j phi) that moves a pole to the unit circle gives the phase margin, a real one the gain
    margin; ``delayed(delay)`` is the largest modulus of the poles with an additional ``delay`` [s] at that place;
    without it there is no delay margin.
    """

    def radii(factors: np.ndarray) -> np.ndarray:
        return monodromy_radii(opened, column, row, factors)

    if radii(np.ones(1))[0] > 1.0 + 1e-9:
        return Margins(stable=False, period=period)
    phase = _first(lambda turns: radii(np.exp(-1j * turns)), 0.0, _TURNS)
    gain = _first(radii, 1.0, _FACTORS)
    less = _first(lambda factors: radii(1.0 / factors), 1.0, _FACTORS)
    delay = None
    if phase is not None and delayed is not None:
        each = np.vectorize(delayed, otypes=[float])
        near = _first(each, 0.0, period * np.arange(0.1, _NEAR, 0.1), at_once=1)
        delay = near if near is not None else _late_delay(opened, column, row, period)
    return Margins(
        stable=True,
        phase_margin_deg=None if phase is None else math.degrees(phase),
        delay_margin=delay,
        gain_margin=gain,
        gain_reduction_margin=None if less is None else 1.0 / less,
        period=period,
    )


def _late_delay(opened: np.ndarray, column: np.ndarray, row: np.ndarray, period: float) -> float | None:
    """Return the least delay [s] that moves a pole to the unit circle, for delays much longer than a cycle.

    A delay of m cycles shifts the phase of the loop by m theta at a pole exp(j theta): if the loop closed with
    exp(-j phi) has that pole, the least delay is phi / theta cycles. Between whole cycles the formula is a good
    approximation for slow loops.
    """
    from scipy.optimize import brentq

    def poles(turn: float) -> np.ndarray:
        closed = opened + np.exp(-1j * turn) * column[..., :, None] * row[..., None, :]
        return np.linalg.eigvals(monodromy(closed))

    def out(turn: float) -> int:
        return int(np.sum(np.abs(poles(turn)) > 1.0 + 1e-9))

    around = np.linspace(0.0, 2.0 * math.pi, 721)
    counts = [out(turn) for turn in around]
    delays = []
    for i in np.flatnonzero(np.diff(counts)):
        between = 0.5 * (counts[i] + counts[i + 1])
        turn = brentq(lambda turn, between=between: out(turn) - between, around[i], around[i + 1])
        z = poles(turn)
        angle = float(np.angle(z[np.argmin(np.abs(np.abs(z) - 1.0))]))
        if angle > 0.0:
            delays.append(turn / angle * len(opened) * period)
    return min(delays, default=None)


def monodromy_radii(opened: np.ndarray, column: np.ndarray, row: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Largest moduli (m,) of the poles of the loop closed with each of ``factors`` (m,) at the break."""
    added = column[..., :, None] * row[..., None, :]
    closed = opened[:, None] + factors[:, None, None] * added[:, None]
    return np.abs(np.linalg.eigvals(monodromy(closed))).max(axis=-1)


def _first(radii: Callable[[np.ndarray], np.ndarray], low: float, tried: np.ndarray, at_once: int = 20) -> float | None:
    """Return the first number above ``low`` at which a pole leaves the unit circle, None if none up to the last does.

    ``radii(numbers)`` is the largest modulus of the poles at each; it gets ``at_once`` numbers of ``tried`` at a time.
    """
    from scipy.optimize import brentq

    def beyond(number: float) -> float:
        return float(radii(np.array([number]))[0]) - (1.0 + 1e-9)

    for start in range(0, tried.size, at_once):
        out = np.flatnonzero(radii(tried[start : start + at_once]) > 1.0 + 1e-9)
        if out.size:
            place = start + int(out[0])
            low, high = float(tried[place - 1]) if place else low, float(tried[place])
            return brentq(beyond, low, high, xtol=1e-15 * high, rtol=1e-14)
    return None


def transfer(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: Any, z: np.ndarray) -> np.ndarray:
    """Return ``c (z I - A)^-1 b + d`` at ``z`` of any shape: (..., n, n), (..., n), (..., n), (...) -> (..., *z.shape).

    >>> delay = transfer(np.zeros((1, 1)), np.ones(1), np.ones(1), 0.0, np.array([1j, -1.0]))
    >>> bool(np.allclose(delay, [-1j, -1.0]))
    True
    """
    if A.ndim == 2 and b.ndim == c.ndim == 1 and np.size(z) == 1:  # the fast case of a search, point by point
        state = np.linalg.solve(np.reshape(z, ()) * np.eye(b.size) - A, b)
        return np.reshape(np.sum(c * state) + d, np.shape(z))
    return transfers(A, b, c[None], np.asarray(d)[None], z)[0]


def transfers(A: np.ndarray, b: np.ndarray, C: np.ndarray, D: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return :func:`transfer` for each of several ``C`` (o, ..., n) and ``D`` (o, ...), from systems solved once."""
    if A.ndim == 3 and len(A) > 1:
        alike = _rank_one(A, b)
        if alike is not None:
            return _rank_one_transfers(A[0], b[0], *alike, C, D, z)
        if len(A) * z.size > AT_ONCE:  # split to limit memory
            half = len(A) // 2
            pieces = [transfers(A[i], b[i], C[:, i], D[:, i], z) for i in (slice(half), slice(half, None))]
            return np.concatenate(pieces, axis=1)
    states = _solved(A, b[..., None], z)[..., 0]
    responses = np.stack([np.sum(c[..., None, :] * states, axis=-1) + d[..., None] for c, d in zip(C, D, strict=True)])
    return responses.reshape(*responses.shape[:-1], *z.shape)


def _solved(A: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``(z I - A)^-1 columns`` (..., z.size, n, columns)."""
    systems = z.reshape(-1, 1, 1) * np.eye(A.shape[-1]) - A[..., None, :, :]
    wide = np.broadcast_to(columns[..., None, :, :], (*systems.shape[:-1], columns.shape[-1]))
    return np.linalg.solve(systems, wide)


def _rank_one(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a column (n,) and shares (m, n + 1) with each ``[A b]`` the first plus column times shares; else None.

    This holds for loops around one plant with laws of one output that differ in the gains of that output.
    """
    tables = np.concatenate([A, b[..., None]], axis=-1)
    apart = tables - tables[0]
    system, row, place = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
    column = apart[system, :, place]
    if column[row] == 0.0:
        return column, apart[:, row]
    shares = apart[:, row] / column[row]
    residual = np.abs(apart - column[:, None] * shares[:, None, :])
    return (column, shares) if np.all(residual <= ROUNDING * (np.abs(tables) + np.abs(tables[0]))) else None


def _rank_one_transfers(A: Any, b: Any, column: Any, shares: Any, C: Any, D: Any, z: np.ndarray) -> np.ndarray:
    """Transfer functions of systems that are :func:`_rank_one`, by the Sherman-Morrison formula."""
    first, moved = np.moveaxis(_solved(A, np.column_stack([b, column]), z), -1, 0)
    rows = shares[:, :-1]
    back = (shares[:, -1:] + rows @ first.T) / (1.0 - rows @ moved.T)
    responses = np.stack([c @ first.T + (c @ moved.T) * back + d[..., None] for c, d in zip(C, D, strict=True)])
    return responses.reshape(*responses.shape[:-1], *z.shape)


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

    @cached_property
    def _eigenvalues(self) -> np.ndarray:
        return np.linalg.eigvals(self.A if self.cycle == 1 else monodromy(self.A))

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
        return transfer(*matrices, np.exp(1j * angle)) if self.cycle == 1 else response(*matrices, angle)

    def admittance(self, w: np.ndarray) -> np.ndarray:
        """Mean velocity over held force at ``w`` (f,) [rad/s], shape (..., f) [m/s/N]."""
        return self.response(w)

    def loop_gain(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input, which must be among the inputs, at ``w`` [rad/s], (..., *w.shape)."""
        opened, column, row = self.opened
        if self.cycle > 1:
            raise InputError(
                f"loop gain: found loops of different rates, the same again after {self.cycle} samples, expected one "
                "rate; nested_loops has the margins of such a law"
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
        samples = [(self.A, self.B, self.C, self.D)]
        if self.cycle > 1:
            samples = list(zip(self.A, self.B, self.C, self.D, strict=True))
        size, count = self.A.shape[-1], len(samples)
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

        matrices, inputs, outputs = (self.A, self.B, self.C, self.D), list(self.inputs), list(OUTPUTS)
        if self.cycle > 1:
            matrices = lifted(*matrices)
            inputs, outputs = ([f"{n}[{k}]" for k in range(self.cycle) for n in names] for names in (inputs, outputs))
        return control.ss(*matrices, self.cycle * self.period, inputs=inputs, outputs=outputs, name="loop")

    def to_tf(self, output: str = "mean_velocity", by: str = "force") -> control.TransferFunction:
        """The transfer function in z from the input ``by`` to ``output``."""
        import control

        if self.cycle > 1:
            raise InputError("transfer function: found loops of different rates, which have none; take to_ss()")
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
    ``voltage``, which a current model in the law does not see. ``keep_position`` keeps the position among the states,
    of which those of the plant come first. Leading axes of ``plant`` and ``law`` broadcast.

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

    def computed(own: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Rows (..., size + inputs) of a quantity that the law computes from its memory and its inputs."""
        rows = by[..., 1, None] * encoder + by[..., 2, None] * read
        rows[..., memory:past] += own
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
    for place, kept in ((past, arriving[:history]), (late, [reading, *past_f][:sensor_delay])):
        for i, row in enumerate(kept):
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
    """Close the loop of the controller of ``axis``, a user's own too; effects are linearised at ``velocity`` [m/s].

    Raises :class:`~emps_design.errors.AxisError` if it has none. The plant input is among the loop's inputs.

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
    """Return ``keep`` without ``cells`` that equal another state from rest on; their columns are added to its own."""
    while (pair := _repetition(rows, keep, cells)) is not None:
        cell, other = pair
        for table in (rows, out):
            table[..., other] += table[..., cell]
        keep = [i for i in keep if i != cell]
    return keep


def _repetition(rows: np.ndarray, keep: list[int], cells: range) -> tuple[int, int] | None:
    """Return the first of the ``cells`` that stays equal to another state once it is equal, and that state, or None."""
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
    """Return poles (..., n) sorted by falling modulus, then by imaginary part, for a reproducible order."""
    poles = np.asarray(poles, dtype=complex)
    return np.take_along_axis(poles, np.lexsort((-poles.imag, -np.round(np.abs(poles), 12)), axis=-1), axis=-1)
