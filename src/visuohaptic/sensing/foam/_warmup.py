"""Compiles the kernels of the foam sensor: they declare their types, so importing them is enough."""

from __future__ import annotations

__all__ = ["warmup"]


def warmup() -> None:
    """Import every module that has kernels."""
    from . import _appearance, _flank_kernels, _profile_kernels  # noqa: F401
