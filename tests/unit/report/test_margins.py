"""What is written around the axes stays in the picture and apart, whatever the numbers on them."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_svg import FigureCanvasSVG

from emps_design.report import style

LARGEST = [3e-7, 0.00123, 4.0, 987.6, 876_543.0, 3e8]


def boxes(figure):
    """Where each of the axes is with all around it, in points, as an SVG has it."""
    FigureCanvasSVG(figure)
    figure.dpi = 72
    figure.draw_without_rendering()
    return [axes.get_tightbbox() for axes in figure.axes if axes.axison]


def inside(figure, slack=1.5):
    width, height = 72 * figure.get_size_inches()
    for box in boxes(figure):
        assert box.x0 > -slack
        assert box.y0 > -slack
        assert box.x1 < width + slack
        assert box.y1 < height + slack


@pytest.mark.parametrize("largest", LARGEST)
def test_labels_are_in_the_picture_and_apart(largest):
    with style.look():
        figure, grid = style.plain_subplots(2, 2, height=5.0)
        for axes in grid.flat[:3]:
            axes.plot([0.0, 1.0], [-largest, 0.7 * largest])
            axes.set(xlabel="velocity [mm/s]", ylabel="residual torque [N m]", title="backwards")
        grid.flat[3].axis("off")
        inside(figure)
        for one, other in combinations(boxes(figure), 2):
            assert not one.padded(-1.0).overlaps(other.padded(-1.0))


def test_words_and_a_bar_of_colours_are_in_the_picture():
    with style.look():
        figure, (axes, bar) = style.plain_subplots(1, 2, width_ratios=(60, 1))
        figure.colorbar(axes.pcolormesh(np.eye(3)), cax=bar, label="missing force [N]")
        axes.set_yticks([0.5, 1.5], ["position-dependent friction", "elastic force"])
        inside(figure)


def test_labels_of_a_column_stand_in_one_line():
    with style.look():
        figure, grid = style.plain_subplots(2, 1, sharex=True)
        for axes, largest in zip(grid, (1.0, 20_000.0), strict=True):
            axes.plot([0.0, largest])
            axes.set_ylabel("force [N]")
        boxes(figure)
    one, other = (axes.yaxis.label.get_window_extent() for axes in grid)
    assert one.x0 == pytest.approx(other.x0, abs=0.1)
    assert one.x1 < grid[1].yaxis.get_tightbbox().x1
