"""The filters of the command: a row of fields for each, to be changed or taken away, and buttons for one more."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import panel as pn

from emps_design.laws.library.cascade import Filter
from emps_design.studio.controls import after_this_event

NAMES = {"lowpass": "Low-pass", "notch": "Notch"}
NUMBERS = {"lowpass": ("frequency",), "notch": ("frequency", "damping", "depth")}


class FilterRows:
    """Fields of filters; ``heard(tables)`` has them all as tables, as typed, once one is changed by hand.

    ``another(kind)`` is the filter that its button adds.
    """

    def __init__(self, heard: Callable[[list[dict[str, Any]]], None], another: Callable[[str], Filter]):
        self._heard, self._another = heard, another
        self._quiet = self._waiting = False
        self._filters: tuple[Filter, ...] = ()
        self.fields: list[dict[str, pn.widgets.TextInput]] = []
        self.rows = pn.Column(margin=0)
        self.more = {
            kind: pn.widgets.Button(label=f"Add a {name.lower()}", width=145, margin=(4, 6))
            for kind, name in NAMES.items()
        }
        for kind, button in self.more.items():
            button.on_click(partial(self._pressed, partial(self._add, kind)))
        self.view = pn.Column(self.rows, pn.Row(*self.more.values(), margin=0), margin=0)

    @property
    def tables(self) -> list[dict[str, Any]]:
        """The filters as tables, what was typed as it is written."""
        found = [one.model_dump(exclude_none=True) for one in self._filters]
        for table, fields in zip(found, self.fields, strict=True):
            typed = {name: str(field.value) for name, field in fields.items() if field.value != _written(table[name])}
            table |= {name: _read(text) for name, text in typed.items()}
        return found

    def set(self, filters: tuple[Filter, ...]) -> None:
        """Show ``filters`` without telling anybody; fields that stay keep the cursor, and what waits for its answer."""
        self._quiet = True
        try:
            before, self._filters = self._filters, filters
            if [one.kind for one in before] != [one.kind for one in filters]:
                self.fields = [{name: self._field(one.kind, name) for name in NUMBERS[one.kind]} for one in filters]
                self.rows[:] = [self._row(place) for place in range(len(filters))]
            elif self._waiting:
                return
            for one, fields in zip(filters, self.fields, strict=True):
                for name, field in fields.items():
                    field.value = _written(getattr(one, name))
        finally:
            self._quiet = False

    def _field(self, kind: str, name: str) -> pn.widgets.TextInput:
        label = f"{NAMES[kind]} [Hz]" if name == "frequency" else name.capitalize()
        field = pn.widgets.TextInput(label=label, width=88 if name == "frequency" else 66, margin=(2, 0, 2, 6))
        field.param.watch(self._changed, "value")
        return field

    def _row(self, place: int) -> pn.Row:
        away = pn.widgets.Button(label="Remove", width=72, margin=(22, 0, 2, 6))
        away.on_click(partial(self._pressed, partial(self._take_away, place)))
        return pn.Row(*self.fields[place].values(), away, margin=0)

    def _pressed(self, act: Callable[[], None], event: Any) -> None:
        after_this_event(act)

    def _changed(self, event: Any) -> None:
        if self._quiet or self._waiting:
            return
        self._waiting = True
        after_this_event(self._answer)

    def _answer(self) -> None:
        self._waiting = False
        self._heard(self.tables)

    def _take_away(self, place: int) -> None:
        self._heard([table for at, table in enumerate(self.tables) if at != place])

    def _add(self, kind: str) -> None:
        self._heard([*self.tables, self._another(kind).model_dump(exclude_none=True)])


def _written(value: float) -> str:
    return f"{value:.6g}"


def _read(text: str) -> Any:
    """A number where ``text`` is one; a frequency keeps its unit, to be read where every other is."""
    try:
        return float(text)
    except ValueError:
        return text
