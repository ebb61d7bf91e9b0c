"""What is handed over to python-control has named signals: ``u[0]`` and ``y[0]`` are no names."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from emps_design.control.discretisation import sample_axis
from emps_design.control.force import design_force_loop
from emps_design.control.linear_plant import linear_plant
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws import law_of
from emps_design.laws.linear import linear_law
from emps_design.machines import machine

PACKAGE = Path(__file__).resolve().parents[2] / "emps_design"
AXIS = machine("emps2018")
DESIGN = design_velocity_loop(AXIS, crossover=60.0, phase_margin_deg=60.0)
OBJECTS = {
    "VelocityLoopDesign": DESIGN,
    "SampledVelocityLoop": DESIGN.sampled,
    "SampledLoop": DESIGN.sampled.loop,
    "ForceLoopDesign": design_force_loop(DESIGN, 0.005, 100.0, 0.0, 0, True),
    "LinearPlant": linear_plant(AXIS),
    "SampledPlant": sample_axis(AXIS),
    "FrequencyResponse": FrequencyResponse.of(np.arange(1.0, 6.0), 1.0 / (1j * np.arange(1.0, 6.0)), name="axis"),
    "LinearLaw": linear_law(law_of(machine("emps2019"), 1e-3), 1e-3),
}


def methods():
    """Class and name of every method that gives an object of python-control."""
    for module in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(module.read_text(encoding="utf-8")).body:
            for part in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(part, ast.FunctionDef) and part.returns and "control." in ast.unparse(part.returns):
                    yield node.name, part.name


@pytest.mark.parametrize(("kind", "method"), list(methods()))
def test_its_signals_have_names(kind, method):
    arguments = (1e-3,) if kind == "LinearLaw" else ()
    system = getattr(OBJECTS[kind], method)(*arguments)
    names = [*system.input_labels, *system.output_labels]
    assert names
    assert not [name for name in names if re.fullmatch(r"[uy]\[\d+\]", name)]
    assert system.name
    assert "sys[" not in system.name


def test_the_loop_is_the_same_in_both_forms():
    by_function, by_states = DESIGN.sampled.transfer_function(), DESIGN.sampled.loop.loop_gain_to_ss()
    assert by_function.input_labels == by_states.input_labels
    z = np.exp(1j * np.array([10.0, 60.0]) * AXIS.sampling.period)
    assert by_function(z) == pytest.approx(by_states(z), rel=1e-6)
