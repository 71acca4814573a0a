"""The page in the browser, bound to this machine only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .browse import BrowsePage
    from .files import open_views
    from .map_view import MapView
    from .object_view import ObjectView
    from .page import LivePage
    from .stage import View
    from .steps_view import StepsView
    from .surface_view import SurfaceView

__all__ = [
    "BrowsePage",
    "LivePage",
    "MapView",
    "ObjectView",
    "StepsView",
    "SurfaceView",
    "View",
    "open_views",
]

_HOMES = {
    "BrowsePage": "browse",
    "LivePage": "page",
    "MapView": "map_view",
    "ObjectView": "object_view",
    "StepsView": "steps_view",
    "SurfaceView": "surface_view",
    "View": "stage",
    "open_views": "files",
}


def __getattr__(name: str) -> Any:
    # Live pages of sensors need none of the object side, which takes a second to import.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
