"""Design of velocity, force and impedance loops: gains, margins, sampled loops."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.control.controller import (
        ControllerMargins as ControllerMargins,
        controller_margins as controller_margins,
    )
    from emps_design.control.force import (
        ForceLoopDesign as ForceLoopDesign,
        design_force_loop as design_force_loop,
    )
    from emps_design.control.impedance.law import (
        equivalent_impedance as equivalent_impedance,
        equivalent_loop as equivalent_loop,
    )
    from emps_design.control.impedance.law import (
        FrictionModel as FrictionModel,
        ImpedanceLaw as ImpedanceLaw,
        impedance_law as impedance_law,
    )
    from emps_design.control.impedance.passivity import (
        contact_map as contact_map,
        largest_wall as largest_wall,
        passivity as passivity,
    )
    from emps_design.control.impedance.robustness import (
        VERDICTS as VERDICTS,
        coulomb_factor_without_creep as coulomb_factor_without_creep,
        smallest_mass as smallest_mass,
        stability_map as stability_map,
    )
    from emps_design.control.impedance.sampled import (
        Clock as Clock,
        recursion_poles as recursion_poles,
        sampled_loop as sampled_loop,
    )
    from emps_design.control.discretisation import sample_axis as sample_axis
    from emps_design.control.velocity.design import (
        VelocityLoopDesign as VelocityLoopDesign,
        design_velocity_loop as design_velocity_loop,
    )
    from emps_design.control.velocity.retune import retune_velocity_loop as retune_velocity_loop
    from emps_design.control.velocity.load_range import (
        identified_mismatch as identified_mismatch,
        margins_under_mismatch as margins_under_mismatch,
        relative_mismatch as relative_mismatch,
    )
    from emps_design.control.velocity.sweeps import (
        sweep_sampled_margins as sweep_sampled_margins,
        sweep_velocity_loop as sweep_velocity_loop,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
