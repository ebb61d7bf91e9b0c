from .chains import (
    chosen_cutoff as chosen_cutoff,
    hold_chain as hold_chain,
    paper_chain as paper_chain,
    report_chain as report_chain,
)
from .identify import identify as identify
from .observation import Observation as Observation, observe as observe, with_known_push as with_known_push
from .result import Estimate as Estimate, Identification as Identification
from .several import identify_several as identify_several
