"""Views: the lines and tables that present a result, as data.

A view is rendered as text for the terminal and ``str``, and as HTML for a page, a notebook and a pane of the studio. It
is in the units and words of its axis. A renderer does not change its text, except that HTML shows +- and -> as ± and →.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape, unescape
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any

from emps_design.errors import printable

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console
    from rich.table import Table as RichTable

LINES = ("", "good", "warning", "bad", "note", "point", "strong", "prose", "code")  # styles of a line
STYLES = {"good": "bold green", "bad": "bold red", "strong": "bold"}  # rich styles, by style of a line
UNWRAPPED = ("good", "bad", "code")  # styles of a line that is not wrapped
MARKS = {"note": "note: ", "point": "- "}  # prefix of a list item on a terminal
BLOCKS = "▁▂▃▄▅▆▇█"
ALERT = ' role="alert"'  # makes a screen reader read a verdict at once
NUMBER = re.compile(r"[−+<≤>≥ -]*[0-9]|—$|-$")  # the start of a cell with a number
Cell = Any  # text, a number or None


class Html(str):
    """Text that is HTML, such as a symbol with a subscript: a page does not escape it, a terminal drops its tags."""

    __slots__ = ()


@dataclass(frozen=True)
class Line:
    """A line of text with a ``style``.

    The styles are "" (default), "good", "warning" and "bad" for a verdict, "strong", "prose", "code", and "note" and
    "point" for list items; successive items form a list. A terminal wraps lines at words, except verdicts and code. A
    file has each line unwrapped, except prose.
    """

    text: str
    style: str = ""

    def __post_init__(self) -> None:
        if self.style not in LINES:
            raise ValueError(f"style of a line: found {self.style!r}, expected one of {', '.join(LINES)}")


@dataclass(frozen=True)
class Table:
    """Rows under headings, with a title. Numbers have four significant digits; None is shown as ``missing``.

    The first cell of a row is its heading. The first column and those with a heading in ``words`` are text and aligned
    left; the others are aligned right. Headings that are all empty are not shown.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    words: Sequence[str] = ("unit",)
    missing: str = "-"

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headings):
                raise ValueError(f"table {self.title!r}: a row has {len(row)} cells, expected {len(self.headings)}")

    def texts(self) -> list[list[str]]:
        """The rows as text.

        >>> Table(("", "value"), [("mass", 95.1089), ("limit", None)]).texts()
        [['mass', '95.11'], ['limit', '-']]
        """
        return [[self._text(cell) for cell in row] for row in self.rows]

    def _text(self, cell: Cell) -> str:
        if cell is None:
            return self.missing
        return f"{cell:.4g}" if isinstance(cell, float) else cell if isinstance(cell, str) else str(cell)


View = tuple[Line | Table, ...]


class Viewed:
    """Base of a result with a ``view``: ``str`` and a notebook render it."""

    def view(self) -> View:
        """The lines and tables that present the result."""
        raise NotImplementedError

    def __str__(self) -> str:
        return text(self.view())

    def _repr_html_(self) -> str:
        return html(self.view())


def text(view: View, width: int = 80) -> str:
    """``view`` as text of at most ``width`` columns, unless a table is wider.

    >>> print(text((Line("stable", "good"), Table(("", "value", "unit"), [("mass", 95.1089, "kg")], "Loop"))))
    stable
    Loop
    <BLANKLINE>
            value   unit
     ───────────────────
     mass   95.11   kg
    """
    from rich.console import Console

    console = Console(width=width, markup=False, emoji=False, highlight=False, color_system=None)
    with console.capture() as captured:
        for part in view:
            show(console, part)
    return "\n".join(line.rstrip() for line in captured.get().rstrip().split("\n"))


def show(console: Console, part: Line | Table, wrap: bool = True) -> None:
    """Print ``part`` on ``console``; unprintable characters, as names may contain, are shown as ``?``."""
    from rich.text import Text

    if isinstance(part, Line):
        unwrapped = part.style in UNWRAPPED or not (wrap or part.style == "prose")
        line = f"{MARKS.get(part.style, '')}{_terminal_text(part.text)}"
        console.print(Text(line, STYLES.get(part.style, "")), soft_wrap=unwrapped)
    else:
        table = _rich(part)
        if console.measure(table, options=console.options.update(width=10_000)).maximum > console.width:
            table.padding = (0, 1, 0, 0)  # closer columns
        console.print(table)


