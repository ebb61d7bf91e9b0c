"""Feed-forward on the second simulator, by right numbers and by wrong ones: the rows of `benchmarks.compensation`."""

import numpy as np
import pytest

from benchmarks.compensation import MACHINES, machine
from tests.studies import quick

SEED = 11  # not that of the benchmark


@pytest.mark.parametrize("name", quick(MACHINES, 3, "more machines"))
def test_a_hidden_effect_fed_forward_lowers_the_error_with_wrong_numbers_too(name):
    """Below no feed-forward and below the rigid one; 2 % and 10 degrees wrong still, and at rest it stays at rest."""
    row = machine(name, SEED, found=False)
    rms = row["rms"]
    assert rms["with"] < rms["without"] / 3.0
    assert rms["with"] < rms["rigid"] / 1.5
    assert len(row["wrong_each"]) == 8
    assert np.isfinite([*rms.values()]).all()
    assert rms["wrong"] < rms["without"]
    assert rms["with"] < min(row["wrong_each"])
    assert np.all(np.less(row["wrong_each"], row["rigid_wrong_each"]))  # the rigid one by the same errors
    assert row["still_moving"] == 0.0
