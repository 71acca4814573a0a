"""Lines for the probe: level, from a safe start through a target to the height axis (Alt 2016, Sec. 5.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..mesh import SurfaceMesh
from .touch import Touch

__all__ = ["best_vertex", "reachable", "starts"]


def reachable(
    mesh: SurfaceMesh,
    axis_m: Float[np.ndarray, "2"],
    touches: Sequence[Touch],
    *,
    size_m: float,
    clear_m: float,
) -> Bool[np.ndarray, "v"]:
    """Where a horizontal line meets the surface from outside, and none missed before.

    Parameters
    ----------
    mesh
        Estimated surface.
    axis_m
        x and y of the height axis [m].
    touches
        Touches so far.
    size_m
        Of the region [m].
    clear_m
        Distance from lines that met nothing [m].
    """
    outward = mesh.vertices_m[:, :2] - axis_m
    radius = np.linalg.norm(outward, axis=1)
    normals = mesh.vertex_normals
    facing = (normals[:, :2] * outward).sum(axis=1) / np.maximum(radius, 1e-9)
    ok = (facing > 0.2) & (radius > 0.02 * size_m)
    for touch in touches:
        if touch.contact_m is None and touch.start_m is not None and touch.end_m is not None:
            way = touch.end_m - touch.start_m
            fraction = np.clip((mesh.vertices_m - touch.start_m) @ way / max(way @ way, 1e-12), 0, 1)
            gap = np.linalg.norm(mesh.vertices_m - touch.start_m - fraction[:, None] * way, axis=1)
            ok &= gap > clear_m
    return ok


def starts(
    targets_m: Float[np.ndarray, "n 3"],
    axis_m: Float[np.ndarray, "2"],
    supports_m: Float[np.ndarray, "s 3"],
    clear_m: float,
) -> Float[np.ndarray, "n 3"]:
    """Starts of lines to targets: outside by the estimated radius, and at least outside of all supports.

    Parameters
    ----------
    targets_m
        Targets (n, 3) [m].
    axis_m
        x and y of the height axis [m].
    supports_m
        Known points (s, 3) of the surface [m].
    clear_m
        Clearance of the starts from the surface [m].
    """
    outward = targets_m[:, :2] - axis_m
    radius = np.linalg.norm(outward, axis=1, keepdims=True)
    reach = float(np.linalg.norm(supports_m[:, :2] - axis_m, axis=1).max())
    safe = np.maximum(2 * radius, reach + 2 * clear_m)
    found = targets_m.copy()
    found[:, :2] = axis_m + outward / np.maximum(radius, 1e-9) * safe
    return found


def best_vertex(score: Float[np.ndarray, "v"], ok: Bool[np.ndarray, "v"]) -> int:
    """The allowed vertex with the largest score; -1 where none is allowed.

    Parameters
    ----------
    score
        Scores (v).
    ok
        Which vertices (v) are allowed.
    """
    return int(np.argmax(np.where(ok, score, -1.0))) if ok.any() else -1
