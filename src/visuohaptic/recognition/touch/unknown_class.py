"""What objects may be that nobody has trained: like one that is known, and yet of another profile.

Symbols: k trained classes, p features as in :mod:`.haptic_model`.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..data.places import HEIGHTS

__all__ = ["FEATURES", "FIRST_WIDTH", "HEIGHT", "USUAL_HEIGHT_m", "smooth_profile", "unknown_kinds"]

FIRST_WIDTH = HEIGHTS * 4  #: among the features
HEIGHT = HEIGHTS * 6  #: of the object, the last one
FEATURES = HEIGHT + 1
#: Unit of heights: where none is known, that of a usual container is taken, as uncertain as that of anything.
USUAL_HEIGHT_m = 0.12
#: Standard deviations of the logarithm of what any container may be: stiffness in common and by place, width in common and
#: by place, and height. Glass is 60 times as stiff as a thin cup, exp(2 * 2.05); a jar three times as wide as a tube, and a
#: bottle five times as tall as a bowl.
ANYTHING = (1.5, 0.25, 0.3, 0.2, 0.4)


def unknown_kinds(means: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "2 p p"]:
    """Covariances by which an unknown object differs from a known class: as classes differ, and as anything may.

    The first is learned from what the known classes differ by, as if :data:`ANYTHING` were one more class.

    Parameters
    ----------
    means
        Features of the trained classes, (k, :data:`FEATURES`).

    Raises
    ------
    InputError
        There are not so many features.
    """
    if means.shape[1] != FEATURES:
        raise InputError(
            "unknown_kinds", f"found {means.shape[1]} features, expected {FEATURES}", field="means"
        )
    inner = means[:, 4 : FIRST_WIDTH - 4]  # what holds the ends says nothing of the wall
    learned = []
    for part, generic in ((inner, ANYTHING[:2]), (means[:, FIRST_WIDTH:HEIGHT], ANYTHING[2:4])):
        level = part.mean(axis=1, keepdims=True)
        shape = part - level - (part - level).mean(axis=0)
        for squares, usual in ((level - level.mean(), generic[0]), (shape, generic[1])):
            learned.append(np.sqrt(((squares**2).mean(axis=1).sum() + usual**2) / len(means)))
    tall = means[:, HEIGHT] - means[:, HEIGHT].mean()
    learned.append(np.sqrt(((tall**2).sum() + ANYTHING[4] ** 2) / len(means)))
    return np.stack([smooth_profile(*learned, reach=4.0), smooth_profile(*ANYTHING, reach=5.0)])


def smooth_profile(
    level: float, bend: float, size: float, shape: float, tall: float, *, reach: float, grooves: float = 0.05
) -> Float[np.ndarray, "p p"]:
    """Covariance of profiles that are smooth over some places.

    Parameters
    ----------
    level, bend
        Standard deviations of the logarithm of stiffness, in common and by place.
    size, shape
        The same of the width.
    tall
        Standard deviation of the logarithm of the height.
    reach
        Places over which a profile is smooth.
    grooves
        Standard deviation of the logarithm of stiffness all around one height.
    """
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
    out[FIRST_WIDTH:HEIGHT, FIRST_WIDTH:HEIGHT] = size**2 * np.where(
        same, 1.4, 1.0
    ) + shape**2 * near * np.where(same, 1.0, 0.5)
    out[HEIGHT, HEIGHT] = tall**2
    return out
