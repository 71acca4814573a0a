"""Grasps with several contacts: finite fingertips, coupled contacts, deformation of single tips (Alt 2016, Sec. 6.1.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import NON_NEGATIVE, InputError, check_numbers
from ...core.geometry import area_vectors
from ..shells.shell import ShellModel
from ..shells.stiffness_map import DualTips, tip_loads


@dataclass(frozen=True, slots=True, eq=False)
class GraspCoupling:
    """Coupled compliance of several contacts.

    ``compliance[i, j]`` is the deformation along contact i per newton at contact j [m/N]; it is
    symmetric. A pinch is a contact of two tips.
    """

    compliance: Float[np.ndarray, "m m"]

    def deformation_m(self, force_N: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        """Deformations of all simultaneous contacts, by superposition [m].

        Parameters
        ----------
        force_N
            Force of each contact [N].
        """
        out: np.ndarray = self.compliance @ np.asarray(force_N, dtype=float)
        return out

    def force_N(self, deformation_m: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        """Forces that cause these deformations of the contacts [N].

        Parameters
        ----------
        deformation_m
            Deformation along each contact [m].
        """
        out: np.ndarray = np.linalg.solve(self.compliance, np.asarray(deformation_m, dtype=float))
        return out

    @property
    def stiffness_N_per_m(self) -> Float[np.ndarray, "m"]:
        """Local stiffness of each contact alone, force per approach."""
        out: np.ndarray = 1.0 / np.diag(self.compliance)
        return out


def contact_loads(
    model: ShellModel, tips: DualTips, *, tip_radius_m: float = 0.0
) -> Float[np.ndarray, "n m"]:
    """Loads of 1 N on both tips of each pair; a finite tip distributes its load.

    A tip of radius r presses with ``1 - (d / r)^2`` at distance d, like a soft finger; r = 0 is
    a point load. Vertices on the opposite wall are excluded.

    Parameters
    ----------
    model, tips
        As of :func:`.dual_tip_compliance`.
    tip_radius_m
        Radius of a finger tip [m]; 0 is a point.

    Returns
    -------
    (6 v, m) sparse array
        Forces and moments at the vertices [N], [N m].
    """
    points = tip_loads(model.nodes, tips, model.mesh.vertices_m)
    check_numbers("contact_loads", NON_NEGATIVE, tip_radius_m=tip_radius_m)
    if tip_radius_m == 0:
        return points
    from scipy.sparse import csc_array

    vertices = model.mesh.vertices_m
    places = np.stack([vertices[tips.first], np.einsum("mk,mki->mi", tips.weights, vertices[tips.second])])
    square = ((vertices - places[:, :, None]) ** 2).sum(axis=3)
    weight = _vertex_area(model) * np.maximum(1 - square / tip_radius_m**2, 0.0)
    # A tip that is smaller than the mesh cells is a point load.
    nearest = np.arange(model.nodes) == square.argmin(axis=2)[..., None]
    weight = np.where(weight.any(axis=2, keepdims=True), weight, nearest)
    first, second = weight / weight.sum(axis=2, keepdims=True)
    out = np.zeros((model.nodes, 6, len(tips)))
    out[:, :3] = np.einsum("m,mv,mi->vim", tips.valid, first - second, tips.direction)
    return csc_array(out.reshape(-1, len(tips)))


def couple(model: ShellModel, tips: DualTips, *, tip_radius_m: float = 0.0) -> GraspCoupling:
    """Exact compliance matrix of several pinches on one object.

    Parameters
    ----------
    model, tips, tip_radius_m
        As of :func:`contact_loads`.

    Raises
    ------
    InputError
        A pair has no wall across the axis.
    """
    if not tips.valid.all():
        raise InputError("couple", f"pair {int(np.argmin(tips.valid))} has no wall across the axis")
    return GraspCoupling(
        model.factor().coupling(model.free_loads(contact_loads(model, tips, tip_radius_m=tip_radius_m)))
    )


def own_compliance(
    model: ShellModel, tips: DualTips, pinch_compliance: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Deformation at the first tip alone per newton of the pinch [m/N].

    With unit loads a and b of the tips, ``a^T K^-1 (a - b) = (c_a - c_b + c) / 2``: two more
    compliances instead of a displacement field for each pinch.

    Parameters
    ----------
    model, tips
        As of :func:`contact_loads`.
    pinch_compliance
        Approach of the two tips of each pair per newton [m/N], see :func:`.dual_tip_compliance`.
    """
    first = np.repeat(tips.first[:, None], 3, axis=1)
    alone = []
    both = tip_loads(model.nodes, tips, model.mesh.vertices_m)
    # The same pair with its second tip at the first: the loads of the first alone, doubled.
    here = DualTips(tips.first, first, np.tile([-1.0, 0.0, 0.0], (len(tips), 1)), tips.direction, tips.valid)
    one = tip_loads(model.nodes, here) / 2
    for loads in (one, one - both):
        alone.append(model.factor().compliance(model.free_loads(loads)))
    out: np.ndarray = (alone[0] - alone[1] + pinch_compliance) / 2
    return out


def _vertex_area(model: ShellModel) -> Float[np.ndarray, "v"]:
    mesh = model.mesh
    area = np.linalg.norm(area_vectors(mesh.vertices_m, mesh.faces), axis=1)
    third = area / 3 * np.asarray(mesh.fraction)
    return np.bincount(mesh.faces.ravel(), np.repeat(third, 3), minlength=model.nodes)
