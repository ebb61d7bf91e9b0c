"""The studio's server, page and session: access control, page frame and style, and the tabs with their shared state.

Only a browser on this machine has access, and only with the token in the printed address: a page of another site can
make a browser send requests to 127.0.0.1, but it does not know the token.
"""

from __future__ import annotations

import hmac
import secrets
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import panel as pn
from tornado.web import RequestHandler

from emps_design.axis import Axis
from emps_design.machines import machine, machine_names
from emps_design.records import Record
from emps_design.studio.design_view import DesignView
from emps_design.studio.files_view import FilesView, velocity_design
from emps_design.studio.state import State

if TYPE_CHECKING:
    from bokeh.server.server import Server
    from tornado.httputil import HTTPServerRequest

NAMES = ("127.0.0.1", "localhost", "[::1]")

TITLE = "emps-design studio"

STYLE = """
body { margin: 0; background: #f5f7fa; color: #1a1a1a;
  font-family: "Segoe UI", "Noto Sans", "Liberation Sans", "DejaVu Sans", Arial, sans-serif; }
header.studio { background: #003a5d; color: #fff; padding: 7px 16px; font-size: 17px; font-weight: 600; }
header.studio small { font-weight: 400; margin-left: 12px; opacity: .9; }
main.studio { padding: 6px 10px 16px; }
"""

# Names and keyboard access for parts that Bokeh leaves without them: slider handles, figures, downloads.
SCRIPT = """
function nameAndReach(root) {
  for (const element of root.querySelectorAll('*')) {
    if (element.shadowRoot) nameAndReach(element.shadowRoot);
  }
  const title = root.querySelector('.bk-slider-title');
  if (title) for (const handle of root.querySelectorAll('.noUi-handle')) {
    const name = title.textContent.trim().replace(/:$/, '');
    if (handle.getAttribute('aria-label') !== name) handle.setAttribute('aria-label', name);
  }
  for (const button of root.querySelectorAll('.bk-spin-btn:not([aria-label])')) {
    button.setAttribute('aria-label', button.classList.contains('bk-spin-btn-up') ? 'more' : 'less');
    button.tabIndex = -1;  // the arrow keys in the field do the same
  }
  for (const layer of root.querySelectorAll('.bk-events[tabindex]:not([aria-label])')) {
    const figure = root.host.getRootNode().host;
    layer.setAttribute('role', 'img');
    layer.setAttribute('aria-label', figure.getAttribute('aria-label') || 'Figure');
  }
  for (const link of root.querySelectorAll('button > a:not([data-reached])')) {
    link.dataset.reached = true;  // a download reacts to its link only, which the keyboard does not reach
    link.parentElement.addEventListener('click', event => { if (event.target !== link) link.click(); });
  }
  for (const input of root.querySelectorAll('input[type=file]')) {
    if (!input.getAttribute('aria-label') && !input.id) input.setAttribute('aria-label', 'File');
  }
}
setInterval(() => nameAndReach(document), 700);
"""

TEMPLATE = (
    """
{% extends base %}
{% block title %}emps-design studio{% endblock %}
{% block postamble %}<style>"""
    + STYLE
    + """</style><script>"""
    + SCRIPT
    + """</script>{% endblock %}
{% block contents %}
<header class="studio">emps-design studio
<small>design, simulate, compare with the record; everything stays on this machine</small></header>
<main class="studio">{{ embed(roots.studio) }}</main>
{% endblock %}
"""
)

RECORD_AXIS = "emps2019"  # default axis of a record
HOST = "127.0.0.1"
TABS = ("Design", "Motion", "Simulation", "Data", "Compensation", "Files")


def guard(server: Server) -> str:
    """Restrict ``server`` to requests with the right host, origin and token; return the suffix of its address."""
    application, token, cookie = server._tornado, secrets.token_urlsafe(24), f"emps-design-{server.port}"
    find = application.find_handler

    def find_handler(request: HTTPServerRequest, **options: Any) -> Any:
        if not local(request.headers, server.port):
            return application.get_handler_delegate(request, Refused, {"why": "wrong host name or origin"})
        from_address = request.query_arguments.get("token", [b""])[-1]
        from_cookie = request.cookies[cookie].value.encode() if cookie in request.cookies else b""
        if not any(hmac.compare_digest(sent, token.encode()) for sent in (from_address, from_cookie)):
            why = "open the complete address that the studio printed, with its token"
            return application.get_handler_delegate(request, Refused, {"why": why})
        delegate = find(request, **options)
        if from_address and hasattr(delegate, "handler_class"):
            delegate.handler_class = _with_cookie(delegate.handler_class, cookie, token)
        return delegate

    application.find_handler = find_handler  # type: ignore[method-assign]
    return f"/?token={token}"


