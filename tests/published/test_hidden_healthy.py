"""Healthy drives of a simulator that shares nothing with this package: two records, two estimators, one answer."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.identification import identify
from emps_design.identification.closed_loop import identify_by_output_error
from emps_design.records import read_record


@pytest.mark.parametrize("case", ["emps-none-0", "emps-none-3", "heavy-none-0", "heavy-none-2"])
def test_estimators_agree_across_records(hidden_data, case):
    folder = hidden_data / case
    axis = Axis.load(folder / "axis.toml")
    train = identify(read_record(folder / "train.npz"), axis, filter="hold")
    held_out = identify_by_output_error(read_record(folder / "holdout.npz"), axis)
    for name, one in train.parameters.items():
        other = held_out.parameters[name]
        assert abs(one.value - other.value) < 4.0 * np.hypot(one.std_long_run, other.std_long_run), name
    # The noise put in is 0.35 N rms below 40 Hz: nothing else is left.
    assert train.rms_error < 0.35
