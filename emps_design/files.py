"""Files that are whole or absent: written aside, then renamed."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from emps_design.errors import EmpsError, InputError

try:
    import fcntl
except ImportError:  # a system without these locks cannot tell what was abandoned, and leaves it
    fcntl = None  # type: ignore[assignment]

LONGEST_NAME = 100  # bytes that the file aside repeats of a name; file systems take 255 in all
# What a disk refuses although the name was good.
_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
_unfinished: dict[Path, int] = {}  # what is being written aside, and the descriptor that locks it


def destination(path: str | Path) -> Path:
    """Return the file that writing to ``path`` replaces: itself, or where a symbolic link leads in the end.

    Raises :class:`InputError` for what no file may replace (a folder, a device, a pipe, a file that is
    write-protected), and where the folder does not exist or cannot be written.

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
            raise InputError(f"{path}: is {_what(mode)}, expected the name of a file to write")
        if mode is not None and not os.access(target, os.W_OK):
            raise InputError(f"{path}: cannot write there, it is write-protected; choose another name")
        if not stat.S_ISDIR(os.stat(target.parent).st_mode):
            raise InputError(f"{path}: {target.parent} is not a folder")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise InputError(f"{path}: cannot write there, no right to make a file in {target.parent}")
    except FileNotFoundError as error:
        raise InputError(f"{path}: folder {target.parent} does not exist; make it first") from error
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a ValueError is a name with a null byte
        raise InputError(f"{path}: cannot write there, {getattr(error, 'strerror', None) or error}") from error
    return target


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` to write to, and rename it when the block ends well.

    A failure, an interrupt or a kill leaves neither a half-written file nor a changed old one. What a killed process
    leaves aside, a hidden file that ends in ``.part``, goes with the next writing of ``path``. A file that is replaced
    keeps its mode, a symbolic link its target's place. Raises :class:`InputError` for what :func:`destination`
    refuses, and :class:`EmpsError` where the disk is full.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> with write_aside(folder / "note.txt") as aside:
    ...     _ = aside.write_text("whole")
    >>> [p.name for p in folder.iterdir()]
    ['note.txt']
    """
    target = destination(path)
    with _aside(path, target, _new_file) as aside, _told(path):
        yield aside
        _put(aside, target)


@contextmanager
def write_together(folder: str | Path) -> Iterator[Path]:
    """Give a temporary folder inside ``folder``; when the block ends well its files take their places, one by one.

    What belongs together is there together: a failure, an interrupt or a kill before that changes nothing. Raises
    :class:`InputError` when ``folder`` does not exist or cannot be written, or one of its files cannot be replaced.

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
    with _aside(folder, folder / folder.resolve().name, _new_folder) as aside, _told(folder):
        yield aside
        places = {whole: destination(folder / whole.name) for whole in sorted(aside.iterdir())}
        try:
            _put_all(places)
        except KeyboardInterrupt:  # half of a set is no set: the few renames that are left come first
            _put_all(places)
            raise


def read_bytes(path: str | Path, most: int, expected: str) -> bytes:
    """Return the content of an ordinary file of at most ``most`` bytes; nothing larger is ever in memory.

    Raises :class:`InputError` in one line that ends in what was ``expected``: for what cannot be read, for what is too
    large, and for devices and pipes, which have no end or none yet.
    """
    try:
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError(f"{path}: is not an ordinary file; {expected}")
            content = file.read(most + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a ValueError is a name with a null byte
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}; {expected}") from error
    if len(content) > most:
        raise InputError(f"{path}: found more than {most / 1e6:g} MB; {expected}")
    return content


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8, whole or not at all."""
    with write_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def discard_unfinished() -> None:
    """Remove what this process has written aside and not renamed yet: for an end that unwinds nothing."""
    for aside in tuple(_unfinished):
        _remove(aside)


def _what(mode: int) -> str:
    kinds = {stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a pipe", stat.S_ISSOCK: "a socket"}
    return next((name for is_kind, name in kinds.items() if is_kind(mode)), "a device")


@contextmanager
def _told(path: str | Path) -> Iterator[None]:
    """Say in one line which file the disk did not take."""
    try:
        yield
    except OSError as error:
        if error.errno not in _DISK:
            raise
        raise EmpsError(f"{path}: cannot be written, {error.strerror}; nothing there was changed") from error


@contextmanager
def _aside(path: str | Path, target: Path, new: Callable[[Path, str], Path]) -> Iterator[Path]:
    """A locked temporary file or folder beside ``target``, removed in the end; ``path`` is what messages call it."""
    start = _start(target.name)
    _remove_abandoned(target.parent, start)
    try:
        aside = _locked(target.parent, f"{start}{platform.node()[:40]}.{os.getpid()}.", new)
    except OSError as error:
        raise InputError(f"{path}: cannot write there, {error.strerror}") from error
    try:
        yield aside
    finally:
        _remove(aside)
        os.close(_unfinished.pop(aside))


def _start(name: str) -> str:
    """How the names of what is written aside for a file called ``name`` start; machine and process number follow."""
    long = len(os.fsencode(name)) > LONGEST_NAME
    return f".{hashlib.sha256(os.fsencode(name)).hexdigest()[:32] if long else name}."


def _new_file(folder: Path, start: str) -> Path:
    handle, name = tempfile.mkstemp(dir=folder, prefix=start, suffix=".part")
    os.close(handle)
    return Path(name)


def _new_folder(folder: Path, start: str) -> Path:
    return Path(tempfile.mkdtemp(dir=folder, prefix=start, suffix=".part"))


def _locked(folder: Path, start: str, new: Callable[[Path, str], Path]) -> Path:
    """Make one with ``new`` and lock it for as long as this process lives; a kill unlocks it."""
    while True:
        aside = new(folder, start)
        # Another process may take it for abandoned, and remove it, in the instant before it is locked.
        with suppress(FileNotFoundError):
            handle = os.open(aside, os.O_RDONLY)
            if fcntl is not None:
                with suppress(OSError):  # a file system without these locks: nothing there counts as abandoned
                    fcntl.flock(handle, fcntl.LOCK_EX)
            if aside.exists():
                _unfinished[aside] = handle
                return aside
            os.close(handle)


def _remove_abandoned(folder: Path, start: str) -> None:
    """Remove what processes that are no more have left in ``folder`` under names that begin with ``start``."""
    ours = re.compile(re.escape(start) + r"(.*\.)?\d+\.[a-z0-9_]{8}\.part")
    with suppress(OSError):  # a folder one may write to and not look into
        for name in filter(ours.fullmatch, os.listdir(folder)):
            _remove_if_abandoned(folder / name)


def _remove_if_abandoned(left: Path) -> None:
    """Remove ``left`` unless a living process holds its lock; with the lock held, so that none gets it meanwhile."""
    if fcntl is None:
        return
    if left.is_symlink():  # never made here
        _remove(left)
        return
    with suppress(OSError):  # of another user, gone by now, or in use
        handle = os.open(left, os.O_RDONLY | os.O_NONBLOCK)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(left)
        finally:
            os.close(handle)


def _remove(left: Path) -> None:
    """Remove a file, a link or a folder; one that cannot be removed keeps nobody from writing."""
    if left.is_dir() and not left.is_symlink():
        shutil.rmtree(left, ignore_errors=True)
    else:
        with suppress(OSError):
            left.unlink(missing_ok=True)


def _put_all(places: dict[Path, Path]) -> None:
    for whole, target in places.items():
        if whole.exists():
            _put(whole, target)


def _put(aside: Path, target: Path) -> None:
    """Let ``aside`` take the place of ``target`` and its mode, when it is on the disk."""
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
            with suppress(OSError):  # only root gives files away
                os.chown(aside, old.st_uid, old.st_gid)
        os.chmod(aside, old.st_mode & 0o777)
    try:
        os.replace(aside, target)
    except OSError as error:
        if error.errno != errno.EXDEV:  # a link may lead to another disk
            raise
        with write_aside(target) as beside:
            shutil.copyfile(aside, beside)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
