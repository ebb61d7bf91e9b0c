"""Control design for a one-axis electromechanical drive, from a measured record to gains and to the missing physics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

__version__ = "0.1.0"

if TYPE_CHECKING:
    from emps_design.advice import Advice as Advice, advise as advise
    from emps_design.axis import Axis as Axis
    from emps_design.comanipulation import run_task as run_task
    from emps_design.control import (
        ForceLoopDesign as ForceLoopDesign,
        ImpedanceLaw as ImpedanceLaw,
        VelocityLoopDesign as VelocityLoopDesign,
        controller_margins as controller_margins,
        design_force_loop as design_force_loop,
        design_velocity_loop as design_velocity_loop,
        impedance_law as impedance_law,
        retune_velocity_loop as retune_velocity_loop,
    )
    from emps_design.discrepancy import Diagnosis as Diagnosis, diagnose as diagnose
    from emps_design.effects import Effect as Effect
    from emps_design.errors import EmpsError as EmpsError
    from emps_design.identification import (
        Identification as Identification,
        identify_several as identify_several,
        observe as observe,
    )
    from emps_design.identification import identify as identify
    from emps_design.laws import Law as Law
    from emps_design.importing import import_record as import_record
    from emps_design.machines import load_axis as load_axis, machine as machine
    from emps_design.records import Record as Record, read_record as read_record
    from emps_design.report import Report as Report, assemble_report as assemble_report
    from emps_design.simulation import (
        Hand as Hand,
        Plant as Plant,
        Wall as Wall,
        synthetic_record as synthetic_record,
        replay as replay,
        trapezoid_laps as trapezoid_laps,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
