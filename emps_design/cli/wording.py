"""What the library says, in the words of this command line and of the axis it is about.

The library writes for a linear axis that is told a voltage, and names `arguments`. One command runs in one process and
is about one axis, so everything that is printed passes :func:`in_words`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from emps_design.cli.flags import in_flags
from emps_design.units import Units

if TYPE_CHECKING:
    from emps_design.axis import Axis

_at_hand = [Units()]


def load_axis(name_or_path: str | Path) -> Axis:
    """The axis of that name or file; what is printed from here on is in its units."""
    from emps_design.machines import load_axis

    axis = load_axis(name_or_path)
    speak(axis.units)
    return axis


def speak(units: Units) -> None:
    """Print in ``units`` from here on."""
    _at_hand[0] = units


def in_words(text: str) -> str:
    """``text`` of the library with flags for arguments, in the units and words of the axis at hand."""
    return in_flags(_at_hand[0].text(text))


def in_units(value: str) -> str:
    """A text of a JSON document in the units and words of the axis at hand; a single word of it is a name."""
    return _at_hand[0].value(value)


def for_reader(size: float, base: str) -> tuple[str, float]:
    """The unit in which ``size`` [SI of ``base``] is shown to a reader of the axis at hand, and the factor to it."""
    return _at_hand[0].display(size, base)
