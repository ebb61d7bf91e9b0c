"""The one sampled loop: any law around any plant, with hold, delays, current loop, effects, environment and sensor.

A law in its linear form and a plant discretised exactly make one state-space system,

    s[k+1] = A s[k] + B w[k],    y[k] = C s[k] + D w[k].

Stability is read from its poles first; an unstable loop has no margins. Three things are taken out of the state: where
the carriage is, if nothing asks for it (its pole at 1 would be there in every free loop); a memory cell of the law that
nothing drives or nothing hears, such as that of a position loop where there is none; and a cell that repeats a state of
the plant from rest on, as the model of the current loop in the impedance law does while the drive follows its command.

A loop that repeats after some samples, as one of different rates does: lifted to the rate at which it repeats.

Matrices of the samples of a cycle stand along the first axis: ``x[k+1] = A[j] x[k] + B[j] w[k]`` with j = k modulo the
length of the cycle. From cycle to cycle the state moves by the monodromy ``A[-1] ... A[1] A[0]``, whose eigenvalues are
the exact poles (Bittanti, Colaneri, Periodic Systems, 2009).

The transfer function of a sampled system in state space, at points of the z plane.
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
from emps_design.control.margins import Margins
from emps_design.errors import InputError
from emps_design.laws import law_of
from emps_design.laws.linear import LinearLaw, linear_law

if TYPE_CHECKING:
    import control

MOST_GAIN = 1e4  # above this a gain margin is unbounded
_NEAR = 30.0  # samples of delay up to which every tenth of one is tried
_TURNS, _FACTORS = np.radians(np.arange(1.0, 181.0)), np.geomspace(1.0, MOST_GAIN, 241)[1:]

AT_ONCE = 100_000  # systems solved together
ROUNDING = 32.0 * np.finfo(float).eps  # share of its size by which a coefficient is not known

MARGINAL = 1e-9  # a pole this close to the unit circle is on it: rounding decides no verdict
SAME = 1e-9  # share of its own coefficients by which a state and its repetition may differ
OUTPUTS = ("velocity", "mean_velocity", "force", "voltage")
_REFERENCE, _FORCE, _MORE = range(3)


def monodromy(A: np.ndarray) -> np.ndarray:
    """The product ``A[-1] ... A[0]`` (..., n, n) of the matrices (cycle, ..., n, n).

    >>> monodromy(np.array([[[0.5]], [[3.0]]])).tolist()
    [[1.5]]
    """
    product = A[0]
    for one in A[1:]:
        product = one @ product
    return product


def lifted(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One step for a whole cycle, with inputs and outputs of all its samples end to end.

    (c, n, n), (c, n, i), (c, o, n), (c, o, i) -> (n, n), (n, c i), (c o, n), (c o, c i).
    """
    cycle, size, count = B.shape
    state, driven = np.eye(size), np.zeros((size, cycle * count))
    outputs, through = [], []
    for j in range(cycle):
        own = slice(j * count, (j + 1) * count)
        outputs.append(C[j] @ state)
        heard = C[j] @ driven
        heard[:, own] += D[j]
        through.append(heard)
        state, driven = A[j] @ state, A[j] @ driven
        driven[:, own] += B[j]
    return state, driven, np.concatenate(outputs), np.concatenate(through)


