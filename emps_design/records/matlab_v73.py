"""MATLAB v7.3 files, which are HDF5: real numeric arrays, on demand structures of arrays; no link is followed."""

from __future__ import annotations

import math
from typing import BinaryIO

import numpy as np

from emps_design.errors import RecordError

HDF5 = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048)


def is_v73(content: bytes) -> bool:
    """Whether ``content`` is HDF5, with or without MATLAB's header before it."""
    return any(content[at : at + 8] == HDF5 for at in HDF5_OFFSETS)


def read_v73(file: BinaryIO, source: str, max_bytes: int, structures: bool = False) -> dict[str, np.ndarray]:
    """Return the numeric arrays of a MATLAB v7.3 file by name; together they may take ``max_bytes`` unpacked.

    With ``structures`` complex arrays too, and the fields of structures as ``name.field``.
    """
    import h5py

    def arrays(group: h5py.Group, before: str, left: int) -> dict[str, np.ndarray]:
        columns: dict[str, np.ndarray] = {}
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue  # a soft or external link may lead anywhere
            data = group[name]
            if isinstance(data, h5py.Group):
                if structures and not before:
                    inside = arrays(data, f"{name}.", left)
                    left -= sum(values.nbytes for values in inside.values())
                    columns.update(inside)
                continue
            pair = structures and data.dtype.names == ("real", "imag")
            if not isinstance(data, h5py.Dataset) or not (data.dtype.kind in "buif" or pair):
                continue
            if data.external or data.is_virtual:
                raise RecordError(f"{source}: column {name!r}: found data kept outside the file, expected it inside")
            if data.attrs.get("MATLAB_empty", 0) or data.shape is None:
                continue
            left -= data.dtype.itemsize * math.prod(data.shape)
            if left < 0:
                raise RecordError(f"{source}: found more than {max_bytes} bytes of arrays, expected at most that")
            values = data[()]
            columns[before + name] = values["real"] + 1j * values["imag"] if pair else values
        return columns

    try:
        with h5py.File(file, "r") as opened:
            return arrays(opened, "", max_bytes)
    except RecordError:
        raise
    except Exception as error:  # whatever a damaged file makes the reader raise, it is one thing to the user
        raise RecordError(
            f"{source}: damaged MATLAB v7.3 file ({error or type(error).__name__}); save it again"
        ) from error
