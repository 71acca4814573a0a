"""Independent worlds: renderers, ray casters, physics and maps that share nothing with the library.

What is measured in these worlds is evidence about the library, so no module here imports it
(``tests/test_worlds.py`` holds that). Even seeds are open to whoever tunes a method; odd seeds are
opened once, for the figures that are reported.
"""
