"""Margins on measured responses against the true sampled loop and against brute force; retuning on a response."""

import json

import numpy as np
import pytest

from benchmarks.frequency_response import COMPARED, SPEED, exact_against_force, one_axis, random_axis, true_margins
from emps_design.cli.app import run as command
from emps_design.control.sampled import axis_loop, nested_loops
from emps_design.errors import InputError, SpecificationError
from emps_design.frequency_response import (
    FrequencyResponse,
    estimate_response,
    measured_margins,
    retune_on_response,
    worst_of,
    write_response,
)
from emps_design.frequency_response.loop import MARGINS, SIDES
from emps_design.frequency_response.measured_plant import law_response
from emps_design.laws import law_of
from emps_design.laws.linear import linear_law
from emps_design.machines import machine
from tests.studies import quick
from tests.unit.frequency_response.cases import exact, experiment, two_mass

F = np.arange(1.0, 400.0)
FEWER = np.geomspace(1.0, 399.0, 160)  # for commands: close around the resonances, and quickly looked through
CASCADE = {
    "kind": "cascade",
    "velocity": {"kp": 200.0, "ti": 0.05},
    "filters": [{"kind": "lowpass", "frequency": 200.0}],
}


def measured(axis, std=0.0, f=F):
    """The exact response of ``axis`` as if measured."""
    return FrequencyResponse.of(f, exact(axis, f, SPEED), np.full(f.size, std), name=axis.name)


@pytest.mark.parametrize("seed", range(100, 106))
def test_margins_of_exact_lines_are_those_of_the_sampled_loop(seed):
    axis = random_axis(np.random.default_rng(seed))
    found, true = measured_margins(measured(axis, f=np.arange(1.0, 400.0, 0.5)), axis), true_margins(axis)
    assert found.stable
    for name in COMPARED:
        assert found.values[name] == pytest.approx(true[name], rel=5e-3), name


@pytest.mark.parametrize("seed", [200, 201])
def test_delay_and_disk_margin_by_brute_force(seed):
    assert max(exact_against_force(seed).values()) < 0.01


@pytest.mark.parametrize("seed", quick([300, 301], 1, "another seed"))
def test_bands_from_a_record_hold_the_truth(seed):
    found = one_axis(seed)
    assert found["stable"] == [True, True]
    assert sum(found["inside"].values()) >= 4


def test_stability_is_read_from_the_data():
    verdicts = []
    for scale in np.geomspace(0.3, 20.0, 14):
        base = two_mass().replace(sampling={"computation_delay": 1})
        axis = base.replace(controller={"kv": base.controller.kv * float(scale)})
        found = measured_margins(measured(axis), axis, draws=0)
        assert found.stable == axis_loop(axis, SPEED).stable, scale
        if not found.stable:
            assert set(found.values.values()) == {None}
            assert any("unstable on the measured plant" in warning for warning in found.warnings)
        verdicts.append(found.stable)
    assert set(verdicts) == {True, False}


@pytest.mark.parametrize("more", [1.0, 4.0])
@pytest.mark.parametrize("first", [0.4, 0.6, 1.0])
def test_lines_that_begin_where_friction_rules(first, more):
    """The viscous corner lies at 0.65 Hz, and four times as high."""
    base = machine("emps2018")
    axis = base.replace(mechanics={"viscous": more * base.mechanics.viscous})
    response = measured(axis, 0.01, np.geomspace(first, 300.0, 200))
    design = retune_on_response(response, axis, 100.0, 60.0)
    assert (design.sampled.margins.crossover, design.sampled.margins.phase_margin_deg) == pytest.approx(
        (100.0, 60.0), 1e-4
    )
    gains, verdicts = design.controller_table(), []
    for scale in (1.0, 13.0):
        run = axis.replace(controller={**gains, "k_v1": scale * gains["k_v1"]})
        found, true = measured_margins(response, run, draws=60), true_margins(run)
        verdicts.append(found.stable)
        assert found.stable == axis_loop(run, SPEED).stable, scale
        assert found.stable_share == float(found.stable)
        if found.stable:
            for name in COMPARED:
                assert found.values[name] == pytest.approx(true[name], rel=5e-3), name
                low, high = found.bands[name]
                assert low <= found.values[name] <= high
    assert verdicts == [True, False]


