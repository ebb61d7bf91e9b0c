"""A hand guides the carriage under an impedance law: tasks, measures, verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.comanipulation.run import TaskRun as TaskRun, run_task as run_task
    from emps_design.comanipulation.scenario import compare_sensors as compare_sensors
    from emps_design.comanipulation.study import MismatchStudy as MismatchStudy, mismatch_study as mismatch_study
    from emps_design.comanipulation.task import Task as Task, guided_task as guided_task, pushed_task as pushed_task
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
