from .advice import Advice as Advice, advise as advise
from .axis import Axis as Axis
from .comanipulation import run_task as run_task
from .control import (
    ForceLoopDesign as ForceLoopDesign,
    ImpedanceLaw as ImpedanceLaw,
    VelocityLoopDesign as VelocityLoopDesign,
    controller_margins as controller_margins,
    design_force_loop as design_force_loop,
    design_velocity_loop as design_velocity_loop,
    impedance_law as impedance_law,
    retune_velocity_loop as retune_velocity_loop,
)
from .discrepancy import Diagnosis as Diagnosis, diagnose as diagnose
from .effects import Effect as Effect
from .errors import EmpsError as EmpsError
from .identification import (
    Identification as Identification,
    identify as identify,
    identify_several as identify_several,
    observe as observe,
)
from .importing import import_record as import_record
from .laws import Law as Law
from .machines import load_axis as load_axis, machine as machine
from .messages import Message as Message, Severity as Severity
from .records import Record as Record, read_record as read_record
from .report import Report as Report, assemble_report as assemble_report
from .simulation import (
    Hand as Hand,
    Plant as Plant,
    Wall as Wall,
    replay as replay,
    synthetic_record as synthetic_record,
    trapezoid_laps as trapezoid_laps,
)

__version__: str
