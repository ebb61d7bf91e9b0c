"""The inverse dynamic model as a linear regression: equations (5), (12)-(17) of the paper, with (15) corrected.

``G_tau u = M qdd + F_v qd + F_c sign(qd) + offset`` (symmetric) or with both friction parameters by sign of the
velocity (asymmetric). Columns are built at the record's rate and then brought to the regression's rate one by one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from emps_design.effects import Motion
from emps_design.errors import InputError, RankError
from emps_design.identification.filtered import Filtered
from emps_design.identification.filters import BLOCK
from emps_design.identification.model import Model

# Columns of unit length whose smallest singular value is below this share of the largest cannot be told apart.
RANK_TOLERANCE = 1e-7
NO_FORCE = 1e-6  # of the residual: what a filter lets ring on of a motor that was switched off


def baseline_columns(motion: Motion) -> np.ndarray:
    """Columns of mass, viscous, coulomb and constant force, shape (n, 4): ``columns @ b`` is the baseline's force.

    >>> still = Motion(*(np.zeros(3) for _ in range(5)), period=1.0)
    >>> baseline_columns(still)[0].tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return np.column_stack(list(Model().columns(motion)))


def with_predicted_force(motion: Motion, baseline: np.ndarray) -> Motion:
    """Return ``motion`` with ``tau`` as the baseline array ``b`` (mass, viscous, coulomb, offset) predicts it."""
    return replace(motion, tau=baseline_columns(motion) @ np.asarray(baseline, dtype=float))


def regression(filtered: Filtered, model: str | Model) -> tuple[np.ndarray, np.ndarray]:
    """W (n, p) and Y (n,) of (5) at the regression's rate; Y holds the external force where one was measured (21).

    Rows that take no part (``filtered.used``) are zero, so that the rest keep their distance in time.
    """
    model = Model.of(model)
    # By columns: a long record's memory is taken when a column is written.
    W = np.empty((len(filtered.used), len(model.names)), order="F")
    for i, column in enumerate(model.columns(filtered.motion)):
        np.multiply(filtered.reduce(column), filtered.used, out=W[:, i])
        del column  # before the next one is made
    force = filtered.force if filtered.f_ext is None else filtered.force + filtered.f_ext
    return W, force * filtered.used


@dataclass(frozen=True)
class LeastSquares:
    """Least-squares solution of Y = W X + e, with the statistics of (13)-(16).

    ``value`` and ``std`` (p,), ``covariance`` (p, p) by (15) as it must read, ``s^2 (W^T W)^-1``;
    ``residual`` (n,) [N].
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
        """The solution ``value`` (p,) from so many ``rows`` of ``force`` (n,); ``spread`` (p, p) times (14) is (15)."""
        square = float(residual @ residual)
        return cls(
            names, value, square / (rows - len(names)) * spread, residual, float(np.sqrt(square / rows)),
            relative_error(residual, force), condition_number,
        )  # fmt: skip

    @property
    def std(self) -> np.ndarray:
        """One standard deviation by (15), for errors that are independent from sample to sample."""
        return np.sqrt(np.diag(self.covariance))


def least_squares(W: np.ndarray, Y: np.ndarray, names: tuple[str, ...], used: np.ndarray | None = None) -> LeastSquares:
    """Solve (17) by least squares; :class:`RankError` names columns that cannot be told apart.

    ``used`` (n,) counts the rows that take part, the others being zero.

    >>> fit = least_squares(np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), np.array([1.0, 3.0, 5.0]), ("a", "b"))
    >>> fit.value.round(6).tolist()
    [1.0, 2.0]
    """
    n, p = (len(W) if used is None else int(used.sum())), W.shape[1]
    if n <= p:
        raise InputError(f"regression: found {n} rows for {p} parameters, expected more; record longer")
    r = _triangle(W, Y)
    r, target = r[:p, :p], r[:p, p]
    check_rank(r, names)
    value = np.linalg.solve(r, target)
    inverse = np.linalg.inv(r)
    return LeastSquares.of(names, value, inverse @ inverse.T, Y - W @ value, Y, n, float(np.linalg.cond(r)))


def _triangle(W: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Triangular factor of ``[W Y]``, a block of rows at a time: a long record's Q is never in memory."""
    r = np.zeros((0, W.shape[1] + 1))
    for start in range(0, len(W), BLOCK):
        block = slice(start, start + BLOCK)
        # An array by this mode; numpy's annotations have what the other modes return.
        r = np.asarray(np.linalg.qr(np.vstack([r, np.column_stack([W[block], Y[block]])]), mode="r"))
    return r


def relative_error(residual: np.ndarray, force: np.ndarray) -> float:
    """100 ||residual|| / ||force|| [%]; NaN where the force is nothing beside the residual, as of a motor at rest.

    >>> relative_error(np.ones(4), np.full(4, 2.0)), relative_error(np.ones(4), np.full(4, 1e-60))
    (50.0, nan)
    """
    error, norm = float(np.linalg.norm(residual)), float(np.linalg.norm(force))
    return 100.0 * error / norm if norm > NO_FORCE * error else float("nan")


def check_rank(W: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise :class:`RankError` naming the columns of ``W``, or of its triangular factor, that a relation ties together.

    >>> W = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0]])
    >>> check_rank(W, ("coulomb", "constant_force"))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.RankError: the record cannot tell apart: coulomb, constant_force; record motion that ...
    """
    length = np.linalg.norm(W, axis=0)
    empty = tuple(name for name, size in zip(names, length, strict=True) if size == 0)
    if empty:
        raise RankError(
            f"the record does not excite: {', '.join(empty)}; record motion in both directions, with acceleration",
            empty,
        )
    _, singular, right = np.linalg.svd(np.linalg.qr(W / length, mode="r"))
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        tied = tuple(name for name, weight in zip(names, np.abs(right[-1]), strict=True) if weight > 0.05)
        raise RankError(
            f"the record cannot tell apart: {', '.join(tied)}; record motion that reverses, at several speeds, with "
            "acceleration, or leave one of them out",
            tied,
        )
