"""Results become figures and pages here; nothing is computed."""

from __future__ import annotations

from emps_design.report.page import Callout, Facts, Formula, Group, Html, Page, Picture, Points, Section, Table, Text

__all__ = ["Callout", "Facts", "Formula", "Group", "Html", "Page", "Picture", "Points", "Section", "Table", "Text"]
