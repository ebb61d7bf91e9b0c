"""What cannot be, and what is far from the axis, is said, with what probably happened."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import RecordError
from emps_design.identification import identify
from emps_design.identification.assemble import implausible
from emps_design.identification.closed_loop import identify_by_output_error, identify_with_instruments
from emps_design.machines import machine

AXIS = machine("emps2019")


def said(record, **options):
    return " ".join(identify(record, AXIS, **options).warnings)


@pytest.mark.parametrize("model", ["symmetric", "asymmetric"])
@pytest.mark.parametrize("chain", ["hold", "report"])
def test_a_flipped_sign_is_named(record, model, chain):
    warning = said(replace(record, u=-record.u), model=model, filter=chain)
    assert "no axis has mass -95" in warning
    assert "the sign of u is probably opposite to that of q" in warning


@pytest.mark.parametrize("estimate", [identify_with_instruments, identify_by_output_error])
def test_a_simulation_that_cannot_start_says_it_too(record, estimate):
    with pytest.raises(
        RecordError, match="mass was identified as -95.*the sign of u is probably opposite to that of q"
    ):
        estimate(replace(record, u=-record.u), AXIS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: replace(r, u=1e-3 * r.u), "u (or the force gain) in another unit, 1000 times too small"),
        (lambda r: replace(r, u=0.01 * r.u), "u (or the force gain) in another unit, 100 times too small"),
        (lambda r: replace(r, q=1e3 * r.q, q_ref=1e3 * r.q_ref), "q (and q_ref) in another unit, 1000 times"),
        (
            lambda r: replace(r, t=1e3 * r.t, period=1e3 * r.period),
            "t in another unit, 1000 times too large",
        ),
    ],
)
def test_a_wrong_unit_is_named(record, change, words):
    assert words in said(change(record))


def test_another_machine_is_far_from_the_axis_without_a_guess_at_the_unit(record):
    heavy = AXIS.replace(mechanics={"mass": 900.0})
    warning = " ".join(identify(record, heavy).warnings)
    assert "far from the axis: mass 95" in warning
    assert "where emps2019 says 900" in warning
    assert "another machine or payload, a wrong force gain, or a wrong unit" in warning


def test_a_plausible_record_is_passed_in_silence(record):
    assert identify(record, AXIS).warnings == ()
    assert identify(record, AXIS.replace(mechanics={"mass": 60.0, "coulomb": 60.0})).warnings == ()


def test_friction_alone_below_zero_is_impossible_and_no_sign_of_u():
    (line,) = implausible({"mass": 90.0, "viscous": -5.0, "coulomb": 20.0}, AXIS)
    assert "no axis has viscous friction -5 N/(m/s)" in line
    assert "sign of u" not in line
    (line,) = implausible({"mass": -3.0, "viscous": 200.0, "coulomb": 20.0}, AXIS)
    assert "do not belong together" in line
    assert implausible({"mass": np.nan}, AXIS) == []
