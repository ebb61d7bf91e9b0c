"""What common drives call the gains of a cascade, and in which units: a row for each parameter, from its public manual.

Families whose manual was not found, or gives a gain no unit, are left out. A drive counts on its motor's side: where
the axis file has the reduction between motor and axis, numbers here are on that side too, else on the axis's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

POSITION, PROPORTIONAL, INTEGRAL = "position.kp", "velocity.kp", "velocity.ti"
BECKHOFF, YASKAWA = "https://infosys.beckhoff.com/content", "https://azmanual.top/manuals/802369"
Value = Callable[[float, Any], float | None]  # of a gain and an axis


@dataclass(frozen=True)
class Setting:
    """A parameter of a drive ``family``: its ``name``, its ``unit``, the gain that it holds, and its manual.

    ``value`` makes a gain of the axis file, SI, a number of that unit, None where the axis has another command.
    """

    family: str
    name: str
    unit: str
    gain: str
    source: str
    value: Value


def _times(factor: float) -> Value:
    return lambda gain, axis: factor * gain


def side_of(axis: Any) -> str:
    """The side on which :func:`drive_settings` counts force and speed: ``motor`` or ``axis``."""
    return "motor" if axis.drive.reduction else "axis"


def _force(gain: float, axis: Any) -> float:
    return float(gain * axis.drive.gain) / (axis.drive.reduction or 1.0) ** 2


def _turns(axis: Any) -> bool:
    """Whether the motion on that side is a rotation."""
    return axis.motion == "rotary" or axis.drive.reduction is not None


def _torque(gain: float, axis: Any) -> float | None:
    return _force(gain, axis) if _turns(axis) else None


def _current(gain: float, axis: Any) -> float | None:
    """In steps of 0.1 mA; None for a command in % of rated, whose amperes are not known."""
    amperes = axis.units.command_in("A")
    if amperes is None or not _turns(axis):
        return None
    return 1e4 * gain * amperes / (axis.drive.reduction or 1.0)


def _crossover(gain: float, axis: Any) -> float:
    return float(gain * axis.drive.gain / axis.mechanics.mass / (2.0 * math.pi))


SETTINGS = (
    Setting("Beckhoff AX5000", "S-0-0100", "Nm/(rad/s) or N/(m/s), with P-0-0010 bit 15 set", PROPORTIONAL,
            f"{BECKHOFF}/1031/ax5000_idn_description/1000502539.html", _force),
    Setting("Beckhoff AX5000", "S-0-0101", "ms", INTEGRAL,
            f"{BECKHOFF}/1031/ax5000_idn_description/1000532747.html", _times(1e3)),
    Setting("Beckhoff AX8000", "3140:01", "Nm/(rad/s), by default", PROPORTIONAL,
            f"{BECKHOFF}/1033/ax8xxx_object/18798255883.html", _torque),
    Setting("Beckhoff AX8000", "3140:02", "s", INTEGRAL,
            f"{BECKHOFF}/1031/ax8xxx_object/18798159243.html", _times(1.0)),
    Setting("Beckhoff EP7047", "8014:03", "0.1 mA/(rad/s)", PROPORTIONAL,
            f"{BECKHOFF}/1031/ep7047-1032/9243797771.html", _current),
    Setting("Beckhoff EP7047", "8014:04", "0.01 ms", INTEGRAL,
            f"{BECKHOFF}/1031/ep7047-1032/9243797771.html", _times(1e5)),
    Setting("Beckhoff AX2000-B750", "S-0-0104", "0.01 (m/min)/mm", POSITION,
            f"{BECKHOFF}/1031/ax2000-b750/15064279307.html", _times(6.0)),
    Setting("Beckhoff AX2000-B750", "S-0-0101", "0.1 ms", INTEGRAL,
            f"{BECKHOFF}/1031/ax2000-b750/15064277259.html", _times(1e4)),
    Setting("Yaskawa Sigma-II", "Pn102", "1/s", POSITION,
            "https://manualarchiveguide.com/manuals/YASKAWA-SGMAH-User-Manual-4781235?page=268", _times(1.0)),
    Setting("Yaskawa Sigma-II", "Pn100", "Hz, with Pn103 the inertia ratio", PROPORTIONAL,
            f"{YASKAWA}/yaskawa-large-capacity-sigma-ii-series.html?page=214", _crossover),
    Setting("Yaskawa Sigma-II", "Pn101", "0.01 ms", INTEGRAL,
            f"{YASKAWA}/yaskawa-large-capacity-sigma-ii-series.html?page=189", _times(1e5)),
)  # fmt: skip


def drive_settings(axis: Any, gains: dict[str, float]) -> list[dict[str, Any]]:
    """The parameters of each drive for ``gains`` of a PI cascade on ``axis``: position.kp, velocity.kp, .ti, SI.

    Each row also has its ``side``, as :func:`side_of` gives it.

    >>> from emps_design.machines import machine
    >>> rows = drive_settings(machine("emps2019"), {"velocity.ti": 0.018})
    >>> [(row["parameter"], round(row["value"], 9), row["unit"]) for row in rows if row["family"] == "Beckhoff AX5000"]
    [('S-0-0101', 18.0, 'ms')]
    """
    rows = []
    for setting in SETTINGS:
        value = setting.value(gains[setting.gain], axis) if setting.gain in gains else None
        if value is not None:
            rows.append({"family": setting.family, "parameter": setting.name, "value": value, "unit": setting.unit,
                          "gain": setting.gain, "side": side_of(axis), "source": setting.source})  # fmt: skip
    return rows


def gains_of(axis: Any) -> dict[str, float]:
    """The gains of the axis's own controller that drives have names for; none where it is no PI cascade."""
    table = axis.controller.parameters
    velocity, position = table.get("velocity"), table.get("position")
    if not isinstance(velocity, dict) or velocity.get("form", "pi") != "pi":
        return {}
    gains = {POSITION: (position or {}).get("kp"), PROPORTIONAL: velocity.get("kp"), INTEGRAL: velocity.get("ti")}
    return {name: float(value) for name, value in gains.items() if isinstance(value, int | float)}
