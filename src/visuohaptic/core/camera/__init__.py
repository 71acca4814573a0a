"""Camera model: pinhole with distortion, calibration, poses, frames, and projection onto a plane (Alt 2016, Sec. 2.3.3)."""

from ..front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
