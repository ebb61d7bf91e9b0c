"""Parameters of an axis from records: filters, inverse model, statistics, estimators."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use
from emps_design.identification.identify import identify as identify  # its module has the name too

if TYPE_CHECKING:
    from emps_design.identification.chains import (
        hold_chain as hold_chain,
        paper_chain as paper_chain,
        report_chain as report_chain,
    )
    from emps_design.identification.cutoff import chosen_cutoff as chosen_cutoff
    from emps_design.identification.instruments import identify_with_instruments as identify_with_instruments
    from emps_design.identification.observation import (
        Observation as Observation,
        observe as observe,
        with_known_push as with_known_push,
    )
    from emps_design.identification.output_error import identify_by_output_error as identify_by_output_error
    from emps_design.identification.result import Estimate as Estimate, Identification as Identification
    from emps_design.identification.several import identify_several as identify_several
    from emps_design.identification.tested import identify_tested as identify_tested
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
