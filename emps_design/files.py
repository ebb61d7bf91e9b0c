"""Files that are whole or absent: written aside, then renamed."""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path

from emps_design.errors import InputError


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` to write to, and rename it when the block ends well.

    A failure, an interrupt or a kill leaves neither a half-written file nor a changed old one. What a killed process
    leaves aside, a hidden file that ends in ``.part``, goes with the next writing of ``path``. Raises
    :class:`InputError` when the folder does not exist or cannot be written.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with write_aside(folder / "note.txt") as aside:
    ...     _ = aside.write_text("whole")
    >>> [p.name for p in folder.iterdir()]
    ['note.txt']
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: folder {path.parent} does not exist; make it first")
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected the name of a file to write")
    _remove_abandoned(path)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f"{_aside(path)}.{os.getpid()}.", suffix=".part")
    except OSError as error:
        raise InputError(f"{path}: cannot write there, {error.strerror}") from error
    os.close(handle)
    aside = Path(name)
    try:
        yield aside
        os.chmod(aside, 0o666 & ~_umask())
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


@contextmanager
def write_together(folder: str | Path) -> Iterator[Path]:
    """Give a temporary folder inside ``folder``; when the block ends well its files take their places, one by one.

    What belongs together is there together: a failure, an interrupt or a kill before that changes nothing. Raises
    :class:`InputError` when ``folder`` does not exist or cannot be written.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with write_together(folder) as aside:
    ...     write_text(aside / "model.toml", "")
    ...     write_text(aside / "report.html", "")
    >>> sorted(p.name for p in folder.iterdir())
    ['model.toml', 'report.html']
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; make it first")
    inside = folder / folder.resolve().name
    _remove_abandoned(inside)
    try:
        aside = Path(tempfile.mkdtemp(dir=folder, prefix=f"{_aside(inside)}.{os.getpid()}.", suffix=".part"))
    except OSError as error:
        raise InputError(f"{folder}: cannot write there, {error.strerror}") from error
    try:
        yield aside
        for whole in sorted(aside.iterdir()):
            os.replace(whole, folder / whole.name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8, whole or not at all."""
    with write_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def _aside(path: Path) -> str:
    """How the names of files beside ``path`` start that this machine writes; the process number follows."""
    return f".{path.name}.{platform.node()}"


def _remove_abandoned(path: Path) -> None:
    """Remove what processes of this machine that are no more have left beside ``path``."""
    for left in path.parent.glob(f"{escape(_aside(path))}.*.part"):
        process = left.name.removeprefix(f"{_aside(path)}.").split(".")[0]
        if process.isdigit() and not _lives(int(process)):
            shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    if os.name != "posix":  # no signal 0 elsewhere, it would end the process
        return True
    try:
        os.kill(process, 0)
    except OSError as error:  # one of another user's lives, we may only not signal it
        return not isinstance(error, ProcessLookupError)
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
