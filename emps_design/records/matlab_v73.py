"""MATLAB v7.3 files, which are HDF5: real numeric arrays only, no link is followed."""

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


def read_v73(file: BinaryIO, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return the numeric arrays of a MATLAB v7.3 file by name; together they may take ``max_bytes`` unpacked."""
    import h5py

    try:
        with h5py.File(file, "r") as opened:
            columns: dict[str, np.ndarray] = {}
            unpacked = 0
            for name in opened:
                if not isinstance(opened.get(name, getlink=True), h5py.HardLink):
                    continue  # a soft or external link may lead anywhere
                data = opened[name]
                if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "buif":
                    continue
                if data.external or data.is_virtual:
                    raise RecordError(
                        f"{source}: column {name!r}: found data kept outside the file, expected it inside"
                    )
                if data.attrs.get("MATLAB_empty", 0) or data.shape is None:
                    continue
                unpacked += data.dtype.itemsize * math.prod(data.shape)
                if unpacked > max_bytes:
                    raise RecordError(f"{source}: found more than {max_bytes} bytes of arrays, expected at most that")
                columns[name] = data[()]
            return columns
    except RecordError:
        raise
    except Exception as error:  # whatever a damaged file makes the reader raise, it is one thing to the user
        raise RecordError(
            f"{source}: damaged MATLAB v7.3 file ({error or type(error).__name__}); save it again"
        ) from error
