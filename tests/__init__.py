"""A package, so that ``tests/io`` is not imported as the standard library's ``io``."""
