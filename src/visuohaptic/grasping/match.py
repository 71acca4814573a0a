"""Compare the observed deformation of a grasped object with the prediction (Alt 2016, Sec. 7.2).

The predicted shape of the chosen grasp is registered to an observed, partial cloud by iterative
closest point (ICP). Besides the pose of the object, it estimates the amplitude of the predicted deformation:
1 is as predicted, 2 is twice as soft, 0 is a rigid object. The gripper's position is
known, so the pose is only a small correction and has a prior; without it, a rigid motion
could be mistaken for deformation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import POSITIVE, Estimate, InputError, Pose, check_numbers
from ..core.geometry import so3_exp, vertex_normals
from ..deformation.maps.confidence_band import barycentric
from ..deformation.nonlinear.contents import Contents, enclosed_gradient, pinch_load
from ..deformation.shapes.mesher import ShellObject
from .confirm import pinch_at

#: Minimum number of points: the residual of n points with seven unknowns is known to 1 / sqrt(2 (n - 7)), here 15 %.
MIN_POINTS = 30
MAX_ITERATIONS = 40


@dataclass(frozen=True, slots=True, eq=False)
class DeformedShape:
    """An object's undeformed surface, and its displacement by a grasp."""

    vertices_m: Float[np.ndarray, "v 3"]  #: undeformed
    faces: Int[np.ndarray, "f 3"]
    displacement_m: Float[np.ndarray, "v 3"]  #: predicted under the force
    force_N: float
    deformation_m: float  #: predicted, of one side at the fingers

    @property
    def points_m(self) -> Float[np.ndarray, "v 3"]:
        """Predicted vertices."""
        return self.vertices_m + self.displacement_m


@dataclass(frozen=True, slots=True, eq=False)
class ShapeMatch:
    """Agreement of an observation with a prediction."""

    amplitude: Estimate  #: observed over predicted deformation
    T_observed_object: Pose  #: transforms the object's frame to that of the cloud
    residual_m: float  #: root mean square distance along the normals, of the points that were used
    used: Bool[np.ndarray, "n"]  #: points that lie on the object
    deformation_m: float  #: observed deformation of one side at the fingers
    stop: bool  #: the grasp should be stopped
    reason: str  #: reason; empty if as predicted


def predicted_shape(
    container: ShellObject, vertex: int, force_N: float, contents: Contents | None = None
) -> DeformedShape:
    """Linear deformation under a pinch, one solve; see :class:`.Confirmation` for the nonlinear one.

    Parameters
    ----------
    container, vertex
        As of :func:`.pinch_at`.
    force_N
        Force of each finger [N].
    contents
        Contents; open by default.
    """
    check_numbers("predicted_shape", POSITIVE, force_N=force_N)
    model = container.model()
    load = pinch_load(model, pinch_at(container, vertex), 0)
    moved = model.solve(force_N * load)
    if contents is not None and contents.closed:
        a = enclosed_gradient(container, model)
        w = model.solve(a)
        kappa = contents.bulk_stiffness(container.volume_m3)
        moved = moved - w * (np.sum(a * moved) / (1 / kappa + np.sum(a * w)))
    deformation = 0.5 * float(np.sum(load * moved))
    return DeformedShape(
        container.mesh.vertices_m, container.surface_faces, moved[:, :3], force_N, deformation
    )


def match_shape(
    shape: DeformedShape,
    observed_m: Float[np.ndarray, "n 3"],
    *,
    sigma_m: float = 0.001,
    max_deformation_m: float = 0.005,
    T_observed_object: Pose | None = None,
    pose_sigma_m: float = 0.002,
    pose_sigma_rad: float = 0.05,
    gate_m: float = 0.015,
) -> ShapeMatch:
    """Fit pose and amplitude of the deformation to a partial cloud.

    Parameters
    ----------
    shape
        Prediction.
    observed_m
        Points of any part of the outer surface; fingers and table may be included.
    sigma_m
        Standard deviation of a point along the normal [m].
    max_deformation_m
        Bound of the deformation of one side [m].
    T_observed_object
        Pose of the object from the gripper; the cloud is in the object's frame by default.
    pose_sigma_m, pose_sigma_rad
        Standard deviations of that pose, each coordinate [m] and each angle [rad].
    gate_m
        Points further from the surface [m] are ignored.

    Notes
    -----
    Point-to-plane ICP with Huber weights at 2 sigma. The unknowns are a small rotation, a translation and the
    amplitude s: ``n . (p + s u - q + t + r x p) = 0``. The standard deviation of s assumes independent noise
    of the points and the given prior of the pose.
    """
    check_numbers(
        "match_shape", POSITIVE, sigma_m=sigma_m, max_deformation_m=max_deformation_m, gate_m=gate_m
    )
    check_numbers("match_shape", POSITIVE, pose_sigma_m=pose_sigma_m, pose_sigma_rad=pose_sigma_rad)
    points, finite = _checked(observed_m)
    start = T_observed_object or Pose(np.eye(3), np.zeros(3))
    rotation, shift = np.array(start.rotation), np.array(start.translation_m)
    middle = shape.vertices_m[np.unique(shape.faces)].mean(axis=0)
    prior = np.array([pose_sigma_rad] * 3 + [pose_sigma_m] * 3)
    away = np.zeros(6)
    amplitude, before = 1.0, np.inf
    for _ in range(MAX_ITERATIONS):
        local = (points - shift) @ rotation
        near = _on_surface(shape, amplitude, local, finite, gate_m)
        step, covariance = _gauss_newton(near, local[near.used] - middle, away, prior, sigma_m)
        turn = so3_exp(step[:3])
        # x -> rotation (x - centre) + centre + step, for points in the object's frame.
        rotation = rotation @ turn.T
        shift = shift + rotation @ (turn @ middle - middle - step[3:6])
        away += step[:6]
        amplitude = float(np.clip(amplitude + step[6], -2.0, 10.0))
        size = float(np.abs(step / np.append(prior, 1.0)).max())
        if size < 1e-5 or abs(size - before) < 1e-9:
            break
        before = size
    near = _on_surface(shape, amplitude, (points - shift) @ rotation, finite, gate_m)
    found = Estimate(amplitude, float(np.sqrt(covariance[6, 6])), samples=int(np.count_nonzero(near.used)))
    residual = float(np.sqrt(np.mean(near.gap**2)))
    reason = _disagreement(shape, found, residual, sigma_m, max_deformation_m)
    return ShapeMatch(
        found,
        Pose(rotation, shift),
        residual,
        near.used,
        amplitude * shape.deformation_m,
        bool(reason),
        reason,
    )


