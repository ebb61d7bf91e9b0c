"""A reference of a few sines: its period is found, and where there are too few of them that is what is said."""

import numpy as np
import pytest

from emps_design.errors import RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.signals import signals_of
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

AXIS = machine("emps2019")
T = 1e-3 * np.arange(12_000)


def followed(*frequencies: float) -> Record:
    """A closed-loop record of a reference of sines [Hz] of equal speed on a running carriage."""
    phases = 1.0 + np.arange(len(frequencies))
    reference = 0.05 * T + sum(
        0.002 / f * np.sin(2.0 * np.pi * f * T + phase) for f, phase in zip(frequencies, phases, strict=True)
    )
    run = Plant.of(AXIS).closed_loop(reference)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(T.size)
    return Record.from_arrays(1e-3, reference, run.q, run.u + noise)


def test_slow_lines_repeat_later_than_the_jerk():
    """The jerk, of 7.5 Hz nearly alone, repeats after 2/3 s; the reference after 2 s."""
    assert signals_of(followed(1.0, 3.0, 7.5)).repeats == 2000


@pytest.mark.parametrize(
    ("frequencies", "said"),
    [
        ((1.0, 3.0, 7.5), "found 3 excited lines, expected at least 4; excite a larger part of the band"),
        ((1.013, 3.37, 7.71), "found 3 lines in the reference, expected at least 4, or a band; excite more"),
    ],
)
def test_three_lines_are_too_few_and_not_too_weak(frequencies, said):
    with pytest.raises(RecordError, match=said):
        estimate_response(followed(*frequencies), AXIS)
