"""Two vessels in one transparent part: where one stands in front of the other, the voxels between them pass both.

One wide body around both is often likelier than each of them, because many rays of both pass it. Two bodies are fitted to the rays
that miss the other, in turns, and compared with one by their evidence together: of the first, and of the second by the rays
that miss the first. No reading is explained twice.

A handle or a spout pulls an upright body aside, and a lean may explain it better than no lean: a leaning body competes with an upright one beside
which a second body stands, by the same comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..vessel_shapes import UprightBody, end_circles
from .outline_fit import (
    MIN_HEIGHT_M,
    MIN_RADIUS_M,
    STEP_M,
    OutlineView,
    body_bounds_m,
    body_evidence,
    fit_beside,
    fit_bodies,
)

#: Number of points on each bounding circle of a hidden body; how often each body of a pair is fitted.
_CORNERS, _TURNS = 24, 2


def fit_part(
    views: Sequence[OutlineView],
    points_m: Float[np.ndarray, "n 3"],
    evidence: Float[np.ndarray, "n"],
    radius_m: float,
    threshold: float,
) -> list[UprightBody]:
    """The likeliest one or two bodies of a part, strongest first; none if nothing has an outline.

    Parameters
    ----------
    views, points_m, evidence
        See :func:`fit_pair`.
    radius_m
        Minimum mean radius: a thinner body is a fragment of a rim, whose centre is elsewhere [m].
    threshold
        See :func:`disjoint_bodies`.
    """
    bodies = [*fit_bodies(views, points_m, evidence), *fit_pair(views, points_m, evidence)]
    thick = [body for body in bodies if sum(body.radius_m) >= 2 * radius_m]
    return disjoint_bodies(views, thick, threshold)


def fit_pair(
    views: Sequence[OutlineView], points_m: Float[np.ndarray, "n 3"], evidence: Float[np.ndarray, "n"]
) -> list[UprightBody]:
    """Two closed bodies that share a part, each fitted to the rays that miss the other; none if only one has a maximum.

    Parameters
    ----------
    views
        All views.
    points_m
        Centres (n, 3) of the voxels of the part [m].
    evidence
        Evidence of each voxel (n) [nat].
    """
    from scipy.cluster.vq import kmeans2

    strong_m = points_m[evidence > 0.5 * evidence.max()]
    place_m = strong_m[:, :2]
    ends = np.argsort(place_m @ np.linalg.svd(place_m - place_m.mean(axis=0), full_matrices=False)[2][0])
    means_m, own = kmeans2(place_m, place_m[ends[[0, -1]]], minit="matrix")
    bounds_m = body_bounds_m(points_m)
    # Half of the distance between them is for the one, half for the other.
    radius_m = max(0.5 * float(np.hypot(*(means_m[1] - means_m[0]))), bounds_m[0])
    shapes: list[np.ndarray] = []
    for k, mean_m in enumerate(means_m):
        z_m = strong_m[own == k, 2]
        low_m, high_m = (z_m.min(), z_m.max()) if len(z_m) else (strong_m[:, 2].min(), strong_m[:, 2].max())
        shapes.append(np.array([*mean_m, radius_m, radius_m, low_m, max(high_m, low_m + 2 * bounds_m[1])]))
    found = _in_turns(views, shapes, bounds_m)
    return [replace(body, evidence=float(body_evidence(views, body).sum())) for body in found]


def attached_part(
    views: Sequence[OutlineView], upright: UprightBody, leaning: UprightBody, threshold: float
) -> UprightBody | None:
    """The second body with which an upright one is likelier than a leaning one; none if the leaning one is.

    Parameters
    ----------
    views
        Views, without the rays through other bodies.
    upright, leaning
        The bodies of maximum likelihood.
    threshold
        See :func:`disjoint_bodies`.
    """
    low_m, high_m = upright.height_m
    bounds_m = np.array([MIN_RADIUS_M, MIN_HEIGHT_M, 2 * max(upright.radius_m)])
    toward = np.array(leaning.lean_m) / np.hypot(*leaning.lean_m)
    for way in (toward, -toward):
        place_m = upright.axis_m + (np.mean(upright.radius_m) + STEP_M) * way
        # Beside the middle half of its height.
        ends_m = np.mean([low_m, high_m]) + 0.25 * (high_m - low_m) * np.array([-1, 1])
        start = np.array([*place_m, STEP_M, STEP_M, *ends_m])
        if found := _in_turns(views, [start, upright.shape_m[:6]], bounds_m):
            part, first = found
            own = body_evidence(without_body(views, first.shape_m), part).sum()
            if body_evidence(views, first).sum() + own - threshold > leaning.evidence:
                return part
    return None


def _in_turns(
    views: Sequence[OutlineView], shapes: Sequence[np.ndarray], bounds_m: Float[np.ndarray, "3"]
) -> list[UprightBody]:
    """Two closed bodies, each fitted to the rays that miss the other, from their starts; none if only one has a maximum."""
    ends, found = list(shapes), []
    for k in (0, 1) * _TURNS:
        body = fit_beside(without_body(views, ends[1 - k]), ends[k], bounds_m)
        if not body:
            return []
        ends[k] = body[0].shape_m
        found += body
    return found[-2:]


def disjoint_bodies(
    views: Sequence[OutlineView], bodies: Sequence[UprightBody], threshold: float
) -> list[UprightBody]:
    """One body, or two that do not meet, with the most evidence together, strongest first.

    Parameters
    ----------
    views
        All views.
    bodies
        Bodies to choose from.
    threshold
        Minimum evidence of a body, and of a second one by its own rays [nat].
    """
    bodies = sorted((b for b in bodies if b.evidence >= threshold), key=lambda body: -body.evidence)
    best, most = bodies[:1], bodies[0].evidence if bodies else 0.0
    for first in bodies:
        # Two have at most the sum of their evidence, so that one of them has more than half of what they are to exceed.
        beside = [body for body in bodies if not body.meets(first)] if 2 * first.evidence > most else []
        rest = without_body(views, first.shape_m) if beside else views
        for second in beside:
            both = first.evidence + float(body_evidence(rest, second).sum()) - threshold
            if both > most:
                best, most = [first, second], both
    return sorted(best, key=lambda body: -body.evidence)


def without_body(views: Sequence[OutlineView], shape_m: Float[np.ndarray, "n"]) -> list[OutlineView]:
    """The views without the rays of both eyes through a body.

    Parameters
    ----------
    views
        Views.
    shape_m
        x, y of the axis, lower and upper radius, lower and upper height of the body, and its lean [m].
    """
    import cv2

    points_m, found = end_circles(shape_m, _CORNERS).T, []
    for view in views:
        x, y, z = view.T_camera_world[:, :3] @ points_m + view.T_camera_world[:, 3:]
        through = np.zeros(view.limit_m.shape, np.uint8)
        if z.min() > 0.05:
            fx, fy, cx, cy = view.matrix
            u, behind_m = fx * x / z + cx, view.limit_m[view.limit_m > z.max()]
            shift = fx * view.baseline_m * (1 / z - 1 / np.median(behind_m)) if len(behind_m) else 0.0
            for column in (u, u - shift):
                hull = cv2.convexHull(np.column_stack([column, fy * y / z + cy]).astype(np.float32))
                cv2.fillConvexPoly(through, np.rint(hull).astype(np.int32), 1)
        found.append(replace(view, limit_m=np.where(through > 0, np.float32(0), view.limit_m)))
    return found
