"""Controls for one number of the state: a field to type in, alone or with a slider to turn, kept in step."""

from __future__ import annotations

from collections.abc import Callable

import panel as pn

from emps_design.studio.state import CHOICES

# The title of the slider stays in the page for screen readers (and for the script that names its handle).
_QUIET = (
    ":host { --design-primary-color: #0072B2; } .bk-slider-title { font-size: 0; height: 0; } "
    ".noUi-handle:focus-visible { outline: 3px solid #E69F00; }"
)


class Field:
    """A field for the number ``name``; ``on_change(name, value)`` hears every change made by hand."""

    def __init__(self, name: str, value: float, on_change: Callable[[str, float], None], width: int = 112):
        self.name, self.on_change, self._quiet = name, on_change, False
        choice = CHOICES[name]
        self.options = {
            "label": choice.label,
            "value": value,
            "start": choice.lower,
            "end": choice.upper,
            "step": choice.step,
        }
        self.whole = isinstance(choice.step, int)
        widget = pn.widgets.IntInput if self.whole else pn.widgets.FloatInput
        # With bounds the browser would keep a number outside them to itself, over a design that it does not belong to.
        unbounded = {key: option for key, option in self.options.items() if key not in ("start", "end")}
        self.field = widget(**unbounded, width=width, margin=(2, 6, 2, 6))
        self.shown = (self.field,)
        self.field.param.watch(self._heard, "value")

    def _heard(self, event) -> None:
        if self._quiet or event.new is None:
            return
        self.set(event.new)
        self.on_change(self.name, event.new)

    def restore(self, value: float) -> None:
        """Show ``value`` again in place of one that was just typed and refused."""
        if pn.state.curdoc is None:
            self.set(value)
        else:  # the browser is told of a value that replaces the one it has just sent only after this event
            pn.state.curdoc.add_next_tick_callback(lambda: self.set(value))

    def set(self, value: float) -> None:
        """Show ``value`` without telling anybody."""
        self._quiet = True
        try:
            for widget in self.shown:
                widget.value = value
        finally:
            self._quiet = False


class Knob(Field):
    """A field and a slider of the number ``name``."""

    def __init__(self, name: str, value: float, on_change: Callable[[str, float], None]):
        super().__init__(name, value, on_change)
        slider = pn.widgets.IntSlider if self.whole else pn.widgets.FloatSlider
        self.slider = slider(
            **self.options, show_value=False, sizing_mode="stretch_width", margin=(22, 10, 0, 4), stylesheets=[_QUIET]
        )
        self.shown = (self.field, self.slider)
        self.slider.param.watch(self._heard, "value")
        self.view = pn.Row(self.field, self.slider, sizing_mode="stretch_width", margin=0)

    def limit(self, low: float, high: float) -> None:
        """Let the control reach ``low`` to ``high`` only; a value outside moves to the nearest end."""
        if low <= self.field.value <= high or pn.state.curdoc is None:
            self._limit(low, high)
        else:  # the browser is told of a value that replaces the one it has just sent only after this event
            pn.state.curdoc.add_next_tick_callback(lambda: self._limit(low, high))

    def _limit(self, low: float, high: float) -> None:
        self._quiet = True
        try:
            value = min(max(self.field.value, low), high)
            high = high if high > low else low + CHOICES[self.name].step
            self.slider.param.update(start=low, end=high, value=value)
            self.field.value = value  # the field takes any number, so that the page can say why it does not stay
        finally:
            self._quiet = False
