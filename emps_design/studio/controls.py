"""Controls for one number of the state: a field to type in, alone or with a slider to turn, kept in step.

The filters of the command: a row of fields for each, to be changed or taken away, and buttons for one more.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import panel as pn

from emps_design.laws.library.cascade import Filter
from emps_design.studio.ranges import CHOICES, Choice
from emps_design.studio.state import State

# The title of the slider stays in the page for screen readers (and for the script that names its handle).
_QUIET = (
    ":host { --design-primary-color: #0072B2; } .bk-slider-title { font-size: 0; height: 0; } "
    ".noUi-handle:focus-visible { outline: 3px solid #E69F00; }"
)

NAMES = {"lowpass": "Low-pass", "notch": "Notch"}
NUMBERS = {"lowpass": ("frequency",), "notch": ("frequency", "damping", "depth")}


def after_this_event(answer: Callable[[], None]) -> None:
    """Call ``answer`` once what the browser has just sent is dealt with: at once where there is no page.

    Only then does the browser listen to a value that replaces the one it sent, and the answer may change pictures: it
    holds the lock of the page, which an event does not.
    """
    if pn.state.curdoc is None:
        answer()
    else:
        pn.state.curdoc.add_next_tick_callback(answer)


class Field:
    """A field for the number ``name``; ``on_change(name, value)`` hears every change made by hand.

    A frequency is typed as text, with its unit or without; what is heard is what was typed, and ``on_change`` has the
    field show what it was taken for.
    """

    def __init__(self, name: str, value: float, on_change: Callable[[str, Any], None], width: int = 112):
        self.name, self.on_change, self._quiet = name, on_change, False
        self._moved: Any = None  # the widget that was changed by hand and has no answer yet
        self.choice = choice = CHOICES[name]
        self.whole = isinstance(choice.step, int)
        common = {"label": choice.label, "width": width, "margin": (2, 6, 2, 6)}
        self.field: pn.widgets.TextInput | pn.widgets.IntInput | pn.widgets.FloatInput
        if choice.frequency:
            self.field = pn.widgets.TextInput(value=_written(value), **common)
        else:
            # With bounds the browser would keep a number outside them to itself, over a design it does not belong to.
            widget = pn.widgets.IntInput if self.whole else pn.widgets.FloatInput
            self.field = widget(value=value, step=choice.step, **common)
        self.field.param.watch(self._heard, "value")

    def _heard(self, event: Any) -> None:
        if self._quiet or event.new is None:
            return
        waiting, self._moved = self._moved is not None, event.obj
        if not waiting:  # of what comes until then, the last counts
            after_this_event(self._answer)

    def _answer(self) -> None:
        widget, self._moved = self._moved, None
        self.on_change(self.name, widget.value)

    def _silently(self, change: Callable, *given: Any) -> None:
        """Call ``change`` without telling anybody."""
        self._quiet = True
        try:
            change(*given)
        finally:
            self._quiet = False

    def set(self, value: float) -> None:
        """Show ``value`` without telling anybody; a number typed since keeps its place until it has its answer."""
        if self._moved is None:
            self._silently(self._show, value)

    def _show(self, value: float) -> None:
        self.field.value = _written(value) if isinstance(self.field, pn.widgets.TextInput) else value

    def suit(self, state: State) -> None:
        """Have the name and the range that the number has in ``state``."""
        choice = state.choices[self.name]
        self.field.label = state.axis.units.label(choice.label)
        if choice != self.choice:
            self.choice = choice
            self._silently(self._range, choice)

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
            stylesheets=[_QUIET],
        )
        self.slider.param.watch(self._heard, "value")
        self.view = pn.Row(self.field, self.slider, sizing_mode="stretch_width", margin=0)

    def _show(self, value: float) -> None:
        super()._show(value)
        self.slider.value = value

    def suit(self, state: State) -> None:
        """Have the name and the range that the number has in ``state``."""
        super().suit(state)
        self.slider.label = self.field.label

    def _range(self, choice: Choice) -> None:
        super()._range(choice)
        self.slider.param.update(start=choice.lower, end=choice.upper, step=choice.step)

    def limit(self, low: float, high: float, value: float) -> None:
        """Let the slider reach ``low`` to ``high`` and ``value`` only.

        The field takes any number, so that the page can answer.
        """
        low, high = min(low, value), max(high, value)
        high = high if high > low else low + self.choice.step
        self._silently(lambda: self.slider.param.update(start=low, end=high))


def _written(value: float) -> str:
    return f"{value:.6g}"


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


def _read(text: str) -> Any:
    """A number where ``text`` is one; a frequency keeps its unit, to be read where every other is."""
    try:
        return float(text)
    except ValueError:
        return text
