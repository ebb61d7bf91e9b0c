"""One more view of excited records: their frequency response beside the extended model, and the masses that fit it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.comparison import Comparison
from emps_design.records import Record


def measured_response(records: Sequence[Record], axis: Axis) -> Comparison | None:
    """The response of the excited ``records`` beside ``axis``; None where none is, or not strongly enough."""
    excited = [one for one in records if one.excitation is not None and np.ptp(one.excitation) > 0.0]
    if not excited:
        return None
    try:
        return estimate_response(excited, axis).comparison
    except RecordError:
        return None
