"""Pages of axes unlike the paper's: what takes phase, where gains are from, whose units, how large walls are taken."""

import re
from html import unescape

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.comanipulation.assessment import _cell, _share
from emps_design.control.force import design_force_loop
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.machines import machine
from emps_design.paper import find_errata
from emps_design.report import Line, Page, Section
from emps_design.report.assemble import assemble_report
from emps_design.report.design import design_page, design_results
from emps_design.report.impedance import _errata_table
from emps_design.report.page import quantity
from emps_design.report.velocity import force_limit_figure
from emps_design.simulation.synthetic import synthetic_record
from tests.rewriting import rewritten
from tests.studies import quick
from tests.unit.unlike_axes import JOINT

GANTRY = Axis.from_dict(
    {
        "name": "gantry",
        "mechanics": {"mass": 62.0, "viscous": 310.0, "coulomb": 48.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.08, "command_limit": 145.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 1e-8},
    }
)
LOW = [{"kind": "lowpass", "frequency": 200.0}]
COUPLING = {"kind": "flexible_coupling", "frequency": 150.0, "damping": 0.1, "share": 0.2}


def page_of(velocity) -> str:
    return design_page(design_results(velocity)).html()


def phase_costs(page: str) -> str:
    """The parts that cost phase at the plant input, as the page lists them."""
    return re.search(r"At the plant input, ([^.]*?) cost [\d.]+°", page)[1]


def with_filters(axis: Axis) -> Axis:
    return axis.replace(controller={"kind": "cascade", "velocity": {"kp": 99.0, "ti": 0.1}, "filters": LOW})


def test_an_interval_of_a_share_is_in_percent():
    assert _share({"share": 0.95, "share_interval": (0.9123, 1.0)}, "share") == "95.00 % (95 %: 91.23 to 100.00 %)"
    assert _share({"share": 0.95, "share_interval": (np.nan, np.nan)}, "share") == "95.00 %"


def test_what_no_random_plant_has_is_not_shown_as_a_number():
    assert [_cell(value) for value in (np.nan, None, 2.53812)] == ["-", "-", "2.538"]


def test_what_costs_phase_is_named_with_the_filters_and_the_effects_of_the_axis(sketched):
    plain = machine("emps2018")
    flexible = plain.replace(effects=[COUPLING])
    costs = [
        phase_costs(page_of(design_velocity_loop(axis, crossover=50.0)))
        for axis in (plain, with_filters(plain), flexible, with_filters(flexible))
    ]
    always = "sampling, hold, current loop, delay"
    assert costs == [
        f"{always} and velocity estimator",
        f"{always}, velocity estimator and filters of the command",
        f"{always}, velocity estimator and effects of the axis",
        f"{always}, velocity estimator, filters of the command and effects of the axis",
    ]


def test_margins_are_said_to_contain_the_filters(sketched):
    assert "the velocity estimator, the filters of the command and the effects of the axis file" in page_of(
        design_velocity_loop(machine("emps2018"), crossover=50.0)
    )


def test_gains_that_were_retuned_are_not_those_of_equation_7(sketched):
    page = page_of(design_velocity_loop(machine("emps2018"), crossover=60.0))
    assert "gains by (7)" in page
    assert "feasible phase margin at this crossover" in page
    retuned = page_of(retune_velocity_loop(machine("emps2018"), crossover=60.0))
    assert "gains retuned for the sampled loop" in retuned
    assert "gains by (7)" not in retuned
    assert "feasible phase margin at this crossover" not in retuned


def test_a_page_rewrites_no_text_and_errata_stay_in_the_papers_units():
    units = GANTRY.units
    page = Page("", "", (), (Section("Errata", Line("k_v1 in V/(m/s)"), _errata_table()),), units=units)
    written = unescape(page.html())
    assert "k_v1 in V/(m/s)" in written  # text stays as it was made
    assert any(rewritten(units, one.text) != one.text for one in find_errata())
    for one in find_errata():
        assert one.text in written, one.place


@pytest.mark.study("whole reports")
@pytest.mark.parametrize(
    ("axis", "gain", "wall", "said"),
    quick(
        [
            (JOINT, 1e3, 0.1, "Torque loop: a {} was assumed, because none was given."),
            (machine("emps2018"), 0.01, 1e4, "Force loop: a {} was assumed, because none was given."),
        ],
        1,
        "another whole report",
    ),
    ids=["joint", "emps2018"],
)
def test_what_a_force_loop_was_not_given_is_taken_by_the_mass_and_said(axis, gain, wall, said, sketched):
    walled = assemble_report(axis, crossover=100.0, environment=wall)
    assert walled.results.force.k_e1 == pytest.approx(gain)
    assert walled.results.force.environment == wall
    gained = assemble_report(axis, crossover=100.0, k_e1=gain)
    assert gained.results.force.environment == pytest.approx(wall)
    assert gained.results.force.k_e1 == gain
    for report, what in (
        (walled, f"gain of {quantity(gain, '(m/s)/N', units=axis.units)}"),
        (gained, f"wall of {quantity(wall, 'N/m', units=axis.units)}"),
    ):
        assert said.format(what) in report.page.html()
    whole = assemble_report(axis, crossover=100.0, k_e1=gain, environment=wall)
    assert "was assumed" not in whole.page.html()


