"""NumPy archives. Members are plain numbers: an object array, which only unpickling could read, is refused."""

from __future__ import annotations

import math
import warnings
import zipfile
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from emps_design.errors import RecordError


def read_archive(file: BinaryIO, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz archive by name; together they may take ``max_bytes`` unpacked."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
            unpacked = sum(member.file_size for member in members)
            if unpacked > max_bytes:
                raise RecordError(f"{source}: found {unpacked} bytes unpacked, expected at most {max_bytes}")
            return {member.filename.removesuffix(".npy"): _array(archive, member, source) for member in members}
    except RecordError:
        raise
    except Exception as error:  # whatever a damaged archive makes zipfile raise, it is one thing to the user
        raise RecordError(f"{source}: damaged .npz archive ({error or type(error).__name__}); save it again") from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: str) -> np.ndarray:
    """One .npy member, its size checked against its header before anything is allocated."""
    with archive.open(member) as stream:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            version = npy.read_magic(stream)
            read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, fortran, dtype = read_header(stream)
        if dtype.hasobject:
            raise RecordError(
                f"{source}: {member.filename}: found pickled objects, expected numbers; they are never unpickled"
            )
        size = member.file_size - stream.tell()
        if math.prod(shape) * dtype.itemsize != size:
            raise RecordError(
                f"{source}: {member.filename}: found {size} bytes of data, expected shape {shape} of {dtype}; "
                "save it again"
            )
        data = bytearray(size)
        filled = 0
        while filled < size and (piece := cast(Any, stream).readinto(memoryview(data)[filled:])):
            filled += piece
        if filled < size:
            raise RecordError(f"{source}: {member.filename}: found {filled} bytes of data, expected {size}")
        stream.read(1)  # past the end, where the archive's check sum is compared
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")
