"""Simulated records with a slow force noise, of a machine whose parameters are known."""

from functools import cache

import pytest

from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from tests.unit.identification.slow_noise_records import noisy_record


@cache
def plant():
    return Plant.of(machine("emps2019"))


def simulated(seed: int, laps: int = 1, std: float = 1.0, time: float = 0.1) -> Record:
    """A record of the embedded machine with slow force noise and 4 mV of voltage noise."""
    return noisy_record(plant(), seed, laps, std, time)


@pytest.fixture(scope="session")
def truth():
    mechanics = machine("emps2019").mechanics
    return dict(zip(("mass", "viscous", "coulomb", "constant_force"), mechanics.array(), strict=True))


@pytest.fixture(scope="session")
def record() -> Record:
    return simulated(0)


@pytest.fixture(scope="session")
def simulate():
    """The function that makes a simulated record: ``simulate(seed, laps, std, time)``."""
    return simulated


@pytest.fixture(scope="session")
def reference_plant():
    """The embedded machine, ready to be simulated."""
    return plant()
