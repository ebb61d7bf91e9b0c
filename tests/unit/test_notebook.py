"""What a notebook shows of the objects that a user meets: a title, and numbers with their units."""

import pytest

import emps_design as ed
from emps_design.comanipulation.assessment import assess_impedance
from emps_design.report.loop_figures import velocity_loop_figures
from emps_design.report.page import Picture
from emps_design.simulation import replay
from emps_design.view import Line, Table, html

AXIS = ed.machine("emps2019")
RIPPLED = AXIS.replace(effects=[{"kind": "position_ripple", "amplitude": 2.0, "period": 2.5e-3, "phase": 0.5}])


@pytest.fixture(scope="module")
def record():
    return ed.synthetic_record(AXIS, laps=1, stroke=0.1)


def test_an_axis_with_its_effects():
    html = RIPPLED._repr_html_()
    assert html.startswith("<table><caption>emps2019</caption>")
    assert '<th>mechanics.mass</th><td class="number">95.109</td><td>kg</td>' in html
    assert '<th>position_ripple.period</th><td class="number">0.0025</td><td>m</td>' in html
    assert "None" not in html


def test_a_record_and_what_is_found_in_it(record):
    assert "<th>stroke</th>" in record._repr_html_()
    assert "<td>kg</td>" in ed.identify(record, AXIS)._repr_html_()
    observed = ed.observe(record, AXIS)._repr_html_()
    assert "Smallest observable force [N]" in observed
    assert "<td>break-away</td>" in observed
    found = replay(AXIS, record)
    assert "<th>force</th>" in found._repr_html_()
    assert "<th>largest speed</th>" in found.run._repr_html_()


def test_designs_and_their_margins():
    design = ed.design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    assert "sampled velocity loop, IP, is stable" in design._repr_html_()
    assert '<th>delay margin</th><td class="number">3.8' in design.sampled.margins._repr_html_()
    assert "unbounded" in design.plant_input._repr_html_()
    force = ed.design_force_loop(design, 0.005)
    assert "sampled force loop, with its velocity loop in contact and without, is stable" in force._repr_html_()
    assert "Largest k_e1" in str(force)
    law = assess_impedance(AXIS, 50.0, 100.0, 0.02, plants=0)
    assert law._repr_html_().startswith('<p class="warning">CREEPING: the released carriage creeps on')
    fast = ed.design_velocity_loop(AXIS, crossover=500.0, phase_margin_deg=80.0)
    assert "undefined" in fast.sampled.margins._repr_html_()


def test_a_picture_of_a_report_is_drawn_with_its_caption():
    design = ed.design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    for name, figure in velocity_loop_figures(design).items():
        assert "<svg" in Picture(figure, "What to see.", name)._repr_html_()


def test_words_are_escaped():
    assert "<b>" not in html((Line("<b>"), Table(("<b>",), [("<b>",), (None,)], "<b>")))
