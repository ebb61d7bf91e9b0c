"""A pane of words and tables in the studio's style, which its shadow root would keep out otherwise."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from typing import Any

import panel as pn

from emps_design.report.advice import LEVELS
from emps_design.report.page import inline

STYLE = """
.message { padding: 5px 10px; border-left: 5px solid #56b4e9; background: #eef7fd; font-size: 13px; margin: 2px 0 4px; }
.message.stop { border-color: #b3261e; background: #fdecea; }
.message.good { border-color: #009e73; background: #e9f7f2; }
.message.warning { border-color: #e69f00; background: #fff8e6; }
table { border-collapse: collapse; font-size: 12.5px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 2px 9px 2px 4px; border-bottom: 1px solid #e5e7eb; vertical-align: bottom; }
th { font-weight: 400; }
table.numbers td, table.numbers tr + tr th { white-space: nowrap; }
table.numbers tr:first-child th { color: #4b5563; font-size: 11px; line-height: 1.15; }
table.about { font-size: 13px; max-width: 900px; }
table.about th { white-space: nowrap; vertical-align: top; padding-right: 18px; }
p { font-size: 13px; max-width: 900px; }
p.caption { color: #374151; margin: 2px 4px 10px; font-size: 12.5px; }
b.yes { color: #00664b; }
b.no { color: #b3261e; }
p.requirements { margin: 4px 4px 0; font-size: 12.5px; }
div.record { max-width: 880px; }
svg { width: 100%; height: auto; max-width: 980px; }
h3 { margin: 6px 0; font-size: 15px; }
"""


def html(text: str = "", **options: Any) -> pn.pane.HTML:
    """Return a pane of HTML that stretches over the width it has."""
    return pn.pane.HTML(text, stylesheets=[STYLE], **{"sizing_mode": "stretch_width", "margin": (0, 5), **options})


def message(text: str, level: str, more: str = "") -> str:
    """Return ``text`` as the HTML of a message, ``stop`` read out at once by screen readers; ``more`` is HTML."""
    role = "alert" if level == "stop" else "status"
    return f'<div class="message {level}" role="{role}">{inline(text)}{more}</div>'


def judgement(text: str, level: str, more: str = "") -> str:
    """Return the message on a result as HTML: what to do with it first, then ``text``, which says why.

    >>> judgement("The loop is unstable.", "stop")
    '<div class="message stop" role="alert"><b>Do not run this.</b> The loop is unstable.</div>'
    """
    title = dict(LEVELS.values())[level]
    return message("", level, f"<b>{title}</b> {inline(text)}{more}")


def numbers(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of numbers as HTML, under its ``heads``; the first cell of a row names it; cells are HTML.

    >>> numbers(("", "mass"), [("found", "2 kg")])
    '<table class="numbers"><tr><th></th><th>mass</th></tr><tr><th>found</th><td>2 kg</td></tr></table>'
    """
    head = "".join(f"<th>{one}</th>" for one in heads)
    lines = (f"<th>{name}</th>{''.join(f'<td>{cell}</td>' for cell in cells)}" for name, *cells in rows)
    return f'<table class="numbers"><tr>{head}</tr>{"".join(f"<tr>{line}</tr>" for line in lines)}</table>'


@cache
def _page_style() -> str:
    """The style of the report's pages, for blocks of a page inside a pane."""
    css = (files("emps_design.report") / "templates" / "page.css").read_text(encoding="utf-8")
    return css.replace(":root", ":host")


def blocks() -> pn.pane.HTML:
    """Return a pane for blocks of a report's page, in the look of the reports."""
    return pn.pane.HTML("", stylesheets=[_page_style()], sizing_mode="stretch_width", margin=(0, 5))
