"""What excited records add to a diagnosis: their frequency response beside the model."""

from dataclasses import replace

import numpy as np

from emps_design.discrepancy.explanation import measured_response
from emps_design.machines import machine
from tests.unit.frequency_response.cases import experiment, two_mass


def test_excited_records_show_their_response_beside_the_model():
    axis, record = two_mass(), experiment(two_mass(), 3, count=2)
    found = measured_response((record,), axis)
    assert found.chain.masses.size == 2
    assert found.agreement.bands == ()
    assert measured_response((record,), machine("emps2019")).agreement.bands
    assert measured_response((replace(record, excitation=None),), axis) is None


def test_an_excitation_that_is_too_weak_shows_nothing():
    axis, record = two_mass(), experiment(two_mass(), 3, count=2)
    faint = replace(record, excitation=np.random.default_rng(1).standard_normal(len(record)))
    assert measured_response((faint,), axis) is None
