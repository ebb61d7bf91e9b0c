from .estimate import ResponseEstimate as ResponseEstimate, estimate_response as estimate_response
from .experiment import Experiment as Experiment, Limits as Limits, design_experiment as design_experiment
from .loop import (
    MeasuredMargins as MeasuredMargins,
    measured_margins as measured_margins,
    retune_on_response as retune_on_response,
    worst_of as worst_of,
)
from .response import (
    FrequencyResponse as FrequencyResponse,
    read_response as read_response,
    write_response as write_response,
)
