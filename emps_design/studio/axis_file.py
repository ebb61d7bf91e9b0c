"""A field that opens an axis file of one's own, in whichever tab it stands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import panel as pn

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.machines import machine_names


class AxisFile:
    """A field for an axis file; ``take(axis)`` has the axis, ``refuse(text)`` says why there is none.

    One that has the name of an embedded machine has that of its file as well, and is another beside it.
    """

    def __init__(self, take: Callable[[Axis], None], refuse: Callable[[str], None], width: int = 230):
        self._take, self._refuse = take, refuse
        self.field = pn.widgets.FileInput(
            label="Axis file of your own (.toml)", accept=".toml", multiple=False, width=width, margin=(2, 6)
        )
        self.field.param.watch(self._opened, "value")

    def _opened(self, event: Any) -> None:
        if not event.new:
            return
        name, content = PurePath((self.field.filename or "axis.toml").replace("\\", "/")).name, bytes(event.new)
        self.field.value = None  # here and in the browser, so that the same file is opened again once it was edited
        self.field.clear()
        try:
            axis = Axis.from_toml(content.decode("utf-8"), name)
        except UnicodeDecodeError:
            self._refuse(f"{name}: not UTF-8 text, expected an axis file")
        except EmpsError as error:
            self._refuse(str(error))
        else:
            self._take(axis.replace(name=f"{axis.name} of {name}") if axis.name in machine_names() else axis)
