"""A page with several selectable views."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from typing import Any

from ..core import InputError, VisuohapticError, check_choice
from .access_control import reported
from .server import Page, markdown_text
from .stage import Stage, View

_log = logging.getLogger(__name__)


class BrowsePage(Page):
    """A page served on localhost that shows one of several views at a time.

    Parameters
    ----------
    views
        Selectable views; the first is shown.
    port
        TCP port on 127.0.0.1; if it is in use, the next free one.
    title
        Headline of the page.

    Examples
    --------
    >>> with BrowsePage([ObjectView.of_object(load_object("cup"))], port=0) as page:  # doctest: +SKIP
    ...     page.show()
    """

    def __init__(self, views: Sequence[View], port: int = 8080, *, title: str = "visuohaptic") -> None:
        if not views:
            raise InputError("BrowsePage", "found no views, expected at least one")
        super().__init__(port, title)
        titles = [view.title for view in views]
        self._views: dict[str, View] = {}
        for number, view in enumerate(views, 1):
            title = view.title if titles.count(view.title) == 1 else f"{view.title} ({number})"
            while title in self._views:  # another one is called so
                title = f"{title} ({number})"
            self._views[title] = view
        self._stage = Stage(self._server)
        self._lock = threading.RLock()
        gui = self._server.gui
        names = tuple(self._views)
        self._choice: Any = gui.add_dropdown("show", names, order=0, visible=len(names) > 1)
        self._trouble: Any = gui.add_markdown("", order=1, visible=False)
        self._choice.on_update(reported(lambda _: self.open(self._choice.value)))
        self.open(names[0])

    @property
    def names(self) -> tuple[str, ...]:
        """Titles of the views."""
        return tuple(self._views)

    @property
    def stage(self) -> Stage:
        """Stage on which the view is drawn."""
        return self._stage

    def open(self, name: str) -> None:
        """Switch to another view.

        Parameters
        ----------
        name
            Title of the view.
        """
        check_choice("BrowsePage", self._views, name)
        with self._lock:
            if self._choice.value != name:
                self._choice.value = name  # whose callback opens it
                return
            self._open(name)

    def _open(self, name: str) -> None:
        with self._server.atomic():
            self._stage.clear()
            self._trouble.visible = False
            try:
                self._views[name].draw(self._stage)
            except VisuohapticError as error:
                _log.warning("%s", error)
                self._trouble.content = markdown_text(str(error))
                self._trouble.visible = True
