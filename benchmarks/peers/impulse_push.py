"""Algorithm 2 of Alt 2016 as published: pseudo impulses at a frictionless contact. The baseline.

For any polygon footprint. Details that the text leaves open are interpreted as follows: the lever of
the moment is the contact point from the centroid (ERRATA), the moment of
inertia is that of a uniform mass on the footprint, and the impulse is scaled such
that the contact point leaves the contact range along its normal. Prefer
:func:`~visuohaptic.navigation.pushing.quasi_static.simulate_push`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from visuohaptic.core import InputError
from visuohaptic.core.geometry import polygon_centroid, polygon_second_moments
from visuohaptic.core.ranges import finite_array
from visuohaptic.navigation.pushing import PushModel, PushTrace
from visuohaptic.navigation.pushing.quasi_static import RELEASE_M, remaining_m

__all__ = ["CONTACT_RANGE_M", "simulate_impulses"]

#: d_c of Algorithm 2: the robot acts on objects nearer than this (m).
CONTACT_RANGE_M = 0.005


def simulate_impulses(
    model: PushModel,
    object_m: tuple[float, float, float] | Float[np.ndarray, "3"],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
    *,
    contact_range_m: float = CONTACT_RANGE_M,
) -> PushTrace:
    """Drive a disc along a path; contact friction and supports of the model are not used.

    Parameters are those of :func:`~visuohaptic.navigation.pushing.quasi_static.simulate_push`.
    """
    from benchmarks.peers._impulse_kernels import impulse_push

    start = np.asarray(object_m, dtype=np.float64)
    path = finite_array("simulate_impulses", path_m, None, 3, field="path_m", least=2)
    if start.shape != (3,) or not np.isfinite(start).all() or not min(radius_m, contact_range_m) > 0:
        raise InputError("simulate_impulses", f"found object {start}, radius {radius_m} m; expected > 0")
    trace, contact = np.zeros((len(path), 3)), np.full((len(path), 2), np.nan)
    centroid, ratio = _even_mass(model)
    last = impulse_push(
        model.outline_m,
        model.round_m,
        centroid,
        ratio,
        radius_m,
        contact_range_m,
        path,
        start,
        trace,
        contact,
    )
    dropped = last >= 0 and remaining_m(path, last) > RELEASE_M
    return PushTrace(path, trace, np.zeros((len(path), 2)), contact, last, dropped)


def _even_mass(model: PushModel) -> tuple[Float[np.ndarray, "2"], float]:
    """Centroid of even mass on the footprint, and its moment of inertia by mass [m^2]."""
    p, r = model.outline_m, model.round_m
    if len(p) < 3:
        return p.mean(axis=0), 0.5 * max(r, 1e-3) ** 2
    return polygon_centroid(p), float(np.trace(polygon_second_moments(p)))
