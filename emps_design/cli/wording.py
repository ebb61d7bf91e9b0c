"""What the library says, in the words of this command line and of the axis it is about.

The library writes for a linear axis that is told a voltage, and names `arguments`. One command runs in one process and
is about one axis, so everything that is printed passes :func:`in_words`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from emps_design.cli.flags import in_flags
from emps_design.units import Units

if TYPE_CHECKING:
    from emps_design.axis import Axis

_at_hand = [Units()]
_words: list[str] = []  # of the command line, from the name of the command on
_asked: list[tuple[str, float, str]] = []  # numbers of the command line, until the axis says their units


def load_axis(name_or_path: str | Path) -> Axis:
    """The axis of that name or file; what is printed from here on is in its units."""
    from emps_design.machines import load_axis

    axis = load_axis(name_or_path)
    speak(axis.units)
    return axis


def begin(words: Sequence[str]) -> None:
    """Forget the axis and the numbers of the command before the one that begins, with these ``words``."""
    _at_hand[0], _words[:] = Units(), words
    _asked.clear()


def at_hand() -> tuple[str, ...]:
    """The words of the command at hand, its name first."""
    return tuple(_words)


def speak(units: Units) -> None:
    """Print in ``units`` from here on; :class:`InputError` for an option, met before, that no machine has in them."""
    _at_hand[0] = units
    while _asked:
        units.check(*_asked.pop(0), positive=True)


def check_option(name: str, value: float, base: str) -> float:
    """Check ``value`` [``base``] of the option ``name``: now, or once the axis is known that says what ``base`` is."""
    if Units("rotary").unit(base) == base:
        return Units().check(name, value, base, positive=True)
    _asked.append((name, value, base))
    return value


def in_words(text: str) -> str:
    """``text`` of the library with flags for arguments, in the units and words of the axis at hand."""
    return in_command(_at_hand[0].text(text))


def in_command(text: str) -> str:
    """``text`` of the library with the flags of the command at hand for arguments."""
    return in_flags(text, _words[0] if _words else "")


def in_units(value: str) -> str:
    """A text of a JSON document in the units and words of the axis at hand; a single word of it is a name."""
    return _at_hand[0].value(value)


def for_reader(size: float, base: str) -> tuple[str, float]:
    """The unit in which ``size`` [SI of ``base``] is shown to a reader of the axis at hand, and the factor to it."""
    return _at_hand[0].display(size, base)
