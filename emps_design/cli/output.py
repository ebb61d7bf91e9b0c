"""What every command shares: JSON and tables on standard output, progress and warnings on standard error.

The arguments that the library's messages name, as the flags of this command line.

What the library says, in the words of this command line and of the axis it is about.

The library writes for a linear axis that is told a voltage, and names `arguments`. One command runs in one process and
is about one axis, so everything that is printed passes :func:`in_words`.

The advice on what a command found: a key of its document, and the last line that people read.

A signal on one line of a terminal.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.advice import Advice, advise, advise_on_error
from emps_design.errors import EmpsError, one_line, printable
from emps_design.progress import Progress, no_progress
from emps_design.units import Units

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from emps_design.axis import Axis

# The library writes an argument between backquotes, with or without a value: `chain='hold'`.
FLAGS = {
    "bootstrap": "--bootstrap",
    "confirm_time": "--confirm-time",
    "cutoff": "--cutoff",
    "cutoff_hz": "--cutoff",
    "design_on": "--design-on",
    "estimator": "--estimator",
    "external_force='known'": "--external-force known",
    "external_force=": "--external-force",
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
# A report identifies too; its own --filter is that of the impedance law.
FLAGS_OF = {
    "report": {
        "cutoff": "--cutoff of 'identify'",
        "external_force='known'": "--external-force known of 'identify'",
        "filter": "--record-filter",
        "with_": "--with of 'identify'",
    }
}

_at_hand = [Units()]
_words: list[str] = []  # of the command line, from the name of the command on
_asked: list[tuple[str, float, str]] = []  # numbers of the command line, until the axis says their units

LOOKING = "looking for the controller that made the record"  # what law and init --from take their time for
NAMES = ("name", "axis", "record", "records", "file", "files", "out", "directory", "machine", "column", "title", "next")
MESSAGES = ("reason", "warnings")  # keys under which the library's messages stand; all other text is data

BLOCKS = "▁▂▃▄▅▆▇█"
PLAIN = "_.-=+*#@"


def in_flags(text: str, command: str = "") -> str:
    """Return ``text`` with every argument of the library as the flag of ``command`` that sets it.

    >>> in_flags("too slow for a cut-off; give `cutoff`, or use `filter='report'`")
    'too slow for a cut-off; give --cutoff, or use --filter report'
    >>> in_flags("use `filter='hold'`", "report")
    'use --record-filter hold'
    """
    flags = FLAGS | FLAGS_OF.get(command, {})

    def flag(argument: re.Match[str]) -> str:
        name, _, value = argument[1].partition("=")
        if argument[1] in flags:
            return flags[argument[1]]
        return f"{flags[name]} {value.strip(chr(39))}".rstrip() if name in flags else argument[0]

    return re.sub(r"`([^`]+)`", flag, text)


def load_axis(name_or_path: str | Path) -> Axis:
    """The axis of that name or file; what is printed from here on is in its units."""
    from emps_design.machines import load_axis

    axis = load_axis(name_or_path)
    speak(axis.units)
    return axis


def begin(words: Sequence[str]) -> None:
    """Forget the axis and the numbers of the command before the one that begins, with these ``words``."""
    _at_hand[0], _words[:] = Units(), words
    _asked.clear()


def at_hand() -> tuple[str, ...]:
    """The words of the command at hand, its name first."""
    return tuple(_words)


def speak(units: Units) -> None:
    """Print in ``units`` from here on; :class:`InputError` for an option, met before, that no machine has in them."""
    _at_hand[0] = units
    while _asked:
        units.check(*_asked.pop(0), positive=True)


def check_option(name: str, value: float, base: str) -> float:
    """Check ``value`` [``base``] of the option ``name``: now, or once the axis is known that says what ``base`` is."""
    if Units("rotary").unit(base) == base:
        return Units().check(name, value, base, positive=True)
    _asked.append((name, value, base))
    return value


def in_words(text: str) -> str:
    """``text`` of the library with flags for arguments, in the units and words of the axis at hand."""
    return in_command(_at_hand[0].text(text))


def in_command(text: str) -> str:
    """``text`` of the library with the flags of the command at hand for arguments."""
    return in_flags(text, _words[0] if _words else "")


def in_units(value: str) -> str:
    """A text of a JSON document in the units and words of the axis at hand; a single word of it is a name."""
    return _at_hand[0].value(value)


def for_reader(size: float, base: str) -> tuple[str, float]:
    """The unit in which ``size`` [SI of ``base``] is shown to a reader of the axis at hand, and the factor to it."""
    return _at_hand[0].display(size, base)


def plain(value: Any, key: str = "") -> Any:
    """Return ``value`` as JSON data: numpy to Python, complex to [re, im], Infinity and NaN to None.

    Texts are in the units of the axis at hand, but for names; arguments that a message names become flags.
    """
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(value, str):
        value = value if key in NAMES else in_units(value)
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
    """Return ``document`` as JSON; what a terminal would take for an order is escaped.

    >>> print(json_text({"name": "é\\x9b31m", "gain": math.inf}))
    {
     "name": "é\\u009b31m",
     "gain": null
    }
    """
    text = json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)
    return "\n".join(line if line.isprintable() else _printable(line) for line in text.split("\n"))


def _printable(line: str) -> str:
    """``line`` with what is not printable in it escaped."""
    return "".join(c if c.isprintable() else _escaped(c) for c in line)


def _escaped(character: str) -> str:
    """One character as JSON escapes it: its UTF-16 units."""
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4))


def print_json(document: Any) -> None:
    """Print one JSON document on standard output; the same data gives the same bytes."""
    text = json_text(document)
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        text = "".join(c if c.isascii() else _escaped(c) for c in text)
    sys.stdout.write(f"{text}\n")


def say(text: object = "") -> None:
    """Print ``text`` on standard output; what in it is no text (names may hold anything) is shown as ``?``."""
    print(printable(in_words(str(text))))


def show(text: str) -> None:
    """Print ``text`` of the user's own files on standard output: in their words, but for what is no text."""
    print(printable(text))


