"""How the fuzzing runs: 60 inputs each, always the same, with the tests; EMPS_DESIGN_FUZZ of them by `make fuzz`."""

import os

from hypothesis import HealthCheck, settings

EXAMPLES = int(os.environ.get("EMPS_DESIGN_FUZZ", "60"))

fuzz = settings(
    max_examples=EXAMPLES,
    deadline=None,  # an input that hangs meets pytest's own timeout
    derandomize=EXAMPLES <= 150,
    database=None,
    suppress_health_check=list(HealthCheck),
)
