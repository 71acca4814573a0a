"""The motion of a rigid body with a known surface, from tracked points: consensus, then least squares on the pixels.

Between the first and the newest image the plane of the surface induces a homography H = R - T n^T / d, Eq. (2.14).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core import Camera, Pose
from ...core.geometry import so3_log
from ...tracking.points.homography import decompose_homography, estimate_homography_robust, facing_motions
from ...tracking.pose.plane_pose import lens_numbers

#: Degrees of freedom of (rotation vector, shift) of an object on the floor.
STANDING = np.array([2, 3, 4])


@dataclass(frozen=True, slots=True, eq=False)
class BodyFit:
    """A motion that fits n tracked points."""

    motion: Pose  #: rotation about the point of contact, then shift, in frame F
    covariance: Float[np.ndarray, "6 6"]  #: of (rotation vector [rad], shift [m])
    inliers: Bool[np.ndarray, "n"]
    cost: float  #: sum of squared residuals in standard deviations, each truncated at the gate


def turn_angle(motion: Pose) -> float:
    """Angle of a motion's rotation [rad].

    Parameters
    ----------
    motion
        Rigid motion.
    """
    return float(np.linalg.norm(so3_log(motion.rotation)))


def turn_about_vertical(motion: Pose) -> float:
    """Component of a rotation about the vertical [rad]: twice the angle of (w, z) of the quaternion.

    Parameters
    ----------
    motion
        Rigid motion in frame F, whose z axis is the vertical.
    """
    r = motion.rotation
    return math.atan2(r[1, 0] - r[0, 1], r[0, 0] + r[1, 1])


def upright(motion: Pose) -> Pose:
    """The nearest motion of an object that stands on the floor: shift in x and y, rotation about the vertical.

    Parameters
    ----------
    motion
        Rigid motion in frame F.
    """
    c, s = math.cos(turn_about_vertical(motion)), math.sin(turn_about_vertical(motion))
    shift = np.array([motion.translation_m[0], motion.translation_m[1], 0.0])
    return Pose(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), shift)


class BodyFitter:
    """Least-squares fit of a body's motion to the pixels of one camera.

    Parameters
    ----------
    camera, T_camera_foam
        The camera and the pose of frame F in it.
    gate_sigmas
        Inlier threshold in standard deviations.
    min_points
        Minimum number of points.
    """

    def __init__(self, camera: Camera, T_camera_foam: Pose, gate_sigmas: float, min_points: int) -> None:
        self.camera, self.T_camera_foam = camera, T_camera_foam
        self.gate_sigmas, self.min_points = gate_sigmas, min_points
        self._lens = lens_numbers(camera)

    def place(self, face: Pose, motion: Pose, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the body after a motion, frame F [m].

        Parameters
        ----------
        face
            Initial surface; its origin is the point of contact.
        motion
            Rotation about that point, then shift.
        points_m
            Points of the body in its initial pose, frame F.
        """
        pivot = face.translation_m
        return (points_m - pivot) @ motion.rotation.T + pivot + motion.translation_m

    def by_homography(self, face: Pose, body: np.ndarray, pixels: np.ndarray) -> Pose | None:
        """Motion by decomposition of the homography of the known plane; None if none is found.

        Parameters
        ----------
        face
            Initial surface: x along the contact, z its normal.
        body
            Points of the body in its initial pose, frame F (n, 3) [m].
        pixels
            Their current image positions, (n, 2).
        """
        view = self.T_camera_foam
        normal = view.rotation @ face.rotation[:, 2]
        distance = -float(normal @ view.apply(face.translation_m))
        if distance <= 1e-3:
            return None
        start = view.apply(body)
        source, target = start[:, :2] / start[:, 2:], self.camera.rays(pixels)[:, :2]
        found = estimate_homography_robust(
            source, target, threshold=2.0 / self.camera.focal_px, minimum=self.min_points
        )
        if not found.valid:
            return None
        rays = np.column_stack([source[found.inliers], np.ones(np.count_nonzero(found.inliers))])
        motions = facing_motions(decompose_homography(found.matrix), rays)
        if not motions:
            return None
        motion = max(motions, key=lambda one: float(one.normal @ normal))
        # Transform from the camera's frame to F, about the point of contact.
        moved = Pose(motion.rotation, distance * motion.translation_over_distance)
        in_foam = view.inverse() @ moved @ view
        pivot = face.translation_m
        return Pose(in_foam.rotation, in_foam.apply(pivot) - pivot)

    def refined(
        self, face: Pose, start: Pose, body: np.ndarray, pixels: np.ndarray, sigma: np.ndarray
    ) -> BodyFit | None:
        """Motion of a standing body if it fits the pixels, otherwise the unconstrained one (BIC).

        Parameters
        ----------
        face
            Initial surface.
        start
            Initial guess of the motion.
        body
            Points of the body in its initial pose, frame F (n, 3) [m].
        pixels, sigma
            Their current image positions, (n, 2), and the standard deviation per axis, (n,) [px].
        """
        free = self.least_squares(face, start, body, pixels, sigma, np.arange(6))
        if free is None:
            return None
        stands = self.least_squares(face, upright(start), body, pixels, sigma, STANDING)
        price = 3.0 * math.log(2.0 * len(body)) + 10.0
        return stands if stands is not None and stands.cost < free.cost + price else free

    def least_squares(
        self,
        face: Pose,
        start: Pose,
        body: np.ndarray,
        pixels: np.ndarray,
        sigma: np.ndarray,
        active: np.ndarray,
    ) -> BodyFit | None:
        """Gauss-Newton on the pixels with Tukey's weights.

        Parameters
        ----------
        face, start, body, pixels, sigma
            As of :meth:`refined`.
        active
            Fitted components of (rotation vector, shift) in F.
        """
        from ._object_kernels import fit_motion

        view = self.T_camera_foam
        rotation, shift = start.rotation.copy(), start.translation_m.copy()
        distance, kept = np.zeros(len(body)), np.zeros((6, 6))
        free = np.zeros(6, dtype=bool)
        free[active] = True
        scale = fit_motion(
            body, np.ascontiguousarray(pixels), sigma, face.translation_m,
            np.ascontiguousarray(view.rotation), view.translation_m, self._lens,
            self.gate_sigmas, max(4, self.min_points // 2), free, rotation, shift, distance, kept,
        )  # fmt: skip
        if not np.isfinite(scale):
            return None
        cost = float(np.minimum(distance, self.gate_sigmas) @ np.minimum(distance, self.gate_sigmas))
        covariance = np.zeros((6, 6))
        covariance[np.ix_(active, active)] = np.linalg.pinv(kept[np.ix_(active, active)]) * scale**2
        return BodyFit(Pose(rotation, shift), covariance, distance < self.gate_sigmas * scale, cost)

    def project(self, face: Pose, motion: Pose, body: np.ndarray) -> np.ndarray:
        """Pixels of points of the body after a motion, (n, 2).

        Parameters
        ----------
        face
            Initial surface.
        motion
            Rotation about its origin, then shift.
        body
            Points of the body in its initial pose, frame F (n, 3) [m].
        """
        return self.camera.project(self.T_camera_foam.apply(self.place(face, motion, body)))

    def jacobian(self, face: Pose, motion: Pose, body: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Derivative of the pixels by (rotation vector, shift): pinhole, at the undistorted point; (n, 2, active).

        Parameters
        ----------
        face, motion, body
            As of :meth:`project`.
        active
            Columns, of (rotation vector, shift) in F.
        """
        placed = self.place(face, motion, body)
        x, y, z = self.T_camera_foam.apply(placed).T
        fx, fy = self.camera.matrix[0, 0], self.camera.matrix[1, 1]
        by_point = np.zeros((len(body), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 2] = fx / z, -fx * x / z**2
        by_point[:, 1, 1], by_point[:, 1, 2] = fy / z, -fy * y / z**2
        by_point = by_point @ self.T_camera_foam.rotation
        arm = placed - face.translation_m - motion.translation_m
        turns = np.zeros((len(body), 3, 6))
        turns[:, :, 3:] = np.eye(3)
        # d(w x a) / dw = -[a]x
        turns[:, 0, 1], turns[:, 0, 2] = arm[:, 2], -arm[:, 1]
        turns[:, 1, 0], turns[:, 1, 2] = -arm[:, 2], arm[:, 0]
        turns[:, 2, 0], turns[:, 2, 1] = arm[:, 1], -arm[:, 0]
        return (by_point @ turns)[:, :, active]
