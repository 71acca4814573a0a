"""The camera: pinhole with distortion, calibration, poses, frames and casting to a plane (Alt 2016, Sec. 2.3.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
