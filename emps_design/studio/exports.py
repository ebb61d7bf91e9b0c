"""Files that the studio hands out: the report, the figures, the model, the gains; the same bytes for the same state."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

from emps_design.errors import EmpsError
from emps_design.progress import Progress, of_part, untold
from emps_design.studio.state import State

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.axis import Axis
    from emps_design.compensation import Compensation
    from emps_design.control.velocity.design import VelocityLoopDesign

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the zip format's first day: an archive carries no clock


def velocity_design(state: State) -> VelocityLoopDesign:
    """The velocity loop that ``state`` asks for."""
    from emps_design.control.velocity.design import design_velocity_loop

    return design_velocity_loop(state.axis, **state.requested)


def report_html(state: State, measured: Mapping[str, Any] | None = None, progress: Progress = untold) -> str:
    """The page of ``report`` for ``state``, with the section on the record ``measured`` where one is loaded.

    ``measured`` has ``record``, ``record_axis`` and ``chain`` of :func:`~emps_design.report.assemble.assemble_report`.
    """
    from emps_design.report.assemble import assemble_report

    report = assemble_report(
        state.axis,
        design_on="axis",
        model=state.friction,
        **(measured or {}),
        k_e1=state.k_e1,
        hand=state.hand,
        environment=state.wall * 1e3,
        mass=state.mass,
        damping=state.damping,
        filter=state.filter,
        mismatch=state.mismatch_percent / 100.0,
        progress=progress,
        **state.requested,
    )
    return report.page.html()


def figures(state: State, progress: Progress = untold) -> dict[str, Figure]:
    """The pictures of ``state`` as matplotlib figures by name."""
    from emps_design.control.force.design import design_force_loop
    from emps_design.report.diagrams import velocity_and_force_loop_diagram
    from emps_design.report.force_figures import force_limit_figure, force_loop_figure
    from emps_design.report.loop_figures import velocity_loop_figures
    from emps_design.studio.simulated import simulate

    design = velocity_design(state)
    force = design_force_loop(design, state.k_e1, hand=state.hand, environment=state.wall * 1e3)
    return {
        "block_diagram": velocity_and_force_loop_diagram(design.structure, bool(design.filters)),
        **velocity_loop_figures(design),
        "force_limit": force_limit_figure(force),
        "force_loop": force_loop_figure(force),
        **{f"simulation_{name}": figure for name, figure in simulate(state, progress).figures().items()},
    }


def figures_zip(state: State, kind: str, progress: Progress = untold) -> bytes:
    """All pictures in one archive; ``kind`` is "svg" or "png"."""
    from emps_design.report import style

    drawn, made = figures(state, of_part(progress, 0.0, 0.5)), {}
    for place, (name, one) in enumerate(drawn.items()):
        progress(name, 0.5 + 0.5 * place / len(drawn))
        made[f"{name}.{kind}"] = style.svg(one, name).encode() if kind == "svg" else style.png(one)
    return _zipped(made)


def _zipped(files: dict[str, bytes]) -> bytes:
    """The ``files`` by name in one archive, the same bytes for the same files."""
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), data)
    return out.getvalue()


def follows(axis: Axis) -> str:
    """What the controller of ``axis`` follows: "position", "velocity", or "" where it follows no reference."""
    from emps_design.laws import law_of

    kind = "rest position" if axis.controller.kind == "none" else law_of(axis, axis.sampling.period).follows
    return "" if kind == "rest position" else kind


def designed(state: State) -> Axis:
    """The axis of ``state`` with the controller of its design; :class:`EmpsError` where that may not run."""
    return state.axis.replace(controller=_for_the_drive(state))


def drive_zip(found: Compensation) -> bytes:
    """The folder for the drive: axis, compensation and controller in C99 with its vectors, in one archive."""
    from emps_design.codegen import export_controller
    from emps_design.codegen.origin import origin_of

    axis = found.axis.to_toml(comments=True)
    exported = export_controller(found.axis, "c", found.to_dict(), origin_of("axis.toml", axis.encode()))
    files = {
        "axis.toml": axis,
        "compensation.json": _json_text(found.to_dict()),
        **{f"code/{name}": content for name, content in exported.files.items()},
    }
    return _zipped({name: text.encode() if isinstance(text, str) else text for name, text in files.items()})


def gains_json(state: State) -> str:
    """The keys and numbers that ``gains --json`` prints for ``state``."""
    from emps_design.control.velocity.comparison import gains_document

    document = gains_document(velocity_design(state))
    return _json_text(document)


def _json_text(document: Any) -> str:
    """``document`` as JSON; what is infinite, such as the error of an unstable loop, is null."""
    document = json.loads(json.dumps(document, default=float), parse_constant=lambda name: None)
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False, default=float) + "\n"


def model_toml(state: State) -> str:
    """The axis with the controller of the design, ready for every command."""
    return designed(state).to_toml()


def _for_the_drive(state: State) -> dict[str, Any]:
    """The controller that ``state`` asks for; :class:`EmpsError` where its loop is unstable."""
    design = velocity_design(state)
    if design.refused:
        raise EmpsError(f"no controller is handed out: {design.refused}")
    return design.controller_table()
