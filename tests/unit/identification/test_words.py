"""What an identification and a measured response say, in the units of their axis: nothing of another machine."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import InputError, RankError, RecordError
from emps_design.frequency_response.coupling import fit_chain
from emps_design.frequency_response.experiment import ExcitationRequest, Limits, check_request
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.identification import identify
from emps_design.identification.assemble import implausible
from emps_design.identification.controller.identify_law import identify_law
from emps_design.identification.excitation import check_record, force_free
from emps_design.identification.inverse_model import check_rank
from emps_design.identification.model import lumped
from emps_design.identification.observation import direct_validation
from emps_design.identification.proposals import Unexplained
from emps_design.importing.sanity import check_against
from emps_design.records.layout import MAPPED, Assignment
from emps_design.simulation.synthetic import synthetic_record
from emps_design.units import LINEAR
from tests.axes import CONTROLLER, KINDS, axis_of
from tests.rewriting import rewritten
from tests.unit.discrepancy.test_words import refused


@pytest.fixture(scope="module", params=KINDS)
def axis(request):
    """An axis of each kind."""
    return axis_of(request.param, **CONTROLLER)


@pytest.fixture(scope="module")
def record(axis):
    """Strokes of the axis, as its model makes them."""
    return synthetic_record(axis, laps=1)


def refusals(axis, record) -> list[str]:
    """Records that cannot identify the axis, and an excitation beyond a limit."""
    still, pushed = replace(record, q=1e-7 * record.q), replace(record, f_ext=np.ones(len(record)))
    onwards = replace(record, q=record.t, u=0.1 * record.u)
    limited = replace(record, u=np.full(len(record), axis.drive.command_limit))
    checks = [refused(RecordError, check_record, wrong, axis) for wrong in (still, pushed, onwards, limited)]
    columns = np.outer([1.0, -1.0, 1.0], [1.0, 1.0])
    fast = Limits(0.5, speed=0.2), ExcitationRequest(0.3), 100.0, 500.0, axis.units
    return [
        *checks,
        refused(RankError, check_rank, columns, ("mass", "constant_force"), axis.units),
        refused(RecordError, direct_validation, record, axis),
        refused(RecordError, identify_law, [record, pushed], axis.units),
        refused(InputError, check_request, *fast),
        refused(InputError, check_request, Limits(0.5, force=-1.0), *fast[1:]),
    ]


def warnings(axis, record) -> list[str]:
    """Warnings on what was identified, and on a record of another machine."""
    noisy = force_free(replace(record, f_ext=np.full(len(record), 1e-3)), axis)
    heavy = axis.replace(mechanics={"mass": 95e4, "viscous": 2e6})
    mapped = replace(record, assigned=(Assignment("q", "q", how=MAPPED),))
    f = np.arange(3.0, 120.0)
    early = FrequencyResponse.of(f, np.exp(2j * np.pi * f * 1e-3) / (2j * np.pi * f * 100.0), np.full(f.size, 0.01))
    chain = fit_chain(early, 1, axis.units)
    identification = identify(record, axis)
    return [
        *noisy.warnings,
        lumped(axis.units),
        *Unexplained(0.4, 0.3, 2.0, 1.5).warnings(axis.units),
        *implausible({"mass": -9.0, "viscous": -2.0, "coulomb": -2.0}, axis),
        *implausible({"mass": 950.0, "viscous": 200.0, "coulomb": 20.0}, axis),
        refused(RecordError, check_against, heavy, mapped, "file").partition(";")[0],  # then a key, "force-scale"
        chain.label,
        *chain.warnings,
        identification.filter_text,
        identification.extra["cutoff_from_data"]["rule"],
    ]


def test_no_message_is_of_another_machine(axis, record):
    messages = [*refusals(axis, record), *warnings(axis, record)]
    assert [rewritten(axis.units, message) for message in messages] == messages


def test_the_messages_are_those_of_the_linear_axis_in_the_units_of_this_one(axis):
    def made(units):
        bare = Unexplained(0.4, 0.3, 2.0, 1.5).warnings(units)
        below_zero = Limits(0.5, force=-1.0), ExcitationRequest(0.3), 100.0, 500.0, units
        return [*bare, lumped(units), refused(InputError, check_request, *below_zero)]

    assert made(axis.units) == [rewritten(axis.units, message) for message in made(LINEAR)]
