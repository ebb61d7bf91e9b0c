"""Names at the top of the package lead where they say, on first use."""

import pytest

import emps_design


@pytest.mark.parametrize("name", emps_design.__all__)
def test_every_name_resolves(name):
    assert getattr(emps_design, name).__doc__
    assert name in dir(emps_design)


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="module 'emps_design' has no attribute 'Axle'"):
        _ = emps_design.Axle
