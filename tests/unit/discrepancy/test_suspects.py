"""What is told of a residual before anything was fitted to it: the right effect, or nothing."""

import pytest

from emps_design.discrepancy import diagnose
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

AXIS = machine("emps2019")
LIBRARY = tuple(map(get_effect, ("stribeck_friction", "elastic_force", "actuator_delay")))
SPRING = {"kind": "elastic_force", "stiffness": 300.0, "rest_position": 0.1}


def stages(effects, rounds):
    """The first stages that a diagnosis tells, up to the end of its calibration."""
    messages = []

    def progress(stage, share):
        messages.append(stage)
        if stage.startswith("round"):
            raise KeyboardInterrupt

    diagnose(synthetic_record(AXIS.replace(effects=effects), laps=1), AXIS, library=LIBRARY, progress=progress)
    return [stage for stage in messages if stage.startswith(rounds)]


@pytest.mark.parametrize("stage", ["fitting the baseline", "healthy reference"])
def test_a_spring_is_suspected_before_it_is_searched(stage):
    assert stages([SPRING], stage)[-1].startswith(f"{stage}; suspects: elastic force ")


@pytest.mark.parametrize("stage", ["fitting the baseline", "healthy reference"])
def test_noise_is_no_suspect(stage):
    assert set(stages([], stage)) == {stage}
