"""A law whose loops run at different rates around a measured plant: exact margins at the plant input.

A sine that goes into such a law comes out at all N frequencies w + 2 pi m/(N T), after which it does the same again.
Over these the plant is diagonal, from the data, and the law a matrix H(w), that of its lifted form; the open loop is
L(w) = -H(w) P(w), N by N. A factor f at the plant input leaves the loop at the edge of stability where
det(I + f L(w)) = 0, a delay where det(I + L(w)) = 0 with the delay in it. The eigenvalues of L say where to look for
these roots in the data as they are; from there they are followed into the data as drawn. What comes out at
the frequency that goes in has the sensitivity that stands on the diagonal of (I + L)^-1.

Source: S. Bittanti and P. Colaneri, Periodic Systems, Springer 2009, chapters 2 and 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.control.loop.margins import KEYS
from emps_design.control.loop.periodic import lifted
from emps_design.control.loop.transfer import transfers
from emps_design.errors import InputError
from emps_design.frequency_response.measured_plant import MeasuredPlant, stable_loops
from emps_design.laws.linear import LinearLaw

MOST = 32  # samples after which a law does the same again
TURNS = 40
FOUND = 1e-9  # of the determinant, relative to its slope


@dataclass(frozen=True, eq=False)
class SeveralRates:
    """The open loop of ``law`` around ``plant``; raises :class:`InputError` for a ``cycle`` of more than ``MOST``."""

    plant: MeasuredPlant
    law: LinearLaw

    def __post_init__(self) -> None:
        if self.law.cycle > MOST:
            raise InputError(
                f"law: found loops that are the same again after {self.law.cycle} samples, expected at most {MOST}"
            )

    @property
    def _end(self) -> float:
        """The Nyquist frequency of the slow rate [rad/s]; all others fold on frequencies below it."""
        return math.pi / (self.law.cycle * self.plant.period)

    @cached_property
    def grid(self) -> np.ndarray:
        """Frequencies [rad/s] on which those of the plant's grid fold."""
        folded = np.mod(self.plant.grid, 2.0 * self._end)
        folded = np.unique(np.minimum(folded, 2.0 * self._end - folded))
        far = folded[np.concatenate([[True], np.diff(folded) > 1e-9 * folded[1:]])]
        return far[far >= self.plant.grid[0] * (1.0 - 1e-9)]

    def _places(self, w: np.ndarray) -> np.ndarray:
        """The frequencies [rad/s] among which the law mixes ``w`` (...), negative from half of them on: (..., N)."""
        all_of_them = w[..., None] + 2.0 * self._end * np.arange(self.law.cycle)
        nyquist = math.pi / self.plant.period
        return np.where(all_of_them > nyquist, all_of_them - 2.0 * nyquist, all_of_them)

    def _law(self, w: np.ndarray) -> np.ndarray:
        """Command over position (..., N, N) between the frequencies of :meth:`_places`."""
        cycle, period = self.law.cycle, self.plant.period
        A, B, C, D = self._lifted
        several, rows = np.broadcast_to(A, (cycle, *A.shape)), np.broadcast_to(C[:, None, :], (cycle, *B.T.shape))
        samples = np.moveaxis(transfers(several, B.T, rows, D, np.exp(1j * w * cycle * period)), (0, 1), (-2, -1))
        turns = np.exp(1j * period * self._places(w)[..., None, :] * np.arange(cycle)[:, None])
        return turns.conj().swapaxes(-1, -2) @ samples @ turns / cycle

    @cached_property
    def _lifted(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        law = self.law
        return lifted(law.A, law.B[..., [1]], law.C[:, None, :], law.D[:, None, [1]])

    @cached_property
    def _law_on_grid(self) -> np.ndarray:
        return self._law(self.grid)

    def matrix(
        self, w: np.ndarray, rows: np.ndarray | int, delay: np.ndarray | float = 0.0, law: np.ndarray | None = None
    ) -> np.ndarray:
        """The open loop (..., N, N) of the ``rows`` at ``w`` (...) [rad/s], ``delay`` [s] more; ``law`` if known."""
        if law is None:
            law = self._law_on_grid if w is self.grid else self._law(w)
        places = self._places(w)
        plant = self.plant.position(np.abs(places), np.asarray(rows)[..., None], np.asarray(delay)[..., None])
        return -law * np.where(places < 0.0, plant.conj(), plant)[..., None, :]

    def margins(self) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Margins of every row as :func:`~emps_design.control.loop.margins.margin_arrays` has them, and which are
        stable."""
        count, unit = len(self.plant.rows), np.eye(self.law.cycle)
        rows = np.arange(count)
        on_grid = np.array([np.linalg.det(unit + self.matrix(self.grid, row)) - 1.0 for row in range(count)])
        found = {key: np.full(count, np.nan) for key in KEYS}
        w, value, place = self._crossings(lambda values: np.log(np.abs(values)))
        sign = np.where(place < 0.0, -1.0, 1.0)
        lag = np.mod(sign * np.angle(value) + np.pi, 2.0 * np.pi)

        # Each is a function of what is sought at frequencies, where all that does not depend on it is there already.
        def turned(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            loop = self.matrix(w, rows)
            return lambda y: np.linalg.det(unit + np.exp(-1j * sign * y)[..., None, None] * loop)

        def later(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            law = self._law(w)
            return lambda y: np.linalg.det(unit + self.matrix(w, rows, y * self.plant.period, law))

        def more(w: np.ndarray, sign: float) -> Callable[[np.ndarray], np.ndarray]:
            loop = self.matrix(w, rows)
            return lambda y: np.linalg.det(unit + np.exp(y)[..., None, None] * loop)

        for start, at, side, angle in zip(w, place, sign, lag, strict=True):
            true, phase = self._followed(turned, start, angle, side)
            self._keep(found, "phase_margin_deg", np.degrees(phase), "crossover", np.abs(at) + side * (true - start))
            _, samples = self._followed(later, start, angle / abs(at) / self.plant.period, side)
            self._keep(found, "delay_margin", self.plant.period * samples)
        w, value, place = self._crossings(lambda values: np.where(values.real < 0.0, np.sin(np.angle(values)), 1.0))
        for start, one, at in zip(w, value, place, strict=True):
            if one.real < 0.0:
                true, gain = self._followed(more, start, math.log(-1.0 / one.real), 1.0)
                self._keep_gain(found, np.exp(gain), np.abs(at) + math.copysign(1.0, at) * (true - start))
        last = np.linalg.eigvals(self.matrix(np.full(count, self._end), rows))
        for one in last.T:
            real = np.abs(one.imag) < 1e-6 * np.abs(one)
            gain = np.where(real & (one.real < 0.0), -1.0 / one.real, np.nan)
            self._keep_gain(found, gain, np.full(count, self._end))
        return found, stable_loops(self.grid, on_grid)

    def _crossings(self, sign_of: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where ``sign_of`` the eigenvalues of the first row changes: frequency, eigenvalue and the frequency of the
        plant that takes the largest part in it, (k,) each."""
        values, places = self.loci(0)
        sign = sign_of(values)
        at, which = np.nonzero((sign[1:] < 0.0) != (sign[:-1] < 0.0))
        before, after = np.abs(sign[at, which]), np.abs(sign[at + 1, which])
        share = np.clip(before / np.maximum(before + after, 1e-300), 0.0, 1.0)
        value = values[at, which] * (1.0 - share) + values[at + 1, which] * share
        w = self.grid[at] * (1.0 - share) + self.grid[at + 1] * share
        return w, value, places[at, which]

    def _followed(
        self, gap: Callable[[np.ndarray, float], Callable[[np.ndarray], np.ndarray]], w: float, y: float, sign: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Roots of ``gap(w, sign)(y)`` in every row, by Newton's rule from the same start; NaN where none is."""
        count, small = len(self.plant.rows), 1e-6
        x, value = np.full(count, math.log(w)), np.full(count, y)
        left = np.full(count, np.inf + 0j)
        for _ in range(TURNS):
            here = gap(np.exp(x), sign)
            now = here(value)
            by_x = (gap(np.exp(x + small), sign)(value) - now) / small
            by_y = (here(value + small) - now) / small
            determinant = by_x.real * by_y.imag - by_x.imag * by_y.real
            with np.errstate(divide="ignore", invalid="ignore"):
                step_x = (now.imag * by_y.real - now.real * by_y.imag) / determinant
                step_y = (now.real * by_x.imag - now.imag * by_x.real) / determinant
                left = now / np.abs(by_y)
            if np.all(np.abs(left) < FOUND):
                break
            x = np.minimum(x + np.clip(np.nan_to_num(step_x), -0.05, 0.05), math.log(self._end))
            value = np.maximum(value + np.clip(np.nan_to_num(step_y), -0.2, 0.2), -1e3)
        good = np.abs(left) < math.sqrt(FOUND)
        return np.where(good, np.exp(x), np.nan), np.where(good, value, np.nan)

    @staticmethod
    def _keep(found: dict[str, np.ndarray], key: str, value: np.ndarray, beside: str = "", w: Any = 0.0) -> None:
        """Keep positive values of ``key`` that are smaller, and what stands ``beside`` them."""
        smaller = (value > 0.0) & ~(value >= found[key])
        found[key] = np.where(smaller, value, found[key])
        if beside:
            found[beside] = np.where(smaller, w, found[beside])

    def _keep_gain(self, found: dict[str, np.ndarray], gain: np.ndarray, w: np.ndarray) -> None:
        self._keep(found, "gain_margin", np.where(gain > 1.0, gain, np.nan), "gain_margin_frequency", w)

    def sensitive(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (n,) [rad/s] and the loop of one rate (n,) that would have the sensitivity of a row there."""
        through = np.diagonal(np.linalg.inv(np.eye(self.law.cycle) + self.matrix(self.grid, row)), axis1=-2, axis2=-1)
        w = np.abs(self._places(self.grid)).ravel()
        order = np.argsort(w)
        return w[order], (1.0 / through - 1.0).ravel()[order]

    def loci(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """The eigenvalues (g, N) of a row on the grid, largest first, and the frequency of the plant [rad/s] that
        takes the largest part in each, negative beyond the Nyquist frequency."""
        values, vectors = np.linalg.eig(self.matrix(self.grid, row))
        order = np.argsort(-np.abs(values), axis=-1)
        largest = np.argmax(np.abs(vectors), axis=-2)
        places = np.take_along_axis(self._places(self.grid), largest, axis=-1)
        return np.take_along_axis(values, order, axis=-1), np.take_along_axis(places, order, axis=-1)
