"""The on-line force observer as one more difference equation that is exported."""

from __future__ import annotations

from typing import Any

from emps_design.laws.law import LawKind, LawTable, Positive, parameter
from emps_design.observer import block
from emps_design.observer.external_force import ForceObserver

COMMAND = "command"  # what the observer is given in place of a reference


class Table(LawTable):
    """The observer's only parameter."""

    cutoff: Positive = parameter("corner of the first-order low-pass", "Hz")


def _gains(p: Any, axis: Any, period: float) -> list[float]:
    return ForceObserver(axis, p.cutoff).gains


def _equations(p: Any, axis: Any, period: float) -> tuple[str, ...]:
    period, gain, alpha, mass, viscous, coulomb, offset, rest = _gains(p, axis, period)
    return (
        f"v[k] = (q[k] - q[k-1]) / {period:.10g},  a[k] = (v[k] - v[k-1]) / {period:.10g}",
        "w[k] = (v[k] + v[k-1]) / 2",
        f"s[k] = sign(w[k]), 0 where |w[k]| <= {rest:.10g}",
        f"x[k] = {mass:.10g} * a[k] + {viscous:.10g} * w[k] + {coulomb:.10g} * s[k] + {offset:.10g}"
        f" - {gain:.10g} * (u[k-1] + u[k-2]) / 2",
        f"f[k] = f[k-1] + {alpha:.10g} * (x[k] - f[k-1])",
    )


OBSERVER = LawKind(
    name="force_observer",
    label="on-line observer of the external force",
    source="paper, (19)",
    table=Table,
    kernel=block.force_observer,
    gains=_gains,
    memory=4,
    equations=_equations,
    follows=lambda p: COMMAND,
)
