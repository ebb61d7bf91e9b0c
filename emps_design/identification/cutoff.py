"""The cut-off of the filter, chosen from the data: up to where the inverse model explains the force."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.errors import InputError
from emps_design.identification.filters import held, low_pass, motion
from emps_design.identification.inverse_model import baseline_columns
from emps_design.records import Record

LOWEST_HZ = 10.0
HIGHEST = 0.2  # of the sampling frequency
EXPLAINED = 0.5
LONGEST = 120_000  # samples that are looked at


@dataclass(frozen=True)
class Cutoff:
    """The cut-off [Hz], and the curve it was read from.

    ``frequency`` [Hz]; ``explained`` the share of the force's power that the inverse model explains there.
    """

    cutoff_hz: float
    frequency: np.ndarray = field(repr=False)
    explained: np.ndarray = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the choice and its curve."""
        return {
            "cutoff_hz": self.cutoff_hz,
            "rule": f"first frequency from {LOWEST_HZ:g} Hz on where the inverse model explains less than "
            f"{100 * EXPLAINED:.0f} % of the force's power",
            "frequency_hz": self.frequency.round(3).tolist(),
            "explained": self.explained.round(4).tolist(),
        }


def can_choose(record: Record) -> bool:
    """Whether the record is sampled fast enough to choose a cut-off from it.

    >>> can_choose(Record(t=np.zeros(1), q_ref=np.zeros(1), q=np.zeros(1), u=np.zeros(1), period=1e-3))
    True
    """
    return HIGHEST / record.period > LOWEST_HZ


def chosen_cutoff(record: Record) -> Cutoff:
    """Read the cut-off from ``record``: the first frequency where the inverse model explains under half of the force.

    The baseline is fitted in a band of 0.4 of the Nyquist frequency; the power of its residual is set against that of
    the voltage in bands of a third of an octave. Above that frequency the regression would fit noise, below it a
    filter throws motion away. Between 10 Hz and a fifth of the sampling frequency.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> 20.0 < chosen_cutoff(synthetic_record(machine("emps2019"), laps=1)).cutoff_hz < 100.0
    True
    """
    from scipy.signal import welch

    part = record.part(0, LONGEST) if len(record) > LONGEST else record
    top = HIGHEST / part.period
    if not can_choose(record):
        raise InputError(
            f"{record.name}: sampled at {1 / part.period:g} Hz, too slow to choose a cut-off; give `cutoff_hz`"
        )
    W = baseline_columns(motion(part, top))
    force = low_pass(held(part.u), top, part.period)
    basis = np.linalg.qr(W / np.maximum(np.linalg.norm(W, axis=0), 1e-300))[0]
    residual = force - basis @ (basis.T @ force)
    length = min(len(force), int(1.0 / part.period))
    frequency, left = welch(residual, 1.0 / part.period, nperseg=length)
    _, whole = welch(force, 1.0 / part.period, nperseg=length)
    centre = LOWEST_HZ * 2.0 ** (np.arange(0, np.log2(top / LOWEST_HZ), 1 / 6))
    explained = []
    for middle in centre:
        band = (frequency >= middle * 2 ** (-1 / 6)) & (frequency <= middle * 2 ** (1 / 6))
        explained.append(1.0 - float(np.sum(left[band]) / max(np.sum(whole[band]), 1e-300)))
    below = np.flatnonzero(np.array(explained) < EXPLAINED)
    chosen = float(centre[below[0]]) if below.size else top
    return Cutoff(cutoff_hz=round(max(chosen, LOWEST_HZ), 1), frequency=centre, explained=np.array(explained))