def _rich(table: Table) -> RichTable:
    """``table`` as a table of rich, with numbers aligned right."""
    from rich import box
    from rich.table import Table as RichTable

    title = printable(table.title) or None
    shown = RichTable(
        title=title,
        title_justify="left",
        box=box.SIMPLE,
        pad_edge=False,
        min_width=len(table.title),
        show_header=any(table.headings),
    )
    for place, heading in enumerate(table.headings):
        words = place == 0 or heading in table.words
        shown.add_column(_terminal_text(heading), justify="left" if words else "right", overflow="fold")
    for row in table.texts():
        shown.add_row(*map(_terminal_text, row))
    return shown


def sparkline(values: np.ndarray, width: int = 60) -> str:
    """``values`` (n,) drawn as at most ``width`` bars, each the mean of a section.

    >>> import numpy as np
    >>> sparkline(np.arange(100.0), 8), sparkline(np.ones(5), 3)
    ('▁▂▃▄▅▆▇█', '▁▁▁')
    """
    import numpy as np

    edges = np.linspace(0, values.size, min(width, values.size) + 1).astype(int)
    means = np.array([values[a:b].mean() for a, b in pairwise(edges)])
    span = float(np.ptp(means))
    heights = np.zeros(means.size) if span == 0.0 else (means - means.min()) / span * (len(BLOCKS) - 1)
    return "".join(BLOCKS[round(height)] for height in heights)


def _terminal_text(text: str) -> str:
    """``text`` for a terminal: :class:`Html` without tags, and ``?`` for unprintable characters.

    >>> _terminal_text(Html("<i>k</i><sub>v1</sub> &lt; 1")), _terminal_text("a <b>")
    ('kv1 < 1', 'a <b>')
    """
    return printable(unescape(re.sub(r"<[^<>]*>", "", text)) if isinstance(text, Html) else text)


def html(parts: Iterable[Any], other: Callable[[Any], str] | None = None) -> str:
    """``parts`` of a view as HTML; ``other`` renders the parts that are no lines, by default :func:`table_html`.

    >>> html((Line("stable", "good"), Table(("", "value"), [("gain <", 2.0)], "Loop")))  # doctest: +ELLIPSIS
    '<p class="good">stable</p>\\n<table><caption>Loop</caption><thead><tr><th></th><th>value</th></tr></thead>...'
    >>> html((Line("late", "note"), Line("slow", "note")))
    '<ul class="note">\\n<li>late</li>\\n<li>slow</li>\\n</ul>'
    """
    written: list[str] = []
    for style, group in groupby(parts, lambda part: part.style if isinstance(part, Line) else None):
        if style is None:
            written += map(other or table_html, group)
            continue
        texts = [_escaped(line.text, style == "code") for line in group]
        if style in MARKS:
            items = "".join(f"<li>{text}</li>\n" for text in texts)
            written.append(f'<ul class="{style}">\n{items}</ul>')
        elif style == "code":
            lines = "\n".join(texts)
            written.append(f"<pre>{lines}</pre>")
        else:
            about = f' class="{style}"' if style else ""
            written += [f"<p{about}{ALERT * (style == 'bad')}>{text}</p>" for text in texts]
    return "\n".join(written)


def typeset(text: str) -> str:
    """``text`` with ± for +- and → for ->.

    >>> typeset("7.4 +- 0.6 N; 1.6 N -> 0.4 N")
    '7.4 ± 0.6 N; 1.6 N → 0.4 N'
    """
    return text.replace("+-", "±").replace("->", "→")


def _escaped(text: str, code: bool = False) -> str:
    if isinstance(text, Html):
        return str(text)
    return escape(printable(text) if code else typeset(printable(text)), quote=False)


def table_html(table: Table, number: str = "") -> str:
    """``table`` as HTML, with ``number``, such as Table 2, before its title; numeric cells have the class number."""

    def cell(text: str, heading: bool) -> str:
        tag, look = ("th", "") if heading else ("td", ' class="number"' * bool(NUMBER.match(text)))
        return f"<{tag}{look}>{_escaped(text)}</{tag}>"

    title = f"<b>{number}.</b> {_escaped(table.title)}" if number else _escaped(table.title)
    caption = f"<caption>{title}</caption>" if table.title else ""
    head = "".join(cell(text, heading=True) for text in table.headings)
    head = f"<thead><tr>{head}</tr></thead>" if any(table.headings) else ""
    rows = ("".join(cell(text, place == 0) for place, text in enumerate(row)) for row in table.texts())
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"
