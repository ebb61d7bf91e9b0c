"""Arrays of numbers from NumPy archives and MATLAB files, by name.

NumPy archives: object arrays, which would have to be unpickled, are refused.

MATLAB v5 files (``save -v7``, ``save -v6``): real numeric arrays, and on demand structures of arrays. The reader is
bounds-checked Python, since scipy's compiled one crashes the process on some damaged files.
Format: MathWorks, "MAT-File Format", level 5: a 128-byte header, then elements of (type, size, data), each on a
multiple of 8 bytes, that are arrays or compressed arrays; an array is flags, dimensions, name and real part.

MATLAB v7.3 files, which are HDF5: real numeric arrays, on demand structures of arrays; no link is followed.
"""

from __future__ import annotations

import math
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.lib import format as npy

from emps_design.errors import RecordError

HEADER = 128
ARRAY, COMPRESSED = 14, 15
COMPLEX = 0x08
STRUCTURE, TEXT = 2, 4
NUMERIC_CLASSES = range(6, 16)  # double, single, int8 to uint64
CHARACTERS = {16: "u1", 17: "u2"}
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}

HDF5 = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048)


def read_archive(file: BinaryIO, source: str, max_bytes: int) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz archive by name; together they may take ``max_bytes`` unpacked."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
            unpacked = sum(member.file_size for member in members)
            if unpacked > max_bytes:
                raise RecordError(f"{source}: found {unpacked} bytes unpacked, expected at most {max_bytes}")
            return {member.filename.removesuffix(".npy"): _member(archive, member, source) for member in members}
    except RecordError:
        raise
    except Exception as error:  # a damaged archive may make zipfile raise anything
        raise RecordError(f"{source}: damaged .npz archive ({error or type(error).__name__}); save it again") from error


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: str) -> np.ndarray:
    """One .npy member; its size is checked against its header before memory is allocated."""
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
        stream.read(1)  # reading past the end checks the check sum
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")


def is_v5(content: bytes) -> bool:
    """Whether ``content`` starts like a MATLAB v5 file."""
    return len(content) >= HEADER and content[126:128] in (b"IM", b"MI")


def read_v5(file: BinaryIO, source: str, max_bytes: int, structures: bool = False) -> dict[str, np.ndarray]:
    """Return the real numeric arrays of a MATLAB v5 file by name; together they may take ``max_bytes`` unpacked.

    With ``structures`` complex arrays too, text as its character codes, and the fields of structures as ``name.field``.
    """
    order = "<" if file.read(HEADER)[126:128] == b"IM" else ">"
    columns: dict[str, np.ndarray] = {}
    remaining = max_bytes
    for kind, data in _variables(file, order, source, max_bytes):
        unpacked = _unpacked(data, source, remaining) if kind == COMPRESSED else data
        remaining -= len(unpacked)
        if remaining < 0:
            raise RecordError(f"{source}: found more than {max_bytes} bytes unpacked, expected at most that")
        inside = _elements(memoryview(unpacked), order, source) if kind == COMPRESSED else [(kind, data)]
        for part, array in inside:
            if part == ARRAY:
                columns.update(_array(array, order, source, structures))
    return columns


def _variables(file: BinaryIO, order: str, source: str, max_bytes: int) -> Iterator[tuple[int, memoryview]]:
    """Type and data of each element of the file, one at a time."""
    while tag := file.read(8):
        if len(tag) < 8:
            raise _damaged(source, "it ends inside a variable")
        kind, size = (int(word) for word in np.frombuffer(tag, dtype=f"{order}u4"))
        if kind >> 16:  # a small element, whose data is in its tag
            yield from _elements(memoryview(tag), order, source)
            continue
        data = file.read(min(size, max_bytes + 1))
        if len(data) < size:
            raise _damaged(source, "it ends inside a variable")
        yield kind, memoryview(data)
        if kind != COMPRESSED:
            file.read(-size % 8)


