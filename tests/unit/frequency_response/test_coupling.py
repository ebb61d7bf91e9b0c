"""Masses, springs and dampers from a response: the number, the values, and how often their intervals hold the truth."""

import numpy as np
import pytest

from benchmarks.frequency_response import random_axis
from emps_design.control.velocity.load_range import loaded
from emps_design.control.velocity.structure import PI
from emps_design.errors import InputError
from emps_design.frequency_response import FrequencyResponse, estimate_response
from emps_design.frequency_response.comparison import Comparison, axis_response
from emps_design.frequency_response.coupling import MassChain, fit_chain
from emps_design.frequency_response.suggestion import suggest_filter_on_response
from emps_design.machines import machine
from tests.unit.frequency_response.cases import COUPLING, exact, experiment, two_mass

F = np.arange(2.0, 200.0)
CHAINS = {
    1: ([95.0], [], []),
    2: ([60.0, 40.0], [3.4e6], [700.0]),
    3: ([50.0, 30.0, 20.0], [2.5e6, 6e6], [700.0, 600.0]),
}


def chain(count):
    masses, springs, dampers = (np.array(values, float) for values in CHAINS[count])
    return MassChain(masses, springs, dampers, 200.0, 5e-4, np.eye(3 * count), 0.0)


@pytest.mark.parametrize("count", CHAINS)
def test_the_number_of_masses_and_intervals_that_hold(count):
    rng, true, held = np.random.default_rng(count), chain(count), []
    for _ in range(8):
        noise = 0.02 / np.sqrt(2.0) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
        response = FrequencyResponse.of(F, true.response(2.0 * np.pi * F) * (1.0 + noise), np.full(F.size, 0.02))
        found = fit_chain(response)
        assert found.masses.size == count
        assert found.misfit == pytest.approx(1.0, abs=0.2)
        wanted = true.parameters
        held += [abs(value - wanted[name][0]) < 2.0 * std for name, (value, std, _) in found.parameters.items()]
    assert np.mean(held) > 0.85


def test_natural_frequencies_are_those_of_the_response():
    found = chain(3).parameters
    light = chain(3)
    light = MassChain(light.masses, light.springs, 1e-3 * light.dampers, 0.0, 0.0, light.covariance, 0.0)
    fine = np.arange(10.0, 150.0, 0.001)
    size = np.abs(light.response(2.0 * np.pi * fine)) * fine
    tops = fine[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])]
    dips = fine[1:-1][(size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])]
    assert tops == pytest.approx([found["resonance_1"][0], found["resonance_2"][0]], rel=1e-3)
    assert dips == pytest.approx([found["antiresonance_1"][0], found["antiresonance_2"][0]], rel=1e-3)


def test_a_record_gives_the_coupling_of_the_axis():
    axis = random_axis(np.random.default_rng(77))
    mass, gain = axis.mechanics.mass, axis.drive.force_gain
    found = estimate_response(experiment(axis, 3, volts=2.0 * mass / gain, newtons=0.02 * mass, periods=5), axis)
    fitted, wanted = found.comparison.chain, axis.effects[0].parameters
    assert fitted.masses.size == 2
    linear = {name: value for name, value in wanted.items() if name != "load_friction"}  # which slides through
    for name, value in {"mass": mass, **linear}.items():
        mean, std, _ = fitted.parameters[name]
        assert abs(mean - value) < 3.5 * std, name
    rigid = axis.replace(effects=[])
    again = fitted.on(rigid)
    assert again.effects[0].kind == axis.effects[0].kind
    assert again.effects[0].parameters["frequency"] == pytest.approx(wanted["frequency"], rel=5e-3)
    assert fitted.on(axis).effects[0].kind == again.effects[0].kind
    assert len(fitted.on(axis).effects) == 1
    document = found.to_dict()
    assert document["coupling"]["masses"] == 2
    assert document["coupling"]["effect"]["kind"] == axis.effects[0].kind
    assert document["model"]["inside"] > 0.9 * document["model"]["lines"]
    assert Comparison(found.response, rigid).agreement.bands


def test_a_rigid_axis_has_no_coupling():
    axis = machine("emps2019")
    found = estimate_response(experiment(axis, 5), axis).comparison.chain
    assert found.masses.size == 1
    assert found.effect is None
    assert found.on(axis).effects == axis.effects
    value, std, _ = found.parameters["mass"]
    assert abs(value - axis.mechanics.mass) < 3.5 * std


def test_the_response_of_the_model_is_that_of_its_plant():
    axis = two_mass().replace(drive={"current_time_constant": 5e-4})
    assert np.allclose(axis_response(axis, F, 0.05), exact(axis, F))


def test_too_few_lines_for_a_mass():
    f = np.array([1.0, 2.0, 3.0, 4.0])
    one = FrequencyResponse.of(f, 1.0 / (2j * np.pi * f), np.full(4, 0.01))
    assert fit_chain(one).masses.size == 1
    with pytest.raises(InputError, match="found 1 lines, expected more than a mass has parameters"):
        fit_chain(one.every(4))


@pytest.mark.parametrize(("frequency", "mass", "viscous"), [(900.0, 0.02, 0.01), (1.5, 2000.0, 800.0)])
def test_a_filter_is_looked_for_at_resonances_that_no_search_looks_at(frequency, mass, viscous):
    period = 0.048 / frequency
    rigid = machine("emps2018").replace(
        mechanics={"mass": mass, "viscous": viscous}, drive={"current_time_constant": 0.0}, sampling={"period": period}
    )
    bent = rigid.replace(effects=[{**COUPLING, "frequency": frequency, "share": 0.7}])
    f = np.geomspace(0.05, 8.0, 100) * frequency
    response = FrequencyResponse.of(f, exact(bent, f), np.full(f.size, 0.01), name="far")
    found = suggest_filter_on_response(response, rigid, 50.0, PI, ())
    without = found["without"]
    assert without["crossover"] > 0.0
    assert without["measured"]["phase_margin_deg"] == pytest.approx(50.0, abs=1.0)
    assert loaded(bent, 40.0, 2.0).effects[0].parameters["share"] > 0.95
