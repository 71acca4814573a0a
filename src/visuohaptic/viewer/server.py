"""Base of pages that are served on localhost only and load nothing from the internet."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from ..core.errors import DeviceError, InputError, needs
from ..core.resources import Closing
from .access_control import AccessControl

if TYPE_CHECKING:
    import viser

_log = logging.getLogger(__name__)


class Page(Closing):
    """A viser server on 127.0.0.1, closed with the context.

    It accepts only clients that know the secret in its address, and only pages from the same origin.

    Parameters
    ----------
    port
        TCP port; if it is in use, the next free one.
    title
        Headline of the page.

    Raises
    ------
    MissingExtraError
        viser is not installed.
    InputError
        The port is out of range.
    DeviceError
        No port from the given one upwards could be opened.
    """

    def __init__(self, port: int, title: str) -> None:
        if not (isinstance(port, int) and 0 <= port < 2**16):
            raise InputError(type(self).__name__, f"found {port!r}, expected 0 to 65535", field="port")
        self._access = AccessControl()
        self._server: Any = _start(port, title, self._access)
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.set_panel_label(title)
        self._server.scene.set_up_direction("+z")

    @property
    def url(self) -> str:
        """Address of the page, including its secret: anyone who has it can open the page."""
        return f"http://127.0.0.1:{self._server.get_port()}/{self._access.token}/"

    def show(self) -> bool:
        """Open the page in a local browser; ``False`` if there is no display."""
        import webbrowser

        # Without a display, Python would start a text browser in the terminal.
        return has_screen() and webbrowser.open(self.url)

    def close(self) -> None:
        """Stop serving; may be called repeatedly."""
        if self._server is not None:
            server, self._server = self._server, None
            server.stop()


def has_screen() -> bool:
    """Whether this machine has a display."""
    import os
    import sys

    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _start(port: int, title: str, access: AccessControl) -> viser.ViserServer:
    """A viser server on 127.0.0.1 with sharing disabled."""
    with needs("viser", "view", "the browser page"):
        import viser
    import rich

    class LocalServer(viser.ViserServer):  # type: ignore[misc]
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse: any connected browser could ask viser to open a tunnel to the internet."""
            _log.warning("rejected the request of a browser to share the page over the internet")
            return None

    # viser prints when it stops; stdout is reserved for results.
    rich.reconfigure(stderr=True)
    # The address that viser prints lacks the secret.
    console = rich.get_console()
    console.quiet = True
    try:
        with access.guarding():
            server = LocalServer(host="127.0.0.1", port=port, label=title, verbose=False)
    except OSError as error:
        raise DeviceError(
            f"the page cannot be served on port {port} ({error}); choose another port"
        ) from error
    finally:
        console.quiet = False
    if access.closed:
        server.stop()
        raise DeviceError(
            f"the page cannot be protected with viser {viser.__version__}; run: pip install 'viser>=1.1,<2'"
        )
    if port and server.get_port() != port:
        _log.warning("port %d is in use, the page is on port %d", port, server.get_port())
    return server


def markdown_text(text: str) -> str:
    """Escape text for Markdown.

    Parameters
    ----------
    text
        Any text.
    """
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]<>()#+!|" else letter for letter in text)
