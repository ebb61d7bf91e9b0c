"""Who may talk to the studio: a browser of this machine, by a name of this machine, with the token of its address.

A page of any other site can make a browser ask 127.0.0.1, by a name that leads there; it cannot know the token.
"""

from __future__ import annotations

import hmac
import secrets
from typing import TYPE_CHECKING, Any

from tornado.web import RequestHandler

if TYPE_CHECKING:
    from bokeh.server.server import Server
    from tornado.httputil import HTTPServerRequest

NAMES = ("127.0.0.1", "localhost", "[::1]")


def guard(server: Server) -> str:
    """Let ``server`` answer only where host, origin and token are right; return what its address ends in."""
    application, token, cookie = server._tornado, secrets.token_urlsafe(24), f"emps-design-{server.port}"
    find = application.find_handler

    def find_handler(request: HTTPServerRequest, **options: Any) -> Any:
        if not local(request.headers, server.port):
            return application.get_handler_delegate(request, Refused, {"why": "by this name the studio is not there"})
        given = request.query_arguments.get("token", [b""])[-1]
        kept = request.cookies[cookie].value.encode() if cookie in request.cookies else b""
        if not any(hmac.compare_digest(one, token.encode()) for one in (given, kept)):
            why = "open the whole address that the studio printed, with its token"
            return application.get_handler_delegate(request, Refused, {"why": why})
        found = find(request, **options)
        if given and hasattr(found, "handler_class"):
            found.handler_class = _leaving(found.handler_class, cookie, token)
        return found

    application.find_handler = find_handler  # type: ignore[method-assign]
    return f"/?token={token}"


def local(headers: Any, port: int | None) -> bool:
    """Whether ``Host``, and ``Origin`` where there is one, are names of this machine at ``port``.

    >>> local({"Host": "localhost:80"}, 80), local({"Host": "rebound.example:80"}, 80)
    (True, False)
    >>> local({"Host": "127.0.0.1:80", "Origin": "http://elsewhere.example"}, 80)
    False
    """
    places = {f"{name}:{port}" for name in NAMES} | ({*NAMES} if port == 80 else set())
    return headers.get("Host") in places and headers.get("Origin", "").removeprefix("http://") in places | {""}


class Refused(RequestHandler):
    """Any request that is not let in: 403 and one sentence."""

    def initialize(self, why: str) -> None:
        """Keep ``why``, the sentence."""
        self.why = why

    def prepare(self) -> None:
        """Answer before any method of the request is looked at."""
        self.set_status(403)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"emps-design studio: {self.why}\n")

    def check_xsrf_cookie(self) -> None:
        """There is nothing to protect."""


def _leaving(handler: type[RequestHandler], cookie: str, token: str) -> type[RequestHandler]:
    """``handler`` that leaves the token with the browser, for what the page asks for next."""

    class Leaving(handler):  # type: ignore[misc,valid-type]
        def set_default_headers(self) -> None:
            """Set the cookie beside the handler's own headers."""
            super().set_default_headers()
            self.set_cookie(cookie, token, httponly=True, samesite="Lax", path="/")

    return Leaving
