"""Readers and writers of file formats; all external files are validated here, and only here.

A reader rejects invalid input with a one-line message before it allocates memory: special files (pipes, devices),
YAML with exponentially growing aliases, arrays and images whose headers declare excessive sizes.
Writers are atomic: they create a complete file or none.
"""

from ..front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
