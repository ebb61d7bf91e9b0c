"""Files that are written completely or not at all: first to a temporary file, which is then renamed."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from emps_design.errors import EmpsError, InputError

try:
    import fcntl
except ImportError:  # without file locks, abandoned temporary files are not removed
    fcntl = None  # type: ignore[assignment]

LONGEST_NAME = 100  # bytes of a name that the temporary file repeats; file systems allow 255 in all
# Errors of the disk, not of the name.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
_unfinished: dict[Path, int] = {}  # temporary files of this process, and the descriptors that lock them


def destination(path: str | Path) -> Path:
    """Return the file that writing to ``path`` replaces: itself, or the target of a symbolic link.

    Raises :class:`InputError` for a folder, a device, a pipe or a write-protected file, and where the folder does not
    exist or cannot be written.

    >>> import os
    >>> destination(os.devnull)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: /dev/null: is a device, expected the name of a file to write
    """
    try:
        target = Path(os.path.realpath(path))
        try:
            mode = os.stat(target).st_mode
        except FileNotFoundError:
            mode = None
        if mode is not None and not stat.S_ISREG(mode):
            raise InputError(f"{path}: is {_kind_of_file(mode)}, expected the name of a file to write")
        if mode is not None and not os.access(target, os.W_OK):
            raise InputError(f"{path}: cannot write there, it is write-protected; choose another name")
        if not stat.S_ISDIR(os.stat(target.parent).st_mode):
            raise InputError(f"{path}: {target.parent} is not a folder")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise InputError(f"{path}: cannot write there, no permission to create a file in {target.parent}")
    except FileNotFoundError as error:
        raise InputError(f"{path}: folder {target.parent} does not exist; make it first") from error
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: the name has a null byte
        raise InputError(f"{path}: cannot write there, {getattr(error, 'strerror', None) or error}") from error
    return target


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` to write to, and rename it when the block succeeds.

    A failure, an interrupt or a kill leaves neither a half-written file nor a changed old one. The temporary file of a
    killed process, hidden and ending in ``.part``, is removed when ``path`` is written again. A replaced file keeps its
    mode; a symbolic link stays one. Raises :class:`InputError` as :func:`destination` does, and :class:`EmpsError`
    where the disk is full.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with write_aside(folder / "note.txt") as aside:
    ...     _ = aside.write_text("whole")
    >>> [p.name for p in folder.iterdir()]
    ['note.txt']
    """
    target = destination(path)
    with _aside(path, target, _new_file) as aside, _report_disk_error(path):
        yield aside
        _put(aside, target)


@contextmanager
def write_together(folder: str | Path) -> Iterator[Path]:
    """Yield a temporary folder inside ``folder``; when the block succeeds its files are renamed into place, one by one.

    A failure, an interrupt or a kill before that changes nothing. Raises :class:`InputError` where ``folder`` does not
    exist or cannot be written, or one of its files cannot be replaced.

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
    with _aside(folder, folder / folder.resolve().name, _new_folder) as aside, _report_disk_error(folder):
        yield aside
        places = {whole: destination(folder / whole.name) for whole in sorted(aside.iterdir())}
        try:
            _put_all(places)
        except KeyboardInterrupt:  # finish the remaining renames first, so that the set is complete
            _put_all(places)
            raise


def read_bytes(path: str | Path, most: int, expected: str) -> bytes:
    """Return the content of a regular file of at most ``most`` bytes, without reading more than that into memory.

    Raises :class:`InputError`, one line that ends with ``expected``, for a file that cannot be read or is too large,
    and for devices and pipes.
    """
    try:
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError(f"{path}: is not an ordinary file; {expected}")
            content = file.read(most + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: the name has a null byte
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}; {expected}") from error
    if len(content) > most:
        raise InputError(f"{path}: found more than {most / 1e6:g} MB; {expected}")
    return content


def read_json(path: str | Path, most: int, expected: str) -> Any:
    """Return the JSON document in the file at ``path``, of at most ``most`` bytes.

    Raises :class:`InputError` that ends with ``expected`` where the file cannot be read or is no JSON.
    """
    text = read_bytes(path, most, expected)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON, {expected}") from error


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8, completely or not at all."""
    with write_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def discard_unfinished() -> None:
    """Remove the temporary files of this process, before an exit that does not unwind the stack."""
    for aside in tuple(_unfinished):
        _remove(aside)


