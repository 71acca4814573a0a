"""Motion of the platform from points on the floor (Alt 2016, Sec. 3.5).

Points of the floor are static. In the platform's frame they move in the opposite direction: with a translation t and
a rotation R(theta) of the platform, a point at q after the motion was at

    p = R(theta) q + t

before, all in the floor's x and y [m] along the axes of the sensor frame F. Wrong tracks, and those on
moving objects, are removed by RANSAC on pairs of points; the others determine the motion by least
squares, each with the covariance that its pixel noise has on the floor.

Points are compared with their positions in a key frame, not in the previous frame: errors of
frames in between cancel, only those of key frames accumulate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ...core import Motion, PlaneView, Ranged, Reason, at_least, compose_2d, relative_2d, rotation_2d, within
from ...tracking.points.flow import FlowStep


@dataclass(frozen=True, slots=True)
class FloorMotionSettings(Ranged):
    """Settings of the motion estimation."""

    hypotheses: int = field(default=80, metadata=at_least(10))  #: number of point pairs in RANSAC
    gate_sigmas: float = 3.5  #: inlier threshold in standard deviations
    min_sigma_px: float = 0.08  #: of a track: error of interpolation in addition to noise
    min_points: int = field(default=8, metadata=at_least(3))  #: minimum number of inliers
    min_fraction: float = field(default=0.3, metadata=within(0.0, 1.0))  #: minimum fraction of inliers
    key_frames: int = 12  #: a new key frame after this number of frames
    key_fraction: float = 0.5  #: or when less than this fraction of its points is left


@dataclass(frozen=True, slots=True, eq=False)
class PlanarFit:
    """Result of :func:`fit_planar_motion`; ``motion`` is (x [m], y [m], theta [rad])."""

    motion: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    inliers: Bool[np.ndarray, "n"]
    valid: bool


def fit_planar_motion(
    before_m: Float[np.ndarray, "n 2"],
    after_m: Float[np.ndarray, "n 2"],
    covariance_m2: Float[np.ndarray, "n 2 2"],
    rng: np.random.Generator,
    settings: FloorMotionSettings | None = None,
    *,
    expected: Float[np.ndarray, "3"] | None = None,
) -> PlanarFit:
    """Motion of the platform from the positions of the same floor points before and after it.

    Parameters
    ----------
    before_m, after_m
        Points in the platform's frame at both times [m].
    covariance_m2
        Covariance of ``before - R after`` for each point [m^2].
    rng
        Source of the random samples.
    settings
        Settings of the motion estimation.
    expected
        Motion by the odometry: if two groups of points disagree, e.g. floor and an object in front of
        the camera, the one that agrees with it is used even if it is smaller.

    Returns
    -------
    PlanarFit
        Its covariance is inflated if the scatter of the points exceeds their declared noise.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> before = rng.uniform(-0.1, 0.1, (40, 2))
    >>> c, s = np.cos(0.02), np.sin(0.02)
    >>> after = (before - [0.01, 0.0]) @ np.array([[c, -s], [s, c]])
    >>> fit = fit_planar_motion(before, after, np.tile(1e-10 * np.eye(2), (40, 1, 1)), rng)
    >>> bool(np.allclose(fit.motion, [0.01, 0.0, 0.02], atol=1e-6))
    True
    """
    s = settings or FloorMotionSettings()
    count = len(before_m)
    failed = PlanarFit(np.full(3, np.nan), np.full((3, 3), np.inf), np.zeros(count, dtype=bool), False)
    if count < s.min_points:
        return failed
    # Whitened residuals have unit variance on both axes.
    whiten = np.linalg.inv(np.linalg.cholesky(covariance_m2))
    guess = _consensus(before_m, after_m, whiten, rng, s)
    if expected is not None:
        distance = np.linalg.norm(_residuals(before_m, after_m, whiten, expected)[0], axis=1)
        near = np.count_nonzero(distance < 2.0 * s.gate_sigmas)
        guess = expected if near >= max(s.min_points, s.min_fraction * count) else guess
    inliers = np.zeros(count, dtype=bool)
    motion, scale = guess, 1.0
    information = np.eye(3)
    for _ in range(6):
        residual, jacobian = _residuals(before_m, after_m, whiten, motion)
        distance = np.linalg.norm(residual, axis=1)
        new = distance < s.gate_sigmas * max(scale, 1.0)
        if np.count_nonzero(new) < max(s.min_points, s.min_fraction * count):
            return failed
        # Tukey's weights: points near the gate have little influence.
        weight = np.where(new, (1 - (distance / (s.gate_sigmas * max(scale, 1.0))) ** 2) ** 2, 0.0)
        flat = jacobian.reshape(-1, 3)
        weighted = np.repeat(weight, 2)[:, None] * flat
        information = flat.T @ weighted
        try:
            step = np.linalg.solve(information, weighted.T @ residual.ravel())
        except np.linalg.LinAlgError:
            return failed
        motion = motion - step
        # The median of the norm of a two-dimensional normal variable is 1.177 sigma.
        scale = float(np.median(distance[new])) / 1.177
        if np.array_equal(new, inliers) and np.abs(step).max() < 1e-12:
            break
        inliers = new
    covariance = _spread_of_fit(before_m, after_m, whiten, motion, inliers)
    return PlanarFit(motion, covariance * max(scale, 1.0) ** 2, inliers, True)


def _spread_of_fit(
    before: np.ndarray, after: np.ndarray, whiten: np.ndarray, motion: np.ndarray, inliers: np.ndarray
) -> np.ndarray:
    """Covariance of the least-squares fit to the inliers, for residuals of unit variance, or of their own.

    On wood, the error of a point is larger than declared along the grain and smaller across it: the median distance
    does not show this, but the scatter of each point's contribution to the motion does (Huber's sandwich estimator). If it
    is larger, it is used.
    """
    residual, jacobian = _residuals(before[inliers], after[inliers], whiten[inliers], motion)
    # Tukey's weights have 10 % less efficiency at this gate.
    model = 1.1 * np.linalg.inv(np.einsum("nia,nib->ab", jacobian, jacobian))
    pulls = np.einsum("nia,ni->na", jacobian, residual)
    count = len(residual)
    scatter = model @ (pulls.T @ pulls) @ model * count / max(count - 3, 1)
    root = np.linalg.cholesky(model)
    back = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(back @ scatter @ back.T)
    spread = root @ vectors
    return np.asarray((spread * np.maximum(values, 1.0)) @ spread.T)


def _residuals(
    before: np.ndarray, after: np.ndarray, whiten: np.ndarray, motion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residuals (n, 2) and their derivatives (n, 2, 3)."""
    turned = after @ rotation_2d(motion[2]).T
    residual = before - turned - motion[:2]
    jacobian = np.zeros((len(before), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = turned[:, 1], -turned[:, 0]
    return np.einsum("nij,nj->ni", whiten, residual), np.einsum("nij,njk->nik", whiten, jacobian)


def _consensus(
    before: np.ndarray,
    after: np.ndarray,
    whiten: np.ndarray,
    rng: np.random.Generator,
    s: FloorMotionSettings,
) -> np.ndarray:
    """The motion by the pair of points with the best consensus, with the cost of MSAC."""
    count = len(before)
    first = rng.integers(count, size=s.hypotheses)
    second = (first + rng.integers(1, count, size=s.hypotheses)) % count
    d_before, d_after = before[second] - before[first], after[second] - after[first]
    angle = np.arctan2(
        d_after[:, 0] * d_before[:, 1] - d_after[:, 1] * d_before[:, 0], (d_after * d_before).sum(axis=1)
    )
    c, sn = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([c, -sn], -1), np.stack([sn, c], -1)], -2)
    middle_after = 0.5 * (after[first] + after[second])
    shift = 0.5 * (before[first] + before[second]) - np.einsum("hij,hj->hi", rotation, middle_after)
    off = before - after @ np.swapaxes(rotation, 1, 2) - shift[:, None]
    # Lower triangular whitening, written explicitly: this is the largest array of the module.
    distance_2 = (whiten[:, 0, 0] * off[..., 0]) ** 2
    distance_2 += (whiten[:, 1, 0] * off[..., 0] + whiten[:, 1, 1] * off[..., 1]) ** 2
    # Wider than the final gate: a pair's own noise is in its hypothesis.
    gate = (2.0 * s.gate_sigmas) ** 2
    cost = np.minimum(distance_2, gate).sum(axis=1)
    best = int(np.argmin(cost))
    return np.array([*shift[best], angle[best]])


