"""Results become figures and pages here; nothing is computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.report.assemble import Report as Report, assemble_report as assemble_report
    from emps_design.report.diagnosis_sections import before_after_figure as before_after_figure
    from emps_design.report.frequency_response import response_figure as response_figure
    from emps_design.report.loop_figures import velocity_loop_figures as velocity_loop_figures
    from emps_design.report.record import observation_figure as observation_figure
    from emps_design.report.page import (
        Callout as Callout,
        Facts as Facts,
        Listing as Listing,
        Html as Html,
        Page as Page,
        Picture as Picture,
        Points as Points,
        Section as Section,
        Table as Table,
        Text as Text,
    )
    from emps_design.report.record import force_figure as force_figure
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