def response(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """What comes out at the frequency that goes in (f,), the mean over a cycle; ``angle`` (f,) [rad] by sample.

    (c, n, n), (c, n), (c, n), (c,), (f,) -> (f,). Other frequencies come out too, the aliases of it.
    """
    cycle, size = b.shape
    turn = np.exp(1j * angle)[:, None, None]
    forth = turn ** np.arange(cycle + 1)[:, None, None, None]  # what goes in, sample by sample
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
    """Margins at one place of a periodic loop, from the poles of the loop closed with a factor there.

    ``opened`` (c, n, n), ``column`` (c, n) and ``row`` (c, n) are the loop broken at that place; ``period`` [s] of a
    sample. A factor exp(-j phi) that brings a pole to the unit circle is the phase margin, a real one the gain margin;
    ``delayed(delay)`` is the largest modulus of the poles with a ``delay`` [s] more at that place; without it there is
    no delay margin.
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
    """The least delay [s] of whole cycles, and parts of one, that brings a pole to the unit circle.

    A delay of m cycles turns all that comes back in a cycle alike, by m theta at a pole exp(j theta): where the loop
    closed with exp(-j phi) has that pole, the least delay is phi / theta cycles. Between whole cycles the formula is
    good far above the length of one, where the loop is slow.
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
        found = poles(turn)
        angle = float(np.angle(found[np.argmin(np.abs(np.abs(found) - 1.0))]))
        if angle > 0.0:
            delays.append(turn / angle * len(opened) * period)
    return min(delays, default=None)


def monodromy_radii(opened: np.ndarray, column: np.ndarray, row: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Largest moduli (m,) of the poles of the loop closed with each of ``factors`` (m,) where it is broken."""
    added = column[..., :, None] * row[..., None, :]
    closed = opened[:, None] + factors[:, None, None] * added[:, None]
    return np.abs(np.linalg.eigvals(monodromy(closed))).max(axis=-1)


def _first(radii: Callable[[np.ndarray], np.ndarray], low: float, tried: np.ndarray, at_once: int = 20) -> float | None:
    """The first number above ``low`` at which a pole leaves the unit circle, None up to the last one ``tried``.

    ``radii`` has the largest modulus of the poles at each of several numbers; it is asked for so many ``at_once``.
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
    if A.ndim == 2 and b.ndim == c.ndim == 1 and np.size(z) == 1:  # a search goes from point to point
        state = np.linalg.solve(np.reshape(z, ()) * np.eye(b.size) - A, b)
        return np.reshape(np.sum(c * state) + d, np.shape(z))
    return transfers(A, b, c[None], np.asarray(d)[None], z)[0]


def transfers(A: np.ndarray, b: np.ndarray, C: np.ndarray, D: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return :func:`transfer` for each of several ``C`` (o, ..., n) and ``D`` (o, ...), from systems solved once."""
    if A.ndim == 3 and len(A) > 1:
        alike = _alike(A, b)
        if alike is not None:
            return _of_alike(A[0], b[0], *alike, C, D, z)
        if len(A) * z.size > AT_ONCE:  # in pieces that fit into memory
            half = len(A) // 2
            pieces = [transfers(A[i], b[i], C[:, i], D[:, i], z) for i in (slice(half), slice(half, None))]
            return np.concatenate(pieces, axis=1)
    states = _solved(A, b[..., None], z)[..., 0]
    found = np.stack([np.sum(c[..., None, :] * states, axis=-1) + d[..., None] for c, d in zip(C, D, strict=True)])
    return found.reshape(*found.shape[:-1], *z.shape)


def _solved(A: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """``(z I - A)^-1 columns`` (..., z.size, n, columns)."""
    systems = z.reshape(-1, 1, 1) * np.eye(A.shape[-1]) - A[..., None, :, :]
    wide = np.broadcast_to(columns[..., None, :, :], (*systems.shape[:-1], columns.shape[-1]))
    return np.linalg.solve(systems, wide)


def _alike(A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A column (n,) and shares (m, n + 1): each ``[A b]`` is the first one plus the column times its shares; else None.

    So it is in loops around one plant whose laws, of one output each, differ in what that hears.
    """
    tables = np.concatenate([A, b[..., None]], axis=-1)
    apart = tables - tables[0]
    one, row, place = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
    column = apart[one, :, place]
    if column[row] == 0.0:
        return column, apart[:, row]
    shares = apart[:, row] / column[row]
    left = np.abs(apart - column[:, None] * shares[:, None, :])
    return (column, shares) if np.all(left <= ROUNDING * (np.abs(tables) + np.abs(tables[0]))) else None


def _of_alike(A: Any, b: Any, column: Any, shares: Any, C: Any, D: Any, z: np.ndarray) -> np.ndarray:
    """The transfer functions of systems that are :func:`_alike`, by Sherman and Morrison's formula."""
    first, moved = np.moveaxis(_solved(A, np.column_stack([b, column]), z), -1, 0)
    heard = shares[:, :-1]
    back = (shares[:, -1:] + heard @ first.T) / (1.0 - heard @ moved.T)
    found = np.stack([c @ first.T + (c @ moved.T) * back + d[..., None] for c, d in zip(C, D, strict=True)])
    return found.reshape(*found.shape[:-1], *z.shape)


@dataclass(frozen=True)
class SampledLoop:
    """A closed loop at its samples; arrays may have leading axes, for many loops at once.

    ``A`` (..., n, n), ``B`` (..., n, i), ``C`` (..., 4, n), ``D`` (..., 4, i). ``inputs``: ``reference`` [m or m/s],
    ``force`` [N] from outside, held over each period so that the energy it brings in is exactly force times position
    step, and what was asked for: signals of the law, ``voltage`` [V] added at the plant input. Outputs: the true
    velocity at the sample and its mean over the period that follows [m/s], the force that the law reads [N], the
    voltage of the law [V].

    Where the law has loops of different rates all of this repeats after ``cycle`` samples: the matrices of each of them
    stand along the first axis, and poles are those of a whole cycle.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    period: float
    inputs: tuple[str, ...]
    cycle: int = 1

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles in the z plane (..., n), largest first; of ``cycle`` samples, so z is exp(s T cycle)."""
        return sorted_poles(np.linalg.eigvals(self.A if self.cycle == 1 else monodromy(self.A)))

    @property
    def radius(self) -> Any:
        """Largest modulus of the poles, by sample: a float, (...) for many loops."""
        found = np.abs(self.poles[..., 0]) ** (1.0 / self.cycle)
        return found if found.ndim else float(found)

    @property
    def stable(self) -> Any:
        """Whether no pole lies outside the unit circle, :data:`MARGINAL` left aside: a bool, (...) for many loops.

        A force that depends on position puts a pole on z = 1 that the velocity does not show, and so does an apparent
        damping of zero.
        """
        return self.radius <= 1.0 + MARGINAL

    def response(self, w: np.ndarray, output: str = "mean_velocity", by: str = "force") -> np.ndarray:
        """Frequency response from the input ``by`` to ``output`` at ``w`` (f,) [rad/s], shape (..., f)."""
        place, row, angle = self.inputs.index(by), OUTPUTS.index(output), np.asarray(w) * self.period
        one = self.A, self.B[..., place], self.C[..., row, :], self.D[..., row, place]
        return transfer(*one, np.exp(1j * angle)) if self.cycle == 1 else response(*one, angle)

    def admittance(self, w: np.ndarray) -> np.ndarray:
        """Mean velocity over held force at ``w`` (f,) [rad/s], shape (..., f) [m/s/N]."""
        return self.response(w)

    def loop_gain(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input, which has to be among the inputs, at ``w`` [rad/s], (..., *w.shape)."""
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
        return control.ss(A, column[:, None], -row[None], [[0.0]], self.period, name="loop_gain")

    def simulate(self, w: np.ndarray) -> np.ndarray:
        """Outputs (k, 4) of a single loop from rest under inputs ``w`` (k, i)."""
        w = np.asarray(w, dtype=float)
        samples = [(self.A, self.B, self.C, self.D)]
        if self.cycle > 1:
            samples = list(zip(self.A, self.B, self.C, self.D, strict=True))
        size, count = self.A.shape[-1], len(samples)
        states, found = np.zeros((len(w) + 1, size)), np.empty((len(w), len(OUTPUTS)))
        for j, (_, B, _, _) in enumerate(samples):
            states[1:][j::count] = (B @ w[j::count, :, None])[..., 0]
        # Only the state has to be gone through sample by sample.
        for k in range(len(w)):
            states[k + 1] += samples[k % count][0] @ states[k]
        for j, (_, _, C, D) in enumerate(samples):
            found[j::count] = (C @ states[:-1][j::count, :, None] + D @ w[j::count, :, None])[..., 0]
        return found

    def to_ss(self) -> control.StateSpace:
        """The loop as a discrete ``control.StateSpace`` with named inputs and outputs.

        Loops of different rates are lifted: one step is a whole ``cycle``, and each input and output is there once for
        every sample of it, ``reference[0]`` and so on.
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
        return control.ss2tf(self.to_ss()[OUTPUTS.index(output), self.inputs.index(by)])


def close(
    plant: SampledPlant,
    law: LinearLaw,
    felt: Felt | None = None,
    sensor_delay: int = 0,
    plant_input: bool = False,
    keep_position: bool = False,
) -> SampledLoop:
    """Close the loop of ``law`` around ``plant``; ``felt`` is what its force sensor reads, so many samples late.

    Without ``felt`` the sensor reads the force from outside. ``plant_input`` adds the input ``voltage``, of which a
    model of the current in the law hears nothing. ``keep_position``: where the carriage is stays among the states, of
    which those of the plant come first. Leading axes of ``plant`` and ``law`` broadcast.

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
    split, heard = bool(np.any(plant.G1)), bool(np.any(felt.voltage))
    history = plant.delay + (1 if split or heard else 0)
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
    if heard:  # the voltage that acted until now
        reading[..., past + plant.delay] += felt.voltage
    read = past_f[-1] if sensor_delay else reading

    def computed(own: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Rows (..., size + inputs) of what the law computes from its memory and from its inputs."""
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
    if free:  # the memory counted from where the carriage is
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
    """Close the loop of the controller that ``axis`` has, a user's own too; effects linearised at ``velocity`` [m/s].

    Raises :class:`~emps_design.errors.AxisError` where it has none. The plant input is among the loop's inputs.

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
    """``keep`` without those ``cells`` that repeat another state from rest on; their columns are added to its own."""
    while (found := _repetition(rows, keep, cells)) is not None:
        cell, other = found
        for table in (rows, out):
            table[..., other] += table[..., cell]
        keep = [i for i in keep if i != cell]
    return keep


def _repetition(rows: np.ndarray, keep: list[int], cells: range) -> tuple[int, int] | None:
    """The first of the ``cells`` that goes on as another state does wherever the two are equal, and that state."""
    mine, others = [one for one in keep if one in cells], [one for one in keep if one not in cells]
    if not mine or not others:
        return None
    columns = np.array([*keep, *range(rows.shape[-2], rows.shape[-1])])
    own, rest = rows[..., mine, :], rows[..., others, :]
    gap = rest[..., None, :, :] - own[..., :, None, :]
    cell, other = np.ix_(range(len(mine)), range(len(others)))
    to_own, to_other = gap[..., cell, other, np.array(mine)[:, None]], gap[..., cell, other, np.array(others)]
    aside = (columns == np.array(mine)[:, None, None]) | (columns == np.array(others)[None, :, None])
    scale = SAME * np.abs(own).max(axis=-1)[..., None]
    alike = np.all((np.abs(gap[..., columns]) <= scale[..., None]) | aside, axis=-1)
    alike &= np.abs(to_own + to_other) <= scale
    pairs = np.argwhere(np.all(alike.reshape(-1, len(mine), len(others)), axis=0))
    return (mine[pairs[0, 0]], others[pairs[0, 1]]) if len(pairs) else None


def sorted_poles(poles: np.ndarray) -> np.ndarray:
    """Poles (..., n) by falling modulus, then by imaginary part, so that the same loop prints the same list."""
    poles = np.asarray(poles, dtype=complex)
    return np.take_along_axis(poles, np.lexsort((-poles.imag, -np.round(np.abs(poles), 12)), axis=-1), axis=-1)
