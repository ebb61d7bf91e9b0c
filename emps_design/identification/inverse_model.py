"""The inverse dynamic model as a linear regression: equations (5), (12)-(17) of the paper, with (15) corrected.

``G_tau u = M qdd + F_v qd + F_c sign(qd) + offset`` (symmetric) or with both friction parameters by sign of the
velocity (asymmetric). Columns are built at the record's rate and then brought to the regression's rate one by one.

Least squares, instruments and output error all start from a :class:`Regression`, each at a cut-off of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.effects.terms import BENT, HIGHEST, LOWEST, POWER
from emps_design.errors import InputError, RankError
from emps_design.identification.chains import Filtered, filter_record
from emps_design.identification.filters import BLOCK
from emps_design.identification.model import Model, powered
from emps_design.messages import Message, warning
from emps_design.observer import acting_voltage, left_out
from emps_design.records import Record
from emps_design.units import LINEAR, Units

# Columns of unit length are dependent where their smallest singular value is below this share of the largest.
RANK_TOLERANCE = 1e-7
NO_FORCE = 1e-6  # of the residual: a smaller force is the filter's ringing after the motor was switched off


def regression(filtered: Filtered, model: str | Model) -> tuple[np.ndarray, np.ndarray]:
    """W (n, p) and Y (n,) of (5) at the regression's rate; Y includes a measured external force (21).

    Unused rows (``filtered.used``) are zero, so that the others keep their distance in time.
    """
    model = Model.of(model)
    # Column by column: memory is allocated when a column is written.
    W = np.empty((len(filtered.used), len(model.names)), order="F")
    for i, column in enumerate(model.columns(filtered.motion)):
        np.multiply(filtered.reduce(column), filtered.used, out=W[:, i])
        del column  # before the next one is made
    force = filtered.force if filtered.f_ext is None else filtered.force + filtered.f_ext
    return W, force * filtered.used


@dataclass(frozen=True)
class LeastSquares:
    """Least-squares solution of Y = W X + e, with the statistics of (13)-(16).

    ``value`` and ``std`` (p,), ``covariance`` (p, p) by (15), corrected to ``s^2 (W^T W)^-1``; ``residual`` (n,) [N].
    """

    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray = field(repr=False)
    rms_error: float
    relative_error_percent: float
    condition_number: float

    @classmethod
    def of(
        cls, names: tuple[str, ...], value: np.ndarray, spread: np.ndarray, residual: np.ndarray, force: np.ndarray,
        rows: int, condition_number: float,
    ) -> LeastSquares:  # fmt: skip
        """The solution ``value`` (p,) from ``rows`` rows of ``force`` (n,); ``spread`` (p, p) times (14) is (15)."""
        square = float(residual @ residual)
        return cls(
            names, value, square / (rows - len(names)) * spread, residual, float(np.sqrt(square / rows)),
            relative_error(residual, force), condition_number,
        )  # fmt: skip

    @property
    def std(self) -> np.ndarray:
        """One standard deviation by (15), for errors that are independent from sample to sample."""
        return np.sqrt(np.diag(self.covariance))


def least_squares(
    W: np.ndarray, Y: np.ndarray, names: tuple[str, ...], used: np.ndarray | None = None, units: Units = LINEAR
) -> LeastSquares:
    """Solve (17) by least squares; :class:`RankError` names linearly dependent columns, in the words of ``units``.

    ``used`` (n,) marks the rows that count; the others are zero.

    >>> fit = least_squares(np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), np.array([1.0, 3.0, 5.0]), ("a", "b"))
    >>> fit.value.round(6).tolist()
    [1.0, 2.0]
    """
    n, p = (len(W) if used is None else int(used.sum())), W.shape[1]
    if n <= p:
        raise InputError(f"regression: found {n} rows for {p} parameters, expected more; make a longer record")
    r = _triangle(W, Y)
    r, target = r[:p, :p], r[:p, p]
    check_rank(r, names, units)
    value = np.linalg.solve(r, target)
    inverse = np.linalg.inv(r)
    return LeastSquares.of(names, value, inverse @ inverse.T, Y - W @ value, Y, n, float(np.linalg.cond(r)))


def _triangle(W: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Triangular factor of ``[W Y]``, block by block of rows, so that Q is never in memory."""
    r = np.zeros((0, W.shape[1] + 1))
    for start in range(0, len(W), BLOCK):
        block = slice(start, start + BLOCK)
        # An array in this mode; numpy's annotation covers the other modes too.
        r = np.asarray(np.linalg.qr(np.vstack([r, np.column_stack([W[block], Y[block]])]), mode="r"))
    return r


def relative_error(residual: np.ndarray, force: np.ndarray) -> float:
    """100 ||residual|| / ||force|| [%]; NaN where the force is negligible beside the residual (motor off).

    >>> relative_error(np.ones(4), np.full(4, 2.0)), relative_error(np.ones(4), np.full(4, 1e-60))
    (50.0, nan)
    """
    error, norm = float(np.linalg.norm(residual)), float(np.linalg.norm(force))
    return 100.0 * error / norm if norm > NO_FORCE * error else float("nan")


