"""What a type checker sees of the package in a script: ``make lint`` checks that it sees each mistake."""

import emps_design
from emps_design.simulation import Plant

design = emps_design.design_velocity_loop(emps_design.machine("emps2018"), crossover=100.0)
right: float = design.k_v1
wrong: str = design.k_v1  # type: ignore[assignment]
emps_design.design_velocity_lop  # type: ignore[attr-defined] # noqa: B018
Plant.off  # type: ignore[attr-defined] # noqa: B018
