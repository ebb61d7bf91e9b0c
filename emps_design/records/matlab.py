"""MATLAB files, v5 (``save -v7``) and v7.3 (HDF5): real numeric arrays only, no link is followed."""

from __future__ import annotations

import io
import math
import struct
import zlib

import numpy as np

from emps_design.errors import RecordError

HDF5 = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048)
_COMPRESSED, _NUMERIC = 15, ("double", "single", "logical", *(f"{s}int{n}" for s in ("", "u") for n in (8, 16, 32, 64)))


def is_v5(content: bytes) -> bool:
    """Whether ``content`` starts like a MATLAB v5 file."""
    return content[126:128] in (b"IM", b"MI") and len(content) >= 128


def is_v73(content: bytes) -> bool:
    """Whether ``content`` is HDF5, with or without MATLAB's header before it."""
    return any(content[at : at + 8] == HDF5 for at in HDF5_OFFSETS)


def read_v5(content: bytes, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return the numeric arrays of a MATLAB v5 file by name; together they may take ``max_bytes`` unpacked."""
    from scipy.io import loadmat, whosmat

    try:
        _refuse_bombs(content, source, max_bytes)
        listed = whosmat(io.BytesIO(content))
        names = [name for name, shape, kind in listed if kind in _NUMERIC]
        size = 8 * sum(math.prod(shape) for name, shape, kind in listed if kind in _NUMERIC)
        if size > max_bytes:
            raise RecordError(f"{source}: found {size} bytes of arrays, expected at most {max_bytes}")
        return loadmat(io.BytesIO(content), variable_names=names) if names else {}
    except RecordError:
        raise
    except Exception as error:  # whatever a damaged file makes the reader raise, it is one thing to the user
        raise RecordError(
            f"{source}: damaged MATLAB v5 file ({error or type(error).__name__}); save it again"
        ) from error


def _refuse_bombs(content: bytes, source: str, max_bytes: int) -> None:
    """Unpack every compressed element once, counting, so that the reader proper never meets an endless one."""
    order = "<" if content[126:128] == b"IM" else ">"
    at, unpacked = 128, 0
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if at + 8 + size > len(content):
            raise RecordError(f"{source}: damaged MATLAB v5 file (it ends inside a variable); save it again")
        if kind == _COMPRESSED:
            stream = zlib.decompressobj()
            data = content[at + 8 : at + 8 + size]
            while data and unpacked <= max_bytes:
                unpacked += len(stream.decompress(data, 1 << 20))
                data = stream.unconsumed_tail
        if unpacked > max_bytes:
            raise RecordError(f"{source}: found more than {max_bytes} bytes unpacked, expected at most that")
        at += 8 + size


def read_v73(content: bytes, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return the numeric arrays of a MATLAB v7.3 file by name; together they may take ``max_bytes`` unpacked."""
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            columns: dict[str, np.ndarray] = {}
            unpacked = 0
            for name in file:
                if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                    continue  # a soft or external link may lead anywhere
                data = file[name]
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
