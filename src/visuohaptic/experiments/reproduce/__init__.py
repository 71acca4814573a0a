"""Every figure and table of the dissertation with data in it, as one experiment that runs by itself.

An experiment is a module of this package with

- ``TITLE: str`` and ``CAPTION: str``, the latter with the word "simulated" where the dissertation used
  a real object;
- ``run(out: Output) -> None``, which writes tables and pictures through ``out`` and says what its
  numbers are beside the dissertation's.

:data:`EXPERIMENTS` names them; :func:`reproduce` runs one into its folder, and leaves alone what is
there and was made by the same version with the same seed. :func:`reproduce_all` runs many, several at a time.
"""

from __future__ import annotations

from .batch import cores, reproduce_all, write_costs
from .output import Comparison, Output
from .pages import write_gallery, write_index
from .runner import EXPERIMENTS, Outcome, read_result, reproduce

__all__ = [
    "EXPERIMENTS",
    "Comparison",
    "Outcome",
    "Output",
    "cores",
    "read_result",
    "reproduce",
    "reproduce_all",
    "write_costs",
    "write_gallery",
    "write_index",
]