def compose_covariance(
    first: Float[np.ndarray, "3"],
    first_covariance: Float[np.ndarray, "3 3"],
    second: Float[np.ndarray, "3"],
    second_covariance: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3 3"]:
    """Covariance of :func:`.compose_2d` for independent motions.

    Parameters
    ----------
    first, second
        (x, y, theta) of two motions [m, rad].
    first_covariance, second_covariance
        Their covariances.
    """
    c, s = math.cos(first[2]), math.sin(first[2])
    x, y = second[0], second[1]
    by_first = np.array([[1, 0, -s * x - c * y], [0, 1, c * x - s * y], [0, 0, 1.0]])
    by_second = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return by_first @ first_covariance @ by_first.T + by_second @ second_covariance @ by_second.T


class FloorTracker:
    """Frame-by-frame motion of the platform from tracked points.

    Parameters
    ----------
    floor_view
        The floor plane in the camera's view; its x and y are those of the moving frame.
    settings
        Settings of the motion estimation.
    rng
        Source of RANSAC's random samples.

    Attributes
    ----------
    pose
        (x, y, theta) of the moving frame since the start [m, rad].
    pose_covariance
        Covariance of ``pose``; noise only, without the scale error from a wrong camera height.
    """

    def __init__(
        self,
        floor_view: PlaneView,
        settings: FloorMotionSettings | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.settings = settings or FloorMotionSettings()
        self.floor_view = floor_view
        self._rng = rng or np.random.default_rng(0)
        self.pose: Float[np.ndarray, "3"] = np.zeros(3)
        self.pose_covariance: Float[np.ndarray, "3 3"] = np.zeros((3, 3))
        self._key_pose, self._key_covariance = np.zeros(3), np.zeros((3, 3))
        self._key_points: dict[int, np.ndarray] = {}
        self._key_age = 0
        self.inlier_fraction = 0.0  #: of the newest frame

    def update(self, step: FlowStep, t_s: float, *, expected: Float[np.ndarray, "3"] | None = None) -> Motion:
        """Motion since the last frame.

        Parameters
        ----------
        step
            Tracks of the floor only.
        t_s
            Time of the frame [s].
        expected
            Motion by other sensors, used for the pose while the floor is not visible.
        """
        s = self.settings
        points, jacobian = self._on_floor(step.after_px)
        sigma = np.hypot(step.sigma_px, s.min_sigma_px)
        first = not self._key_points and not len(step.ids)
        if not self._key_points:
            self._set_key(step, self.floor_view.cast(step.before_px))
        ids = [int(i) for i in step.ids]
        known = np.array([i in self._key_points for i in ids], dtype=bool) & np.isfinite(points).all(axis=1)
        chosen = np.flatnonzero(known)
        start = np.array([self._key_points[ids[i]] for i in chosen]).reshape(-1, 2)
        spread = 2.0 * sigma[chosen, None, None] ** 2 * (
            jacobian[chosen] @ np.swapaxes(jacobian[chosen], 1, 2)
        )  # fmt: skip
        since_key = relative_2d(self._key_pose, self.pose)
        prior = None if expected is None else np.array(compose_2d(since_key, expected))
        fit = fit_planar_motion(start, points[chosen], spread, self._rng, s, expected=prior)
        self.inlier_fraction = float(np.mean(fit.inliers)) if len(chosen) else 0.0
        before = self.pose
        if fit.valid:
            self.pose = np.array(compose_2d(self._key_pose, fit.motion))
            self.pose_covariance = compose_covariance(
                self._key_pose, self._key_covariance, fit.motion, fit.covariance
            )
            for i in chosen[~fit.inliers]:
                # An outlier is ignored until the next key frame.
                self._key_points.pop(ids[i])
        elif expected is not None:
            self.pose = np.array(compose_2d(self.pose, expected))
        moved = relative_2d(before, self.pose)
        self._key_age += 1
        few = np.count_nonzero(fit.inliers) < s.key_fraction * max(len(points), 1)
        if not fit.valid or few or self._key_age >= s.key_frames:
            self._set_key(step, points)
        if not fit.valid:
            reason = Reason.NOT_ZEROED if first else Reason.LOST
            return Motion(t_s, False, reason, np.array(moved[:2]), moved[2], np.full((3, 3), np.inf))
        # From frame to frame the same points scatter about as much as from the key frame.
        return Motion(t_s, True, Reason.OK, np.array(moved[:2]), moved[2], fit.covariance)

    def _on_floor(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.floor_view.cast(pixels), self.floor_view.jacobian(pixels)

    def _set_key(self, step: FlowStep, points: np.ndarray) -> None:
        self._key_pose, self._key_covariance, self._key_age = self.pose, self.pose_covariance, 0
        self._key_points = {int(i): p for i, p in zip(step.ids, points, strict=True) if np.isfinite(p).all()}
