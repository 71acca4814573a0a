"""Pose of a planar template from its aligned corners, by homography decomposition and refinement.

Alt 2016, Sec. 2.3.3. The decomposed homography is that between a virtual camera that
faces the template at distance d and the real camera, so that d is known and the pose
is metric. A view with little perspective has a second pose, with the opposite tilt about the
line of sight, that explains it almost as well: both are refined and returned.

The refinement weights the four corners with the full 8 x 8 covariance of the alignment,
the inverse of the photometric Hessian. To first order, this minimises the
image difference over the six parameters of the pose itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import Camera, InputError, Pose
from ...core.geometry import so3_log
from ..points.homography import decompose_homography, estimate_homography, facing_motions


@dataclass(frozen=True, slots=True, eq=False)
class PlanePose:
    """One pose that is consistent with a view of a plane."""

    T_camera_template: Pose
    #: of (x, y, z, rx, ry, rz) [m, rad]: translation and a small rotation about the camera's axes,
    #: R' = exp([r]) R, as in ROS ``PoseWithCovariance``
    covariance: Float[np.ndarray, "6 6"]
    chi2: float  #: squared residual of the eight corner coordinates in units of their covariance


def estimate_plane_poses(
    camera: Camera,
    points_template_m: Float[np.ndarray, "4 3"],
    corners_px: Float[np.ndarray, "4 2"],
    corner_covariance: Float[np.ndarray, "8 8"],
    *,
    starts: tuple[Pose, ...] = (),
) -> tuple[PlanePose, ...]:
    """Poses consistent with the observed positions of four points of a plane, the best first; one or two.

    Parameters
    ----------
    camera
        Intrinsics and distortion.
    points_template_m
        Four points with z = 0, no three collinear.
    corners_px
        Their observed pixels.
    corner_covariance
        Covariance of (x0, y0, x1, ...) [px^2].
    starts
        Initial poses instead of those from the decomposition, e.g. of the last frame.

    Returns
    -------
    tuple of PlanePose
        Empty if no pose has the plane in front of the camera.
    """
    points = np.ascontiguousarray(points_template_m, dtype=np.float64)
    if points.shape != (4, 3) or not np.allclose(points[:, 2], 0):
        raise InputError("estimate_plane_poses", "expected four points (4, 3) with z = 0", field="points")
    # A floor of a thousandth of a pixel keeps a noise-free covariance invertible.
    # Inverted once: triangular solvers on 8 x 8 may wait for threads of the linear algebra library.
    whiten = np.linalg.inv(np.linalg.cholesky(np.asarray(corner_covariance) + 1e-6 * np.eye(8)))
    if not starts:
        start = _from_decomposition(camera, points, corners_px)
        starts = (start, tilted_back(start)) if start is not None else ()
    corners_px, lens = np.ascontiguousarray(corners_px, dtype=np.float64), lens_numbers(camera)
    found: list[PlanePose] = []
    for start in starts:
        refined = _refine(points, corners_px, whiten, lens, start)
        if refined is not None and all(
            refined.T_camera_template.angle_to(other.T_camera_template) > 1e-4 for other in found
        ):
            found.append(refined)
    return tuple(sorted(found, key=lambda pose: pose.chi2))


def pose_difference(a: Pose, b: Pose) -> Float[np.ndarray, "6"]:
    """``b - a`` as (x, y, z, rx, ry, rz) [m, rad], in the convention of the covariance.

    Parameters
    ----------
    a, b
        Two poses.
    """
    return np.concatenate([b.translation_m - a.translation_m, so3_log(b.rotation @ a.rotation.T)])


def _from_decomposition(camera: Camera, points: np.ndarray, corners_px: np.ndarray) -> Pose | None:
    """Pose by decomposing the homography from a camera that faces the template at distance d."""
    rays = camera.rays(np.asarray(corners_px))
    distance = 10.0 * float(np.abs(points).max())
    try:
        homography = estimate_homography(points[:, :2] / distance, rays[:, :2])
        motions = decompose_homography(homography)
    except InputError:
        return None
    virtual = np.column_stack([points[:, :2] / distance, np.ones(4)])
    motions = facing_motions(motions, virtual)
    if not motions:
        return None
    # The virtual camera looks along the normal, which selects one of the two remaining solutions.
    motion = min(motions, key=lambda found: found.normal[2])
    shift = distance * motion.translation_over_distance + motion.rotation @ np.array([0, 0, distance])
    return Pose(motion.rotation, shift) if shift[2] > 0 else None


def tilted_back(pose: Pose) -> Pose:
    """The pose with its tilt mirrored about the line of sight: the same image without perspective effects.

    Parameters
    ----------
    pose
        ``T_camera_plane``.
    """
    sight = pose.translation_m / np.linalg.norm(pose.translation_m)
    # Mirrored in the plane perpendicular to the line of sight, with the template's own axis restored.
    rotation = pose.rotation - 2.0 * np.outer(sight, sight @ pose.rotation)
    rotation[:, 2] *= -1.0
    return Pose(rotation, pose.translation_m)


def _refine(
    points: np.ndarray, corners_px: np.ndarray, whiten: np.ndarray, lens: np.ndarray, start: Pose
) -> PlanePose | None:
    """Levenberg-Marquardt on the six parameters, residuals whitened by the corners' covariance."""
    from ._pose_kernels import refine_pose

    rotation, translation, normal = start.rotation.copy(), start.translation_m.copy(), np.zeros((6, 6))
    chi2 = float(refine_pose(points, corners_px, whiten, lens, rotation, translation, normal))
    if not np.isfinite(chi2):
        return None
    try:
        covariance = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None
    return PlanePose(Pose(rotation, translation), 0.5 * (covariance + covariance.T), chi2)


def lens_numbers(camera: Camera) -> Float[np.ndarray, "12"]:
    """Camera parameters for the kernels: fx, fy, cx, cy, and eight distortion coefficients.

    Parameters
    ----------
    camera
        Intrinsics and distortion.
    """
    k, result = camera.matrix, np.zeros(12)
    result[:4] = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    result[4 : 4 + len(camera.distortion)] = camera.distortion
    return result