def tell(text: object) -> None:
    """Print ``text`` as one line of this program on standard error."""
    print(f"emps-design: {one_line(in_words(str(text)))}", file=sys.stderr)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print each warning as one line on standard error."""
    for warning in warnings:
        tell(f"warning: {warning}")


def new_console() -> Console:
    """Return a console for tables on standard output, to which text is text: no markup, no escape sequences in it."""
    from rich.console import Console

    class Plain(Console):
        def render_str(self, text: str, **options: Any) -> Any:
            return super().render_str(printable(in_words(text)), **options)

    return Plain(markup=False, emoji=False)


def new_table(title: str, *headings: str, words: Collection[str] = (), whole: bool = False, **look: Any) -> Table:
    """Return a table with ``headings``: the first column and ``words`` are text, the others numbers, set to the right.

    ``whole``: no cell is broken over lines; ``look`` is of :class:`rich.table.Table`.
    """
    from rich import box
    from rich.table import Table

    table = Table(title=title or None, box=box.SIMPLE, **look)
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place and heading not in words else "left", no_wrap=whole)
    return table


@contextmanager
def progress_bar(show: bool = True) -> Iterator[Progress]:
    """Give a ``progress(stage, fraction)`` that draws on standard error: a bar, or one line per stage."""
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
        with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
    else:
        seen: list[str] = []

        def report(stage: str, fraction: float) -> None:
            if not seen or seen[-1] != stage:
                seen.append(stage)
                tell(stage)

        yield report


def add_advice(
    document: dict[str, Any], axis: str | Path | None = None, records: Iterable[str | Path] = ()
) -> dict[str, Any]:
    """Return the ``document`` of the command at hand, given those files, with its advice."""
    words = at_hand()
    found = advise(words[0], document, words, None if axis is None else str(axis), [str(record) for record in records])
    return {**document, "advice": _in_flags(found).to_dict()}


def advice_on_error(error: EmpsError) -> Advice | None:
    """The advice where the command at hand ends with ``error``; None where that says nothing about a design."""
    words = at_hand()
    if error.exit_code not in (3, 4) or not words:
        return None
    nearest = getattr(error, "nearest", {})
    return _in_flags(advise_on_error(words[0], error.exit_code, str(error), nearest, words))


def _in_flags(found: Advice) -> Advice:
    return Advice(found.level, in_command(found.text), found.next)


def say_advice(document: dict[str, Any]) -> None:
    """Print the advice of ``document`` as one line on standard output."""
    advice = Advice(**document["advice"])
    show(str(Advice(advice.level, in_words(advice.text), advice.next)))


def sparkline(values: np.ndarray, width: int = 60, encoding: str = "utf-8") -> str:
    """Draw ``values`` (n,) in ``width`` characters, the lowest at the bottom; plain ones where no others can be shown.

    >>> import numpy as np
    >>> sparkline(np.arange(100.0), 8), sparkline(np.ones(5), 3), sparkline(np.arange(9.0), 4, "ascii")
    ('▁▂▃▄▅▆▇█', '▁▁▁', '_-+@')
    """
    marks = BLOCKS if encoding.lower().startswith("utf") else PLAIN
    edges = np.linspace(0, values.size, min(width, values.size) + 1).astype(int)
    means = np.array([values[a:b].mean() for a, b in pairwise(edges)])
    span = float(np.ptp(means))
    heights = np.zeros(means.size) if span == 0.0 else (means - means.min()) / span * (len(marks) - 1)
    return "".join(marks[round(height)] for height in heights)
