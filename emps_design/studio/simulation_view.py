"""The simulation tab: an operator guides the carriage under the impedance law, with the estimates a little wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import panel as pn

from emps_design.report.display import number, quantity
from emps_design.report.page import inline
from emps_design.studio.jobs import Job
from emps_design.studio.panes import html
from emps_design.studio.state import State

TASKS = {"Hand guides the carriage": None, "Pushes to and fro (Fig. 12)": 40.0}


class SimulationView:
    """Choose the task and the mismatch, run it, see force, velocity and position and the verdict."""

    def __init__(self, state: Callable[[], State]):
        self._state = state
        self.task = pn.widgets.Select(label="Task", options=list(TASKS), width=250)
        self.force = pn.widgets.FloatInput(label="Push [N]", value=40.0, start=1.0, end=500.0, step=5.0, width=110)
        self.stiffness = pn.widgets.FloatInput(
            label="Hand stiffness [N/m]", value=1000.0, start=0.0, end=20000.0, step=100.0, width=140
        )
        self.damping = pn.widgets.FloatInput(
            label="Hand damping [N/(m/s)]", value=100.0, start=0.0, end=2000.0, step=10.0, width=160
        )
        self.mismatch = pn.widgets.FloatInput(label="Mismatch [%]", value=2.0, start=0.0, end=20.0, step=0.5, width=110)
        self.plants = pn.widgets.IntInput(label="Random plants", value=200, start=0, end=10000, step=100, width=120)
        self.seed = pn.widgets.IntInput(label="Seed", value=0, start=0, end=10**6, width=90)
        self.run = pn.widgets.Button(label="Simulate", button_type="primary", width=120, margin=(24, 5, 5, 5))
        self.run.on_click(self._start)
        self.job = Job()
        self.message, self.table, self.picture, self.cloud = html(), html(), html(), html()
        self.view = pn.Column(
            pn.Row(
                self.task, self.force, self.stiffness, self.damping, self.mismatch, self.plants, self.seed, self.run
            ),
            self.job.view,
            self.message,
            pn.Row(
                self.picture,
                pn.Column(self.table, self.cloud, sizing_mode="stretch_width"),
                sizing_mode="stretch_width",
            ),
            sizing_mode="stretch_width",
        )

    def _start(self, event: Any) -> None:
        state, task = self._state(), self.task.value
        options = {
            "force": self.force.value if TASKS[task] is not None else None,
            "hand": (self.stiffness.value, self.damping.value),
            "mismatch": self.mismatch.value / 100.0,
            "plants": self.plants.value,
            "seed": self.seed.value,
        }
        self.message.object = ""
        self.job.start(lambda progress: simulate(state, progress, **options), self._done, self._failed)

    def _failed(self, message: str) -> None:
        self.message.object = f'<div class="said stop" role="alert">{inline(message)}</div>'

    def _done(self, found: dict[str, str]) -> None:
        for name in ("message", "table", "picture", "cloud"):
            getattr(self, name).object = found[name]


def simulate(
    state: State, progress: Callable, force: float | None, hand: tuple, mismatch: float, plants: int, seed: int
) -> dict[str, str]:
    """Run the law exactly and at its worst corner, and the study over all plants; return pictures and words as HTML."""
    from emps_design.control.impedance import FrictionModel, impedance_law
    from emps_design.control.impedance_sampled import Clock, Environment, sampled_loop
    from emps_design.report import style
    from emps_design.report.impedance_figures import mismatch_figure, task_figure
    from emps_design.simulation.impedance_run import run
    from emps_design.simulation.impedance_study import mismatch_study
    from emps_design.simulation.impedance_task import guided_task, pushed_task

    axis, period = state.axis, state.axis.sampling.period
    progress("setting up", 0.02)
    law = impedance_law(axis, state.mass, state.damping, state.filter)
    task = guided_task(period, hand=hand) if force is None else pushed_task(period, force=force)
    study = mismatch_study(
        axis, law, mismatch, plants, seed, task=task, progress=lambda stage, share: progress(stage, 0.05 + 0.7 * share)
    )
    progress("the worst plant", 0.8)
    worst = study.plant(study.worst)
    runs = {
        "exact estimates": run(axis, law, task),
        "worst estimates": run(axis, law.with_errors(worst["errors"]), task),
    }
    progress("drawing", 0.9)
    plant, clock = FrictionModel.of(axis), Clock.of(axis)
    wall = sampled_loop(law, plant, clock, environment=Environment(stiffness=state.wall * 1e3)).stable
    share, low, high = study.stable_share
    rows = [
        ("verdict, exact estimates", runs["exact estimates"].verdict.replace("_", " ")),
        (f"verdict, worst within ±{100 * mismatch:g} %", worst["verdict"].replace("_", " ")),
        ("estimates of the worst", ", ".join(f"{name} {100 * e:+.1f} %" for name, e in worst["errors"].items())),
        (
            "neither unstable nor cycling",
            f"{100 * share:.4g} %"
            + (f" (95 %: {100 * low:.3g} to {100 * high:.3g} %)" if plants else ", of the corners"),
        ),
        ("worst: apparent mass, damping", _felt(worst)),
        ("worst: peak voltage", quantity(worst["peak_voltage"], "V")),
        ("worst: rms force of the hand", quantity(worst["effort"]["rms_force"], "N")),
        (f"against a wall of {number(state.wall)} N/mm", "stable" if wall else "unstable"),
    ]
    body = "".join(f"<tr><th>{inline(name)}</th><td><b>{inline(value)}</b></td></tr>" for name, value in rows)
    level = "good" if worst["verdict"] in ("stable", "dead_band") else "stop"
    text = (
        f"M_a {number(state.mass)} kg, B {number(state.damping)} N/(m/s), filter {number(state.filter)} rad/s on "
        f"{axis.name}: the worst of {study.corners} corners and {plants} random plants is "
        f"{worst['verdict'].replace('_', ' ')}."
    )
    return {
        "message": f'<div class="said {level}" role="status">{inline(text)}</div>',
        "table": f'<table class="side">{body}</table>',
        "picture": style.svg(task_figure(runs), "task"),
        "cloud": style.svg(mismatch_figure(study), "cloud"),
    }


def _felt(worst: dict[str, Any]) -> str:
    return f"{quantity(worst['apparent_mass'], 'kg')}, {quantity(worst['apparent_damping'], 'N/(m/s)')}"