def _elements(data: memoryview, order: str, source: str) -> Iterator[tuple[int, memoryview]]:
    """Type and data of each element; small ones keep both in the 8 bytes of a tag."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise _damaged(source, "it ends inside a variable")
        kind, size = (int(word) for word in np.frombuffer(data[at : at + 8], dtype=f"{order}u4"))
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            start, following = at + 4, at + 8
            if size > 4:
                raise _damaged(source, "a small element is too large")
        else:
            start = at + 8
            following = start + size + (0 if kind == COMPRESSED else -size % 8)
        if start + size > len(data):
            raise _damaged(source, "it ends inside a variable")
        yield kind, data[start : start + size]
        at = following


def _unpacked(data: memoryview, source: str, remaining: int) -> bytes:
    stream = zlib.decompressobj()
    try:
        unpacked = stream.decompress(data, remaining + 1)
    except zlib.error as error:
        raise _damaged(source, str(error)) from error
    if len(unpacked) <= remaining and not stream.eof:
        raise _damaged(source, "it ends inside a compressed variable")
    return unpacked


def _array(data: memoryview, order: str, source: str, structures: bool, inside: bool = False) -> dict[str, np.ndarray]:
    """The array of one element by its name; nothing for cells, objects and classes that are not requested."""
    parts = list(_elements(data, order, source))
    if not parts or len(parts[0][1]) < 4:
        raise _damaged(source, "a variable has no flags")
    flags = int(np.frombuffer(parts[0][1][:4], dtype=f"{order}u4")[0])
    if structures and flags & 0xFF == STRUCTURE and not inside:
        return _structure(parts, order, source)
    is_complex = bool((flags >> 8) & COMPLEX)
    wanted = flags & 0xFF in NUMERIC_CLASSES or (structures and flags & 0xFF == TEXT)
    if not wanted or (is_complex and not structures):
        return {}
    shape = tuple(int(n) for n in np.frombuffer(parts[1][1], dtype=f"{order}i4")) if _whole(parts, 1) else (-1,)
    values = _numbers(parts, 3, shape, order, source)
    if is_complex:
        values = values + 1j * _numbers(parts, 4, shape, order, source)
    return {_text(parts[2][1]): values.reshape(shape, order="F")}


def _whole(parts: list[tuple[int, memoryview]], place: int) -> bool:
    return len(parts) > place and len(parts[place][1]) % 4 == 0


def _numbers(
    parts: list[tuple[int, memoryview]], place: int, shape: tuple[int, ...], order: str, source: str
) -> np.ndarray:
    kinds = NUMBERS | CHARACTERS
    if len(parts) <= place or parts[place][0] not in kinds:
        raise _damaged(source, "an array has no values")
    number = np.dtype(kinds[parts[place][0]]).newbyteorder(cast(Any, order))
    if not _whole(parts, 1) or len(parts[place][1]) % number.itemsize:
        raise _damaged(source, "an array is cut off")
    values = np.frombuffer(parts[place][1], dtype=number)
    if min(shape, default=0) < 0 or math.prod(shape) != values.size:
        raise _damaged(source, f"an array of shape {shape} has {values.size} values")
    return values


def _structure(parts: list[tuple[int, memoryview]], order: str, source: str) -> dict[str, np.ndarray]:
    """The arrays in the fields of one structure; nothing for arrays of structures and nested structures."""
    if len(parts) < 5 or not _whole(parts, 3) or len(parts[3][1]) < 4:
        raise _damaged(source, "a structure has no fields")
    length = int(np.frombuffer(parts[3][1][:4], dtype=f"{order}i4")[0])
    names, fields = bytes(parts[4][1]), parts[5:]
    if length <= 0 or len(names) // length != len(fields):
        return {}
    columns = {}
    for i, (kind, data) in enumerate(fields):
        if kind == ARRAY and len(data):
            name = f"{_text(parts[2][1])}.{_text(names[i * length : (i + 1) * length])}"
            for values in _array(data, order, source, True, inside=True).values():
                columns[name] = values
    return columns


def _text(data: memoryview | bytes) -> str:
    return bytes(data).partition(b"\0")[0].decode("ascii", "replace")


def _damaged(source: str, what: str) -> RecordError:
    return RecordError(f"{source}: damaged MATLAB v5 file ({what}); save it again")


def is_v73(content: bytes) -> bool:
    """Whether ``content`` is HDF5, with or without MATLAB's header before it."""
    return any(content[at : at + 8] == HDF5 for at in HDF5_OFFSETS)


def read_v73(file: BinaryIO, source: str, max_bytes: int, structures: bool = False) -> dict[str, np.ndarray]:
    """Return the numeric arrays of a MATLAB v7.3 file by name; together they may take ``max_bytes`` unpacked.

    With ``structures`` complex arrays too, and the fields of structures as ``name.field``.
    """
    import h5py

    def arrays(group: h5py.Group, before: str, remaining: int) -> dict[str, np.ndarray]:
        columns: dict[str, np.ndarray] = {}
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue  # a soft or external link may lead anywhere
            data = group[name]
            if isinstance(data, h5py.Group):
                if structures and not before:
                    inside = arrays(data, f"{name}.", remaining)
                    remaining -= sum(values.nbytes for values in inside.values())
                    columns.update(inside)
                continue
            pair = structures and data.dtype.names == ("real", "imag")
            if not isinstance(data, h5py.Dataset) or not (data.dtype.kind in "buif" or pair):
                continue
            if data.external or data.is_virtual:
                raise RecordError(f"{source}: column {name!r}: found data kept outside the file, expected it inside")
            if data.attrs.get("MATLAB_empty", 0) or data.shape is None:
                continue
            remaining -= data.dtype.itemsize * math.prod(data.shape)
            if remaining < 0:
                raise RecordError(f"{source}: found more than {max_bytes} bytes of arrays, expected at most that")
            values = data[()]
            columns[before + name] = values["real"] + 1j * values["imag"] if pair else values
        return columns

    try:
        with h5py.File(file, "r") as opened:
            return arrays(opened, "", max_bytes)
    except RecordError:
        raise
    except Exception as error:  # a damaged file may make h5py raise anything
        raise RecordError(
            f"{source}: damaged MATLAB v7.3 file ({error or type(error).__name__}); save it again"
        ) from error
