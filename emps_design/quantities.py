"""A physical quantity: its name, its symbol, its SI unit, and between which bounds it makes sense."""

from __future__ import annotations

import math
from dataclasses import dataclass

from emps_design.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """Name, symbol (LaTeX without dollars), SI unit and closed bounds of a number.

    >>> mass = Quantity("mass", "M", "kg", lower=0.0, text="load-side equivalent mass")
    >>> mass.check(95.1)
    95.1
    """

    name: str
    symbol: str
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    text: str = ""

    def check(self, value: float) -> float:
        """Return ``value`` [``unit``] as a float, or raise :class:`InputError` outside the bounds or not finite."""
        number = float(value)
        if not math.isfinite(number) or not self.lower <= number <= self.upper:
            unit = f" {self.unit}" if self.unit else ""
            raise InputError(
                f"{self.name}: found {number:g}{unit}, expected a number in [{self.lower:g}, {self.upper:g}]{unit}"
            )
        return number
