"""A robot looks, touches and remembers.

Cameras and touch become measurements, measurements become object knowledge,
knowledge becomes plans. Import the package that you need, for example
``from visuohaptic.sensing.foam import FoamSensor``; importing ``visuohaptic``
itself costs nothing.
"""

from ._version import __version__

__all__ = ["__version__"]
