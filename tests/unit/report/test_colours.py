"""Colours that stand for different things are told apart by readers with every common form of colour blindness.

Simulated by the matrices of G. Machado, M. Oliveira, L. Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009), severity
1.0, on linear RGB; distances in CIELAB, where about 2.3 is just noticeable.
"""

from itertools import combinations

import numpy as np
import pytest

from emps_design import figures
from emps_design.report.impedance import VERDICT_COLORS

SEEN_BY = {
    "everybody else": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
TOGETHER = {
    "lines": [figures.BLACK, figures.BLUE, figures.RED, figures.GREEN],
    "continuous, sampled, pinned": [figures.BLUE, figures.RED, figures.GREY],
    "verdicts": list(VERDICT_COLORS.values()),
}


def lab(colour: str, seen: np.ndarray) -> np.ndarray:
    """CIELAB of ``#rrggbb`` as ``seen``."""
    rgb = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(seen @ linear, 0.0, 1.0) / TO_XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("reader", SEEN_BY)
@pytest.mark.parametrize("group", TOGETHER)
def test_told_apart(group, reader):
    for one, other in combinations(TOGETHER[group], 2):
        distance = np.linalg.norm(lab(one, SEEN_BY[reader]) - lab(other, SEEN_BY[reader]))
        assert distance > 15.0, (one, other, distance)


def test_the_distance_is_that_of_the_textbook():
    """White against black is 100; red, green and blue of sRGB have their published CIELAB values."""
    assert lab("#ffffff", np.eye(3)) == pytest.approx([100.0, 0.0, 0.0], abs=0.05)
    assert lab("#ff0000", np.eye(3)) == pytest.approx([53.24, 80.09, 67.20], abs=0.1)
