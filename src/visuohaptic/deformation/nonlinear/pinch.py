"""Pinches under large deformation: two opposing tips close on a wall under displacement control."""

from __future__ import annotations

from collections.abc import Sequence

from ...core.errors import InputError
from ..shells.corotational import CorotationalShell
from ..shells.stiffness_map import DualTips, tip_loads
from .equilibrium_path import EquilibriumPath
from .load_stepping import follow_displacement


def pinch_curve(
    shell: CorotationalShell,
    tips: DualTips,
    which: int,
    deformation_m: Sequence[float],
) -> EquilibriumPath:
    """Close two tips on a wall: force against the mean deformation of both.

    Parameters
    ----------
    shell
        Wall with its contents.
    tips
        As for a map, see :func:`.opposing_points`.
    which
        Index of the pair.
    deformation_m
        Targets, ascending. ``load`` of the points is the force of one tip [N].

    Raises
    ------
    InputError
        The pair has no opposite wall.
    """
    if not tips.valid[which]:
        raise InputError("pinch_curve", f"pair {which} has no wall across the axis")
    load = tip_loads(shell.model.nodes, tips)[:, [which]].toarray().reshape(-1, 6)
    return follow_displacement(shell, load, deformation_m, control=load / 2)
