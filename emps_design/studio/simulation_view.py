"""The simulation tab: an operator guides the carriage under the impedance law, with errors in the estimates.

It simulates the task with exact and with the worst estimates, every plant of the mismatch, and a push into a wall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import panel as pn

from emps_design import view
from emps_design.laws.law import left_out
from emps_design.progress import Progress, no_progress, of_part
from emps_design.report.page import inline, quantity
from emps_design.report.style import labelled, svg
from emps_design.studio.controls import Field, after_this_event
from emps_design.studio.panes import Job, bold, html, judgement, message
from emps_design.studio.state import State
from emps_design.view import Table, View, Viewed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.comanipulation.run import TaskRun
    from emps_design.comanipulation.study import MismatchStudy
    from emps_design.comanipulation.wall import WallContact

EXACT, WORST = "exact estimates", "worst estimates"

TASKS = {"Hand guides the axis": "guided", "Pushes to and fro (Fig. 12)": "pushed"}
WIDTHS = {
    "push": 80,
    "hand_stiffness": 155,
    "hand_damping": 175,
    "wall": 110,
    "mismatch_percent": 90,
    "plants": 105,
    "seed": 70,
}
PICTURES = ("task", "wall", "plants")
INTRODUCTION = """
<h3>What is simulated</h3>
<p>The impedance law of the design tab (M_a, B, filter, sampling, current loop) on its axis, with stick-slip friction:
first with exact estimates, then with the worst estimates within the mismatch; then all corners of the mismatch and the
chosen number of random plants; finally a push into the wall.</p>
<p>Fig. 12 of the paper is the task <i>Pushes to and fro</i>.</p>
"""


@dataclass(frozen=True)
class Simulated(Viewed):
    """The runs by name, the study over the mismatch, and the push into the wall."""

    state: State
    runs: dict[str, TaskRun]
    study: MismatchStudy
    worst: dict[str, Any]
    wall: WallContact
    wall_poles_stable: bool

    def verdict(self) -> tuple[str, str]:
        """Return the level of the verdict, such as "bad", and its sentence."""
        state, worst, units = self.state, self.worst["verdict"], self.state.axis.units
        mass, damping = units.quantity(state.mass, "kg", "g"), units.quantity(state.damping, "N/(m/s)", "g")
        text = (
            f"M_a {mass}, B {damping}, filter {state.filter:g} rad/s on {state.axis.name}: "
            f"the worst of {self.study.corners} corners and {state.plants} random plants is {self._worst_in_words}."
        )
        if self.wall.verdict not in ("bouncing", "unstable") and self.wall_poles_stable:
            creeps = "warning" if worst in ("creeping", "no_motion") else "bad"
            return ("good" if worst in ("stable", "dead_band") else creeps), text
        poles = "" if self.wall_poles_stable else "; the poles of the loop are unstable there"
        return "bad", f"{text} Pushed into the wall of {self._stiffness} it is {self.wall.verdict}{poles}."

    @property
    def _stiffness(self) -> str:
        """The stiffness of the wall with its unit."""
        return f"{self.state.wall:g} {self.state.axis.units.unit('N/mm')}"

    @property
    def _worst_in_words(self) -> str:
        """The verdict on the worst plant, and what its curve shows of it."""
        run, verdict = self.runs[WORST], self.worst["verdict"]
        if run.verdict != verdict:
            length = quantity(len(run.t) * self.state.axis.sampling.period, "s", 3)
            return f"{verdict.replace('_', ' ')} by its poles ({run.verdict.replace('_', ' ')} in the {length} drawn)"
        if verdict != "limit_cycle":
            return verdict.replace("_", " ")
        speeds, units = (run.measures.end_min_v, run.measures.end_max_v), self.state.axis.units
        low, high = (quantity(float(speed[0]), "m/s", 2, units) for speed in speeds)
        moving = np.flatnonzero(run.v)
        last = int(moving[-1]) if moving.size else 0
        since = quantity(float(run.t[last]), "s", 3)
        still = "" if last == run.v.size - 1 else f"; the drawn curve is at rest from {since} on"
        return f"in a limit cycle, with velocities from {low} to {high} long after the release{still}"

    def view(self) -> View:
        """The verdicts, and the apparent impedance of the worst plant."""
        state, worst, wall, units = self.state, self.worst, self.wall, self.state.axis.units
        exact = self.runs[EXACT].verdict
        share, low, high = self.study.stable_share
        peak = "" if wall.peak_force is None else f", at most {quantity(wall.peak_force, 'N', units=units)}"
        off = ", ".join(
            f"{units.words(name.replace('_', ' '))} {100 * e:+.1f} %".replace("-", "−")
            for name, e in worst["errors"].items()
        )
        felt = ", ".join(
            quantity(worst[name], base, units=units)
            for name, base in (("apparent_mass", "kg"), ("apparent_damping", "N/(m/s)"))
        )
        among = f" (95 %: {100 * low:.3g} to {100 * high:.3g} %)" if state.plants else " of the corners"
        rows = [
            ("verdict, exact estimates", exact.replace("_", " ")),
            (f"verdict, worst within ±{state.mismatch_percent:g} %", worst["verdict"].replace("_", " ")),
            ("errors of the worst estimates", off),
            ("come to rest after the release", f"{100 * share:.4g} %{among}"),
            (f"worst: apparent {units.word('mass')}, damping", felt),
            (f"worst: peak {units.word('voltage')}", quantity(worst["peak_voltage"], "V", units=units)),
            (
                f"worst: rms {units.word('force')} of the hand",
                quantity(worst["effort"]["rms_force"], "N", units=units),
            ),
            (f"pushed into a wall of {self._stiffness}", wall.verdict + peak),
            (
                f"poles of the loop at that wall{', without the effects' if left_out(state.axis) else ''}",
                "stable" if self.wall_poles_stable else "unstable",
            ),
        ]
        return (Table(("", ""), [(name, bold(value)) for name, value in rows]),)

    def figures(self) -> dict[str, Figure]:
        """Return the figures by name."""
        from emps_design.report.impedance import mismatch_figure, task_figure, wall_figure

        return {
            "task": task_figure(self.runs, self.study.task),
            "wall": wall_figure(self.wall),
            "plants": mismatch_figure(self.study),
        }

    def captions(self) -> dict[str, str]:
        """Return the caption of each figure by name."""
        state, task, units = self.state, self.study.task, self.state.axis.units
        return {
            "task": f"The hand releases the {units.word('carriage')} after "
            f"{quantity(task.release * task.period, 's', 3)}; then it must come to rest, without creep or oscillation. "
            f"{WORST.capitalize()}: "
            f"{self.runs[WORST].verdict.replace('_', ' ')}.",
            "wall": f"A push of {units.quantity(state.push, 'N', 'g')} into a wall of {self._stiffness}, "
            f"exact estimates: {self.wall.verdict}. "
            "The position must come to rest at the wall and not keep bouncing.",
            "plants": f"Estimates with errors of up to {state.mismatch_percent:g} %: "
            f"apparent {units.word('mass')} and damping, coloured by verdict, and the number of plants per verdict.",
        }


def simulate(state: State, progress: Progress | None = None) -> Simulated:
    """Simulate the impedance law of ``state``: its task, the plants of its mismatch, and a push into its wall."""
    from emps_design.comanipulation.run import run_task
    from emps_design.comanipulation.study import mismatch_study, run_worst
    from emps_design.comanipulation.task import fitted_task
    from emps_design.comanipulation.wall import push_into_wall
    from emps_design.control.impedance.law import FrictionModel, impedance_law
    from emps_design.control.impedance.passivity import Clock, Environment, sampled_loop

    report = progress or no_progress
    axis, mismatch, stiffness = state.axis, state.mismatch_percent / 100.0, state.wall * 1e3
    law = impedance_law(axis, state.mass, state.damping, state.filter)
    if state.task == "guided":
        task = fitted_task(axis, law, mismatch, hand=(state.hand_stiffness, state.hand_damping))
    else:
        task = fitted_task(axis, law, mismatch, force=state.push)
    study = mismatch_study(
        axis,
        law,
        mismatch,
        state.plants,
        state.seed,
        task=task,
        progress=of_part(report, 0.0, 0.8),
    )
    report("the worst plant", 0.8)
    worst = study.plant(study.worst)
    runs = {EXACT: run_task(axis, law, task), WORST: run_worst(axis, study)}
    report("the wall", 0.9)
    wall = push_into_wall(axis, law, stiffness, state.push)
    poles = sampled_loop(
        law, FrictionModel.of(axis), Clock.of(axis), environment=Environment(stiffness=stiffness)
    ).stable
    report("drawing", 0.95)
    return Simulated(state, runs, study, worst, wall, poles)


class SimulationView:
    """Choice and simulation of task, wall and mismatch, with force, velocity, position and the verdict."""

    def __init__(self, state: Callable[[], State], turn: Callable[[str, Any], None]):
        self._state, now = state, state()
        self.task = pn.widgets.Select(label="Task", options=TASKS, value=now.task, width=215, margin=(2, 6))
        self.task.param.watch(lambda event: turn("task", event.new), "value")
        self.fields = {name: Field(name, getattr(now, name), turn, width) for name, width in WIDTHS.items()}
        self.run = pn.widgets.Button(label="Simulate", color="primary", width=100, margin=(22, 6, 2, 6))
        self.run.on_click(lambda event: after_this_event(self._start))  # a number entered just before counts
        self._of: State | None = None  # the state of the result that is shown or computed
        self.job = Job()
        self.message, self.table = html(), html(INTRODUCTION)
        self.pictures = {name: html() for name in PICTURES}
        self.view = pn.Column(
            pn.FlexBox(self.task, *(field.field for field in self.fields.values()), self.run),
            self.job.view,
            self.message,
            pn.Row(
                pn.Column(self.pictures["task"], self.pictures["wall"], sizing_mode="stretch_width", margin=0),
                pn.Column(self.table, self.pictures["plants"], sizing_mode="stretch_width", margin=0),
                sizing_mode="stretch_width",
                margin=0,
            ),
            sizing_mode="stretch_width",
        )
        self.show(now)

    def show(self, state: State) -> None:
        """Show the numbers of ``state``."""
        self.task.value = state.task
        for name, field in self.fields.items():
            field.suit(state)
            field.set(getattr(state, name))
        if self._of is not None and _read(state) != _read(self._of):
            self._withdraw()

    def _withdraw(self) -> None:
        """Remove an outdated result."""
        self.job.stop()
        self._of = None
        self.message.object, self.table.object = "", INTRODUCTION
        for picture in self.pictures.values():
            picture.object = ""

    def _start(self) -> None:
        state = self._state()
        self._withdraw()
        self._of = state
        self.job.start(lambda progress: simulate(state, progress), self._done, self._failed)

    def _failed(self, text: str) -> None:
        self.message.object = message(text, "bad")

    def _done(self, simulated: Simulated) -> None:
        if simulated.state is not self._of:
            return
        level, text = simulated.verdict()
        self.message.object = judgement(text, level)
        self.table.object = view.html(simulated.view())
        captions, units = simulated.captions(), simulated.state.axis.units
        for name, figure in simulated.figures().items():
            caption = inline(captions[name])
            self.pictures[name].object = f'{svg(labelled(figure, units), name)}<p class="caption">{caption}</p>'


def _read(state: State) -> tuple[Any, ...]:
    """Return the part of ``state`` that a simulation depends on."""
    return state.axis, state.task, state.mass, state.damping, state.filter, *(getattr(state, name) for name in WIDTHS)
