"""What a reader is to see of a result: lines and tables in their order, as data.

One description is rendered as text for the terminal and ``str``, and as HTML for a page, a notebook and a pane of the
studio. A view is made in the units and words of its axis; a renderer changes no text, but HTML has the signs ± and →.
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
STYLES = {"good": "bold green", "bad": "bold red", "strong": "bold"}  # of a line on a terminal
WHOLE = ("good", "bad", "code")  # styles of a line that is not wrapped
MARKS = {"note": "note: ", "point": "- "}  # before a line of a list on a terminal
BLOCKS = "▁▂▃▄▅▆▇█"
ALERT = ' role="alert"'  # of a verdict that a screen reader is to read at once
NUMBER = re.compile(r"[−+<≤>≥ -]*[0-9]|—$|-$")  # at the start of a cell with a number
Cell = Any  # text, a number or None


class Html(str):
    """Text that is HTML already, such as a symbol with its subscript: not escaped, and without its tags as text."""

    __slots__ = ()


@dataclass(frozen=True)
class Line:
    """A line of text; ``style`` is "", or "good", "warning" and "bad" for a verdict, "strong", "prose" and "code".

    Lines of the styles "note", a warning to read with the numbers, and "point" are lists where they follow one another.
    A terminal wraps a line at words, but a verdict and code, which stand as they are; a file has it in one line, but
    prose.
    """

    text: str
    style: str = ""

    def __post_init__(self) -> None:
        if self.style not in LINES:
            raise ValueError(f"style of a line: found {self.style!r}, expected one of {', '.join(LINES)}")


@dataclass(frozen=True)
class Table:
    """Rows under headings, with a title; a number has four significant digits, None is ``missing``.

    ``words`` are the headings of columns of text, aligned left as the first one is; the others are aligned right. The
    first cell of a row is its heading. Headings that are all empty are not shown.
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
    """A result with a ``view``: it prints as text and shows itself in a notebook."""

    def view(self) -> View:
        """What a reader is to see of it."""
        raise NotImplementedError

    def __str__(self) -> str:
        return text(self.view())

    def _repr_html_(self) -> str:
        return html(self.view())


def text(view: View, width: int = 80) -> str:
    """``view`` as text of at most ``width`` columns where its tables fit.

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
    """Print ``part`` on ``console``; unprintable characters, which names may hold, are shown as ``?``."""
    from rich.text import Text

    if isinstance(part, Line):
        whole = part.style in WHOLE or not (wrap or part.style == "prose")
        written = f"{MARKS.get(part.style, '')}{_plain(part.text)}"
        console.print(Text(written, STYLES.get(part.style, "")), soft_wrap=whole)
    else:
        table = _rich(part)
        if console.measure(table, options=console.options.update(width=10_000)).maximum > console.width:
            table.padding = (0, 1, 0, 0)  # closer columns
        console.print(table)


def _rich(table: Table) -> RichTable:
    """The table with numbers on the right."""
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
        shown.add_column(_plain(heading), justify="left" if words else "right", overflow="fold")
    for row in table.texts():
        shown.add_row(*map(_plain, row))
    return shown


def sparkline(values: np.ndarray, width: int = 60) -> str:
    """The means of ``values`` (n,) drawn in ``width`` characters.

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


def _plain(text: str) -> str:
    """``text`` as a terminal shows it.

    >>> _plain(Html("<i>k</i><sub>v1</sub> &lt; 1")), _plain("a <b>")
    ('kv1 < 1', 'a <b>')
    """
    return printable(unescape(re.sub(r"<[^<>]*>", "", text)) if isinstance(text, Html) else text)


def html(parts: Iterable[Any], other: Callable[[Any], str] | None = None) -> str:
    """``parts`` of a view as HTML, for a page, a notebook or a pane; ``other`` renders each that is no line.

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
    """``text`` with the signs of a page in place of those of a terminal.

    >>> typeset("7.4 +- 0.6 N; 1.6 N -> 0.4 N")
    '7.4 ± 0.6 N; 1.6 N → 0.4 N'
    """
    return text.replace("+-", "±").replace("->", "→")


def _escaped(text: str, code: bool = False) -> str:
    if isinstance(text, Html):
        return str(text)
    return escape(printable(text) if code else typeset(printable(text)), quote=False)


def table_html(table: Table, counted: str = "") -> str:
    """``table`` as HTML, with ``counted``, such as Table 2, before its title; numbers have the class number."""

    def cell(text: str, heading: bool) -> str:
        tag, look = ("th", "") if heading else ("td", ' class="number"' * bool(NUMBER.match(text)))
        return f"<{tag}{look}>{_escaped(text)}</{tag}>"

    title = f"<b>{counted}.</b> {_escaped(table.title)}" if counted else _escaped(table.title)
    caption = f"<caption>{title}</caption>" if table.title else ""
    head = "".join(cell(text, heading=True) for text in table.headings)
    head = f"<thead><tr>{head}</tr></thead>" if any(table.headings) else ""
    rows = ("".join(cell(text, place == 0) for place, text in enumerate(row)) for row in table.texts())
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"