def check_rank(W: np.ndarray, names: tuple[str, ...], units: Units = LINEAR) -> None:
    """Raise :class:`RankError`, which names the linearly dependent columns of ``W`` or of its triangular factor.

    >>> W = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0]])
    >>> check_rank(W, ("coulomb", "constant_force"))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.RankError: the record does not separate: coulomb, constant_force; record motion that ...
    """
    length = np.linalg.norm(W, axis=0)
    empty = tuple(name for name, size in zip(names, length, strict=True) if size == 0)
    if empty:
        raise RankError(
            f"the record does not excite: {', '.join(map(units.word, empty))}; record motion in both directions, with "
            "acceleration",
            empty,
        )
    _, singular, right = np.linalg.svd(np.linalg.qr(W / length, mode="r"))
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        tied = tuple(name for name, weight in zip(names, np.abs(right[-1]), strict=True) if weight > 0.05)
        raise RankError(
            f"the record does not separate: {', '.join(map(units.word, tied))}; record motion that reverses, at "
            "several speeds, with acceleration, or leave one of them out",
            tied,
        )


def notes(axis: Axis, simulated: bool = False) -> list[Message]:
    """Messages on how the identification treats the effects of ``axis``, one line each.

    ``simulated``: the estimator simulates all effects and needs no regressor for them.

    >>> from emps_design.machines import machine
    >>> notes(machine("emps2019"))
    []
    """
    messages = []
    _, rest = acting_voltage(axis, np.zeros(1))
    unused = () if simulated else left_out(rest)["offline"]
    taken = [entry.kind for entry in axis.effects if entry.kind not in unused]
    if taken:
        text = f"taken as known from {axis.name}, and kept in the identified axis: {', '.join(taken)}"
        messages.append(warning("effects-known", text, effects=taken))
    if unused:
        force, mass = axis.units.word("force"), axis.units.word("mass")
        text = (
            f"not in the regression, since their {force} does not follow from the motion: {', '.join(unused)}; they "
            f"bias {mass} and friction; output error (oe) simulates them"
        )
        messages.append(warning("effects-left-out", text, effects=unused))
    own = [entry.kind for entry in axis.effects if any(p.per_record for p in entry.effect.parameters)]
    if own:
        text = (
            f"valid only if the axis was identified from this record, because of their phase or time: {', '.join(own)}"
        )
        messages.append(warning("effects-of-one-record", text, effects=own))
    return messages


@dataclass(frozen=True)
class Regression:
    """``Y = W X + e`` of one record: ``W`` (n, p), ``Y`` (n,) [N], zero in unused rows.

    ``axis`` gives the drive and the known effects; ``filtered`` is the record after its filter chain, without the
    motion that W was made of. ``model`` is linearised around its point: for a nonlinear parameter the solution X is
    the difference from that point.
    """

    record: Record
    axis: Axis
    model: Model
    filtered: Filtered
    W: np.ndarray = field(repr=False)
    Y: np.ndarray = field(repr=False)

    @classmethod
    def of(
        cls, record: Record, axis: Axis, model: str | Model, chain: str = "hold", cutoff: float | None = None
    ) -> Regression:
        """The regression of ``record`` after a ``chain`` of filters with ``cutoff`` [Hz] (None: the chain's own).

        A nonlinear ``model`` without a point is linearised around its solution. Raises :class:`RecordError` where the
        filter leaves too few rows.

        >>> from emps_design.machines import machine
        >>> from emps_design.simulation.synthetic import synthetic_record
        >>> axis = machine("emps2019")
        >>> problem = Regression.of(synthetic_record(axis, laps=1), axis, "symmetric", cutoff=40.0)
        >>> problem.names[0], round(problem.solved().value[0])
        ('mass', 95)
        """
        filtered = filter_record(record, axis, chain, cutoff)
        model = settled(filtered, Model.of(model))
        W, Y = regression(filtered, model)
        return cls(record, axis, model, filtered.without_motion(), W, Y)

    def alike(self, record: Record) -> Regression:
        """The regression of another ``record`` of the same axis, filtered in the same way."""
        return self.of(record, self.axis, self.model, self.filtered.chain, self.filtered.cutoff_hz)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the columns."""
        return self.model.names

    @property
    def used(self) -> np.ndarray:
        """Mask (n,) of the rows that count."""
        return self.filtered.used

    def solved(self) -> LeastSquares:
        """The least-squares fit; raises :class:`RankError` for columns that the record cannot tell apart."""
        return least_squares(self.W, self.Y, self.names, self.used, self.axis.units)


def settled(filtered: Filtered, model: Model) -> Model:
    """The ``model`` linearised around its least-squares solution, where it is nonlinear and has no point yet.

    The exponent of the speed is searched; for each exponent all other parameters are linear (variable projection,
    G. Golub, V. Pereyra, 1973).
    """
    if model.point or not model.curved.any():
        return model
    if BENT in model.terms:
        rest, Y = regression(filtered, replace(model, terms=tuple(term for term in model.terms if term != BENT)))
        rest = np.delete(rest, model.names.index("viscous"), axis=1)
        basis = np.linalg.qr(rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-300))[0]

        def explained(power: float) -> float:
            column = filtered.reduce(powered(filtered.motion.v, power)) * filtered.used
            column = column - basis @ (basis.T @ column)
            return float(column @ Y) ** 2 / max(float(column @ column), 1e-300)

        best = scipy.optimize.minimize_scalar(
            lambda power: -explained(power), bounds=(LOWEST, HIGHEST), method="bounded"
        )
        model = replace(model, point={POWER.name: float(best.x)})
    W, Y = regression(filtered, model)
    return model.around(np.linalg.lstsq(W, Y, rcond=None)[0])
