"""What every command shares: JSON and tables on standard output, progress and warnings on standard error."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from emps_design.cli.wording import in_command, in_units, in_words
from emps_design.errors import one_line, printable
from emps_design.progress import Progress, untold

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

LOOKING = "looking for the controller that made the record"  # what law and init --from take their time for
NAMES = ("name", "axis", "record", "records", "file", "files", "out", "directory", "machine", "column", "title", "next")
MESSAGES = ("reason", "warnings")  # keys under which the library's messages stand; all other text is data


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
        yield untold
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

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
