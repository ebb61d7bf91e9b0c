"""Controls of the state: a number field, a number field with a slider, and a row of fields for each filter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import panel as pn

from emps_design.laws.library.cascade import Filter
from emps_design.studio.ranges import CHOICES, Choice
from emps_design.studio.state import State

# The title of the slider stays in the page for screen readers and for the script that names its handle.
_SLIDER_STYLE = (
    ":host { --design-primary-color: #0072B2; } .bk-slider-title { font-size: 0; height: 0; } "
    ".noUi-handle:focus-visible { outline: 3px solid #E69F00; }"
)

NAMES = {"lowpass": "Low-pass", "notch": "Notch"}
NUMBERS = {"lowpass": ("frequency",), "notch": ("frequency", "damping", "depth")}


def after_this_event(callback: Callable[[], None]) -> None:
    """Call ``callback`` after the current event of the browser, or at once if there is no page.

    Only then does the browser accept another value in place of the one that it sent, and only then does the callback
    hold the lock of the page, which it needs to change figures.
    """
    if pn.state.curdoc is None:
        callback()
    else:
        pn.state.curdoc.add_next_tick_callback(callback)


class Field:
    """A field for the number ``name``; every change by the user calls ``on_change(name, value)``.

    A frequency is entered as text, with or without a unit; ``on_change`` gets the text, and then sets the field to the
    number in rad/s.
    """

    def __init__(self, name: str, value: float, on_change: Callable[[str, Any], None], width: int = 112):
        self.name, self.on_change, self._quiet = name, on_change, False
        self._pending: Any = None  # the widget that the user has changed, until on_change is called
        self.choice = choice = CHOICES[name]
        self.whole = isinstance(choice.step, int)
        common = {"label": choice.label, "width": width, "margin": (2, 6, 2, 6)}
        self.field: pn.widgets.TextInput | pn.widgets.IntInput | pn.widgets.FloatInput
        if choice.frequency:
            self.field = pn.widgets.TextInput(value=_format_number(value), **common)
        else:
            # Without bounds, since the browser would show but not send a number outside them.
            widget = pn.widgets.IntInput if self.whole else pn.widgets.FloatInput
            self.field = widget(value=value, step=choice.step, **common)
        self.field.param.watch(self._on_input, "value")

    def _on_input(self, event: Any) -> None:
        if self._quiet or event.new is None:
            return
        waiting, self._pending = self._pending is not None, event.obj
        if not waiting:  # of several changes before the callback only the last counts
            after_this_event(self._answer)

    def _answer(self) -> None:
        widget, self._pending = self._pending, None
        self.on_change(self.name, widget.value)

    def _quietly(self, change: Callable, *arguments: Any) -> None:
        """Call ``change(*arguments)`` without calling ``on_change``."""
        self._quiet = True
        try:
            change(*arguments)
        finally:
            self._quiet = False

    def set(self, value: float) -> None:
        """Show ``value`` without calling ``on_change``; a pending input of the user is not overwritten."""
        if self._pending is None:
            self._quietly(self._show, value)

    def _show(self, value: float) -> None:
        self.field.value = _format_number(value) if isinstance(self.field, pn.widgets.TextInput) else value

    def suit(self, state: State) -> None:
        """Take the label and the range of the number from ``state``."""
        choice = state.choices[self.name]
        self.field.label = state.axis.units.label(choice.label)
        if choice != self.choice:
            self.choice = choice
            self._quietly(self._range, choice)

    def _range(self, choice: Choice) -> None:
        if not isinstance(self.field, pn.widgets.TextInput):
            self.field.step = choice.step


class Knob(Field):
    """A field and a slider of the number ``name``."""

    def __init__(self, name: str, value: float, on_change: Callable[[str, Any], None]):
        super().__init__(name, value, on_change)
        choice = self.choice
        slider = pn.widgets.IntSlider if self.whole else pn.widgets.FloatSlider
        self.slider = slider(
            label=choice.label,
            value=value,
            start=choice.lower,
            end=choice.upper,
            step=choice.step,
            show_value=False,
            sizing_mode="stretch_width",
            margin=(22, 10, 0, 4),
            stylesheets=[_SLIDER_STYLE],
        )
        self.slider.param.watch(self._on_input, "value")
        self.view = pn.Row(self.field, self.slider, sizing_mode="stretch_width", margin=0)

    def _show(self, value: float) -> None:
        super()._show(value)
        self.slider.value = value

    def suit(self, state: State) -> None:
        """Take the label and the range of the number from ``state``."""
        super().suit(state)
        self.slider.label = self.field.label

    def _range(self, choice: Choice) -> None:
        super()._range(choice)
        self.slider.param.update(start=choice.lower, end=choice.upper, step=choice.step)

    def limit(self, low: float, high: float, value: float) -> None:
        """Limit the slider to ``low`` to ``high``, extended to ``value``; the field accepts any number."""
        low, high = min(low, value), max(high, value)
        high = high if high > low else low + self.choice.step
        self._quietly(lambda: self.slider.param.update(start=low, end=high))


def _format_number(value: float) -> str:
    return f"{value:.6g}"


class FilterRows:
    """A row of fields for each filter; a change by the user calls ``on_change(tables)`` with all filters as entered.

    ``default_filter(kind)`` is the filter that the button for ``kind`` adds.
    """

    def __init__(self, on_change: Callable[[list[dict[str, Any]]], None], default_filter: Callable[[str], Filter]):
        self._on_change, self._default_filter = on_change, default_filter
        self._quiet = self._waiting = False
        self._filters: tuple[Filter, ...] = ()
        self.fields: list[dict[str, pn.widgets.TextInput]] = []
        self.rows = pn.Column(margin=0)
        self.add_buttons = {
            kind: pn.widgets.Button(label=f"Add a {name.lower()}", width=145, margin=(4, 6))
            for kind, name in NAMES.items()
        }
        for kind, button in self.add_buttons.items():
            button.on_click(partial(self._pressed, partial(self._add, kind)))
        self.view = pn.Column(self.rows, pn.Row(*self.add_buttons.values(), margin=0), margin=0)

    @property
    def tables(self) -> list[dict[str, Any]]:
        """The filters as tables of an axis file; changed fields have the text of the user."""
        tables = [filter.model_dump(exclude_none=True) for filter in self._filters]
        for table, fields in zip(tables, self.fields, strict=True):
            entered = {
                name: str(field.value) for name, field in fields.items() if field.value != _format_number(table[name])
            }
            table |= {name: _read(text) for name, text in entered.items()}
        return tables

    def set(self, filters: tuple[Filter, ...]) -> None:
        """Show ``filters`` without calling ``on_change``; filters of the same kinds keep fields and pending input."""
        self._quiet = True
        try:
            before, self._filters = self._filters, filters
            kinds = [filter.kind for filter in filters]
            if [filter.kind for filter in before] != kinds:
                self.fields = [{name: self._field(kind, name) for name in NUMBERS[kind]} for kind in kinds]
                self.rows[:] = [self._row(place) for place in range(len(filters))]
            elif self._waiting:
                return
            for filter, fields in zip(filters, self.fields, strict=True):
                for name, field in fields.items():
                    field.value = _format_number(getattr(filter, name))
        finally:
            self._quiet = False

    def _field(self, kind: str, name: str) -> pn.widgets.TextInput:
        label = f"{NAMES[kind]} [Hz]" if name == "frequency" else name.capitalize()
        field = pn.widgets.TextInput(label=label, width=88 if name == "frequency" else 66, margin=(2, 0, 2, 6))
        field.param.watch(self._changed, "value")
        return field

    def _row(self, place: int) -> pn.Row:
        button = pn.widgets.Button(label="Remove", width=72, margin=(22, 0, 2, 6))
        button.on_click(partial(self._pressed, partial(self._remove, place)))
        return pn.Row(*self.fields[place].values(), button, margin=0)

    def _pressed(self, action: Callable[[], None], event: Any) -> None:
        after_this_event(action)

    def _changed(self, event: Any) -> None:
        if self._quiet or self._waiting:
            return
        self._waiting = True
        after_this_event(self._answer)

    def _answer(self) -> None:
        self._waiting = False
        self._on_change(self.tables)

    def _remove(self, place: int) -> None:
        self._on_change([table for at, table in enumerate(self.tables) if at != place])

    def _add(self, kind: str) -> None:
        self._on_change([*self.tables, self._default_filter(kind).model_dump(exclude_none=True)])


def _read(text: str) -> Any:
    """Return ``text`` as a number, or unchanged if it is not a plain number, such as a frequency with its unit."""
    try:
        return float(text)
    except ValueError:
        return text
