"""Independent simulations: renderers, ray casters, physics and maps that share no code with the library.

Results in these worlds are evidence about the library, so no module here imports it
(``tests/test_worlds.py`` checks this). Even seeds are open for tuning; odd seeds are
opened once, for the reported figures.
"""
