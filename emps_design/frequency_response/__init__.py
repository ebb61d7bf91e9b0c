"""Frequency responses from records: estimated in closed loop, with deviations; files of them; experiments for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.frequency_response.estimate import Estimate as Estimate, estimate_response as estimate_response
    from emps_design.frequency_response.experiment import (
        Experiment as Experiment,
        Limits as Limits,
        design_experiment as design_experiment,
    )
    from emps_design.frequency_response.loop import (
        MeasuredMargins as MeasuredMargins,
        measured_margins as measured_margins,
        worst_of as worst_of,
    )
    from emps_design.frequency_response.response import FrequencyResponse as FrequencyResponse
    from emps_design.frequency_response.retune import retune_on_response as retune_on_response
    from emps_design.frequency_response.response import (
        read_response as read_response,
        write_response as write_response,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