def test_the_gain_and_the_wall_taken_for_a_light_axis_are_no_absurd_ones():
    taken = assemble_report(JOINT, crossover=100.0, hand=0.01).results.force
    assert taken.environment == 0.0
    assert taken.k_c == pytest.approx(1e-3)  # N m/(rad/s), of the size of the axis's own friction


def shades(figure) -> list[np.ndarray]:
    """Corners (n, 2) of each shaded area."""
    return [path.vertices for shade in figure.axes[0].collections for path in shade.get_paths() if len(path.vertices)]


@pytest.mark.parametrize(
    ("axis", "crossover", "k_e1", "wall"),
    [
        (machine("emps2018"), 100.0, 1e-6, 1e4),
        (machine("emps2018"), 100.0, 50.0, 3e7),
        (JOINT, 150.0, 500.0, 0.5),
        (JOINT, 150.0, 500.0, 200.0),
    ],
)
def test_the_design_lies_inside_the_picture_of_the_largest_gain(axis, crossover, k_e1, wall):
    design = design_force_loop(design_velocity_loop(axis, crossover=crossover), k_e1, environment=wall)
    axes = force_limit_figure(design).axes[0]
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < wall / 1e3 < right
    assert bottom < k_e1 < top
    marked = [tuple(line.get_xydata()[0]) for line in axes.get_lines() if line.get_marker() in ("o", "X")]
    assert marked == [(wall / 1e3, k_e1)]


def test_without_a_wall_the_picture_is_around_the_stiffness_at_which_the_mass_swings_at_the_crossover():
    design = design_force_loop(design_velocity_loop(JOINT, crossover=150.0), 500.0, hand=0.01)
    left, right = force_limit_figure(design).axes[0].get_xlim()
    assert left < JOINT.mechanics.mass * 150.0**2 / 1e3 < right
    assert right / left < 1e4


def test_the_limit_is_shaded_from_the_dashed_line_to_the_top():
    design = design_force_loop(design_velocity_loop(JOINT, crossover=150.0), 500.0, hand=0.01, environment=0.5)
    figure = force_limit_figure(design)
    bottom, top = figure.axes[0].get_ylim()
    sampled = figure.axes[0].get_lines()[1].get_ydata()
    (corners,) = shades(figure)
    assert corners[:, 1].min() == pytest.approx(np.nanmin(sampled))
    assert corners[:, 1].max() == pytest.approx(top)
    assert bottom <= np.nanmin(sampled) < np.nanmax(sampled) <= top


def test_where_no_gain_is_stable_the_whole_height_is_shaded():
    axis = machine("emps2018").replace(sampling={"computation_delay": 2})
    velocity = design_velocity_loop(axis, crossover=300.0, phase_margin_deg=20.0)
    design = design_force_loop(velocity, 0.01, environment=1e4)
    assert design.k_e1_max_sampled == 0.0
    figure = force_limit_figure(design)
    bottom, top = figure.axes[0].get_ylim()
    (corners,) = shades(figure)
    assert corners[:, 1].min() == pytest.approx(bottom)
    assert corners[:, 1].max() == pytest.approx(top)
    assert bottom < design.k_e1 < top


@pytest.mark.study("looks for the law of a record")
def test_a_record_is_identified_with_the_drive_of_the_axis_that_made_it(sketched):
    made_on = machine("emps2019")
    other = machine("emps2018").replace(name="other", drive={"force_gain": 70.0})
    record = synthetic_record(made_on, laps=1, stroke=0.1)
    own, alike = (
        assemble_report(other, record, design_on="axis", crossover=100.0, record_axis=axis) for axis in (made_on, None)
    )
    assert own.identifications[0].parameters["mass"].value == pytest.approx(95.1, abs=1.0)
    assert alike.identifications[0].parameters["mass"].value == pytest.approx(95.1 * 70.0 / 35.15, rel=0.02)
    assert own.results.velocity.axis == alike.results.velocity.axis
    assert "is identified below, with the drive of emps2019." in own.page.html()
    assert "is compared with it below." in alike.page.html()


def test_a_record_of_an_axis_with_other_units_is_left_out_and_the_page_says_so(sketched):
    made_on = machine("emps2019")
    report = assemble_report(
        JOINT, synthetic_record(made_on, laps=1, stroke=0.1), design_on="axis", crossover=100.0, record_axis=made_on
    )
    page = report.page.html()
    assert report.identifications == ()
    assert "The record was made on emps2019, an axis with other units, and is not on this page." in page
    assert "<h2>Record" not in page
