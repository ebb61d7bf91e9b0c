"""What a record tells of the controller that made it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

TOLD, AMBIGUOUS, NOT_TOLD = "told", "ambiguous", "not told"


@dataclass(frozen=True)
class LawEstimate:
    """The controller that made a record, as the ``[controller]`` table of an axis file, or why it cannot be told.

    ``verdict`` is "told"; "ambiguous", where ``equivalents`` explain the record as well; or "not told", with the
    ``reason`` and no ``controller``: ``closest`` is then the law that came nearest, if one came near, and is not the
    machine's. ``std`` has the standard deviations in the shape of the table.
    ``residual_rms`` [command unit] is what the law leaves of the command, ``residual_share`` the same over the
    command's standard deviation, and ``allowed_rms`` what the record's own noise and resolution would leave.
    ``limit`` [command unit] is None where it never acts; ``delay`` [samples] lies between a measurement and its
    command; ``tried`` has the structures that were compared, with what each leaves; ``notes`` say what a table cannot
    hold.
    """

    record: str
    verdict: str
    reason: str
    controller: dict[str, Any] | None
    std: dict[str, Any]
    residual_rms: float | None
    residual_share: float | None
    command_unit: str
    delay: int = 0
    limit: float | None = None
    limited_samples: int = 0
    equivalents: tuple[dict[str, Any], ...] = ()
    tried: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    closest: dict[str, Any] | None = None
    allowed_rms: float | None = None
    warnings: tuple[str, ...] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "record": self.record,
            "verdict": self.verdict,
            "reason": self.reason,
            "controller": self.controller,
            "std": self.std,
            "closest": self.closest,
            "residual": {
                "rms": self.residual_rms,
                "share": self.residual_share,
                "allowed": self.allowed_rms,
                "unit": self.command_unit,
            },
            "delay": self.delay,
            "limit": {"value": self.limit, "samples": self.limited_samples, "unit": self.command_unit},
            "equivalents": list(self.equivalents),
            "tried": list(self.tried),
            "notes": list(self.notes),
            "warnings": list(self.warnings),
        }

    @property
    def in_words(self) -> str:
        """The controller in one line, its numbers to five digits; "" where it is not told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0000001}, {}, 0.0, 0.0, "V").in_words
        'p with kp = 2'
        """
        return "" if self.controller is None else self._said(self.controller)

    @property
    def closest_in_words(self) -> str:
        """The law that came nearest, in one line likewise; "" where none did, or the controller is told.

        >>> LawEstimate("r", NOT_TOLD, "", None, {}, 0.0, 0.0, "V", closest={"kind": "p", "kp": 2.0}).closest_in_words
        'p with kp = 2'
        """
        return "" if self.closest is None else self._said(self.closest)

    @staticmethod
    def _said(table: dict[str, Any]) -> str:
        kind, *rest = table.items()
        return f"{kind[1]} with {', '.join(f'{name} = {_inline(value, 5)}' for name, value in rest)}"

    @property
    def numbers(self) -> list[tuple[str, float, float]]:
        """The numbers of the table that have a deviation: place in it, value and standard deviation.

        >>> table, std = {"kind": "cascade", "velocity": {"kp": 2.0}}, {"velocity": {"kp": 0.1}}
        >>> LawEstimate("r", TOLD, "", table, std, 0.0, 0.0, "V").numbers
        [('velocity.kp', 2.0, 0.1)]
        """
        return [] if self.controller is None else _numbers(self.controller, self.std)

    def to_toml(self) -> str:
        """The ``[controller]`` table alone, ready to paste into an axis file; raises ``ValueError`` where none is told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0}, {}, 0.0, 0.0, "V").to_toml()
        '[controller]\\nkind = "p"\\nkp = 2.0\\n'
        """
        if self.controller is None:
            raise ValueError(f"{self.record}: {self.reason}")
        return "[controller]\n" + "".join(f"{name} = {_inline(value)}\n" for name, value in self.controller.items())


def _numbers(table: Any, std: Any, name: str = "") -> list[tuple[str, float, float]]:
    """The numbers of a ``table`` that have one in ``std``, by their place in it."""
    if isinstance(std, dict):
        pairs = [(f"{name}.{key}" if name else key, table[key], one) for key, one in std.items()]
    elif isinstance(std, list):
        pairs = [(f"{name}[{i}]", table[i], one) for i, one in enumerate(std)]
    else:
        return [(name, table, std)]
    return [row for key, value, one in pairs for row in _numbers(value, one, key)]


def _inline(value: Any, digits: int = 0) -> str:
    """A value on one line of TOML, numbers to so many ``digits``, 0: as they are."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_inline(one, digits)}" for name, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(one, digits) for one in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:.{digits}g}" if digits else repr(value)
