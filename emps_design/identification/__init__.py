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
    from emps_design.identification.inverse_model import chosen_cutoff as chosen_cutoff
    from emps_design.identification.observation import (
        Observation as Observation,
        observe as observe,
        with_known_push as with_known_push,
    )
    from emps_design.identification.result import Estimate as Estimate, Identification as Identification
    from emps_design.identification.several import identify_several as identify_several
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
