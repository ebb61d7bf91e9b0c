"""The machine of section IV-B, its friction model and its clock."""

import pytest

from emps_design.axis import Axis
from emps_design.control.impedance.law import FrictionModel
from emps_design.control.impedance.passivity import Clock
from emps_design.machines import machine


@pytest.fixture(scope="session")
def axis() -> Axis:
    return machine("emps2018")


@pytest.fixture(scope="session")
def plant(axis) -> FrictionModel:
    return FrictionModel.of(axis)


@pytest.fixture(scope="session")
def clock(axis) -> Clock:
    return Clock.of(axis)
