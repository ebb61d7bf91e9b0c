"""What a control law is: a difference equation, its parameters, and what joins them.

The kernel *is* the law, in plain Python of numbers, computed once a sample:

    ``u = kernel(k, reference, q, f_ext, limit, gains, memory)``

``k`` counts samples from 0; ``reference`` is what the law follows, one of ``FOLLOWS`` [m or m/s]; ``q`` [m] is what the
encoder reports, ``f_ext`` [N] what a force sensor on the carriage reports; ``limit`` [V] bounds the voltage
``u``; ``gains`` are its numbers and ``memory`` its own, zero at first. Before the first sample the carriage stood still
at ``q[0]``. Simulations compile it; :mod:`.linear` runs it on linear numbers, which gives a loop its poles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from emps_design.errors import AxisError
from emps_design.laws.estimators import (
    BACKWARD as BACKWARD,
    TWO_TAP as TWO_TAP,
    WORDS,
    Finite as Finite,
    Group as Group,
    NonNegative as NonNegative,
    Positive as Positive,
    VelocityEstimator,
    in_words,
    parameter as parameter,
    unit_of as unit_of,
)

FOLLOWS = ("position", "velocity", "rest position")  # the last is where a spring pulls to, and no more


class FromRecord(Group):
    """A gain that the record gives: ``scale`` times its column ``record``, one number or one for each sample."""

    record: str = Field(description="name of the column", json_schema_extra={"unit": ""})
    scale: Finite = Field(1.0, description="what the column is multiplied by", json_schema_extra={"unit": ""})


NUMBER, RECORDED = "a number", "a column of the record"  # tags of the union; with a blank, as no key of a table has
Gain = Annotated[
    Annotated[Positive, Tag(NUMBER)] | Annotated[FromRecord, Tag(RECORDED)],
    Discriminator(lambda gain: RECORDED if isinstance(gain, dict | FromRecord) else NUMBER),
]


class LawTable(Group):
    """The ``[controller]`` table of one kind of law without its ``kind``; what every law has."""

    velocity_estimator: VelocityEstimator = Field(TWO_TAP, description=WORDS)


@dataclass(frozen=True)
class Law:
    """A control law with its numbers: the kernel, its ``gains``, the length of its ``memory``; the rest of its kind.

    ``gains`` (g,), or (n, g) where a record gives them sample by sample. After ``cycle`` samples the law does the same
    again: 1, but for loops of different rates. For :mod:`.linear` the gains may be a list that holds arrays (m,), of m
    laws, or symbols. With ``error_alone`` its position input is the position error, and the integral at place
    ``integral`` of its memory is held while the limit acts on the sum of law and feed-forward (None: no integral).
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

        Of a linear law this leaves out the response to its own reference (the braking of a velocity feedback, its own
        feed-forward), so that a feed-forward of the whole motion can be added. A law that follows a velocity takes the
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
        """Reference, position and force (n,) that the kernel gets, of those of the axis; no force counts as 0."""
        sensed = np.zeros(q.size) if f_ext is None else f_ext
        return (np.zeros(q.size), q - reference, sensed) if self.error_alone else (reference, q, sensed)

    def reference(self, q_ref: np.ndarray, period: float) -> np.ndarray:
        """Reference of the law (n,) [m or m/s] for the positions ``q_ref`` (n,) [m]: those, or their rate."""
        return np.diff(q_ref, prepend=q_ref[:1]) / period if self.follows == "velocity" else q_ref

    def followed(self, record: Any) -> np.ndarray:
        """Reference of the law (n,) [m or m/s] in a :class:`~emps_design.records.Record`."""
        if self.follows == "velocity" and record.velocity_reference is not None:
            return record.velocity_reference
        return self.reference(record.q_ref, record.period)


@dataclass(frozen=True)
class LawKind:
    """One kind of control law: its words, its table in the axis file, its kernel, and the numbers the kernel gets.

    ``table`` is the pydantic model of its parameters, with units, bounds and descriptions. ``gains(p, axis, period)``
    gives the kernel's numbers from a table ``p``, the :class:`~emps_design.axis.Axis` it runs on and the sampling
    ``period`` [s]; ``memory`` is the length of the kernel's memory, or a function of table and axis.
    ``equations(p, axis, period)`` are the lines to paste into a drive. ``follows`` is one of ``FOLLOWS``, or a function
    of the table, and so is ``cycle``, after how many samples the law does the same again.

    ``loops(p)`` are the loops within one another, innermost first: a name, and the table of the law up to that loop
    without feed-forward. One that follows a velocity is broken at the plant input, one that follows a position at the
    position error. ``state_feedback`` says that the kernel is ``u = gains[0] (reference - q) - gains[1] v`` and no
    more, with 1/period and whether v is the two-tap estimate behind them: fused runs compute it in its place, but for
    estimators that are a table.
    ``gain`` is the parameter (dotted where it is in a table of its own) that scales all the law answers to the motion.
    ``apparent`` says that the law gives the carriage the apparent ``mass`` and ``damping`` of its table.
    ``integral`` is the place in the memory of an integral that does not run while the limit acts, or a function of the
    table that gives it, None for none: beside a feed-forward the kernel does not see when that is.
    ``propose(reference, q, u, p, period)`` gives parameters by name with which the law makes a recorded voltage ``u``
    best (nan: not to be fitted), or None.

    Raises :class:`AxisError` for a law that follows nothing known.
    """

    name: str
    label: str
    source: str
    table: type[LawTable]
    kernel: Callable[..., float]
    gains: Callable[[Any, Any, float], Sequence[float]]
    memory: int | Callable[[Any, Any], int]
    equations: Callable[[Any, Any, float], tuple[str, ...]]
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
        """Names of the parameters that have to be given."""
        return tuple(name for name, field in self.table.model_fields.items() if field.is_required())

    def law(self, p: Any, axis: Any, period: float) -> Law:
        """The law with the numbers of the table ``p``, on ``axis``, at a sampling ``period`` [s]."""
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


def velocity_in_words(p: Any, period: float) -> str:
    """The velocity estimate of a law as a line to paste.

    >>> velocity_in_words(LawTable(velocity_estimator="backward"), 1e-3)
    'v[k] = (q[k] - q[k-1]) / 0.001'
    """
    return in_words(p.velocity_estimator, period)
