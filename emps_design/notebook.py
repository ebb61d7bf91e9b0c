"""HTML tables of results for notebooks, as ``_repr_html_`` returns them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def table(title: str, rows: Iterable[Sequence[Any]], heads: Sequence[str] = (), missing: str = "—") -> str:
    """Return ``title`` and ``rows`` as HTML; numbers with five digits, None as ``missing``, text escaped.

    >>> table("small", [("mass", 10.0, "kg"), ("limit", None, "V")])
    '<p>small</p><table><tr><td>mass</td><td>10</td><td>kg</td></tr><tr><td>limit</td><td>—</td><td>V</td></tr></table>'
    """
    head = _row("th", heads, missing) if heads else ""
    return f"<p>{escape(title)}</p><table>{head}{''.join(_row('td', row, missing) for row in rows)}</table>"


def _row(tag: str, cells: Sequence[Any], missing: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{_cell(cell, missing)}</{tag}>' for cell in cells)}</tr>"


def _cell(value: Any, missing: str) -> str:
    if value is None:
        return missing
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else escape(str(value))
