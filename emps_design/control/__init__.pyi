from .controller import ControllerMargins as ControllerMargins, controller_margins as controller_margins
from .discretisation import sample_axis as sample_axis
from .force import ForceLoopDesign as ForceLoopDesign, design_force_loop as design_force_loop
from .impedance.law import (
    FrictionModel as FrictionModel,
    ImpedanceLaw as ImpedanceLaw,
    equivalent_impedance as equivalent_impedance,
    equivalent_loop as equivalent_loop,
    impedance_law as impedance_law,
)
from .impedance.passivity import (
    Clock as Clock,
    contact_map as contact_map,
    largest_wall as largest_wall,
    passivity as passivity,
    recursion_poles as recursion_poles,
    sampled_loop as sampled_loop,
)
from .impedance.robustness import (
    VERDICTS as VERDICTS,
    coulomb_factor_without_creep as coulomb_factor_without_creep,
    smallest_mass as smallest_mass,
    stability_map as stability_map,
)
from .velocity.design import VelocityLoopDesign as VelocityLoopDesign, design_velocity_loop as design_velocity_loop
from .velocity.gains import sweep_velocity_loop as sweep_velocity_loop
from .velocity.limits import retune_velocity_loop as retune_velocity_loop
from .velocity.load_range import (
    identified_mismatch as identified_mismatch,
    margins_under_mismatch as margins_under_mismatch,
    relative_mismatch as relative_mismatch,
)
from .velocity.sampled import sweep_sampled_margins as sweep_sampled_margins
