"""The foam's mechanics: stress-strain law, calibration, hysteresis, boundary tension (Alt 2016, Sec. 3.1)."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
