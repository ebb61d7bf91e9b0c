"""Output of every command: JSON and tables on standard output, progress and warnings on standard error.

The library writes its messages for a linear axis with a voltage as command, and names arguments between backquotes. A
process runs one command on one axis, so everything printed passes :func:`in_words`, which puts in the flags of this
command line and the units of that axis. The advice on a result is a key of the document and the last line printed.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.advice import Advice, advise, advise_on_error
from emps_design.errors import EmpsError, one_line, printable
from emps_design.progress import Progress, no_progress
from emps_design.units import Units
from emps_design.view import BLOCKS, Line, show as show_part

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from emps_design.axis import Axis
    from emps_design.view import View

# The library writes an argument between backquotes, with or without a value: `chain='hold'`.
FLAGS = {
    "bootstrap": "--bootstrap",
    "confirm_time": "--confirm-time",
    "cutoff": "--cutoff",
    "cutoff_hz": "--cutoff",
    "design_on": "--design-on",
    "estimator": "--estimator",
    "external_force='known'": "--external-force known",
    "filter": "--filter",
    "fit_time": "--fit-time",
    "holdout": "--holdout",
    "identify": "--estimator ls",
    "mismatch": "--mismatch",
    "model": "--model",
    "peak": "--peak",
    "phase_deg": "--phase",
    "position_kp": "--position-kp",
    "rate": "--rate",
    "record": "--record",
    "retune": "--retune",
    "target": "--to",
    "window": "--time",
    "with_": "--with",
}
# A report identifies as well; its own --filter is that of the impedance law.
FLAGS_OF = {
    "report": {
        "cutoff": "--cutoff of 'identify'",
        "external_force='known'": "--external-force known of 'identify'",
        "filter='hold'": "--record-filter hold",
        "with_": "--with of 'identify'",
    }
}

_units = [Units()]  # those of the axis that the command is about
_words: list[str] = []  # of the command line, from the name of the command on
_flags: dict[str, str] = {}  # of the running command, by the names of its options
_unchecked: list[tuple[str, float, str]] = []  # options with units that only the axis tells: name, number, unit

LOOKING = "looking for the controller that made the record"  # the stage that law and init --from show
NAMES = ("name", "axis", "record", "records", "file", "files", "out", "directory", "machine", "column", "title", "next")
MESSAGES = ("reason", "warnings")  # keys under which the library's messages stand; all other text is data

PLAIN = str.maketrans(f"{BLOCKS}─", "_.-=+*#@-")  # for a terminal without blocks and rules


def in_flags(text: str, command: str = "") -> str:
    """Return ``text`` with every argument of the library as the flag of ``command`` that sets it.

    >>> in_flags("too slow for a cut-off; give `cutoff`, or use `filter='report'`")
    'too slow for a cut-off; give --cutoff, or use --filter report'
    >>> in_flags("use `filter='hold'`", "report")
    'use --record-filter hold'
    """
    flags = FLAGS | _flags | FLAGS_OF.get(command, {})

    def flag(argument: re.Match[str]) -> str:
        name, _, value = argument[1].partition("=")
        if argument[1] in flags:
            return flags[argument[1]]
        return f"{flags[name]} {value.strip(chr(39))}".rstrip() if name in flags else argument[0]

    return re.sub(r"`([^`]+)`", flag, text)


def load_axis(name_or_path: str | Path) -> Axis:
    """Return the axis of that name or file, and print in its units from here on."""
    from emps_design.machines import load_axis

    axis = load_axis(name_or_path)
    set_units(axis.units)
    return axis


def begin(words: Sequence[str]) -> None:
    """Start a command with these ``words`` of the command line: forget units and options of the one before."""
    _units[0], _words[:] = Units(), words
    _flags.clear()
    _unchecked.clear()


def set_units(units: Units) -> None:
    """Print in ``units`` from here on, and check the options that waited for them; :class:`InputError` if one fails."""
    _units[0] = units
    while _unchecked:
        units.check(*_unchecked.pop(0), positive=True)


def set_flags(flags: dict[str, str]) -> None:
    """Name options of the running command by these ``flags``."""
    _flags.update(flags)


def check_option(name: str, value: float, base: str) -> float:
    """Check ``value`` [``base``] of the option ``name``: now, or in :func:`set_units` if the axis decides the unit."""
    if Units("rotary").unit(base) == base:
        return Units().check(name, value, base, positive=True)
    _unchecked.append((name, value, base))
    return value


def in_words(text: str) -> str:
    """Return ``text`` of the library with flags for arguments, in the units and words of the axis."""
    return in_command(_units[0].text(text))


def in_command(text: str) -> str:
    """Return ``text`` of the library with the flags of the running command for arguments."""
    return in_flags(text, _words[0] if _words else "")


def display_unit(size: float, base: str) -> tuple[str, float]:
    """Return the unit in which ``size`` [SI of ``base``] is shown for this axis, and the factor to it."""
    return _units[0].display(size, base)


def plain(value: Any, key: str = "") -> Any:
    """Return ``value`` as JSON data: numpy to Python, complex to [re, im], Infinity and NaN to None.

    Texts other than names are in the units of the axis; arguments that a message names become flags.
    """
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(value, str):
        value = value if key in NAMES else _units[0].value(value)
        return in_command(value) if key in MESSAGES else value
    if isinstance(value, dict):
        return {str(name): plain(item, str(name)) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, key) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def json_text(document: Any) -> str:
    """Return ``document`` as JSON; control characters of a terminal are escaped.

    >>> print(json_text({"name": "é\\x9b31m", "gain": math.inf}))
    {
     "name": "é\\u009b31m",
     "gain": null
    }
    """
    text = json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)
    return "\n".join(line if line.isprintable() else _printable(line) for line in text.split("\n"))


def _printable(line: str) -> str:
    """Return ``line`` with unprintable characters escaped."""
    return "".join(c if c.isprintable() else _escaped(c) for c in line)


def _escaped(character: str) -> str:
    """Return the JSON escape of one character: its UTF-16 units."""
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4))


def print_json(document: Any) -> None:
    """Print one JSON document on standard output; the same data gives the same bytes."""
    text = json_text(document)
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        text = "".join(c if c.isascii() else _escaped(c) for c in text)
    sys.stdout.write(f"{text}\n")


def say(text: object = "") -> None:
    """Print ``text`` on standard output; unprintable characters, which names may hold, are shown as ``?``."""
    print(printable(in_words(str(text))))


def show(text: str) -> None:
    """Print ``text`` of the user's own files on standard output: unchanged but for unprintable characters."""
    print(printable(text))


