"""Rates of readings at each place of a surface, from the rays that pass beside a part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32

from ...io.depth.depth_sequence import DepthFrame
from .ray_readings import CONTEXTS, KINDS, RayImage
from .view_geometry import intrinsics


def surface_ratios(
    frames: Sequence[DepthFrame],
    images: Sequence[RayImage],
    through: Bool[np.ndarray, "n h w"],
    used: Bool[np.ndarray, "n h w"],
    tables: Float32[np.ndarray, "kinds n"],
    patch_m: float,
) -> list[Float32[np.ndarray, "h w"]]:
    """Correction of the log-likelihood ratios of the rays through a part for the readings at the surface behind it [nat].

    A specular surface mirrors a lamp into every view from another place, and rays to it drop out as through glass: in a polished
    bowl all of them pass its centre of curvature. Rays that end at the same place of the surface, but pass beside the part, drop
    out there too, whereas behind glass they read the surface. The rates without glass at a place are the mean rates of these
    rays over the views, with those of the context as a prior of one view (unit information, Kass and Wasserman 1995).

    Parameters
    ----------
    frames, images
        Views and their readings.
    through, used
        Rays through the part, and rays that no other part explains (n, h, w).
    tables
        See :func:`reading_tables` [nat].
    patch_m
        Size of a place of the surface, that of the smallest object of interest [m].
    """
    rates = np.exp(np.log(KINDS[0]) - tables[0].reshape(CONTEXTS, 5)[:, 1:])

    def patches(k: int, rays: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        chosen = rays & (images[k].reading > 0)
        (v, u), z = np.nonzero(chosen), images[k].predicted_m[chosen]
        fx, fy, cx, cy = intrinsics(frames[k].camera)
        points_m = frames[k].T_world_camera.apply(np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z]))
        cells = np.floor(points_m / patch_m).astype(np.int64) & 0xFFFFF
        return chosen, (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2], images[k].code[chosen]

    hit = [patches(k, rays) for k, rays in enumerate(through)]
    keys = np.unique(np.concatenate([key for _, key, _ in hit]))
    sums, views = np.zeros((len(keys), 4)), np.zeros(len(keys))
    for k, rays in enumerate(used & ~through):
        _, key, code = patches(k, rays)
        at = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
        same = keys[at] == key
        counts = np.bincount(4 * at[same] + code[same] % 5 - 1, minlength=4 * len(keys)).reshape(-1, 4)
        number = counts.sum(axis=1)
        sums += counts / np.maximum(number, 1)[:, None]
        views += number > 0
    found = []
    for chosen, key, code in hit:
        at, context, reading = np.searchsorted(keys, key), code // 5, code % 5 - 1
        image = np.zeros(chosen.shape, np.float32)
        prior = rates[context, reading]
        image[chosen] = np.log(prior * (1 + views[at]) / (prior + sums[at, reading]))
        found.append(image)
    return found
