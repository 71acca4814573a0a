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
UNKNOWN_CLASS_SIGMAS = (1.5, 0.25, 0.3, 0.2, 0.4)
#: Standard deviation of the logarithm of stiffness by grooves and shoulders, which run all around one height.
GROOVE_SIGMA = 0.05


def unknown_kinds(
    means: Float[np.ndarray, "k p"],
) -> tuple[Float[np.ndarray, "4 p p"], Float[np.ndarray, "4"]]:
    """Covariances by which an unknown object differs from a known class, and the probability of each.

    As classes differ, and as anything may; each for objects whose axes differ, and for round ones. The first is learned from
    what the known classes differ by, as if :data:`UNKNOWN_CLASS_SIGMAS` were one more class. An object is round or is not, once for all
    of its touches: were each height to differ around by chance, every second touch of a height would be evidence against an
    unknown object. How many are round is learned from the known classes, too (Laplace's rule of succession).

    Parameters
    ----------
    means
        Features of the trained classes, (k, :data:`FEATURES`).

    Returns
    -------
    tuple
        Covariances (4, p, p), those of round objects last, and probabilities (4,).

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
    for part, generic in (
        (inner, UNKNOWN_CLASS_SIGMAS[:2]),
        (means[:, FIRST_WIDTH:HEIGHT], UNKNOWN_CLASS_SIGMAS[2:4]),
    ):
        level = part.mean(axis=1, keepdims=True)
        shape = part - level - (part - level).mean(axis=0)
        for squares, usual in ((level - level.mean(), generic[0]), (shape, generic[1])):
            learned.append(np.sqrt(((squares**2).mean(axis=1).sum() + usual**2) / len(means)))
    tall = means[:, HEIGHT] - means[:, HEIGHT].mean()
    learned.append(np.sqrt(((tall**2).sum() + UNKNOWN_CLASS_SIGMAS[4] ** 2) / len(means)))
    out = [
        smooth_profile(*spread, reach=reach, even=even)
        for even in (False, True)
        for spread, reach in ((learned, 4.0), (UNKNOWN_CLASS_SIGMAS, 5.0))
    ]
    sides = inner.reshape(len(means), -1, 2, 2).mean(axis=3)
    even = np.sqrt(((sides[..., 0] - sides[..., 1]) ** 2).mean(axis=1)) < GROOVE_SIGMA
    fraction = (even.sum() + 1) / (len(means) + 2)
    return np.stack(out), 0.5 * np.array([1 - fraction, 1 - fraction, fraction, fraction])


def smooth_profile(
    level: float, bend: float, size: float, shape: float, tall: float, *, reach: float, even: bool = False
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
    even
        Of round objects: all sides of a height are alike.
    """
    out = np.zeros((FEATURES, FEATURES))
    height, axis = np.arange(FIRST_WIDTH) // 4, np.arange(FIRST_WIDTH) // 2 % 2
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    alike = np.where(even | (axis[:, None] == axis), 1.0, 0.7)
    ring = GROOVE_SIGMA**2 * (height[:, None] == height)
    out[:FIRST_WIDTH, :FIRST_WIDTH] = level**2 + (bend**2 * near + ring) * alike
    height, axis = np.arange(HEIGHTS * 2) // 2, np.arange(HEIGHTS * 2) % 2
    near = np.exp(-0.5 * ((height[:, None] - height) / reach) ** 2)
    same = even | (axis[:, None] == axis)
    wide = size**2 * np.where(same, 1.4, 1.0) + shape**2 * near * np.where(same, 1.0, 0.5)
    out[FIRST_WIDTH:HEIGHT, FIRST_WIDTH:HEIGHT] = wide
    out[HEIGHT, HEIGHT] = tall**2
    return out
