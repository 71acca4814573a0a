"""Homographies: estimation from points, composition from a motion, decomposition into motions.

Conventions, tested by round trips through random poses:

- ``H_target_source`` maps homogeneous source points to target points, up to scale.
- A plane in the source camera's frame is given by its unit normal ``n``, which points
  from the plane *towards* the camera, and its distance ``d > 0``: points of the plane
  satisfy ``n . X = -d``.
- A rigid motion maps source to target coordinates, ``X' = R X + T``.

With these, Alt 2016, Eq. (2.14) holds as printed: ``X' = R X - T (n . X) / d``, so
``H = R - T n^T / d``. A normal that points away from the camera would flip the sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core import InputError, finite_array

#: Relative difference of singular values below which a motion is degenerate.
_SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMotion:
    """A rigid motion and a plane that together define a homography."""

    rotation: Float[np.ndarray, "3 3"]  #: R, source to target
    translation_over_distance: Float[np.ndarray, "3"]  #: T / d, dimensionless: the scale is not observable
    normal: Float[np.ndarray, "3"]  #: unit normal in the source frame, towards the camera

    @property
    def homography(self) -> Float[np.ndarray, "3 3"]:
        """``R - (T / d) n^T``."""
        return self.rotation - np.outer(self.translation_over_distance, self.normal)


@dataclass(frozen=True, slots=True, eq=False)
class RobustHomography:
    """A homography from correspondences with outliers."""

    matrix: Float[np.ndarray, "3 3"]  #: ``H_target_source``; NaN if none was found
    inliers: Bool[np.ndarray, "n"]  #: inlier correspondences
    valid: bool
    reason: str = ""  #: why it is invalid


def apply_homography(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Map points; those on or beyond the horizon (third coordinate <= 0) give NaN.

    The sign of H matters and is used as given, normally with ``H[2, 2] > 0``.

    Parameters
    ----------
    homography
        H, defined up to scale.
    points
        Points (x, y).
    """
    homography = np.asarray(homography, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    mapped = points @ homography[:, :2].T + homography[:, 2]
    depth = mapped[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth > 0, mapped[..., :2] / depth, np.nan)


def _normaliser(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Similarity that moves the centroid to 0 and scales the mean distance to sqrt 2 (Hartley)."""
    centre = points.mean(axis=0)
    distance = float(np.linalg.norm(points - centre, axis=1).mean())
    scale = np.sqrt(2.0) / max(distance, 1e-12)
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])


def _checked(source: object, target: object) -> tuple[np.ndarray, np.ndarray]:
    first = finite_array("homography", source, None, 2, field="source", least=4)
    return first, finite_array("homography", target, len(first), 2, field="target")


def estimate_homography(
    source: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "3 3"]:
    """Normalised direct linear transform, Alt 2016, Eq. (2.15), with Hartley's normalisation.

    Parameters
    ----------
    source, target
        At least four corresponding points, no three of four collinear.

    Returns
    -------
    ``H_target_source`` with determinant 1 in absolute value and positive depth
    at the centroid of the source points.

    Raises
    ------
    InputError
        The points do not determine a homography (e.g. they are collinear).
    """
    a, b = _checked(source, target)
    normal_a, normal_b = _normaliser(a), _normaliser(b)
    x = a @ normal_a[:2, :2].T + normal_a[:2, 2]
    u = b @ normal_b[:2, :2].T + normal_b[:2, 2]
    ones, zeros = np.ones((len(x), 1)), np.zeros((len(x), 3))
    homogeneous = np.hstack([x, ones])
    design = np.vstack(
        [
            np.hstack([-homogeneous, zeros, u[:, :1] * homogeneous]),
            np.hstack([zeros, -homogeneous, u[:, 1:] * homogeneous]),
        ]
    )
    # With four points, the null space is one right-singular vector short of a square matrix.
    _, singular, rows = np.linalg.svd(design, full_matrices=True)
    if not singular[7] > 1e-10 * singular[0]:
        raise InputError(
            "homography",
            f"{len(a)} points do not determine it (they repeat or lie on a line)",
            remedy="use points that are spread over the plane",
        )
    normalised = rows[-1].reshape(3, 3)
    # In normalised coordinates the entries are of order 1, so that the bound is scale-independent.
    if not abs(np.linalg.det(normalised)) > 1e-9:
        raise InputError("homography", "the points give a singular matrix (the target lies on a line)")
    result = np.linalg.inv(normal_b) @ normalised @ normal_a
    determinant = np.linalg.det(result)
    result = result / np.cbrt(abs(determinant))
    centre = a.mean(axis=0)
    return result if result[2] @ [*centre, 1.0] > 0 else -result


def estimate_homography_robust(
    source: Float[np.ndarray, "n 2"],
    target: Float[np.ndarray, "n 2"],
    *,
    threshold: float = 3.0,
    minimum: int = 8,
    seed: int = 0,
) -> RobustHomography:
    """Homography from correspondences with outliers: RANSAC with local optimisation, followed by the DLT.

    Alt 2016, Sec. 2.3.3. The sampling is OpenCV's USAC (MAGSAC scoring); the
    result is the normalised DLT on the consensus set, which is then reselected once.

    Parameters
    ----------
    source, target
        Corresponding points.
    threshold
        Maximum distance of an inlier in the target.
    minimum
        Minimum number of inliers.
    seed
        Seed of the sampling: the same seed gives the same result.
    """
    import cv2

    a, b = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    nothing = np.zeros(len(a), dtype=bool)
    missing = np.full((3, 3), np.nan)
    if len(a) < max(4, minimum):
        return RobustHomography(missing, nothing, False, f"{len(a)} matches, at least {minimum} needed")
    a, b = _checked(a, b)
    settings = cv2.UsacParams()
    settings.threshold = threshold
    settings.confidence = 0.999
    settings.maxIterations = 5000
    settings.score = cv2.SCORE_METHOD_MAGSAC
    settings.sampler = cv2.SAMPLING_UNIFORM
    settings.loMethod = cv2.LOCAL_OPTIM_SIGMA
    settings.randomGeneratorState = seed
    try:
        found, mask = cv2.findHomography(a, b, settings)
    except cv2.error:
        found, mask = None, None
    if found is None or mask is None or not np.isfinite(found).all():
        return RobustHomography(missing, nothing, False, "no consensus")
    inliers = mask.ravel().astype(bool)
    matrix = np.asarray(found, dtype=np.float64)
    for _ in range(2):
        if np.count_nonzero(inliers) < max(4, minimum):
            reason = f"{np.count_nonzero(inliers)} agreeing matches, at least {minimum} needed"
            return RobustHomography(missing, inliers, False, reason)
        try:
            matrix = estimate_homography(a[inliers], b[inliers])
        except InputError as error:
            return RobustHomography(missing, inliers, False, error.problem)
        distance = np.linalg.norm(apply_homography(matrix, a) - b, axis=1)
        inliers = distance < threshold  # NaN (beyond the horizon) compares as false
    valid = bool(np.count_nonzero(inliers) >= max(4, minimum))
    return RobustHomography(matrix, inliers, valid, "" if valid else "the consensus set became too small")


def decompose_homography(homography: Float[np.ndarray, "3 3"]) -> tuple[PlaneMotion, ...]:
    """All motions and planes that are consistent with a homography between unit planes.

    Four in general, in pairs that differ by the sign of T and n; two if T is
    parallel to n, one (with T = 0 and an arbitrary normal) for a pure rotation.

    The SVD gives ``H^T H = V diag(s1^2, 1, s3^2) V^T`` once the middle singular value
    is scaled to 1. H preserves the length of vectors in the plane orthogonal to ``n``; the
    two planes of such vectors contain ``v2`` and ``u = (a v1 +- b v3)`` with
    ``a^2 = (1 - s3^2) / (s1^2 - s3^2)``, ``b^2 = (s1^2 - 1) / (s1^2 - s3^2)``, which determines
    R for each of them (Ma, Soatto, Kosecka, Sastry, An Invitation to 3-D Vision, 5.3).

    Parameters
    ----------
    homography
        H between points on the planes z = 1 of both cameras.
    """
    matrix = finite_array("decompose_homography", homography, 3, 3)
    _, singular, vectors = np.linalg.svd(matrix)
    if not singular[2] > 1e-12 * singular[0]:
        raise InputError(
            "decompose_homography", f"the matrix is singular (singular values {singular.tolist()})"
        )
    matrix = matrix / singular[1]
    if np.linalg.det(matrix) < 0:
        # A plane that is seen from the same side before and after has det H > 0.
        matrix = -matrix
    s1, s3 = singular[0] / singular[1], singular[2] / singular[1]
    spread = s1**2 - s3**2
    if spread < _SAME:
        u, _, vt = np.linalg.svd(matrix)
        return (PlaneMotion(u @ vt, np.zeros(3), np.array([0.0, 0.0, -1.0])),)
    v1, v2, v3 = vectors
    along = np.sqrt(max(1.0 - s3**2, 0.0) / spread)
    across = np.sqrt(max(s1**2 - 1.0, 0.0) / spread)
    signs: tuple[float, ...] = (1.0, -1.0)
    if min(along, across) < np.sqrt(_SAME):
        # T parallel to n: both planes coincide; remove rounding under the root.
        signs, along, across = (1.0,), round(along), round(across)
    motions: list[PlaneMotion] = []
    for sign in signs:
        kept = along * v1 + sign * across * v3
        normal = np.cross(v2, kept)
        before = np.column_stack([v2, kept, normal])
        first, second = matrix @ v2, matrix @ kept
        after = np.column_stack([first, second, np.cross(first, second)])
        rotation = after @ before.T
        # The columns are orthonormal up to rounding; make them exactly so.
        u, _, vt = np.linalg.svd(rotation)
        rotation = u @ vt
        shift = (rotation - matrix) @ normal
        motions.append(PlaneMotion(rotation, shift, normal))
        motions.append(PlaneMotion(rotation, -shift, -normal))
    return tuple(motions)


def facing_motions(
    motions: tuple[PlaneMotion, ...], rays_source: Float[np.ndarray, "n 3"]
) -> tuple[PlaneMotion, ...]:
    """Motions whose plane lies in front of both cameras: the positive depth constraint.

    ``rays_source`` are points of the plane as seen by the source camera, scaled to
    z = 1. Their depth ``-d / (n . ray)`` must be positive, also after
    the motion. In general, at most two solutions remain; prior knowledge of the normal, or a
    third view, resolves the ambiguity.

    Parameters
    ----------
    motions
        From :func:`decompose_homography`.
    rays_source
        Points of the plane as seen by the source camera, scaled to z = 1.
    """
    rays = np.atleast_2d(np.asarray(rays_source, dtype=np.float64))
    kept = []
    for motion in motions:
        if not motion.translation_over_distance.any():
            kept.append(motion)
            continue
        in_front = rays @ motion.normal < 0
        after = (rays @ motion.homography.T)[:, 2] > 0
        if in_front.all() and after.all():
            kept.append(motion)
    return tuple(kept)
