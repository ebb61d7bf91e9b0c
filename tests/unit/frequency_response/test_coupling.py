"""Masses, springs and dampers from a response: the number, the values, and how often their intervals hold the truth."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frequency_response import random_axis
from emps_design.control.velocity.gains import PI
from emps_design.control.velocity.load_range import loaded
from emps_design.errors import InputError
from emps_design.frequency_response import FrequencyResponse, estimate_response
from emps_design.frequency_response.coupling import MassChain, ResponseComparison, axis_response, fit_chain
from emps_design.frequency_response.loop import suggest_filter_on_response
from emps_design.frequency_response.response import has_wrong_sign
from emps_design.machines import machine
from emps_design.report.loop_figures import response_section
from tests.studies import quick
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


@pytest.mark.study("shares over many responses")
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
    assert ResponseComparison(found.response, rigid).agreement.bands


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


@pytest.mark.parametrize(
    ("frequency", "mass", "viscous"), quick([(1.5, 2000.0, 800.0), (900.0, 0.02, 0.01)], 1, "a fast and light one")
)
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


@pytest.mark.study("a mean over twelve fits")
def test_lines_that_are_too_large_by_chance_weigh_no_more_for_it():
    """Noise of the output: relative to a line that is too large its deviation is too small."""
    rng, true, apart = np.random.default_rng(5), chain(2), []
    g = true.response(2.0 * np.pi * F)
    for _ in range(12):
        noise = 0.25 / np.sqrt(2.0) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
        found = fit_chain(FrequencyResponse.of(F, g * (1.0 + noise), 0.25 / np.abs(1.0 + noise)))
        mass, std, _ = found.parameters["mass"]
        apart.append((mass - 100.0) / std)
    assert abs(np.mean(apart)) < 1.5


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("delay", quick([8e-3, -2e-3, 3e-3, 0.0], 1, "shorter delays"))
def test_a_delay_that_turns_the_top_line_by_more_than_half_a_turn(count, delay):
    rng, true = np.random.default_rng(count), replace(chain(count), delay=delay)
    noise = 0.01 / np.sqrt(2.0) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
    response = FrequencyResponse.of(F, true.response(2.0 * np.pi * F) * (1.0 + noise), np.full(F.size, 0.01))
    found = fit_chain(response)
    assert (found.masses.size, found.misfit) == (count, pytest.approx(1.0, abs=0.3))
    assert found.delay == pytest.approx(delay, abs=2e-5)
    assert found.parameters["mass"][0] == pytest.approx(true.parameters["mass"][0], rel=0.01)
    assert [("a delay" in warning) for warning in found.warnings] == ([True] if delay < 0.0 else [])
    assert not has_wrong_sign(response)


@pytest.mark.parametrize("delay", quick([3e-3, 0.0], 1, "without delay"))
@pytest.mark.parametrize("count", CHAINS)
def test_a_command_of_the_wrong_sign_is_seen_whatever_the_delay(count, delay):
    true = replace(chain(count), delay=delay).response(2.0 * np.pi * F)
    wrong = FrequencyResponse.of(F, -true, np.full(F.size, 0.01))
    assert has_wrong_sign(wrong)
    assert not has_wrong_sign(FrequencyResponse.of(F, true, np.full(F.size, 0.01)))
    assert any("their values and intervals are not valid" in warning for warning in fit_chain(wrong).warnings)


def test_the_command_of_a_record_has_the_wrong_sign():
    axis = machine("emps2019")
    record = experiment(axis, count=2, periods=3)
    found = estimate_response(replace(record, u=-record.u, excitation=-record.excitation), axis)
    assert found.warnings[0].startswith("the command has the wrong sign: at")
    assert any("are not valid" in warning for warning in found.to_dict()["warnings"])
    assert not any("sign" in warning for warning in estimate_response(record, axis).to_dict()["warnings"])


def test_what_is_not_determined_has_no_deviation_that_is_no_number():
    two = chain(2)
    lost = MassChain(
        two.masses, two.springs, np.array([1e300]), 200.0, 0.0, np.diag([1e-4] * 3 + [1e300, 1.0, 0.0]), 1.0
    )
    assert not any(np.isnan(std) for _, std, _ in lost.parameters.values())
    assert not lost.determines("damping")
    assert lost.determines("mass")


def test_the_page_says_what_is_not_determined_and_what_speaks_against_the_masses():
    two = chain(2)
    response = FrequencyResponse.of(F, two.response(2.0 * np.pi * F), np.full(F.size, 0.02))
    compared = ResponseComparison(response, machine("emps2019"))
    vague = np.diag([1e-4, 1e-4, 1e-4, 1e300, 1.0, 0.0])
    compared.__dict__["chain"] = replace(two, dampers=np.array([1e300]), covariance=vague, misfit=300.0)
    _, table, _, *warnings = response_section(compared).blocks
    assert "not determined" in {row[1] for row in table.rows}
    assert any("do not fit the response: residuals 3e+02 standard deviations" in warning.text for warning in warnings)
