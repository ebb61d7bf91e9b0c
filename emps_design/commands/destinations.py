"""Checks of a command's output files before its work: they must be writable and must not destroy other content."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from emps_design.errors import InputError
from emps_design.files import destination

HEAD = 65536  # bytes read to find the kind of a file
OVERWRITE = "Overwrite a file with other content."  # the help of --force
AXIS, PAGE, ARCHIVE, TABLE = "an axis file", "an HTML page", "a NumPy archive", "a text table"
JSON, MATLAB, ANYTHING = "a JSON document", "a MATLAB file", "something else"
CODE, CONTROLLER = "code of emps-design", "a table of a controller"
PICTURES = {".png": "a PNG picture", ".svg": "an SVG picture", ".pdf": "a PDF document"}

_MAGIC = (
    (b"PK", ARCHIVE),
    (b"\x89PNG", PICTURES[".png"]),
    (b"%PDF", PICTURES[".pdf"]),
    (b"\x89HDF", MATLAB),
    (b"MATLAB", MATLAB),
)
_TEXT = (
    (r"[^\n]*(\n[^\n]*){0,20}made by emps-design", CODE),
    (r"<(!doctype )?html\b", PAGE),
    (r"<(\?xml|svg)\b", PICTURES[".svg"]),
    (r"(?m)(\A|.*^)\s*\[?\s*mechanics\b", AXIS),
    (r"(?m)(\A|.*^)\s*\[\s*controller\b", CONTROLLER),
    (r"\{|\[\s*(\Z|[\[{\"\d-])", JSON),
    (r"[^\n]*[;,\t][^\n]*\n\s*[-+.\d]", TABLE),
)


def check_out(
    out: Path | None,
    kind: str,
    inputs: Sequence[str | Path | None] = (),
    force: bool = False,
    option: str = "--out",
) -> None:
    """Raise :class:`InputError` if ``out`` cannot be written or must not be overwritten.

    An input of the command must not be overwritten (``inputs``; names of embedded machines and None are ignored), nor,
    without ``force``, a file of another kind than ``kind``.
    """
    if out is None:
        return
    target = destination(out)
    if not target.exists():
        return
    for source in inputs:
        if source is not None and os.path.exists(source) and os.path.samefile(source, target):
            raise InputError(f"{option}: {out} is an input of this command ({source}); choose another name")
    existing = content(target)
    if existing not in ("", kind) and not force:
        raise InputError(
            f"{option}: {out} holds {existing}, expected {kind} or a new file; choose another name, or give --force"
        )


def check_named_out(
    out: Path | None,
    kinds: Mapping[str, str],
    inputs: Sequence[str | Path | None] = (),
    force: bool = False,
    option: str = "--out",
) -> None:
    """As :func:`check_out`, with the kind of file from the suffix of ``out``: ``kinds`` maps suffix to kind."""
    if out is None:
        return
    if out.suffix not in kinds:
        *others, last = kinds
        expected = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{option}: found {out.name!r}, expected a name that ends in {expected}")
    check_out(out, kinds[out.suffix], inputs, force, option)


def check_folder(
    out: Path | None, kinds: Mapping[str, str], inputs: Sequence[str | Path | None] = (), force: bool = False
) -> None:
    """As :func:`check_out`, for a folder ``out``: ``kinds`` maps the name of each file to be written to its kind."""
    if out is None:
        return
    if os.path.lexists(out) and not os.path.isdir(out):
        raise InputError(f"{out}: found a file, expected a folder for the results")
    if not os.path.isdir(out):
        destination(out)
        return
    for name, kind in kinds.items():
        check_out(out / name, kind, inputs, force)


def make_folder(out: Path, parents: bool = False) -> None:
    """Create the folder ``out`` unless it exists; with ``parents``, the folders above it as well."""
    try:
        out.mkdir(parents=parents, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be created, {error.strerror}; expected a folder to write to") from error


def content(path: Path) -> str:
    """Return the kind of file at ``path`` in words, "" for an empty file.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "a"
    >>> def of(text):
    ...     _ = path.write_text(text)
    ...     return content(path)
    >>> of("name = 'a'\\n[mechanics]\\nmass = 1"), of("<!DOCTYPE html>"), of("t;q;u\\n0;0;0"), of("{}"), of("words")
    ('an axis file', 'an HTML page', 'a text table', 'a JSON document', 'something else')
    """
    with path.open("rb") as file:
        head = file.read(HEAD)
    for start, kind in _MAGIC:
        if head.startswith(start):
            return kind
    text = head.decode("utf-8-sig", errors="replace").strip().lower()
    if not text or "\0" in text:
        return ANYTHING if text else ""
    return next((kind for pattern, kind in _TEXT if re.match(pattern, text, re.DOTALL)), ANYTHING)
