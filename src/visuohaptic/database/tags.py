"""Merging of several haptic tags of one object.

Explorations sample a property at different contact points, where it varies by more than its noise: all
explorations have equal weight, and the scatter is kept as the spread. This differs from
:mod:`.merge`, where estimates of one value are weighted by their certainty, and the same evidence counts once. Use this
for pushes on one trip, whose counters add up; use :func:`.merge.merge_objects` for versions of an object, whose
tags arrive as evidence and may arrive twice.
"""

from __future__ import annotations

import numpy as np

from ..core.objects import Estimate, HapticTag

_ESTIMATES = (
    "static_friction_N", "dynamic_friction_N", "deceleration_s", "drift", "deformability", "stiffness_N_per_m",
    "rotation_rad_per_m", "contact_offset_m",
)  # fmt: skip


def merge_tags(first: HapticTag, second: HapticTag) -> HapticTag:
    """Merge the tags of two sets of explorations of the same object.

    Means are weighted by the number of samples, the spread is the scatter
    over all samples, counters are added; primitive and shape are those of the tag whose
    primitive has the higher score, of the tags that have them. An object that moved once is not fixed; one that
    fell once may fall.

    Parameters
    ----------
    first, second
        Tags of the two sets.
    """

    def either(a: bool | None, b: bool | None, *, any_true: bool) -> bool | None:
        known = [value for value in (a, b) if value is not None]
        return None if not known else (any(known) if any_true else all(known))

    bounds = [b for b in (first.min_static_friction_N, second.min_static_friction_N) if b is not None]
    fixed = either(first.fixed, second.fixed, any_true=False)
    best = sorted((first, second), key=lambda tag: -tag.primitive.score if tag.primitive else 1.0)
    shapes = (tag.deformation_shape_m for tag in best if tag.deformation_shape_m is not None)
    estimates = {name: _merge(getattr(first, name), getattr(second, name)) for name in _ESTIMATES}
    return HapticTag(
        **estimates,
        # An object that has moved invalidates the bound.
        min_static_friction_N=max(bounds) if bounds and fixed is not False else None,
        primitive=best[0].primitive,
        deformation_shape_m=next(shapes, None),
        fixed=fixed,
        falls=either(first.falls, second.falls, any_true=True),
        explored=first.explored + second.explored,
        failed=first.failed + second.failed,
    )


def _merge(a: Estimate | None, b: Estimate | None) -> Estimate | None:
    if a is None or b is None:
        return a if b is None else b
    n = a.samples + b.samples
    value = (a.samples * a.value + b.samples * b.value) / n
    sigma = np.hypot(a.samples * a.sigma, b.samples * b.sigma) / n
    squares = (
        (a.samples - 1) * a.spread**2
        + (b.samples - 1) * b.spread**2
        + a.samples * b.samples / n * (a.value - b.value) ** 2
    )
    return Estimate(float(value), float(sigma), float(np.sqrt(squares / (n - 1))), n)