@pytest.mark.parametrize(("kp", "stable"), [(400.0, True), (6000.0, False)])
def test_several_rates_where_friction_rules(kp, stable):
    base = machine("emps2018")
    law = {**CASCADE, "velocity": {"kp": kp, "ti": 0.05}, "position": {"kp": 10.0, "every": 4}}
    axis = base.replace(mechanics={"viscous": 4.0 * base.mechanics.viscous}, controller=law)
    found = measured_margins(measured(axis, 0.005, np.geomspace(0.4, 300.0, 150)), axis, draws=8)
    true = nested_loops(axis, SPEED)[-1].margins
    assert found.stable == true.stable == stable
    if stable:
        assert found.values["phase_margin_deg"] == pytest.approx(true.phase_margin_deg, rel=1e-3)
        assert found.values["delay_margin"] == pytest.approx(true.delay_margin, rel=1e-3)


def test_worst_of_several():
    axis = two_mass()
    heavy, light = (axis.replace(mechanics={"mass": kg}) for kg in (120.0, 80.0))
    margins = [measured_margins(measured(one), axis) for one in (heavy, light)]
    worst = worst_of(margins)
    for name in ("phase_margin_deg", "delay_margin", "gain_margin", "disk_margin"):
        assert worst[name] == min(one.values[name] for one in margins)
    assert worst["sensitivity_peak_below"] == max(one.values["sensitivity_peak_below"] for one in margins)


def test_retuned_on_data():
    axis = two_mass().replace(controller={"kind": "none"})
    found = estimate_response(experiment(two_mass(), 11, samples=2000, newtons=0.2), two_mass()).response
    design = retune_on_response(found, axis, 90.0, 50.0)
    from emps_design.control.velocity.sampled import SampledVelocityLoop

    loop = SampledVelocityLoop(design.sampled.plant, design.k_v1, design.t_v)
    assert loop.margins.crossover == pytest.approx(90.0, rel=0.03)
    assert loop.margins.phase_margin_deg == pytest.approx(50.0, rel=0.03)


def test_what_cannot_be_retuned_says_what_can():
    with pytest.raises(
        SpecificationError, match="no gains give 60 deg at a crossover of 250 rad/s.* rad/s works"
    ) as no:
        retune_on_response(measured(two_mass()), two_mass(), 250.0, 60.0)
    assert retune_on_response(measured(two_mass()), two_mass(), no.value.nearest["crossover"], 60.0).k_v1 > 0.0
    with pytest.raises(InputError, match="found a crossover of 2 rad/s, expected one within the data"):
        retune_on_response(measured(two_mass()), two_mass(), 2.0)
    with pytest.raises(InputError, match="`at`: found 'here', expected one of"):
        retune_on_response(measured(two_mass()), two_mass(), 50.0, at="here")


def test_what_the_data_do_not_reach_is_said():
    axis = machine("emps2019")
    narrow = measured(axis, 0.01, np.arange(30.0, 60.0))
    assert any(
        "a crossover below it cannot be detected" in warning for warning in measured_margins(narrow, axis).warnings
    )
    slow = measured(axis, 0.01, np.arange(1.0, 20.0))
    words = measured_margins(slow, axis).warnings
    assert any("a crossover above it cannot be detected" in warning for warning in words)
    assert any("outside the data, where the response is extrapolated as a mass" in warning for warning in words)


@pytest.mark.parametrize(("every", "kp"), quick([(2, 900.0), (4, 200.0), (7, 400.0)], 1, "slower rates"))
@pytest.mark.parametrize("base", [machine("emps2019"), two_mass()], ids=["rigid", "two masses"])
def test_loops_of_several_rates_have_the_margins_of_the_periodic_loop(base, every, kp):
    law = {**CASCADE, "velocity": {"kp": kp, "ti": 0.05}, "position": {"kp": 30.0, "every": every}}
    axis = base.replace(controller=law, sampling={"computation_delay": 1})
    found, true = measured_margins(measured(axis, 0.005), axis, draws=140), nested_loops(axis, SPEED)[-1].margins
    assert found.stable == true.stable
    if true.stable:
        for name in ("phase_margin_deg", "delay_margin", "gain_margin"):
            assert found.values[name] == pytest.approx(getattr(true, name), rel=1e-3), name
            low, high = found.bands[name]
            assert low < found.values[name] < high
        w = np.linspace(0.1, np.pi / axis.sampling.period, 4000)
        largest = np.max(np.abs(1.0 + axis_loop(axis, SPEED).response(w, "voltage", "voltage")))
        peaks = [found.values[f"sensitivity_peak_{side}"] for side in ("below", "above")]
        assert max(one for one in peaks if one is not None) == pytest.approx(largest, rel=5e-3)


