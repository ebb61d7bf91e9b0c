"""The generator's plant and the package's must tell the same story: same physics, other people's numerics."""

import numpy as np
import pytest

from emps_design.axis import Axis
from tests.hidden.drives import EFFECTS, FORMS, FURTHER, TURNING, draw_drive, draw_effect, turning
from tests.hidden.generate import SKIP, axis_file, misfit, run
from tests.hidden.plant import numbers
from tests.hidden.programs import laps

TOLERANCE = 0.015  # of the Coulomb friction: rms of G_tau u that 20 us steps and the quantised encoder cause


@pytest.mark.parametrize("name", ["none", *EFFECTS, *FURTHER, *FORMS, *TURNING])
def test_same_force_along_a_lap(name):
    from emps_design.simulation import Plant

    rng = np.random.default_rng(7)
    drive = turning(draw_drive(rng), 0.1) if name in TURNING else draw_drive(rng)
    q_ref = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 1, drive.period)
    _, healthy = run(drive, q_ref, numbers())
    values, truth = ({}, {}) if name == "none" else draw_effect(name, rng, drive, 2, np.abs(healthy).max())
    if name == "mass_change":  # within the one lap
        values["mass_time"] = truth[name]["time"] = 2.0
    _, u = run(drive, q_ref, numbers(**values))
    axis = Axis.from_toml(axis_file(rng, drive)).replace(
        motion="rotary" if name in TURNING else "linear",
        mechanics={key: getattr(drive, key) for key in ("mass", "viscous", "coulomb", "offset")},
        effects=[{"kind": kind, **parameters} for kind, parameters in truth.items()],
    )
    t = np.arange(q_ref.size) * drive.period
    off = (t >= values.get("off_from", 0.0)) & (t < values.get("off_to", 0.0))
    other = Plant.of(axis).closed_loop(q_ref, enable=np.where(off, 0.0, 1.0) if off.any() else None).u
    error, size = misfit(drive, u, other), misfit(drive, u, healthy)
    assert error < TOLERANCE * drive.coulomb
    assert name == "none" or error < 0.1 * size
    assert u[SKIP:].std() > 0


def test_a_transmission_is_loaded_by_the_force_behind_the_lag():
    """Friction of the force that the transmission carries, which is not the one commanded while a current loop lags."""
    from emps_design.simulation import Plant

    rng = np.random.default_rng(7)
    drive = draw_drive(rng)
    q_ref = laps(rng, drive.travel, list(drive.speeds), drive.acceleration, 1, drive.period)
    values, kinds = {"lag": 2.5e-3}, [{"kind": "actuator_lag", "time_constant": 2.5e-3}]
    _, lagging = run(drive, q_ref, numbers(**values))
    loaded, truth = draw_effect("load_dependent_friction", rng, drive, 2, np.abs(lagging).max())
    kinds += [{"kind": kind, **parameters} for kind, parameters in truth.items()]
    _, u = run(drive, q_ref, numbers(**values, **loaded))
    mechanics = {key: getattr(drive, key) for key in ("mass", "viscous", "coulomb", "offset")}
    axis = Axis.from_toml(axis_file(rng, drive)).replace(mechanics=mechanics, effects=kinds)
    error, size = misfit(drive, u, Plant.of(axis).closed_loop(q_ref).u), misfit(drive, u, lagging)
    assert error < TOLERANCE * drive.coulomb < 0.1 * size
    in_the_loop = axis.replace(drive={"current_time_constant": 2.5e-3}, effects=kinds[1:])
    assert misfit(drive, u, Plant.of(in_the_loop).closed_loop(q_ref).u) < TOLERANCE * drive.coulomb
