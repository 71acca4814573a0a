"""What objects may be that nobody has trained: any smooth profile of stiffness and width.

Symbols: v training objects, u kinds of unknown objects, p features as in :mod:`.haptic_model`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..data.places import HEIGHTS

__all__ = ["FEATURES", "FIRST_WIDTH", "unknown_covariances"]

FIRST_WIDTH = HEIGHTS * 4  #: among the features
FEATURES = HEIGHTS * 6


def unknown_covariances(
    features: Float[np.ndarray, "v p"], component: Int[np.ndarray, "v"]
) -> Float[np.ndarray, "u p p"]:
    """Covariances of containers that nobody has seen, of three kinds.

    Two are of the size and stiffness of what is known, and of another profile, with grooves and smooth: what is
    mistaken most easily. The third is anything, as glass and paper are.

    Parameters
    ----------
    features
        Of the training objects.
    component
        Trained class of each.
    """
    middle = np.stack([features[component == k].mean(axis=0) for k in np.unique(component)]).mean(axis=0)
    away = features - middle
    inner = slice(4, FIRST_WIDTH - 4)  # what holds the ends says nothing of the wall
    level = away[:, inner].mean(axis=1)
    wide = away[:, FIRST_WIDTH:].mean(axis=1)
    own = (
        max(1.2 * level.std(), 0.5),
        max(1.2 * (away[:, inner] - level[:, None]).std(), 0.4),
        max(1.2 * wide.std(), 0.15),
        max(1.2 * (away[:, FIRST_WIDTH:] - wide[:, None]).std(), 0.1),
    )
    return np.stack(
        [
            _any_profile(*own),
            _any_profile(*own, grooves=0.0, reach=5.0),
            _any_profile(1.5, 0.8, 0.29, 0.2),
        ]
    )


def _any_profile(
    level: float, bend: float, size: float, shape: float, *, grooves: float = 0.2, reach: float = 3.0
) -> Float[np.ndarray, "p p"]:
    """Smooth over ``reach`` places; standard deviations of logarithms, in common and by place."""
    height, side = (part.ravel() for part in np.mgrid[:HEIGHTS, :4])
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    axis = np.where(side[:, None] // 2 == side // 2, 1.0, 0.7)
    out = np.zeros((FEATURES, FEATURES))
    # Grooves and shoulders run all around.
    ring = grooves**2 * (height[:, None] == height)
    out[:FIRST_WIDTH, :FIRST_WIDTH] = level**2 + (bend**2 * near + ring) * axis
    height, side = (part.ravel() for part in np.mgrid[:HEIGHTS, :2])
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    same = side[:, None] == side
    out[FIRST_WIDTH:, FIRST_WIDTH:] = size**2 * np.where(same, 1.4, 1.0) + shape**2 * near * np.where(
        same, 1.0, 0.5
    )
    return out
