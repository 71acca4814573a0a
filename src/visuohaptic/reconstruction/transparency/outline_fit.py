"""Where a transparent part stands: an upright body by the likelihood of its outlines.

Voxels that only rays through glass pass reach away from the cameras and into what else the glass shades, so that their
middle is a centimetre off. The outline in every view is sharper: windows of readings inside it are those of glass, or show
nothing of it, as walls bend little in the middle and near to what is behind them; beside it they are those of the sequence.
A truncated cone with its axis along z is laid through the outlines of all views by maximum likelihood. The second eye of
the camera looks past the body, too: where its line of sight crosses it nothing is matched beside the outline, as far as the
disparities of the body and of what is behind it differ.

The deviation of the axis is that of a likelihood which is wrong in detail (Huber 1967; White 1982): H^-1 (sum of g g^T) H^-1
with H the curvature of the whole, g the slope of each view, over half of the camera's matching window: over less it is the
roughness of single readings. Seen from one side a body farther away is nearly one that stands higher, so that the height is
unknown with the axis, where the likelihood has a maximum in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Float32

from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import DepthNoise
from .background import intrinsics

__all__ = ["OutlineView", "UprightBody", "fit_body"]

#: Points of each of the two circles that bound a body.
_CORNERS = 16
#: Probability that a window inside the outline shows nothing of the glass.
_HIDDEN = 0.5
#: First steps of the search of places, radii and heights [m]; evaluations of a search.
_STEP_M, _MAX_STEPS = 0.012, 400
#: Smallest radius and height of a body [m].
_MIN_RADIUS_M, _MIN_HEIGHT_M = 0.01, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class OutlineView:
    """What each pixel of a view says for kinds of glass, thinned to independent readings."""

    evidence: Float32[np.ndarray, "h w"]  #: log-likelihood ratios of glass, per pixel [nat]
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which each ray is evidence [m]
    T_camera_world: Float[np.ndarray, "3 4"]
    matrix: tuple[float, float, float, float]  #: fx, fy, cx, cy of the thinned image [px]
    baseline_m: float  #: of the second eye along the rows
    window_px: float  #: matching window in the thinned image
    weight: float  #: part of an independent view

    @classmethod
    def of_view(
        cls,
        frame: DepthFrame,
        log_ratios: Sequence[Float32[np.ndarray, "h w"]],
        limit_m: Float32[np.ndarray, "h w"],
        noise: DepthNoise,
        weight: float,
    ) -> OutlineView:
        """Thin a view to a quarter of a window.

        Parameters
        ----------
        frame
            View.
        log_ratios
            Log-likelihood ratio of every reading (h, w), for each kind of glass [nat].
        limit_m
            Depth up to which each ray is evidence (h, w) [m]; not copied, so that what is explained later counts no more.
        noise
            Of the camera: where its second eye is, and the window whose readings count as one.
        weight
            Part of an independent view.
        """
        import cv2

        window_px = noise.window_px(frame.camera.focal_px)
        step = max(1, window_px // 4)
        ratio = np.mean(
            [cv2.exp(cv2.blur(part, (window_px, window_px))[::step, ::step]) for part in log_ratios], axis=0
        )
        evidence = np.log((1 - _HIDDEN) * ratio + _HIDDEN) * (step / window_px) ** 2
        fx, fy, cx, cy = (float(value) / step for value in intrinsics(frame.camera))
        motion = frame.T_world_camera.inverse().matrix[:3]
        thinned = evidence.astype(np.float32)
        matrix = (fx, fy, cx, cy)
        return cls(
            thinned, limit_m[::step, ::step], motion, matrix, noise.baseline_m, window_px / step, weight
        )

    def log_likelihood(self, body: Float[np.ndarray, "6"]) -> float:
        """Of a body against nothing [nat].

        Parameters
        ----------
        body
            x, y of the axis, lower and upper radius, lower and upper height [m].
        """
        import cv2

        ring = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
        x, y, low_r, high_r, low_z, high_z = body
        circle = np.column_stack([np.cos(ring), np.sin(ring), np.zeros(_CORNERS)])
        low, high = np.array([x, y, low_z]), np.array([x, y, high_z])
        points = np.concatenate([low + low_r * circle, high + high_r * circle])
        local = points @ self.T_camera_world[:, :3].T + self.T_camera_world[:, 3]
        if local[:, 2].min() < 0.05:
            return 0.0
        fx, fy, cx, cy = self.matrix
        u, v = fx * local[:, 0] / local[:, 2] + cx, fy * local[:, 1] / local[:, 2] + cy
        rows, columns = self.limit_m.shape
        middle_m = float(local[:, 2].mean())
        # The second eye sees the body before another part of what is behind it.
        a, b = int(np.clip(v.mean(), 0, rows - 1)), int(np.clip(u.mean(), 0, columns - 1))
        behind_m = max(float(self.limit_m[a, b]), middle_m)
        moved = u - fx * self.baseline_m * (1 / local[:, 2] - 1 / behind_m)
        left, right = math.floor(min(u.min(), moved.min())) - 1, math.ceil(max(u.max(), moved.max())) + 2
        top, bottom = math.floor(v.min()) - 1, math.ceil(v.max()) + 2
        left, right, top, bottom = max(left, 0), min(right, columns), max(top, 0), min(bottom, rows)
        if right - left < 2 or bottom - top < 2:
            return 0.0
        part = slice(top, bottom), slice(left, right)
        mask = np.zeros((bottom - top, right - left), np.uint8)
        for place in (u, moved):
            hull = cv2.convexHull(np.column_stack([place - left, v - top]).astype(np.float32))
            cv2.fillConvexPoly(mask, np.rint(16 * hull).astype(np.int32), 1, cv2.LINE_8, 4)
        mask[self.limit_m[part] <= middle_m] = 0
        return self.weight * float(self.evidence[part][mask > 0].sum())


@dataclass(frozen=True, slots=True, eq=False)
class UprightBody:
    """An upright truncated cone, and how well the place of its axis is known."""

    axis_m: Float[np.ndarray, "2"]  #: x, y of its axis [m]
    axis_sigma_m: Float[np.ndarray, "2"]  #: their standard deviations [m]
    radius_m: tuple[float, float]  #: lower and upper [m]
    radius_sigma_m: float  #: standard deviation of both together [m]
    height_m: tuple[float, float]  #: z of its lower and upper end [m]
    evidence: float  #: log-likelihood ratio against nothing [nat]


def fit_body(
    views: Sequence[OutlineView], low_m: Float[np.ndarray, "3"], high_m: Float[np.ndarray, "3"]
) -> UprightBody | None:
    """The likeliest upright body where a part was found; ``None`` where no outline holds it.

    Parameters
    ----------
    views
        All views.
    low_m, high_m
        Corners of the box (3) of the part [m].
    """
    from scipy.optimize import minimize

    def cost(body: np.ndarray) -> float:
        if min(body[2], body[3]) < _MIN_RADIUS_M or body[5] - body[4] < _MIN_HEIGHT_M:
            return 1e3
        return -sum(view.log_likelihood(body) for view in views)

    middle = 0.5 * (low_m + high_m)
    radius = max(0.4 * float((high_m - low_m)[:2].min()), 2 * _MIN_RADIUS_M)
    found = []
    for lowest in (low_m[2], low_m[2] - 0.25 * (high_m[2] - low_m[2])):
        start = np.array([middle[0], middle[1], radius, radius, lowest, high_m[2]])
        simplex = np.vstack([start, start + _STEP_M * np.diag([1, 1, 0.5, 0.5, -1, -1])])
        options = {"initial_simplex": simplex, "maxfev": _MAX_STEPS, "xatol": 3e-4, "fatol": 1e-2}
        found.append(minimize(cost, start, method="Nelder-Mead", options=options))
    best = min(found, key=lambda one: float(one.fun))
    covariance = _covariance(views, best.x)
    if best.fun >= 0 or covariance is None:
        return None
    sigma = np.sqrt(np.diag(covariance))
    x, y, low_r, high_r, low_z, high_z = (float(value) for value in best.x)
    return UprightBody(
        np.array([x, y]), sigma[:2], (low_r, high_r), float(sigma[2]), (low_z, high_z), -float(best.fun)
    )


def _covariance(
    views: Sequence[OutlineView], body: Float[np.ndarray, "6"]
) -> Float[np.ndarray, "3 3"] | None:
    """Of x, y and both radii together [m2]; ``None`` where the likelihood has no maximum in one of them."""
    middle = np.array([body[0], body[1], 0.5 * (body[4] + body[5]), 1.0])
    step_m = float(
        np.median(
            [0.5 * view.window_px * (view.T_camera_world[2] @ middle) / view.matrix[0] for view in views]
        )
    )
    ways = step_m * np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1]])

    def each(step: np.ndarray) -> np.ndarray:
        return np.array([view.log_likelihood(body + step) for view in views])

    ahead, back = ([each(sign * way) for way in ways] for sign in (1, -1))
    here = each(np.zeros(6))
    slopes = np.array([(a - b) / (2 * step_m) for a, b in zip(ahead, back, strict=True)])
    curvature = np.diag([float((2 * here - a - b).sum()) for a, b in zip(ahead, back, strict=True)])
    for i, j in combinations(range(len(ways)), 2):
        both = (
            each(ways[i] + ways[j])
            + each(-ways[i] - ways[j])
            - ahead[i]
            - back[i]
            - ahead[j]
            - back[j]
            + 2 * here
        ).sum()
        curvature[i, j] = curvature[j, i] = -0.5 * float(both)
    curvature /= step_m**2
    for count in (4, 3):
        if np.linalg.eigvalsh(curvature[:count, :count])[0] > 0:
            inverse = np.linalg.inv(curvature[:count, :count])
            # No better than the likelihood itself says: a few views may agree by chance.
            found: np.ndarray = inverse @ (slopes[:count] @ slopes[:count].T) @ inverse + inverse
            return found[:3, :3]
    return None
