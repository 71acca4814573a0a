"""Access control of the local page: requires its secret, and only the page itself may connect."""

from __future__ import annotations

import logging
import re
import secrets
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from importlib import import_module
from typing import Any

from ..core.errors import VisuohapticError

_log = logging.getLogger(__name__)
#: Of the connections themselves: malformed requests and lost browsers are logged separately from the page's events.
_connections_log = logging.getLogger(f"{__name__}.connections")
_connections_log.setLevel(logging.CRITICAL)

#: Values of ``Host`` sent by a local browser; other names come from an external name server (DNS rebinding).
_LOCAL_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
#: Maximum message size of a browser [bytes]: camera poses, clicks and widget values take a few hundred.
MAX_MESSAGE_BYTES = 1 << 20
#: Maximum number of simultaneous browsers; each receives every image.
MAX_BROWSERS = 16
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
#: Part of the page: viser has no setting for the colours of the system, but its address can ask for the dark ones.
_SCHEME_SCRIPT = b"""<script>{
  const dark = matchMedia("(prefers-color-scheme: dark)"), address = new URL(location), asked = address.searchParams;
  if (dark.matches) asked.set("darkMode", ""); else asked.delete("darkMode");
  history.replaceState(null, "", address);
  dark.addEventListener("change", () => location.reload());
}</script>"""
_PATCHING = threading.Lock()


class AccessControl:
    """Rejects requests with a foreign ``Host`` or ``Origin``, or without the secret of the page's address."""

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)  #: first part of the path of every request
        self.closed = True  #: whether no server uses it
        self._browsers = 0
        self._misread = 0

    def refusal(self, path: str, headers: Mapping[str, str]) -> str:
        """Why a request is rejected; empty if it is accepted.

        Parameters
        ----------
        path
            Path of the request, with its query.
        headers
            Headers of the request; a duplicate name raises an exception.
        """
        try:
            host, origin = headers.get("Host", ""), headers.get("Origin")
        except LookupError:
            return "a header occurs twice"
        if not _LOCAL_HOST.fullmatch(host):
            return "the Host header names another machine"
        if origin is not None and origin != f"http://{host}":
            return "the request comes from another page"
        given = path.partition("?")[0].split("/")[1:2]
        # A path of bytes that are no ASCII has lone surrogates.
        if not given or not secrets.compare_digest(given[0].encode(errors="replace"), self.token.encode()):
            return "the address lacks the printed secret"
        return ""

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Apply this access control to the server that viser starts inside the block; viser has no setting for it.

        Remains ``closed`` if viser starts its server in an unknown way.
        """
        library: Any = import_module("websockets.asyncio.server")
        with _PATCHING:
            serve = library.serve

            def guarded(handler: Any, *place: Any, **options: Any) -> Any:
                if not str(getattr(handler, "__module__", "")).startswith("viser."):
                    return serve(handler, *place, **options)
                answer = options["process_request"]
                options |= {
                    "process_request": lambda connection, request: self._answer(answer, connection, request),
                    "max_size": MAX_MESSAGE_BYTES,
                    "logger": _connections_log,
                    "server_header": None,
                }
                self.closed = False
                return serve(lambda connection: self._serve(handler, connection), *place, **options)

            library.serve = guarded
            try:
                yield
            finally:
                library.serve = serve

    def _answer(self, answer: Any, connection: Any, request: Any) -> Any:
        if refusal := self.refusal(request.path, request.headers):
            return connection.respond(HTTPStatus.FORBIDDEN, f"Refused: {refusal}.\n")
        path = request.path.partition("?")[0]
        request.path = request.path[1 + len(self.token) :] or "/"
        if "Accept-Encoding" in request.headers:  # compression is of no use on one machine
            del request.headers["Accept-Encoding"]
        response = answer(connection, request)
        if response is not None:
            if path == f"/{self.token}/" and response.body:
                response.body = response.body.replace(b"<head>", b"<head>" + _SCHEME_SCRIPT, 1)
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
            for name, value in _HEADERS.items():
                response.headers[name] = value
        elif self._browsers >= MAX_BROWSERS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "Refused: too many browsers.\n")
        return response

    async def _serve(self, handler: Any, connection: Any) -> None:
        """Serve one browser; an invalid message only closes its connection."""
        import asyncio

        asyncio.get_running_loop().set_exception_handler(lambda _, context: self._note(context))
        self._browsers += 1
        try:
            await handler(connection)
        finally:
            self._browsers -= 1

    def _note(self, context: Mapping[str, Any]) -> None:
        """Log one line about the first invalid value; log the others at debug level."""
        level = logging.DEBUG if self._misread else logging.WARNING
        self._misread += 1
        found = type(context["exception"]).__name__ if "exception" in context else context["message"]
        _log.log(level, "a browser sent an invalid value (%s)", found)


def reported(callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """Wrap a widget callback so that an invalid value from a browser is reported in one line.

    Parameters
    ----------
    callback
        Called with viser's event.
    """

    def call(event: Any) -> None:
        try:
            callback(event)
        except (VisuohapticError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            _log.warning("the page: %s", error if isinstance(error, VisuohapticError) else repr(error))

    return call