def tell(text: object) -> None:
    """Print ``text`` as one line of this program on standard error."""
    print(f"emps-design: {one_line(in_words(str(text)))}", file=sys.stderr)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print each warning as one line on standard error."""
    for warning in warnings:
        tell(f"warning: {warning}")


def print_view(view: View) -> None:
    """Print ``view`` on standard output, with flags for the arguments that its lines name."""
    from rich.console import Console

    plain = not (sys.stdout.encoding or "ascii").lower().startswith("utf")
    console = Console(markup=False, emoji=False, highlight=False)
    for part in view:
        if isinstance(part, Line):
            words = part.text if part.style == "code" else in_command(part.text)
            part = replace(part, text=words.translate(PLAIN) if plain else words)
        show_part(console, part)


def new_console() -> Console:
    """Return a console for tables on standard output that prints text without markup or escape sequences."""
    from rich.console import Console

    class Plain(Console):
        def render_str(self, text: str, **options: Any) -> Any:
            return super().render_str(printable(in_words(text)), **options)

    return Plain(markup=False, emoji=False)


def new_table(title: str, *headings: str, words: Collection[str] = (), whole: bool = False, **look: Any) -> Table:
    """Return a table with ``headings``: the first column and those in ``words`` are text, the others right-aligned.

    ``whole``: no cell is broken over lines; ``look`` goes to :class:`rich.table.Table`.
    """
    from rich import box
    from rich.table import Table

    table = Table(title=title or None, box=box.SIMPLE, **look)
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place and heading not in words else "left", no_wrap=whole)
    return table


@contextmanager
def progress_bar(show: bool = True) -> Iterator[Progress]:
    """Yield a ``progress(stage, fraction)`` that draws on standard error: a bar, or one line per stage."""
    if not show:
        yield no_progress
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeElapsedColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
        )
        bar = Bar(*columns, console=Console(stderr=True), transient=True)
        task = bar.add_task("", total=1.0)

        def draw(stage: str, fraction: float) -> None:
            bar.start()  # at the first report, and not again
            bar.update(task, description=stage, completed=fraction)

        try:
            yield draw
        finally:
            bar.stop()
    else:
        stages: list[str] = []

        def report(stage: str, fraction: float) -> None:
            if not stages or stages[-1] != stage:
                stages.append(stage)
                tell(stage)

        yield report


def add_advice(
    document: dict[str, Any], axis: str | Path | None = None, records: Iterable[str | Path] = ()
) -> dict[str, Any]:
    """Return the ``document`` of the running command, which read those files, with its advice."""
    files = [str(record) for record in records]
    name = None if axis is None else str(axis)
    advice = advise(_words[0], document, tuple(_words), name, files, _units[0])
    return {**document, "advice": _in_flags(advice).to_dict()}


def advice_on_error(error: EmpsError) -> Advice | None:
    """Return the advice when the running command ends with ``error``, or None if that is not about a design."""
    if error.exit_code not in (3, 4) or not _words:
        return None
    nearest = getattr(error, "nearest", {})
    return _in_flags(advise_on_error(_words[0], error.exit_code, str(error), nearest, tuple(_words)))


def _in_flags(advice: Advice) -> Advice:
    return Advice(advice.level, in_command(advice.text), advice.next)


def say_advice(document: dict[str, Any]) -> None:
    """Print the advice of ``document`` as one line on standard output."""
    advice = Advice(**document["advice"])
    show(str(Advice(advice.level, in_words(advice.text), advice.next)))