def local(headers: Any, port: int | None) -> bool:
    """Whether ``Host``, and ``Origin`` if sent, name this machine at ``port``.

    >>> local({"Host": "localhost:80"}, 80), local({"Host": "rebound.example:80"}, 80)
    (True, False)
    >>> local({"Host": "127.0.0.1:80", "Origin": "http://elsewhere.example"}, 80)
    False
    """
    places = {f"{name}:{port}" for name in NAMES} | ({*NAMES} if port == 80 else set())
    return headers.get("Host") in places and headers.get("Origin", "").removeprefix("http://") in places | {""}


class Refused(RequestHandler):
    """Handler of a refused request: status 403 and one sentence."""

    def initialize(self, why: str) -> None:
        """Store the sentence ``why``."""
        self.why = why

    def prepare(self) -> None:
        """Answer every method of a request with status 403."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"emps-design studio: {self.why}\n")

    def check_xsrf_cookie(self) -> None:
        """Skip the check: the request is refused anyway."""


def _with_cookie(handler: type[RequestHandler], cookie: str, token: str) -> type[RequestHandler]:
    """Return ``handler`` with the token set as a cookie, for the further requests of the page."""

    class WithCookie(handler):  # type: ignore[misc,valid-type]
        def set_default_headers(self) -> None:
            """Set the cookie in addition to the handler's headers."""
            super().set_default_headers()
            self.set_cookie(cookie, token, httponly=True, samesite="Lax", path="/")

    return WithCookie


def prepare() -> None:
    """Load the extensions of Panel that the page needs; everything is served from this machine."""
    pn.extension("filedropper", inline=False, notifications=False)


def page(root: pn.viewable.Viewable) -> pn.Template:
    """Return the page with ``root`` in its frame."""
    template = pn.Template(TEMPLATE)
    template.add_panel("studio", root)
    return template


class Session:
    """The views of one browser window and their shared state."""

    def __init__(self, axis: Axis, record: Record | None = None):
        from emps_design.studio.data_view import DataView
        from emps_design.studio.motion_view import CompensationView, MotionView
        from emps_design.studio.simulation_view import SimulationView

        machines = {name: machine(name) for name in machine_names()}
        machines[axis.name] = axis
        self.state = State.of(axis)
        self.design = DesignView(self.state, machines, self._changed, self._axis_opened)
        self.motion = MotionView(lambda: self.state, self.design.turn, lambda: self.data.record)
        self.simulation = SimulationView(lambda: self.state, self.design.turn)
        name = axis.name if axis.name not in machine_names() else RECORD_AXIS
        self.data = DataView(
            lambda: self.design.machines, name, lambda: self.state, self.design.turn, self.design.add_axis, record,
            record_changed=lambda: self.motion.show(self.state),
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
        """Design on an axis from a file, and read the next records with it."""
        self.design.add_axis(axis)
        if self.data.record is None:
            self.data.of(axis)

    def _loaded(self, state: State) -> None:
        if state.pinned is not None:
            velocity_design(state.pinned)  # raises, before anything changes, if there is no such design
        if state.axis.name not in machine_names():  # embedded machines do not change: a state may have another period
            self.design.machines[state.axis.name] = state.axis
        self.design.machine.options = list(self.design.machines)
        self.design.machine.value = state.axis.name
        self.design.set_state(state)
        self._changed(self.design.state)
        self.data.show(self.state)


def serve(axis: Axis, record: Record | None = None, port: int = 0) -> tuple[str, Callable[[], None]]:
    """Listen on 127.0.0.1; return the address, and a function that serves the studio until it is interrupted.

    With ``port`` 0 the system chooses a free port. Raises :class:`OSError` for a port in use.
    """
    from emps_design.studio.data_view import LIMIT_MB

    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
    prepare()
    server = pn.serve(
        lambda: page(Session(axis, record).root),
        port=port,
        address=HOST,
        title=TITLE,
        show=False,
        start=False,
        verbose=False,
        websocket_max_message_size=2 * LIMIT_MB * 2**20,
        websocket_origin=None,
    )
    suffix = guard(server)
    server.start()

    def wait() -> None:
        try:
            server.io_loop.start()
        finally:
            server.stop()

    return f"http://{HOST}:{server.port}{suffix}", wait
