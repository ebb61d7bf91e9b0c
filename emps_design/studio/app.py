"""One session of the studio: the tabs, and what passes between them."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import panel as pn

from emps_design.axis import Axis
from emps_design.machines import machine, machine_names
from emps_design.records import Record
from emps_design.studio.access import guard
from emps_design.studio.design_view import DesignView
from emps_design.studio.exports import velocity_design
from emps_design.studio.page import page
from emps_design.studio.state import State

RECORD_AXIS = "emps2019"  # the machine that records are taken for where no axis of their own is named
HOST = "127.0.0.1"
TABS = ("Design", "Motion", "Simulation", "Data", "Compensation", "Files")


class Session:
    """The views of one browser window and the state they share."""

    def __init__(self, axis: Axis, record: Record | None = None):
        from emps_design.studio.compensation_view import CompensationView
        from emps_design.studio.data_view import DataView
        from emps_design.studio.files_view import FilesView
        from emps_design.studio.motion_view import MotionView
        from emps_design.studio.simulation_view import SimulationView

        machines = {name: machine(name) for name in machine_names()}
        machines[axis.name] = axis
        self.state = State.of(axis)
        self.design = DesignView(self.state, machines, self._changed, self._axis_opened)
        self.motion = MotionView(lambda: self.state, self.design.turn, lambda: self.data.record)
        self.simulation = SimulationView(lambda: self.state, self.design.turn)
        own = axis.name if axis.name not in machine_names() else RECORD_AXIS
        self.data = DataView(
            lambda: self.design.machines, own, lambda: self.state, self.design.turn, self.design.add_axis, record,
            another=lambda: self.motion.show(self.state),
        )  # fmt: skip
        self.compensation = CompensationView(lambda: self.state)
        self.files = FilesView(lambda: self.state, lambda: self.data.measured, self._loaded)
        self.tab = pn.widgets.RadioButtonGroup(
            label="Tab", options=list(TABS), value=TABS[0], color="primary", margin=6
        )
        views = (
            self.design.view, self.motion.view, self.simulation.view, self.data.view, self.compensation.view,
            self.files.view,
        )  # fmt: skip
        self.views = dict(zip(TABS, views, strict=True))
        for name, view in self.views.items():
            view.visible = name == TABS[0]
        self.tab.param.watch(self._turn_to, "value")
        self.root = pn.Column(self.tab, *views, sizing_mode="stretch_width", margin=0)

    def _turn_to(self, event: Any) -> None:
        for name, view in self.views.items():
            view.visible = name == event.new

    def _changed(self, state: State) -> None:
        self.state = state
        self.motion.show(state)
        self.simulation.show(state)
        self.compensation.show(state)
        self.data.show(state)

    def _axis_opened(self, axis: Axis) -> None:
        """Design on an axis from a file, and take the records to come for ones of it."""
        self.design.add_axis(axis)
        if self.data.record is None:
            self.data.of(axis)

    def _loaded(self, state: State) -> None:
        if state.pinned is not None:
            velocity_design(state.pinned)  # what cannot be designed is refused before anything changes
        if state.axis.name not in machine_names():  # those stay what they are: a state may have changed their clock
            self.design.machines[state.axis.name] = state.axis
        self.design.machine.options = list(self.design.machines)
        self.design.machine.value = state.axis.name
        self.design.set_state(state)
        self._changed(self.design.state)
        self.data.show(self.state)


def serve(
    axis: Axis, record: str | Path | None = None, port: int = 0, ready: Callable[[str], None] | None = None
) -> None:
    """Serve the studio on 127.0.0.1 until it is interrupted; ``ready(address)`` is called once it listens.

    ``port`` 0 takes a free one. Raises :class:`RecordError` for a record that cannot be read and :class:`OSError` for
    a port that is taken, before serving.
    """
    from emps_design.importing import import_record
    from emps_design.studio.data_view import LIMIT_MB
    from emps_design.studio.page import TITLE, prepare

    read = None if record is None else import_record(record, axis)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
    prepare()
    server = pn.serve(
        lambda: page(Session(axis, read).root),
        port=port,
        address=HOST,
        title=TITLE,
        show=False,
        start=False,
        verbose=False,
        websocket_max_message_size=2 * LIMIT_MB * 2**20,
        websocket_origin=None,
    )
    ending = guard(server)
    server.start()
    if ready is not None:
        ready(f"http://{HOST}:{server.port}{ending}")
    try:
        server.io_loop.start()
    finally:
        server.stop()
