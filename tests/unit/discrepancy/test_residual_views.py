"""What a residual looks like over each quantity it could depend on."""

import numpy as np

from emps_design.discrepancy.residual_views import views
from emps_design.discrepancy.unknown_force import MissingForce
from emps_design.effects import Motion
from emps_design.machines import machine


def seen(window) -> list[str]:
    """The quantities of the views of a shaft that turns to and fro three times, and then on and on."""
    t = np.arange(6000) * 1e-3
    v = np.where(t < 3.0, np.sin(2 * np.pi * t), 1.0)
    motion = Motion(t, np.cumsum(v) * 1e-3, v, np.gradient(v, 1e-3), 0.1 * v, 1e-3, 0.1 * v)
    missing = MissingForce(motion, np.random.default_rng(0).standard_normal(t.size), np.abs(v) > 0.1)
    return [view.quantity for view in views(missing, missing, window(t), 1.0, machine("emps2019"))]


def test_where_no_reversal_is_looked_at_none_is_shown():
    assert "time from reversal" in seen(lambda t: t >= 0.0)
    assert "time from reversal" not in seen(lambda t: t > 4.0)
    assert {"velocity", "position", "time", "frequency"} <= set(seen(lambda t: t > 4.0))
