"""Where each numbered equation of the paper stands in the package."""

from __future__ import annotations

_GAINS, _FORCE = "emps_design.control.velocity.gains", "emps_design.control.force.design.design_force_loop"
_LEAST_SQUARES = "emps_design.identification.inverse_model.least_squares"
_DIRECT = "emps_design.identification.observation.direct_validation"
_LAW, _LIBRARY = "emps_design.control.impedance.law.ImpedanceLaw", "emps_design.laws.library.impedance"

PLACES: dict[str, tuple[str, ...]] = {
    "1": ("emps_design.axis.Drive",),
    "2": ("emps_design.simulation.plant.Plant", "emps_design.observer.model_force"),
    "3": ("emps_design.identification.model.column",),
    "4": ("emps_design.effects.library.stribeck_friction",),
    "5": ("emps_design.identification.inverse_model.regression",),
    "6": ("emps_design.control.velocity.design.VelocityLoopDesign.velocity_error_loop",),
    "7": (f"{_GAINS}.velocity_gains",),
    "8": ("emps_design.control.velocity.design.VelocityLoopDesign.closed_loop",),
    "9": (f"{_GAINS}.canonical_form",),
    "10": (_FORCE,),
    "11": (_FORCE,),
    "12": ("emps_design.identification.inverse_model.regression",),
    "13": (_LEAST_SQUARES, "emps_design.identification.statistics"),
    "14": (_LEAST_SQUARES,),
    "15": ("emps_design.identification.inverse_model.LeastSquares",),
    "16": ("emps_design.identification.result.Identification",),
    "17": (_LEAST_SQUARES,),
    "18": ("emps_design.observer.observe_offline",),
    "19": ("emps_design.observer.observe_offline", "emps_design.observer.observe_online"),
    "20": ("emps_design.identification.observation.observe",),
    "21": (_DIRECT,),
    "22": (_DIRECT,),
    "23": (_DIRECT,),
    "24": (_LAW,),
    "25": (_LAW, "emps_design.control.impedance.equivalence.equivalent_impedance"),
    "26": ("emps_design.paper.derivations.impedance.derived_law",),
    "27": (f"{_LIBRARY}.demanded_force",),
    "28": (f"{_LIBRARY}.demanded_force",),
    "29": (f"{_LIBRARY}.observed_force", "emps_design.observer.ForceObserver"),
    "30": (f"{_LIBRARY}.impedance",),
}
