"""Which views of a sequence are compared with one of them, by where the cameras stood and not by the order of views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose

__all__ = ["nearest_on_both_sides", "signed_baselines", "views_at_baselines"]

#: Cameras nearer than this stand at one place: ten deviations of a tracker's 5 mm.
_SAME_PLACE_M = 0.05


def signed_baselines(poses: Sequence[Pose], index: int) -> Float[np.ndarray, "n"]:
    """Distance of every camera from one of them, negative on one of its two sides [m].

    The sides are those of the direction in its image plane in which the other cameras lie most: on a ring, to the left
    and to the right. No order of the views is assumed.

    Parameters
    ----------
    poses
        ``T_world_camera`` of each view.
    index
        The view that the others are measured from; its own baseline is 0.
    """
    here = poses[index]
    eyes = np.array([pose.translation_m for pose in poses])
    offset = here.inverse().apply(eyes)
    distance = np.linalg.norm(offset, axis=1)
    flat = offset[:, :2] / np.maximum(distance, 1e-9)[:, None] ** 2  # near views decide
    _, vectors = np.linalg.eigh(flat.T @ flat)
    return np.where(flat @ vectors[:, -1] < 0, -distance, distance)


def views_at_baselines(
    baselines_m: Float[np.ndarray, "n"], wanted_m: Sequence[float], *, index: int
) -> list[int]:
    """Views for a model of one view: at the wanted baselines on both sides, then whatever is nearest.

    Parameters
    ----------
    baselines_m
        Of every view, signed [m].
    wanted_m
        Ascending [m]; a view nearer than half of the first is left out: its rays pass the same glass.
    index
        The view itself.
    """
    wanted = np.asarray(wanted_m, dtype=np.float64)
    usable = [k for k in range(len(baselines_m)) if k != index and abs(baselines_m[k]) >= 0.5 * wanted[0]]
    if not usable:
        return []
    ways = baselines_m[usable]
    chosen: dict[int, None] = {}
    for target in (*wanted, *-wanted):
        chosen[usable[int(np.argmin(np.abs(ways - target)))]] = None
    for k in np.argsort(np.abs(ways), kind="stable"):
        if len(chosen) >= 2 * len(wanted):
            break
        chosen[usable[int(k)]] = None
    return sorted(chosen)


def nearest_on_both_sides(
    baselines_m: Float[np.ndarray, "n"], ranks: Sequence[int], *, index: int
) -> list[int]:
    """Views of the given ranks (1: the next one) on each side of one view.

    Between views that stand at one place, within ``_SAME_PLACE_M``, their order decides.

    Parameters
    ----------
    baselines_m
        Signed baselines (n) of all views to this one [m].
    ranks
        Ranks of the wanted views on each side.
    index
        Number of this view.
    """
    step = np.arange(len(baselines_m)) - index
    place = np.trunc(baselines_m / _SAME_PLACE_M)
    side = np.where(place == 0, np.sign(step), np.sign(place))
    ordered = np.lexsort((np.abs(step), np.abs(place)))
    found = []
    for sign in (1, -1):
        there = [int(k) for k in ordered if side[k] == sign]
        found += [there[rank - 1] for rank in ranks if rank <= len(there)]
    return found
