"""A signal on one line of a terminal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

BLOCKS = "▁▂▃▄▅▆▇█"
PLAIN = "_.-=+*#@"


def sparkline(values: np.ndarray, width: int = 60, encoding: str = "utf-8") -> str:
    """Draw ``values`` (n,) in ``width`` characters, the lowest at the bottom; plain ones where no others can be shown.

    >>> import numpy as np
    >>> sparkline(np.arange(100.0), 8), sparkline(np.ones(5), 3), sparkline(np.arange(9.0), 4, "ascii")
    ('▁▂▃▄▅▆▇█', '▁▁▁', '_-+@')
    """
    marks = BLOCKS if encoding.lower().startswith("utf") else PLAIN
    edges = np.linspace(0, values.size, min(width, values.size) + 1).astype(int)
    means = np.array([values[a:b].mean() for a, b in pairwise(edges)])
    span = float(np.ptp(means))
    heights = np.zeros(means.size) if span == 0.0 else (means - means.min()) / span * (len(marks) - 1)
    return "".join(marks[round(height)] for height in heights)
