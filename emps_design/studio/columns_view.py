"""The columns of a dropped file: what each was taken for, to be chosen anew and read again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import panel as pn

from emps_design.records.columns import factor_of, title_unit
from emps_design.records.layout import Assignment
from emps_design.records.mapping import KEYS, Column, ColumnMap
from emps_design.records.recognise import meanings
from emps_design.studio.panes import html
from emps_design.units import Units

NONE, AS_TITLED = "none", "as titled"
CHOSEN = ("t", "q", "q_ref", "u")  # the columns that a record is made of
UNITS = ("s", "ms", "us", "m", "mm", "um", "rad", "deg", "rev", "V", "mV", "A", "mA", "N m", "N", "%")


class ColumnsView:
    """Two fields for each column of a record, and a button that hands them to ``read`` as a ``[record]`` table."""

    def __init__(self, read: Callable[[ColumnMap], None]):
        self._read = read
        self.titles = {
            name: pn.widgets.Select(label=KEYS[name].capitalize(), options=[NONE], width=190, margin=(4, 6))
            for name in CHOSEN
        }
        self.units = {
            name: pn.widgets.Select(label=f"Unit of {KEYS[name]}", options=[AS_TITLED], width=110, margin=(4, 6))
            for name in CHOSEN
        }
        self.button = pn.widgets.Button(label="Read these columns", color="primary", width=160, margin=(24, 6, 4, 6))
        self.button.on_click(lambda event: self._read(self.table))
        self.about = html("Columns of the file, and what each is. Choose anew where a wrong one was taken.")
        pairs = [pn.Column(self.titles[name], self.units[name], margin=0) for name in CHOSEN]
        self.view = pn.Column(self.about, pn.FlexBox(*pairs, self.button, align_items="flex-start"), visible=False)

    @property
    def table(self) -> ColumnMap:
        """What is chosen, as the ``[record]`` table of an axis file."""
        chosen = {
            KEYS[name]: Column(column=self.titles[name].value, unit=None if unit == AS_TITLED else unit)
            for name in CHOSEN
            if self.titles[name].value != NONE and (unit := self.units[name].value)
        }
        return ColumnMap.model_validate(chosen)

    def show(self, titles: Sequence[str], assigned: Sequence[Assignment], units: Units) -> None:
        """Offer the ``titles`` of a file: what they were ``assigned`` to is chosen, or what they seem to say."""
        taken = {one.name: one.title for one in assigned}
        for name, found in meanings(titles, units).items():
            if len(found) == 1:
                taken.setdefault(name, found[0])
        for name in CHOSEN:
            known = [unit for unit in UNITS if factor_of(unit, name, units) is not None]
            title = taken.get(name, NONE)
            self.titles[name].param.update(options=[NONE, *titles], value=title if title in titles else NONE)
            stated = title_unit(title)[1] in known
            given = next((one.unit for one in assigned if one.name == name and one.unit in known), AS_TITLED)
            self.units[name].param.update(options=[AS_TITLED, *known], value=AS_TITLED if stated else given)
        self.view.visible = True

    def hide(self) -> None:
        """Show nothing: the columns of the file have the names of a record."""
        self.view.visible = False
