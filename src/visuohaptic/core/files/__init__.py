"""One gate per file format: every file from outside is distrusted here, and nowhere else.

A reader refuses what it cannot read in one line, before it takes memory: special files (pipes, devices),
YAML whose aliases multiply, arrays and images whose headers promise more than a program should hold.
Writers leave a whole file or none.
"""

from ..front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
