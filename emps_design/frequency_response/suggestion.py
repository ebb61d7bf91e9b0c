"""Whether a filter of the command pays on a measured plant: found on the masses that fit it, tried on the data."""

from __future__ import annotations

from typing import Any

from emps_design.axis import Axis
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.limits import suggest_filter
from emps_design.control.velocity.structure import Structure
from emps_design.frequency_response.comparison import Comparison
from emps_design.frequency_response.loop import measured_margins
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws.library.cascade import Filter

SIDES = ("without", "with_equal_margins", "with")
MARGINS = ("phase_margin_deg", "gain_margin", "disk_margin")


def suggest_filter_on_response(
    response: FrequencyResponse,
    axis: Axis,
    phase_margin_deg: float,
    structure: Structure,
    filters: tuple[Filter, ...],
    velocity: float = 0.1,
) -> dict[str, Any]:
    """Return what :func:`suggest_filter` does on the masses that fit ``response``, each side tried on the data.

    ``measured`` of a side has ``stable`` and the margins of its gains on the data. A filter with which the loop is
    unstable there is not suggested.

    >>> import numpy as np
    >>> from emps_design.control.velocity.structure import PI
    >>> from emps_design.frequency_response.comparison import axis_response
    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> axis, f = machine("emps2018").replace(effects=bent), np.geomspace(1.0, 400.0, 300)
    >>> found = suggest_filter_on_response(
    ...     FrequencyResponse.of(f, axis_response(axis, f), np.full(300, 0.01)), machine("emps2018"), 50.0, PI, ()
    ... )
    >>> found["filter"]["kind"], abs(found["with"]["measured"]["phase_margin_deg"] - 50.0) < 2.0
    ('notch', True)
    """
    model = Comparison(response, axis).chain.on(axis)
    found = suggest_filter(model, phase_margin_deg, structure, filters, velocity)
    for name in SIDES:
        side = found[name]
        if side is None or side["crossover"] is None:
            continue
        added = () if name == "without" else (Filter(**found["filter"]),)
        design = VelocityLoopDesign(
            axis, side["k_v1"], side["t_v"], {}, velocity=velocity, structure=structure, filters=(*filters, *added)
        )
        on_data = measured_margins(response, design.loop_axis, draws=0)
        side["measured"] = {"stable": on_data.stable, **{key: on_data.values[key] for key in MARGINS}}
    if found["filter"] is not None and not found["with"]["measured"]["stable"]:
        found |= {"filter": None, "with_equal_margins": None, "with": None}
    return {**found, "model": f"the masses that fit {response.name}"}
