"""Runs the kernels of maps, graphs and mapping once."""

from __future__ import annotations

__all__ = ["warmup"]


def warmup() -> None:
    """Each part on a small input of its own."""
    from . import _graph_warmup, _mapper_warmup, _push_warmup

    _graph_warmup.warmup()
    _mapper_warmup.warmup()
    _push_warmup.warmup()
