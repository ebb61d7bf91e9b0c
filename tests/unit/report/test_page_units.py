"""Pages are made in the units of their axis: nothing of another machine is left in them to be rewritten."""

import pytest

from emps_design.discrepancy.view import diagnosis_view
from emps_design.identification.controller import identify_law
from emps_design.identification.observation import observe
from emps_design.report import Page, Section
from emps_design.report.assemble import assemble_report
from emps_design.report.diagnosis import design_change, experiment_section
from emps_design.report.diagnosis_sections import (
    closest_section,
    findings_section,
    gap_section,
    parameters_section,
)
from emps_design.report.page import interval, quantity, with_std
from emps_design.report.record import observation_blocks
from emps_design.simulation.synthetic import synthetic_record
from emps_design.units import LINEAR, Units
from tests.axes import CONTROLLER, KINDS, axis_of
from tests.rewriting import rewritten

JOINT = Units("rotary", "current", "A")


@pytest.fixture(scope="module", params=KINDS)
def axis(request):
    """An axis of each kind, with the numbers of the paper's machine."""
    return axis_of(request.param, **CONTROLLER)


@pytest.fixture(scope="module")
def record(axis):
    return synthetic_record(axis, laps=1, stroke=0.1)


def check(written: str, units: Units) -> None:
    """Nothing in ``written`` would be rewritten, but the metre of a newton metre."""
    rest = written.replace("newton metre", "")
    assert rewritten(units, rest) == rest


def test_nothing_on_the_page_of_a_report_has_to_be_rewritten(axis, record, sketched, few_estimates):
    report = assemble_report(
        axis, record, design_on="axis", crossover=60.0, k_e1=0.01, hand=10.0, environment=1e4, mass=40.0, damping=60.0
    )
    check(report.page.html(), axis.units)


def test_nothing_in_a_law_and_an_observation_has_to_be_rewritten(axis, record, sketched):
    blocks = identify_law(record, axis.units).view()
    blocks += observation_blocks(observe(record, axis))
    check(Page("", "", (), (Section("Result", *blocks),), units=axis.units).html(), axis.units)


def test_nothing_in_the_numbers_of_a_diagnosis_has_to_be_rewritten(axis):
    units, force = axis.units, axis.units.unit("N")
    parameters = {
        name: {"value": 0.0123, "std": 0.001, "unit": unit}
        for name, unit in (("force", "N"), ("period", "m"), ("level", "V"), ("velocity", "m/s"), ("delay", "s"))
    }
    where = {"text": "throughout", "force": {"value": 0.92, "unit": force, "sense": "more"}}
    finding = {"effect": "backlash", "label": "Backlash", "gap_before": 2.0, "gap_after": 1.0, "p_value": 0.01}
    finding |= {"where": where, "parameters": parameters, "equivalents": ["mass_change"]}
    values = {"baseline": 2.0, "extended": 1.0}
    gap = {"unit": "N", "floor": 0.4, "train": values, "holdout": values}
    numbers = {"mass": {"axis": 95.0, "unit": "kg", "baseline": {"value": 96.0, "std": 0.1}}}
    document = {
        "verdict": "named",
        "findings": [finding],
        "gap": gap,
        "parameters": numbers,
        "simulation": "closed loop",
    }
    document |= {"gap_inverse_60hz": gap, "closest": {"text": "it is close", "gap": gap, "gap_inverse_60hz": gap}}
    row = {"program": "sweep", "text": "a sweep", "distance": 1.0, "over_noise": 4.0}
    chosen = {"text": "a sweep", "program": "sweep", "file": "next.csv", "menu": [row], "between": [], "needed": 3.0}
    sections = (
        Section("Answer", *diagnosis_view(document, units)),
        findings_section([finding], units),
        closest_section(document, units),
        parameters_section(document, units),
        gap_section(document, units),
        experiment_section(chosen, None, units),
    )
    check(Page("", "", (), sections, units=units).html(), units)
    for row in design_change(axis, axis.replace(mechanics={"mass": 100.0})):
        check(" | ".join(str(row[key]) for key in ("quantity", "before", "after", "note")), units)


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (quantity(0.02, "m", units=JOINT), "1.146 deg"),
        (quantity(0.0123, "V", 3, JOINT), "12.3 mA"),
        (quantity(0.01, "m/s", units=JOINT), "0.5730 deg/s"),
        (quantity(2.5, "N/V", 3, JOINT), "2.50 N m/A"),
        (quantity(1.5, "m/s", 3, JOINT), "1.50 rad/s (14.3 rpm)"),
        (quantity(2e-3, "s", 3, JOINT), "2.00 ms"),
        (with_std(0.00993, 0.0003, "m/s", JOINT), "0.569 ± 0.017 deg/s"),
        (interval(0.00993, 0.0003, "m/s", JOINT), "0.535 to 0.603 deg/s"),
        (quantity(0.02, "m"), quantity(0.02, "m", units=LINEAR)),
    ],
)
def test_a_number_is_rounded_once_in_the_unit_of_its_axis(shown, expected):
    assert shown == expected
