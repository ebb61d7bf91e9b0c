"""Control laws: a difference equation, its parameters, and the properties of the axis that it uses.

The kernel is the law itself, a Python function of numbers, called once per sample:

    ``u = kernel(k, reference, q, f_ext, limit, gains, memory)``

``k`` counts samples from 0; ``reference`` is the reference of the law, one of ``FOLLOWS`` [m or m/s]; ``q`` [m] is the
output of the encoder, ``f_ext`` [N] that of a force sensor on the carriage; ``limit`` [V] bounds the voltage ``u``;
``gains`` are the constants and ``memory`` the states of the law, initially zero. Before the first sample the carriage
is at rest at ``q[0]``. Simulations compile the kernel; :mod:`.linear` evaluates it with linear numbers, from which the
poles of a loop follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Generic, Protocol, TypeVar

import numpy as np
from pydantic import Discriminator, Field, Tag

from emps_design.errors import AxisError, InputError
from emps_design.laws.estimators import TWO_TAP, WORDS, VelocityEstimator, in_words
from emps_design.records import Record
from emps_design.tables import AxisEffect, AxisTable, Drive, Finite, Mechanics, Positive, Sampling

PARAMETERS = ("mass", "viscous_positive", "viscous_negative", "coulomb_positive", "coulomb_negative")
FOLLOWS = ("position", "velocity", "rest position")  # the last is the rest position of a virtual spring


class FromRecord(AxisTable):
    """A gain from the record: ``scale`` times the column ``record``, one number or one for each sample."""

    record: str = Field(description="name of the column", json_schema_extra={"unit": ""})
    scale: Finite = Field(1.0, description="factor on the column", json_schema_extra={"unit": ""})


NUMBER, RECORDED = "a number", "a column of the record"  # tags of the union; the blank separates them from table keys
Gain = Annotated[
    Annotated[Positive, Tag(NUMBER)] | Annotated[FromRecord, Tag(RECORDED)],
    Discriminator(lambda gain: RECORDED if isinstance(gain, dict | FromRecord) else NUMBER),
]


class LawTable(AxisTable):
    """The ``[controller]`` table of one kind of law without ``kind``: the parameters common to all laws."""

    velocity_estimator: VelocityEstimator = Field(TWO_TAP, description=WORDS)


class PlantTables(Protocol):
    """The part of an axis that a law may read; every :class:`~emps_design.axis.Axis` has it."""

    @property
    def mechanics(self) -> Mechanics:
        """Mass, viscous and Coulomb friction, constant force."""

    @property
    def drive(self) -> Drive:
        """From command to force."""

    @property
    def sampling(self) -> Sampling:
        """Clock and encoder."""

    @property
    def effects(self) -> Sequence[AxisEffect]:
        """The effects beyond the mechanics."""

    @property
    def damping(self) -> float:
        """Viscous friction plus braking by the back-EMF [N/(m/s)]."""


Reads = TypeVar("Reads", contravariant=True)  # the part of the axis that a kind of law reads


@dataclass(frozen=True)
class FrictionModel:
    """The vector X of equation (5): mass [kg], viscous [N/(m/s)] and Coulomb friction [N] for either direction."""

    mass: float
    viscous_positive: float
    viscous_negative: float
    coulomb_positive: float
    coulomb_negative: float

    @classmethod
    def of(cls, axis: PlantTables) -> FrictionModel:
        """X of an axis; back-EMF and effects proportional to speed add to the viscous friction.

        Other effects are not included, see :func:`left_out`.

        >>> from emps_design.machines import machine
        >>> FrictionModel.of(machine("emps2018-two-quadrant")).viscous_negative
        563.8568
        """
        m = axis.mechanics
        positive, negative = axis.damping, axis.damping
        for entry in axis.effects:
            if entry.effect.solver.slopes is not None:
                slopes = entry.effect.solver.slopes(entry.effect.values(entry.parameters))
                positive, negative = positive + float(slopes[0]), negative + float(slopes[1])
        return cls(m.mass, round(positive, 12), round(negative, 12), m.coulomb + m.offset, m.coulomb - m.offset)

    @property
    def two_quadrant(self) -> bool:
        """Whether friction differs with the direction."""
        return self.viscous_positive != self.viscous_negative or self.coulomb_positive != self.coulomb_negative

    @property
    def directions(self) -> tuple[int, ...]:
        """The directions of motion with different friction: 1 and -1, or 1 alone if friction is symmetric."""
        return (1, -1) if self.two_quadrant else (1,)

    @property
    def coulomb(self) -> tuple[float, float]:
        """Coulomb friction for motion to + and to - [N]."""
        return self.coulomb_positive, self.coulomb_negative

    @property
    def viscous(self) -> tuple[float, float]:
        """Viscous friction for motion to + and to - [N/(m/s)]."""
        return self.viscous_positive, self.viscous_negative

    def with_errors(self, errors: dict[str, Any]) -> FrictionModel:
        """Return estimates ``(1 + error)`` times these numbers; raises :class:`InputError` if one turns negative.

        ``errors`` has keys of ``PARAMETERS``, or ``viscous`` and ``coulomb`` for both directions; with arrays (m,) the
        result has the numbers of m models.

        >>> FrictionModel(100.0, 400.0, 400.0, 20.0, 20.0).with_errors({"coulomb": 0.05}).coulomb
        (21.0, 21.0)
        """
        both = {name: error for name, error in errors.items() if name in PARAMETERS}
        for name in ("viscous", "coulomb"):
            if name in errors:
                both |= {f"{name}_positive": errors[name], f"{name}_negative": errors[name]}
        for name, error in both.items():
            bad = np.extract(~(np.isfinite(error) & np.greater(error, -1.0)), error)
            if bad.size:
                raise InputError(
                    f"mismatch: found {bad[0]:g} on {name.replace('_', ' ')}, so the estimate is not positive; "
                    "expected more than -1"
                )
        return replace(self, **{name: getattr(self, name) * (1.0 + error) for name, error in both.items()})

    def array(self) -> np.ndarray:
        """The five numbers in the order of ``PARAMETERS``."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    def to_dict(self) -> dict[str, float]:
        """The five numbers by name, SI."""
        return {name: getattr(self, name) for name in PARAMETERS}


