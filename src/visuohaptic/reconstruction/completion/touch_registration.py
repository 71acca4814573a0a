"""Registration of the haptic to the visual frame, from contacts with the visible surface.

Point-to-plane ICP of few contacts with the calibrated transform as a prior: directions that the
contacts leave undetermined, as the rotation of a round bottle about its axis, keep their prior.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core import CalibrationError, Pose, finite_array
from ..mesh import SurfaceMesh

#: Minimum number of contacts for six degrees of freedom.
MIN_CONTACTS = 6
_SAMPLES, _ROUNDS = 20_000, 30
#: Standard deviation of contacts and surface along the normal [m], and of the prior, per axis, about the centroid of the contacts.
_CONTACT_M, _SIGMA_M, _SIGMA_RAD = 0.001, 0.02, math.radians(5.0)


def register_touches(
    contacts_haptic_m: Float[np.ndarray, "n 3"],
    surface: SurfaceMesh,
    prior: Pose | None = None,
) -> tuple[Pose, float]:
    """Estimate ``T_visual_haptic`` from contacts on a visible surface, and the root mean square residual [m].

    Parameters
    ----------
    contacts_haptic_m
        Contacts on visible parts of the object, in the haptic frame [m]; a minority on other parts is tolerated.
    surface
        The visible surface.
    prior
        Calibrated ``T_visual_haptic``; identity by default.

    Raises
    ------
    InputError
        Contacts are not finite, or fewer than six.
    CalibrationError
        Half of the contacts are farther from the surface than the prior permits.
    """
    from scipy.spatial import cKDTree

    contacts = finite_array("register_touches", contacts_haptic_m, None, 3, least=MIN_CONTACTS)
    prior = prior or Pose.identity()
    points, face = surface.sampled(_SAMPLES, np.random.default_rng(0))
    normals = surface.face_normals[face]
    tree = cKDTree(points)
    placed = prior.apply(contacts)
    middle = placed.mean(axis=0)
    reach_m = 3 * (_SIGMA_M + _SIGMA_RAD * float(np.linalg.norm(placed - middle, axis=1).max()))
    stiffness = np.repeat([1 / _SIGMA_RAD**2, 1 / _SIGMA_M**2], 3)
    vector = np.zeros(6)
    correction = Pose.identity()
    distance = np.zeros(len(contacts))
    for _ in range(_ROUNDS):
        moved = correction.apply(placed - middle) + middle
        gaps, near = tree.query(moved)
        if np.median(gaps) > reach_m:
            raise CalibrationError(
                "register_touches",
                f"half of the contacts are over {reach_m:.3g} m from the surface",
                remedy="check frames and units, or give the prior pose a larger deviation",
            )
        normal = normals[near]
        distance = ((moved - points[near]) * normal).sum(axis=1)
        # Robust weights: contacts on hidden parts have no corresponding surface; their weight falls with the distance.
        scale = max(_CONTACT_M, 1.5 * float(np.median(gaps)))
        weight = (1 + (gaps / (2 * scale)) ** 2) ** -2 / scale**2
        jacobian = np.concatenate([np.cross(moved - middle, normal), normal], axis=1)
        matrix = (jacobian * weight[:, None]).T @ jacobian + np.diag(stiffness)
        step = np.linalg.solve(matrix, -(jacobian * weight[:, None]).T @ distance - stiffness * vector)
        correction = Pose.from_rotation_vector(step[:3], step[3:]) @ correction
        vector = vector + step
        if np.linalg.norm(step[3:]) < 1e-7 and np.linalg.norm(step[:3]) < 1e-6:
            break
    about = Pose(np.eye(3), middle) @ correction @ Pose(np.eye(3), -middle)
    moved = (about @ prior).apply(contacts)
    _, near = tree.query(moved)
    distance = ((moved - points[near]) * normals[near]).sum(axis=1)
    return about @ prior, float(np.sqrt(np.mean(distance**2)))
