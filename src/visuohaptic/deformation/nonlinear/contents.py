"""Contents of a container: none, enclosed air, or liquid below air (Alt 2016, Sec. 6.1.5).

All pressures are gauge pressures, p = P - P_0: an open container has p = 0. With V_L the volume of
the liquid, Boyle's law is ``p(V) = P_0 (V_0 - V_L) / (V - V_L) - P_0``, Eq. (6.3) minus
P_0. For small deformation it is ``p = -kappa dV`` with ``kappa = P_0 / (V_0 - V_L)``: a rank-one
term of the stiffness, so the map of all pinches of a closed container costs one more solve than that of an open one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, InputError, Ranged, within
from ...core.measurement import AIR_PA
from ..shapes.mesher import ShellObject
from ..shells.corotational import CorotationalShell, PressureLaw
from ..shells.shell import ShellModel, enclosed_volume, volume_gradient
from ..shells.stiffness_map import DualTips, bent_loads, tip_loads
from .equilibrium_path import EquilibriumPath
from .load_stepping import follow_displacement
from .self_contact import SelfContactGuard


@dataclass(frozen=True, slots=True)
class Contents(Ranged):
    """Contents of a container.

    >>> Contents(fill=0.95).bulk_stiffness(1e-3)
    2000000000.0...
    """

    closed: bool = True  #: the contents cannot escape
    #: fraction of the volume that is liquid; 1 is incompressible
    fill: float = field(default=0.0, metadata=within(0, 1))
    ambient_Pa: float = field(default=AIR_PA, metadata=POSITIVE)  #: absolute pressure outside

    def bulk_stiffness(self, volume_m3: float) -> float:
        """kappa = -dp/dV in the undeformed state [Pa/m^3]; infinite without gas, zero when open.

        Parameters
        ----------
        volume_m3
            Enclosed volume in the undeformed state [m^3].
        """
        gas = (1 - self.fill) * volume_m3
        if not self.closed:
            return 0.0
        return self.ambient_Pa / gas if gas > 0 else float("inf")

    def law(self, volume_m3: float) -> PressureLaw | None:
        """Gauge pressure and its derivative by volume; None when open.

        Below a thousandth of the undeformed gas volume, the law is extrapolated linearly: an intermediate step
        of Newton's method may reach that range, a solution does not.

        Parameters
        ----------
        volume_m3
            Enclosed volume in the undeformed state [m^3].
        """
        if not self.closed:
            return None
        # Without gas: a bulk modulus like that of water.
        liquid = min(self.fill, 1 - 1e-4) * volume_m3
        gas = volume_m3 - liquid
        least = 1e-3 * gas

        def pressure(volume: float) -> tuple[float, float]:
            left = volume - liquid
            at = max(left, least)
            slope = -self.ambient_Pa * gas / at**2
            return self.ambient_Pa * (gas / at - 1) + slope * (left - at), slope

        return pressure


def enclosed_gradient(container: ShellObject, model: ShellModel) -> Float[np.ndarray, "v 6"]:
    """Gradient a = dV/du of the enclosed volume [m^2], including the lid over an open mouth; zero at fixed vertices.

    Parameters
    ----------
    container
        Parametric or imported container.
    model
        Its shell model.
    """
    out = model.volume_gradient()
    if len(container.lid):
        out[:, :3] += volume_gradient(container.mesh.vertices_m, container.lid)
        out[model.fixed] = 0.0
    return out


def closed_compliance(
    container: ShellObject,
    model: ShellModel,
    tips: DualTips,
    compliance: Float[np.ndarray, "m"],
    contents: Sequence[Contents],
) -> Float[np.ndarray, "c m"]:
    """Compliance of all pinches for several contents, from that of the open container and one more solve.

    ``c - (f . w)^2 / (1 / kappa + a . w)`` with ``w = K^-1 a``, by the Sherman-Morrison formula.

    Parameters
    ----------
    container, model
        As of :func:`enclosed_gradient`.
    tips
        The m pairs.
    compliance
        Compliance of the open container: approach of both tips per newton [m/N].
    contents
        The c contents to evaluate.

    Returns
    -------
    (c, m) array
        Compliance with each of the contents [m/N].
    """
    a = enclosed_gradient(container, model)
    w = model.solve(a)
    along = tip_approach(tips, w, model.mesh.vertices_m)
    stiff = float(np.sum(a * w))
    out = np.empty((len(contents), len(compliance)))
    for row, what in zip(out, contents, strict=True):
        kappa = what.bulk_stiffness(container.volume_m3)
        row[:] = compliance - (along**2 / (1 / kappa + stiff) if kappa else 0.0)
    return out


def tip_approach(
    tips: DualTips,
    displacement: Float[np.ndarray, "v 6"],
    vertices_m: Float[np.ndarray, "v 3"] | None = None,
) -> Float[np.ndarray, "m"]:
    """f . u: approach of the tips of each pair towards each other [m], as in :func:`.tip_loads`.

    Parameters
    ----------
    tips
        Pairs of tips.
    displacement
        Displacements and rotations of the vertices, (v, 6).
    vertices_m
        Vertices [m], (v, 3); without them, displacements are linear across a face.
    """
    first = np.einsum("mi,mi->m", tips.direction, displacement[tips.first, :3])
    second = np.einsum("mki,mki->m", bent_loads(tips, vertices_m), displacement[tips.second])
    return first - second


def contained_curve(
    container: ShellObject,
    model: ShellModel,
    tips: DualTips,
    which: int,
    deformation_m: Sequence[float],
    contents: Contents | None = None,
    **limits: Any,
) -> EquilibriumPath:
    """Force-deformation curve of one pinch under large deformation, with contents.

    The path ends before self-intersection; ``reason`` then states this.

    Parameters
    ----------
    container, model
        As of :func:`closed_compliance`.
    tips
        Candidate pairs, one of which is pinched.
    which
        Index of the pinched pair.
    deformation_m
        Mean deformations of both tips, ascending [m].
    contents
        Contents; open by default.
    **limits
        ``max_iterations`` and ``until_load``, see :func:`.follow_displacement`; the load is the force of one tip [N].
    """
    law = None if contents is None else contents.law(container.volume_m3)
    shell = CorotationalShell(model, pressure=law, lid=container.lid)
    path = pinch_curve(shell, tips, which, deformation_m, **limits)
    walls = [point.state.points_m for point in path.points]
    return SelfContactGuard(container).cut(path, walls, container.mesh.vertices_m)


def liquid_level_m(container: ShellObject, fill: float) -> float:
    """Height of the liquid's surface above the foot [m].

    Parameters
    ----------
    container
        Parametric or imported container, upright.
    fill
        Fraction of the volume that is liquid, 0 to 1.
    """
    from scipy.optimize import brentq

    mesh, top = container.mesh, container.height_m
    # An imported mesh does not necessarily start at z = 0.
    foot = float(mesh.vertices_m[:, 2].min())
    whole = container.volume_m3

    def missing(level: float) -> float:
        # Vertices above the level are projected onto it and become the lid.
        cut = mesh.vertices_m.copy()
        cut[:, 2] = np.minimum(cut[:, 2], foot + level)
        return (
            enclosed_volume(cut, mesh.faces, mesh.fraction)
            + enclosed_volume(cut, container.lid)
            - fill * whole
        )

    if fill <= 0 or fill >= 1:
        return 0.0 if fill <= 0 else top
    return float(brentq(missing, 0.0, top, xtol=1e-9))


def pinch_load(model: ShellModel, tips: DualTips, which: int) -> Float[np.ndarray, "v 6"]:
    """The load of 1 N on both tips of one pair.

    Parameters
    ----------
    model
        Shell model.
    tips
        Pairs of tips.
    which
        Index of the pair.
    """
    out: np.ndarray = tip_loads(model.nodes, tips, model.mesh.vertices_m)[:, [which]].toarray().reshape(-1, 6)
    return out


def pinch_curve(
    shell: CorotationalShell,
    tips: DualTips,
    which: int,
    deformation_m: Sequence[float],
    **limits: Any,
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
    **limits
        ``max_iterations`` and ``until_load``, see :func:`.follow_displacement`.

    Raises
    ------
    InputError
        The pair has no opposite wall.
    """
    if not tips.valid[which]:
        raise InputError("pinch_curve", f"pair {which} has no wall across the axis")
    load = tip_loads(shell.model.nodes, tips)[:, [which]].toarray().reshape(-1, 6)
    return follow_displacement(shell, load, deformation_m, control=load / 2, **limits)
