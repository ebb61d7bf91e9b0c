"""How fast a loop may be made, what ends that, filters that move the end, and the disk margin beside the others."""

import json
import math

import numpy as np
import pytest

from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.control.margins import disk_margin
from emps_design.control.velocity.design import command_in_a_step, design_velocity_loop
from emps_design.control.velocity.gains import IP, PI
from emps_design.control.velocity.limits import (
    GAIN_MARGIN,
    limits,
    reach,
    retune_velocity_loop,
    retuned_gains,
    suggest_filter,
)
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine

RIGID = machine("emps2018")
COUPLING = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}
BENT = RIGID.replace(effects=[COUPLING])


def test_a_factor_on_the_rim_of_the_disk_makes_the_loop_unstable():
    loop = design_velocity_loop(RIGID, crossover=100.0).sampled
    a = loop.margins.disk_margin
    grid = loop.plant.frequencies(4000)
    S = 1.0 / (1.0 + loop.plant_input_response(grid))
    assert a == pytest.approx(1.0 / np.abs(S - 0.5).max(), rel=1e-5)
    at = grid[np.argmax(np.abs(S - 0.5))]
    d = 1.0 / complex(1.0 / (1.0 + loop.plant_input_response(at)) - 0.5)
    factor = (1.0 + 0.5 * d) / (1.0 - 0.5 * d)
    assert abs(d) == pytest.approx(a, rel=1e-5)
    assert abs(1.0 + factor * loop.plant_input_response(at)) < 1e-9
    assert loop.margins.gain_margin >= (2.0 + a) / (2.0 - a)
    assert math.radians(loop.margins.phase_margin_deg) >= 2.0 * math.atan(0.5 * a)
    assert disk_margin(lambda w: 1.0 / (1j * w), np.geomspace(0.01, 100.0, 50)) == pytest.approx(2.0)


@pytest.mark.parametrize("share", [0.2, 0.7])
@pytest.mark.parametrize("damping", [0.001, 0.05])
def test_margins_beside_a_narrow_resonance_are_spent_exactly(share, damping):
    """Each margin put into the loop leaves a pole on the unit circle; a grid that misses the peak is optimistic."""
    axis = RIGID.replace(effects=[{**COUPLING, "share": share, "damping": damping}])
    loop = SampledVelocityLoop(sample_axis(axis), 60.0, 0.1)
    margins = loop.margins
    assert loop.stable
    gains = [60.0 * margins.gain_margin * by for by in (0.999, 1.001)]
    assert [SampledVelocityLoop(loop.plant, gain, 0.1).stable for gain in gains] == [True, False]
    for by, stable in ((0.999, True), (1.001, False)):
        late = SampledVelocityLoop(loop.plant.delayed(by * margins.delay_margin), 60.0, 0.1)
        assert late.stable is stable


def test_a_notch_at_the_resonance_makes_a_faster_loop_at_equal_margins():
    found = suggest_filter(BENT, 50.0, PI)
    without, better = found["without"], found["with"]
    assert found["filter"]["kind"] == "notch"
    assert found["filter"]["frequency"] == pytest.approx(48.0, rel=0.02)
    equal, notch = found["with_equal_margins"], (Filter(**found["filter"]),)
    assert 1.15 * without["crossover"] < equal["crossover"] < better["crossover"]
    assert better["crossover"] > 1.5 * without["crossover"]
    for name in ("gain_margin", "disk_margin"):
        assert equal["margins"][name] >= (1.0 - 1e-6) * without["margins"][name]
    for side, filters in ((without, ()), (equal, notch), (better, notch)):
        loop = SampledVelocityLoop(sample_axis(BENT, filters=filters), side["k_v1"], side["t_v"], PI)
        assert loop.stable
        assert loop.margins.phase_margin_deg == pytest.approx(50.0, abs=1e-5)
        assert loop.margins.gain_margin >= GAIN_MARGIN
    assert reach(sample_axis(BENT), 50.0).limit == "resonance at 47.99 Hz"


def test_where_no_filter_pays_delay_binds():
    found = suggest_filter(RIGID, 60.0)
    assert (found["filter"], found["with_equal_margins"], found["with"]) == (None, None, None)
    assert reach(sample_axis(RIGID), 60.0).limit.startswith("delay")


def test_a_coarse_encoder_and_a_low_limit_bind_first():
    coarse = suggest_filter(RIGID.replace(sampling={"encoder_resolution": 1e-5}), 60.0, velocity=0.001)
    assert coarse["without"]["limits"]["binding"].startswith("encoder noise")
    assert coarse["without"]["limits"]["encoder_noise"] < coarse["without"]["crossover"]
    low = suggest_filter(RIGID.replace(drive={"voltage_limit": 2.0}), 60.0, velocity=0.1)
    assert low["without"]["limits"]["binding"].startswith("voltage")


def test_retune_names_the_resonance_that_binds():
    with pytest.raises(SpecificationError, match="near the resonance at 47.99 Hz"):
        retune_velocity_loop(BENT, crossover=80.0, phase_margin_deg=50.0)


def test_the_command_suggests_with_retune_only(capsys, tmp_path):
    (tmp_path / "axis.toml").write_text(BENT.to_toml())
    line = f"gains {tmp_path}/axis.toml --crossover 40 --phase-margin 50 --structure pi"
    assert run(f"{line} --retune --json".split()) == 0
    assert json.loads(capsys.readouterr().out)["suggestion"]["filter"]["kind"] == "notch"
    assert run(f"{line} --json".split()) == 0
    assert "suggestion" not in json.loads(capsys.readouterr().out)
    assert run(f"{line} --retune".split()) == 0
    assert "Fastest loop with 50 deg" in capsys.readouterr().out


def test_the_crossovers_at_which_a_step_takes_too_much_are_its_own_and_end_where_it_takes_less_again():
    plant = sample_axis(RIGID)
    fastest = reach(plant, 60.0)
    found = limits(RIGID, plant, fastest, 60.0, IP, 0.1)

    def demand(w):
        return command_in_a_step(RIGID, SampledVelocityLoop(plant, *map(float, retuned_gains(plant, w, 60.0)), IP), 0.1)

    begin, end = found["voltage"], float(found["binding"].split(" to ")[1].split()[0])
    assert demand(begin) == pytest.approx(RIGID.drive.command_limit, rel=0.01)
    assert demand(end) == pytest.approx(RIGID.drive.command_limit, rel=0.01)
    assert demand(0.98 * begin) < RIGID.drive.command_limit < demand(1.02 * begin)
    assert demand(1.02 * end) < RIGID.drive.command_limit < demand(0.98 * end)


def test_a_notch_is_below_the_nyquist_frequency():
    notch = Filter(kind="notch", frequency=600.0, damping=0.1, depth=0.1)
    with pytest.raises(InputError, match="found a notch at 600 Hz, expected one below the Nyquist frequency, 500 Hz"):
        assert design_velocity_loop(RIGID, crossover=40.0, filters=(notch,)).sampled.margins


def test_two_limits_that_are_met_at_once_are_both_said():
    axis = RIGID.replace(sampling={"encoder_resolution": 1e-3})
    plant = sample_axis(axis)
    found = limits(axis, plant, reach(plant, 60.0), 60.0, IP, 3.0)
    assert found["encoder_noise"] == found["voltage"]
    assert " to " in found["binding"] or found["binding"].endswith("rad/s on")