def _checked(observed_m: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, "n"]]:
    """Points as array, and mask of the finite ones."""
    points = np.asarray(observed_m, dtype=float)
    finite = np.isfinite(points).all(axis=1)
    if np.count_nonzero(finite) < MIN_POINTS:
        raise InputError(
            "match_shape",
            f"found {np.count_nonzero(finite)} finite points, expected at least {MIN_POINTS}",
            field="observed_m",
        )
    return points, finite


def _gauss_newton(
    near: _Near,
    arm_m: Float[np.ndarray, "k 3"],
    away: Float[np.ndarray, "6"],
    prior: Float[np.ndarray, "6"],
    sigma_m: float,
) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "7 7"]]:
    """Step of (rotation about the centre, translation, amplitude) and its covariance; ``away`` is the pose from its prior."""
    # In the object's frame the points move: by the rotation about its centre, the translation, and against s.
    jacobian = np.column_stack([np.cross(arm_m, near.normal), near.normal, -near.along])
    weight = np.minimum(1.0, 2 * sigma_m / np.maximum(np.abs(near.gap), 1e-12)) / sigma_m**2
    normal_matrix = (jacobian * weight[:, None]).T @ jacobian
    right = -(jacobian * weight[:, None]).T @ near.gap
    normal_matrix[:6, :6] += np.diag(1 / prior**2)
    right[:6] -= away / prior**2
    # If the cloud contains no information about the deformation, the amplitude is unchanged.
    normal_matrix[6, 6] += 1e-12
    return np.linalg.solve(normal_matrix, right), np.linalg.inv(normal_matrix)


def _disagreement(
    shape: DeformedShape, amplitude: Estimate, residual_m: float, sigma_m: float, max_deformation_m: float
) -> str:
    """Reason why the observation deviates from the prediction; empty if it does not."""
    deformation = amplitude.value * shape.deformation_m
    if amplitude.value - 3 * amplitude.sigma > 1 and deformation > max_deformation_m:
        return (
            f"deforms by {1e3 * deformation:.1f} mm at {shape.force_N:.3g} N; predicted "
            f"{1e3 * shape.deformation_m:.1f} mm, limit {1e3 * max_deformation_m:.3g} mm"
        )
    if abs(amplitude.value - 1) > max(5 * amplitude.sigma, 0.5):
        kind = "softer" if amplitude.value > 1 else "stiffer"
        return f"is {kind} than predicted: {amplitude.value:.2f} times the deformation"
    if residual_m > 3 * sigma_m:
        return f"has a different shape: {1e3 * residual_m:.1f} mm mean distance"
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    used: Bool[np.ndarray, "n"]
    gap: Float[np.ndarray, "k"]  # signed distance of each used point, positive outside the surface
    normal: Float[np.ndarray, "k 3"]
    along: Float[np.ndarray, "k"]  #: predicted displacement along the normal


def _on_surface(
    shape: DeformedShape,
    amplitude: float,
    local: Float[np.ndarray, "n 3"],
    finite: Bool[np.ndarray, "n"],
    gate_m: float,
) -> _Near:
    """Closest points on the surface with that amplitude, from the nearest of its face centres."""
    from scipy.spatial import cKDTree

    vertices = shape.vertices_m + amplitude * shape.displacement_m
    normals = vertex_normals(vertices, shape.faces)
    tree = cKDTree(vertices[shape.faces].mean(axis=1))
    _, face = tree.query(np.where(finite[:, None], local, 0.0))
    # The plane of the nearest face; the position on it determines displacement and normal.
    fraction = np.clip(barycentric(vertices[shape.faces[face]], local), -0.5, 1.5)
    fraction /= fraction.sum(axis=1, keepdims=True)
    corners = shape.faces[face]
    normal = np.einsum("nk,nki->ni", fraction, normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    on = np.einsum("nk,nki->ni", fraction, vertices[corners])
    with np.errstate(invalid="ignore"):
        used = finite & (np.linalg.norm(local - on, axis=1) < gate_m)
    if np.count_nonzero(used) < MIN_POINTS:
        raise InputError(
            "match_shape",
            f"{np.count_nonzero(used)} points are within {gate_m} m of the object, "
            f"expected at least {MIN_POINTS}",
            field="observed_m",
        )
    moved = np.einsum("nk,nki->ni", fraction, shape.displacement_m[corners])
    gap = np.einsum("ni,ni->n", normal, local - on)
    return _Near(used, gap[used], normal[used], np.einsum("ni,ni->n", normal, moved)[used])
