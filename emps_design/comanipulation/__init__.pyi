from .run import TaskRun as TaskRun, run_task as run_task
from .scenario import compare_sensors as compare_sensors
from .study import MismatchStudy as MismatchStudy, mismatch_study as mismatch_study
from .task import Task as Task, guided_task as guided_task, pushed_task as pushed_task
