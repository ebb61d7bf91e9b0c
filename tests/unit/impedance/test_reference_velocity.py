"""The reference velocity of (25) in the law: simulated, where it goes, and what (27) as printed makes of it."""

import numpy as np
import pytest

from emps_design.control.impedance.law import PRINTED, impedance_law, law_for
from emps_design.simulation.plant import Plant

V_0 = 0.05


def final_speed(axis, **options):
    """Speed [m/s] that the free carriage tends to, started at V_0."""
    law = impedance_law(axis, 50.0, 400.0, reference_velocity=V_0, **options)
    n = 4000
    run = Plant.of(axis).closed_loop(
        np.zeros(n), law=law_for(axis, law, axis.sampling.period), v0=V_0, method="general"
    )
    return float(np.mean(run.v[-200:]))


def test_the_free_carriage_keeps_the_reference_velocity(axis):
    assert final_speed(axis) == pytest.approx(V_0, rel=0.02)


def test_as_printed_it_does_not(axis):
    """(27) as printed leaves F_v qd_0 uncompensated: the carriage comes to rest or goes another way."""
    assert final_speed(axis, current_factor=PRINTED) < 0.2 * V_0


def test_the_continuous_law_asks_for_what_keeps_the_speed(plant):
    """At v = qd_0 and no hand the motor carries the friction alone; as printed it lacks that of qd_0."""
    from emps_design.control.impedance.law import ImpedanceLaw

    friction = plant.viscous_positive * V_0 + plant.coulomb_positive
    law = ImpedanceLaw(50.0, 100.0, plant, reference_velocity=V_0)
    assert law.motor_force(0.0, V_0, 0.0, friction) == pytest.approx(friction)
    printed = ImpedanceLaw(50.0, 100.0, plant, reference_velocity=V_0, current_factor=PRINTED, force_sensor=True)
    asked = printed.motor_force(0.0, V_0, 0.0, friction, 0.0)
    assert asked == pytest.approx(friction - plant.viscous_positive * V_0)


def test_with_a_stiffness_the_rest_position_moves_along(axis):
    law = impedance_law(axis, 50.0, 400.0, stiffness=2000.0, reference_velocity=V_0)
    n, period = 6000, axis.sampling.period
    run = Plant.of(axis).closed_loop(np.zeros(n), law=law_for(axis, law, period), v0=V_0, method="general")
    assert run.position[-1] == pytest.approx(V_0 * n * period, abs=0.02)


def test_what_a_hand_feels_with_30_as_printed(capsys):
    """Through the command: near the closed form of the ideal loop, and a dead band of the friction that is left."""
    import json

    from emps_design.cli.app import run
    from emps_design.laws.law import FrictionModel
    from emps_design.machines import machine
    from emps_design.paper import cost_of_printed

    arguments = ["simulate", "--scenario", "comanipulation", "--mismatch", "0", "--plants", "0", "--json"]
    assert run([*arguments, "--as-printed"]) == 0
    found = json.loads(capsys.readouterr().out)
    felt = cost_of_printed(FrictionModel.of(machine("emps2018")), 50.0, 100.0)["printed"]
    assert found["law"]["current_factor"] == PRINTED
    assert found["verdict"] == "dead_band"
    assert found["transparency"]["apparent_mass"] == pytest.approx(felt["apparent_mass"], rel=0.03)
    # The regression has no column for dry friction: what is left of it counts as damping.
    assert found["transparency"]["apparent_damping"] > felt["apparent_damping"]
