"""A record whose logger lost a stretch: the signals straight across it, as an import joins its pieces."""

from dataclasses import replace

import numpy as np

COLUMNS = ("q_ref", "q", "u", "excitation", "f_ext")


def lost(record, start, stop):
    """``record`` without the samples from ``start`` to ``stop``."""
    there = np.ones(len(record), bool)
    there[start:stop] = False
    at = np.flatnonzero(there)
    columns = {name: getattr(record, name) for name in COLUMNS if getattr(record, name) is not None}
    straight = {name: np.interp(np.arange(len(record)), at, values[at]) for name, values in columns.items()}
    return replace(record, **straight, bridged=np.where(there, 0.0, 1.0))


def as_one(record):
    """The same as if nothing had been lost."""
    return replace(record, bridged=None)
