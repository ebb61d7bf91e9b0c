"""Pages: self-contained, repeatable, escaped, numbered; the parts refuse what cannot be drawn."""

import re

import numpy as np
import pytest

from emps_design import figures
from emps_design.report import Facts, Html, Line, Page, Picture, Section, Table, style
from emps_design.report.page import delay, frequency, number, quantity, ratio, with_std
from emps_design.units import Units


def picture(caption="a line", points=50):
    with style.look():
        figure, axes = style.subplots(height=1.5)
        axes.plot(np.linspace(0, 1, points), np.linspace(0, 1, points) ** 2, label="q")
        axes.legend()
    return Picture(figure, caption, "Square")


def page():
    return Page(
        "Title <b>",
        "machine",
        (Line("The loop is unstable: 1 & 2", "bad"), Facts((("margin", "60.0°", ""),))),
        (
            Section("First things", Line("x < y"), Line("one", "point"), Line(Html("<i>two</i>"), "point"), picture()),
            Section(
                "Second", None, picture("b"), Table(["a", "b [N]"], [["row", 1.5]], "Numbers."), Line("a = b", "code")
            ),
        ),
    )


def test_page_asks_for_nothing_outside_itself():
    html = page().html()
    assert not re.findall(r'(?:src|href)="(?!#)', html.replace('xmlns:xlink="', ""))
    assert "@import" not in html
    assert "<script" not in html


def test_same_content_same_bytes():
    assert page().html() == page().html()


def test_text_is_escaped_and_html_is_kept():
    html = page().html()
    assert "Title &lt;b&gt;" in html
    assert "x &lt; y" in html
    assert "1 &amp; 2" in html
    assert "<i>two</i>" in html


def test_an_unstable_loop_comes_before_any_number():
    html = page().html()
    assert html.index("The loop is unstable") < html.index("60.0°")
    assert '<p class="bad" role="alert">The loop is unstable' in html


def test_contents_list_reaches_every_section():
    html = page().html()
    for key in re.findall(r'<a href="#([^"]+)"', html):
        assert f'<section id="{key}">' in html


def test_ids_are_unique_and_every_reference_resolves():
    html = page().html()
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:xlink:)?href="#([^"]+)"', html)) | set(re.findall(r"url\(#([^)]+)\)", html)) <= set(ids)


def test_figures_and_tables_are_numbered_through():
    html = page().html()
    assert "Figure 1. Square." in html
    assert "Figure 2. Square." in html
    assert "Table 1." in html
    assert len(page().pictures()) == 2


def test_notebook_view_wraps_the_page():
    assert page()._repr_html_().startswith("<iframe srcdoc=")


def test_parts_refuse_what_cannot_be_drawn():
    with pytest.raises(ValueError, match="style of a line: found 'loud'"):
        Line("x", "loud")
    with pytest.raises(ValueError, match="a row has 1 cells, expected 2"):
        Table(["a", "b"], [["x"]], "t")


def test_picture_does_not_depend_on_the_users_settings():
    import matplotlib as mpl

    before = style.svg(picture().figure)
    with mpl.rc_context({"font.size": 30, "lines.linewidth": 9, "svg.hashsalt": "other"}):
        after = style.svg(picture().figure)
    assert before == after


def test_thinning_keeps_the_extremes():
    t = np.arange(100_000) * 1e-3
    y = np.sin(t)
    y[54_321] = 7.0
    kept_t, kept_y = figures.thin(t, y)
    assert kept_y.max() == 7.0
    assert kept_t.size < 2500
    assert np.all(np.diff(kept_t) > 0)
    assert kept_t[0] == t[0]
    assert kept_t[-1] == t[-1]


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (number(-0.5), "−0.5000"),
        (number(999.96), "1000"),
        (number(float("nan")), "—"),
        (quantity(3.84e-3, "m/s"), "3.840 mm/s"),
        (quantity(12.0, "V"), "12.00 V"),
        (frequency(2 * np.pi), "6.283 rad/s (1.000 Hz)"),
        (ratio(10.0), "10.00 (20.0 dB)"),
        (delay(None), "unbounded"),
        (with_std(-3.1648, 0.0444, "N"), "−3.165 ± 0.044 N"),
        (with_std(7.4, 0.6, "N"), "7.40 ± 0.60 N"),
        (with_std(1.0, 1e-9, ""), "1.00000 ± 1.0e−9"),
    ],
)
def test_numbers_as_a_reader_sees_them(shown, expected):
    assert shown == expected


def test_a_log_axis_of_a_rotary_machine_is_read_in_degrees_too():
    with style.look():
        figure, axes = style.subplots(height=2.0)
        axes.semilogx([3.0, 900.0], [0.0, 1.0])
        axes.set_xlabel("period of position [mm]")
        style.labelled(figure, Units("rotary", "current", "A"))
        figure.canvas.draw()
    assert axes.get_xlabel() == "period of angle [deg]"
    ticks = {label.get_text(): label.get_position()[0] for label in axes.get_xticklabels()}
    assert ticks["10"] == pytest.approx(1e3 * np.radians(10.0))
