from .assemble import Report as Report, assemble_report as assemble_report
from .diagnosis_sections import before_after_figure as before_after_figure
from .loop_figures import response_figure as response_figure, velocity_loop_figures as velocity_loop_figures
from .page import (
    Facts as Facts,
    Html as Html,
    Line as Line,
    Page as Page,
    Picture as Picture,
    Section as Section,
    Table as Table,
)
from .record import force_figure as force_figure, observation_figure as observation_figure
from .request import ReportRequest as ReportRequest
