"""The nearest specification that works, judged by a simulation of its own: the law's lines and a plant by scipy."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.control.margins import Margins
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.velocity.specification import Pairs, nearest_that_works, proposal_in_words
from emps_design.errors import SpecificationError
from emps_design.machines import machine
from tests.studies import quick

AXIS = machine("emps2018")


def random_axis(rng):
    """An axis between 0.05 kg at 4 kHz and 20 t at 100 Hz, with whatever drive and estimator."""
    mass = 10 ** rng.uniform(math.log10(0.05), math.log10(20e3))
    period = 10 ** rng.uniform(math.log10(1 / 4000), math.log10(1 / 100))
    return Axis(
        name="drawn",
        mechanics={"mass": mass, "viscous": mass * 10 ** rng.uniform(-2.0, 2.5), "coulomb": 0.0},
        drive={
            "force_gain": mass * 10 ** rng.uniform(-1, 1),
            "current_time_constant": float(rng.choice([0.0, 0.3, 2.0])) * period,
        },
        sampling={"period": period, "encoder_resolution": 0.0, "computation_delay": int(rng.integers(0, 3))},
        controller={"kind": "none", "velocity_estimator": str(rng.choice(["two_tap", "backward"]))},
    )


def simulated(axis, k_v1, t_v, extra_delay, samples=4000):
    """Velocity estimate (samples,) after a unit step of the reference: the difference equation and an exact plant."""
    mass, viscous, gain = axis.mechanics.mass, axis.mechanics.viscous, axis.drive.force_gain
    lag, T = axis.drive.current_time_constant, axis.sampling.period
    if lag > 0.0:
        generator = np.array([[0, 1, 0, 0], [0, -viscous / mass, 1 / mass, 0], [0, 0, -1 / lag, gain / lag], [0] * 4])
    else:
        generator = np.array([[0, 1, 0], [0, -viscous / mass, gain / mass], [0, 0, 0]])
    step = expm(generator * T)
    x = np.zeros(len(step))
    late = [0.0] * (axis.sampling.computation_delay + extra_delay)
    back = 2 if axis.controller.velocity_estimator == "two_tap" else 1
    read, integral, out = [0.0, 0.0], 0.0, np.empty(samples)
    for k in range(samples):
        v = (x[0] - read[-back]) / (back * T)
        integral += T / t_v * (1.0 - v)
        late.append(k_v1 * (integral - v))
        read.append(x[0])
        x[-1] = late.pop(0)
        x = step @ x
        out[k] = v
        if abs(v) > 1e6:
            out[k:] = np.inf
            break
    return out


def settles(response):
    """Whether a step response does not grow: its last quarter swings no more than the second, rounding aside."""
    if not np.isfinite(response).all():
        return False
    quarter = response.size // 4
    return np.ptp(response[-quarter:]) <= np.ptp(response[quarter : 2 * quarter]) + 1e-6


def refused(axis, request, retune):
    """What is proposed instead of ``request``; None where the request itself can be had."""
    design = retune_velocity_loop if retune else design_velocity_loop
    try:
        found = design(axis, **request)
    except SpecificationError as error:
        return error.nearest
    return None if found.sampled.stable else found.nearest_stable


@pytest.mark.parametrize("retune", quick([False, True], 1, "retuned"))
@pytest.mark.parametrize("kind", ["crossover", "bandwidth"])
def test_every_proposal_works_in_a_simulation(kind, retune):
    rng = np.random.default_rng(20 + 2 * retune + (kind == "crossover"))
    proposals = 0
    while proposals < 12:
        axis = random_axis(rng)
        nyquist = math.pi / axis.sampling.period
        request = {kind: 10 ** rng.uniform(-2.5, 0.6) * nyquist, "phase_margin_deg": float(rng.uniform(3.0, 89.8))}
        nearest = refused(axis, request, retune)
        if nearest is None:
            continue
        assert nearest, f"nothing proposed for {request}"
        proposals += 1
        other = nearest.pop("or", nearest)
        for pair in (nearest, other):
            design = (retune_velocity_loop if retune else design_velocity_loop)(axis, **pair)
            margins = design.sampled.margins
            assert margins.delay_margin_samples is None or margins.delay_margin_samples >= 1.0
            for extra_delay in (0, 1):
                assert settles(simulated(axis, design.k_v1, design.t_v, extra_delay)), (axis, pair, extra_delay)
            if kind == "bandwidth":
                asked = pair["bandwidth"]
            elif retune:  # at the plant input a closed loop passes about the crossover over tan of its phase margin
                asked = pair["crossover"] * np.clip(1.0 / math.tan(math.radians(pair["phase_margin_deg"])), 0.01, 1.0)
            else:
                asked = pair["crossover"]
            assert design.sampled.bandwidth > min(0.5 * asked, 0.5 * nyquist), (axis, pair)


def test_nothing_nearer_works():
    """Walk from the request towards the proposal with the simulation alone: what lies between fails."""
    axis = AXIS.replace(sampling={"computation_delay": 1})
    request = {"crossover": 400.0, "phase_margin_deg": 60.0}
    nearest = design_velocity_loop(axis, **request).nearest_stable
    other = nearest.pop("or", None)
    assert nearest["phase_margin_deg"] == 60.0
    for crossover in np.linspace(nearest["crossover"] * 1.02, 400.0, 8):
        loop = design_velocity_loop(axis, crossover=crossover, phase_margin_deg=60.0)
        assert not settles(simulated(axis, loop.k_v1, loop.t_v, 1)), crossover
    assert other is None


def test_a_proposal_is_no_loop_without_integral_action():
    """At the upper limit of the phase margin the integral vanishes: 268 rad/s would be proposed, -3 dB far below."""
    with pytest.raises(SpecificationError, match="the upper limit binds") as caught:
        retune_velocity_loop(AXIS, crossover=300.0, phase_margin_deg=60.0)
    nearest = dict(caught.value.nearest)
    for pair in (nearest.pop("or"), nearest):
        found = retune_velocity_loop(AXIS, **pair).sampled
        inherent = pair["crossover"] / max(1.0, math.tan(math.radians(pair["phase_margin_deg"])))
        assert found.bandwidth > 0.5 * inherent


def test_phase_margins_next_to_90_are_found():
    """A stiff friction leaves less than a tenth of a degree below 90 deg, and that works."""
    viscous = AXIS.replace(mechanics={"viscous": 115.7315 * 1000.0})
    with pytest.raises(SpecificationError, match="the lower limit binds") as caught:
        design_velocity_loop(viscous, crossover=1.0, phase_margin_deg=60.0)
    nearest = dict(caught.value.nearest)
    other = nearest.pop("or", nearest)
    pair = next(pair for pair in (nearest, other) if pair["crossover"] == 1.0)
    assert 89.9 < pair["phase_margin_deg"] < 90.0
    assert design_velocity_loop(viscous, **pair).sampled.stable


def test_both_may_change_where_neither_line_has_one():
    """A low phase margin that (7) cannot have at low crossovers nor the sampled loop at high ones."""
    axis = AXIS.replace(mechanics={"viscous": 115.7315 * 65.0}, sampling={"period": 5e-3})
    with pytest.raises(SpecificationError) as caught:
        design_velocity_loop(axis, crossover=150.0, phase_margin_deg=12.0)
    nearest = caught.value.nearest
    assert nearest["crossover"] != 150.0
    assert nearest["phase_margin_deg"] != 12.0
    assert design_velocity_loop(axis, **nearest).sampled.stable


def test_nothing_is_said_to_be_nothing():
    plant = sample_axis(AXIS)

    def gains(frequency, phase):
        return np.full(frequency.size, np.nan), np.full(frequency.size, np.nan)

    nothing = nearest_that_works(
        Pairs(plant, gains, lambda frequency, phase: frequency), {"crossover": 100.0, "phase_margin_deg": 60.0}
    )
    assert nothing == {}
    assert proposal_in_words(nothing) == "no pair of frequency and phase margin works"


def test_little_room_is_told(capsys):
    """9 degrees and a twentieth of a sample: stable, and no loop to run on a drive."""
    axis = AXIS.replace(sampling={"computation_delay": 2})
    steps = np.linspace(10.0, 200.0, 400)
    loops = [design_velocity_loop(axis, crossover=w, phase_margin_deg=60.0) for w in steps]
    last = max((loop for loop in loops if loop.sampled.stable), key=lambda loop: loop.crossover)
    assert last.sampled.margins.delay_margin_samples < 0.5
    assert any(warning.startswith("the sampled loop is barely stable") for warning in last.warnings)
    assert run(["gains", "--crossover", "400", "--computation-delay", "2"]) == 4
    reason = capsys.readouterr().err
    assert "nearest that works: 60 deg at a crossover of" in reason
    assert re.search(r"delay margin \S+ samples", reason)


def test_a_proposal_without_a_bounded_margin_has_no_empty_brackets():
    boundless = SimpleNamespace(loop=lambda *pair: SimpleNamespace(margins=Margins(stable=True), bandwidth=None))
    said = proposal_in_words({"crossover": 0.01, "phase_margin_deg": 80.0}, boundless)
    assert said == "nearest that works: 80 deg at a crossover of 0.01 rad/s"


def test_a_proposal_for_a_loop_that_hardly_moves_says_what_it_has():
    with pytest.raises(SpecificationError, match=r"rad/s \(sampled: \S* deg, delay margin \S* samples, -3 dB at 0.0"):
        design_velocity_loop(AXIS, crossover=0.01)