def left_out(axis: PlantTables) -> tuple[str, ...]:
    """Kinds of the effects of ``axis`` that are not in X of (5); to be named wherever the model is used."""
    return tuple(entry.kind for entry in axis.effects if entry.effect.solver.slopes is None)


@dataclass(frozen=True)
class Law:
    """A control law with its numbers: the kernel, its ``gains``, the length of its ``memory``; the rest of its kind.

    ``gains`` (g,), or (n, g) if they come from a record sample by sample. The law is periodic with ``cycle`` samples:
    1, except for loops of different rates. For :mod:`.linear` the gains may be a list that has arrays (m,), of m laws,
    or symbols. With ``error_alone`` its position input is the position error, and the integral at place ``integral`` of
    its memory is held while the limit acts on the sum of law and feed-forward (None: no integral).
    """

    kernel: Callable[..., float]
    gains: Any
    memory: int
    follows: str = "position"
    state_feedback: bool = False
    cycle: int = 1
    error_alone: bool = False
    integral: int | None = None

    def on_error(self) -> Law:
        """The law with the position error ``q`` - reference [m] as its position, and 0 as its reference.

        For a linear law this removes the response to its own reference (the damping by a velocity feedback, its own
        feed-forward), so that a feed-forward of the whole motion can be added. A law that follows a velocity gets the
        position of its reference.
        """
        return replace(self, follows="position", state_feedback=False, error_alone=True)

    def commands(
        self, reference: np.ndarray, q: np.ndarray, limit: float, f_ext: np.ndarray | None = None
    ) -> np.ndarray:
        """Command (n,) for reference, position and sensed force (n,) each, from rest; computed in Python."""
        rows, memory = self.gains.tolist(), [0.0] * self.memory
        inputs = [signal.tolist() for signal in self.inputs(reference, q, f_ext)]
        samples = enumerate(zip(*inputs, strict=True))
        by_sample = np.ndim(self.gains) == 2
        return np.array(
            [self.kernel(k, r, x, f, limit, rows[k] if by_sample else rows, memory) for k, (r, x, f) in samples]
        )

    def inputs(
        self, reference: np.ndarray, q: np.ndarray, f_ext: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reference, position and force (n,) for the kernel, from those of the axis; a missing force is 0."""
        sensed = np.zeros(q.size) if f_ext is None else f_ext
        return (np.zeros(q.size), q - reference, sensed) if self.error_alone else (reference, q, sensed)

    def reference(self, q_ref: np.ndarray, period: float) -> np.ndarray:
        """Reference of the law (n,) [m or m/s] for the positions ``q_ref`` (n,) [m]: these, or their derivative."""
        return np.diff(q_ref, prepend=q_ref[:1]) / period if self.follows == "velocity" else q_ref

    def followed(self, record: Record) -> np.ndarray:
        """Reference of the law (n,) [m or m/s] in a ``record``."""
        if self.follows == "velocity" and record.velocity_reference is not None:
            return record.velocity_reference
        return self.reference(record.q_ref, record.period)


@dataclass(frozen=True)
class LawKind(Generic[Reads]):
    """One kind of control law: its texts, its table in the axis file, its kernel, and the kernel's constants.

    ``table`` is the pydantic model of its parameters, with units, bounds and descriptions. ``gains(p, axis, period)``
    returns the kernel's constants for a table ``p``, the axis and the sampling ``period`` [s]; ``memory`` is the length
    of the kernel's memory, or a function of table and axis. Of the axis they read :class:`PlantTables`, or nothing: the
    kinds of ``LawKind[object]``, those of a velocity loop, are determined by their table alone.
    ``equations(p, axis, period)`` are the lines to paste into a drive. ``follows`` is one of ``FOLLOWS``, or a function
    of the table; so is ``cycle``, the period of the law in samples.

    ``loops(p)`` are the nested loops, innermost first: a name, and the table of the law up to that loop without
    feed-forward. A loop that follows a velocity is broken at the plant input, one that follows a position at the
    position error. ``state_feedback``: the kernel is exactly ``u = gains[0] (reference - q) - gains[1] v``, with
    1/period and whether v is the two-tap estimate after these; fused runs compute it directly, except for estimators
    that are a table.
    ``gain`` is the parameter (dotted if it is in an inner table) that scales the whole response to the motion.
    ``apparent``: the law gives the carriage the apparent ``mass`` and ``damping`` of its table.
    ``integral`` is the place in the memory of an integral that is held while the limit acts, or a function of the table
    that returns it, None for none: with a feed-forward the kernel itself does not know when the limit acts.
    ``propose(reference, q, u, p, period)`` returns parameters by name with which the law best fits a recorded voltage
    ``u`` (nan: not to be fitted), or None.

    Raises :class:`AxisError` for an unknown ``follows``.
    """

    name: str
    label: str
    source: str
    table: type[LawTable]
    kernel: Callable[..., float]
    gains: Callable[[Any, Reads, float], Sequence[float]]
    memory: int | Callable[[Any, Reads], int]
    equations: Callable[[Any, Reads, float], tuple[str, ...]]
    follows: str | Callable[[Any], str] = "position"
    cycle: int | Callable[[Any], int] = 1
    loops: Callable[[Any], tuple[tuple[str, LawTable], ...]] | None = None
    state_feedback: bool = False
    gain: str = ""
    apparent: bool = False
    integral: int | Callable[[Any], int | None] | None = None
    propose: Callable[..., dict[str, float] | None] | None = None

    def __post_init__(self) -> None:
        if not callable(self.follows) and self.follows not in FOLLOWS:
            raise AxisError(f"law {self.name}: follows {self.follows!r}, expected one of {', '.join(FOLLOWS)}")
        if not (isinstance(self.table, type) and issubclass(self.table, LawTable)):
            raise AxisError(f"law {self.name}: table {self.table!r}, expected a class derived from LawTable")

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the required parameters."""
        return tuple(name for name, field in self.table.model_fields.items() if field.is_required())

    def law(self, p: LawTable, axis: Reads, period: float) -> Law:
        """The law with the parameters of the table ``p``, on ``axis``, at a sampling ``period`` [s]."""
        gains = np.array(self.gains(p, axis, period), dtype=float)
        return Law(
            self.kernel,
            gains,
            self.memory(p, axis) if callable(self.memory) else self.memory,
            self.follows(p) if callable(self.follows) else self.follows,
            self.state_feedback and isinstance(p.velocity_estimator, str),
            self.cycle(p) if callable(self.cycle) else self.cycle,
            integral=self.integral(p) if callable(self.integral) else self.integral,
        )


def velocity_in_words(p: LawTable, period: float) -> str:
    """The velocity estimate of a law as a line to paste.

    >>> velocity_in_words(LawTable(velocity_estimator="backward"), 1e-3)
    'v[k] = (q[k] - q[k-1]) / 0.001'
    """
    return in_words(p.velocity_estimator, period)
