"""Frames of a video, an image folder, a live camera or an MCAP recording."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