def test_rates_too_far_apart_and_lines_beyond_nyquist_are_refused():
    axis = machine("emps2019")
    with pytest.raises(InputError, match="found a line at 600 Hz, expected less than the Nyquist frequency"):
        measured_margins(measured(axis, f=np.arange(1.0, 601.0)), axis)
    slow = {**CASCADE, "position": {"kp": 20.0, "every": 33}}
    with pytest.raises(InputError, match="a period of 33 samples, expected at most 32"):
        measured_margins(measured(axis), axis.replace(controller=slow))
    law = linear_law(law_of(axis.replace(controller=slow), 1e-3), 1e-3)
    with pytest.raises(InputError, match="loops at different rates"):
        law_response(law, F, 1e-3)


@pytest.mark.slow("a retuning on data, twice")
def test_gains_on_a_response(tmp_path, capsys):
    axis, path = two_mass(), tmp_path / "two.csv"
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    write_response(path, measured(axis, 0.01, FEWER))
    line = ["gains", str(tmp_path / "axis.toml"), "--crossover", "40", "--frf", str(path)]
    assert command([*line, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    found, sampled = document["measured"], document["sampled"]
    assert found["stable"]
    for name in ("phase_margin_deg", "crossover", "delay_margin", "gain_margin"):
        assert found[name] == pytest.approx(sampled[name], rel=2e-2)
        low, high = found["bands"][name]
        assert low <= found[name] <= high
    assert found["responses"][0]["disk"]["phase_deg"] > 20.0
    assert command(line) == 0
    assert "On the measured plant" in capsys.readouterr().out
    assert command([*line, "--retune", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    retuned, suggested = document["measured"], document["suggestion"]
    assert suggested["model"] == "the masses that fit two"
    for name in SIDES if suggested["filter"] else SIDES[:1]:
        side = suggested[name]
        assert side["measured"]["stable"]
        for margin in MARGINS:  # of the gains that were found on the masses, on the data
            assert side["measured"][margin] == pytest.approx(side["margins"][margin], rel=0.05), (name, margin)
    assert command([*line, "--retune"]) == 0
    assert "designed on the masses that fit two, then checked on the data" in capsys.readouterr().out
    assert retuned["crossover"] == pytest.approx(40.0, rel=1e-3)
    assert retuned["phase_margin_deg"] == pytest.approx(60.0, rel=1e-3)


@pytest.mark.study("a retuning under two limits")
def test_limits_of_the_sensitivity_below_and_above_the_antiresonance(tmp_path, capsys):
    axis, path, out = two_mass(), tmp_path / "two.csv", tmp_path / "out.toml"
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    write_response(path, measured(axis, f=FEWER))
    line = ["gains", str(tmp_path / "axis.toml"), "--frf", str(path), "--json", "--crossover"]
    below, above = (f"--sensitivity-peak-{side}" for side in ("below", "above"))

    def answer(*options, status=0):
        assert command([*line, *options]) == status
        said = capsys.readouterr()
        return json.loads(said.out)["measured"] if status == 0 else said.err

    assert "requested" not in answer("60")
    assert command([*line, "60", below, "6dB", above, "1.2"]) == 0
    document = json.loads(capsys.readouterr().out)
    found = document["measured"]
    assert found["requested"] == {
        "sensitivity_peak_below": pytest.approx(10.0**0.3),
        "sensitivity_peak_above": 1.2,
    }
    words = f"sensitivity above the first antiresonance is {found['sensitivity_peak_above']:.4g}, requested at most 1.2"
    assert found["sensitivity_peak_above"] > 1.2
    assert [words in warning for warning in document["warnings"]].count(True) == 1
    assert not any("sensitivity below" in warning for warning in document["warnings"])

    free = answer("80", "--retune")
    limits = {side: free[f"sensitivity_peak_{side}"] for side in ("below", "above")}
    assert answer("80", "--retune", below, str(1.01 * limits["below"]), above, str(1.01 * limits["above"])) == {
        **free, "requested": {f"sensitivity_peak_{side}": pytest.approx(1.01 * limits[side]) for side in limits}
    }  # fmt: skip
    for side, other in (("below", "above"), ("above", "below")):
        binding = (f"--sensitivity-peak-{side}", str(0.98 * limits[side]))
        refused = answer("80", "--retune", *binding, "--out", str(out), status=3)
        assert f"the largest sensitivity {side} the first antiresonance is {limits[side]:.4g}, requested" in refused
        assert f"sensitivity {other}" not in refused
        assert not out.exists()
        slower = refused.partition("; ")[2].rpartition(" rad/s works")[0].split()[-1]
        assert answer(slower, "--retune", *binding)[f"sensitivity_peak_{side}"] <= 0.98 * limits[side]


def test_without_an_antiresonance_all_lies_below_and_the_limit_above_says_so(tmp_path, capsys):
    path = tmp_path / "rigid.csv"
    write_response(path, measured(machine("emps2019")))
    line = ["gains", "emps2019", "--crossover", "40", "--frf", str(path), "--sensitivity-peak-above", "6dB"]
    assert command([*line, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["measured"]["sensitivity_peak_above"] is None
    assert any("the data have no antiresonance" in warning for warning in document["warnings"])
    assert command(line) == 0
    assert "at most 1.995" in capsys.readouterr().out


@pytest.mark.study("two retunings")
def test_the_position_loop_around_is_judged_on_the_response_too(tmp_path, capsys):
    axis, path = two_mass().replace(controller={**CASCADE, "position": {"kp": 10.0, "every": 4}}), tmp_path / "two.csv"
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    write_response(path, measured(axis, 0.01, FEWER))
    line = ["gains", str(tmp_path / "axis.toml"), "--crossover", "40", "--frf", str(path), "--position-overshoot", "5"]
    assert command([*line, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["measured"]
    assert found["stable"]
    assert found["whole_loop"]["stable"]
    assert 10.0 < found["whole_loop"]["phase_margin_deg"] < found["phase_margin_deg"]
    assert found["whole_loop"]["bands"]["delay_margin"][0] < found["whole_loop"]["delay_margin"]
    assert command(line) == 0
    assert "whole loop at the plant input" in capsys.readouterr().out


def test_gains_that_the_measured_plant_does_not_bear(tmp_path, capsys):
    path = tmp_path / "late.csv"
    late = exact(machine("emps2019"), F) * np.exp(-2j * np.pi * F * 0.02)
    write_response(path, FrequencyResponse.of(F, late, np.full(F.size, 0.01)))
    out = tmp_path / "axis.toml"
    assert command(["gains", "--crossover", "60", "--frf", str(path), "--out", str(out), "--json"]) == 4
    document = json.loads(capsys.readouterr().out)
    assert document["sampled"]["stable"]
    assert not document["measured"]["stable"]
    assert "unstable on the measured plant" in document["reason"]
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bandwidth", "50", "--retune"], "--retune with --frf: found a bandwidth, expected --crossover"),
        (["--crossover", "50", "--retune", "--frf", "{path}"], "found 2 responses to retune on, expected one"),
        (["--crossover", "50", "--frf", "none.csv"], "none.csv: No such file"),
        (
            ["--crossover", "50", "--sensitivity-peak-below", "0"],
            "found '0', expected a positive number, or one such as",
        ),
        (["--crossover", "50", "--sensitivity-peak-above", "1e9dB"], "ratio: found 1e+10, expected a magnitude of at"),
    ],
)
def test_bad_options(tmp_path, capsys, options, message):
    path = tmp_path / "two.csv"
    write_response(path, measured(two_mass()))
    words = [word.format(path=path) for word in options]
    assert command(["gains", "--frf", str(path), *words]) == 2
    assert message in capsys.readouterr().err