def _kind_of_file(mode: int) -> str:
    kinds = {stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a pipe", stat.S_ISSOCK: "a socket"}
    return next((name for is_kind, name in kinds.items() if is_kind(mode)), "a device")


@contextmanager
def _report_disk_error(path: str | Path) -> Iterator[None]:
    """Turn a disk error into an :class:`EmpsError` of one line that names ``path``."""
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK:
            raise
        raise EmpsError(f"{path}: cannot be written, {error.strerror}; nothing there was changed") from error


@contextmanager
def _aside(path: str | Path, target: Path, new: Callable[[Path, str], Path]) -> Iterator[Path]:
    """A locked temporary file or folder beside ``target``, removed at the end; messages name ``path``."""
    start = _prefix(target.name)
    _remove_abandoned(target.parent, start)
    try:
        aside = _make_locked(target.parent, f"{start}{platform.node()[:40]}.{os.getpid()}.", new)
    except OSError as error:
        raise InputError(f"{path}: cannot write there, {error.strerror}") from error
    try:
        yield aside
    finally:
        _remove(aside)
        os.close(_unfinished.pop(aside))


def _prefix(name: str) -> str:
    """Prefix of the temporary files for a file called ``name``; host name and process id follow it."""
    long = len(os.fsencode(name)) > LONGEST_NAME
    return f".{hashlib.sha256(os.fsencode(name)).hexdigest()[:32] if long else name}."


def _new_file(folder: Path, start: str) -> Path:
    handle, name = tempfile.mkstemp(dir=folder, prefix=start, suffix=".part")
    os.close(handle)
    return Path(name)


def _new_folder(folder: Path, start: str) -> Path:
    return Path(tempfile.mkdtemp(dir=folder, prefix=start, suffix=".part"))


def _make_locked(folder: Path, start: str, new: Callable[[Path, str], Path]) -> Path:
    """Create a temporary file or folder with ``new`` and lock it until it is closed or this process ends."""
    while True:
        aside = new(folder, start)
        # Another process may remove the file as abandoned before it is locked.
        with suppress(FileNotFoundError):
            handle = os.open(aside, os.O_RDONLY)
            if fcntl is not None:
                with suppress(OSError):  # on a file system without locks nothing is removed as abandoned
                    fcntl.flock(handle, fcntl.LOCK_EX)
            if aside.exists():
                _unfinished[aside] = handle
                return aside
            os.close(handle)


def _remove_abandoned(folder: Path, start: str) -> None:
    """Remove the temporary files in ``folder`` whose names begin with ``start`` and whose processes have ended."""
    temporary = re.compile(re.escape(start) + r"(.*\.)?\d+\.[a-z0-9_]{8}\.part")
    with suppress(OSError):  # a folder without the right to list it
        for name in filter(temporary.fullmatch, os.listdir(folder)):
            _remove_if_abandoned(folder / name)


def _remove_if_abandoned(path: Path) -> None:
    """Remove ``path`` unless a running process holds its lock; this process holds the lock meanwhile."""
    if fcntl is None:
        return
    if path.is_symlink():  # never created here
        _remove(path)
        return
    with suppress(OSError):  # the file belongs to another user, no longer exists, or is in use
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(path)
        finally:
            os.close(handle)


def _remove(path: Path) -> None:
    """Remove a file, a link or a folder; errors are ignored."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _put_all(places: dict[Path, Path]) -> None:
    for whole, target in places.items():
        if whole.exists():
            _put(whole, target)


def _put(aside: Path, target: Path) -> None:
    """Flush ``aside`` to the disk and rename it to ``target``; a file that it replaces passes on owner and mode."""
    handle = os.open(aside, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
    try:
        old = os.stat(target)
    except FileNotFoundError:
        os.chmod(aside, 0o666 & ~_umask())
    else:
        if hasattr(os, "chown"):
            with suppress(OSError):  # only root may change the owner
                os.chown(aside, old.st_uid, old.st_gid)
        os.chmod(aside, old.st_mode & 0o777)
    try:
        os.replace(aside, target)
    except OSError as error:
        if error.errno != errno.EXDEV:  # the target of a link may be on another file system
            raise
        with write_aside(target) as beside:
            shutil.copyfile(aside, beside)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
