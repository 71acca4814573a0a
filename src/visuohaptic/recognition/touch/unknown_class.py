"""What is of no known kind: features of objects of no trained class, and states of an object that are none of the known ones.

Untrained objects are similar to a known class, but with another profile. Symbols: k trained classes, p features as in
:mod:`.haptic_model`.

Of states (:func:`posterior_with_unknown`): evidence consists of pieces i of n_i numbers, such as one squeeze or one weight.
State s predicts a piece with a Gaussian whose chi-square is q_si. For the piece that s predicts worst, the unknown state
has a broad density: it is everywhere that of s where a test with the stated false-alarm rate just rejects it,

    log p(y | like s, but unknown) = log p(y | s) + (q_si - Q_i) / 2,

with Q_i the quantile of chi-square with n_i degrees of freedom at 1 - alpha / m for m pieces (Bonferroni).
A state at the limit of its test is therefore as probable as the unknown state, and the probability of one far beyond it
vanishes, however much worse the other states are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.places import HEIGHTS

FIRST_WIDTH = HEIGHTS * 4  #: index of the first width among the features
HEIGHT = HEIGHTS * 6  #: index of the height of the object
CURVATURE = HEIGHT + 1  #: index of the mean curvature of its curves, see :attr:`.CurveCoefficients.curvature`
FEATURES = CURVATURE + 1
#: Unit of heights, that of a typical container; the default where none is measured, with the uncertainty of any container.
USUAL_HEIGHT_m = 0.12
#: Standard deviations of the logarithms of the features of any container: stiffness, common part and by place; width, common
#: part and by place; and height. Glass is 60 times as stiff as a thin cup, exp(2 * 2.05); a jar three times as wide as a tube,
#: and a bottle five times as tall as a bowl. Curvatures, which are no logarithms: a plush toy has 2, a wall that snaps through -1.
UNKNOWN_CLASS_SIGMAS = (1.5, 0.25, 0.3, 0.2, 0.4, 1.0)
#: Standard deviation of the logarithm of stiffness due to grooves and shoulders, which run around the object at one height.
GROOVE_SIGMA = 0.05
#: Probability that a known state is rejected.
FALSE_ALARM = 1e-3


def unknown_kinds(
    means: Float[np.ndarray, "k p"],
) -> tuple[Float[np.ndarray, "4 p p"], Float[np.ndarray, "4"]]:
    """Covariances of the difference between an unknown object and a known class, and the probability of each.

    There are two: that between the known classes, and that of any container; each for objects whose axes differ and for round
    objects. The first is learned from the differences of the known classes, with :data:`UNKNOWN_CLASS_SIGMAS` as one more class.
    Roundness is a property of the whole object: if the axes differed at random at each height, every second touch
    of a height would be evidence against an unknown object. The fraction of round objects is learned from the known classes as
    well (Laplace's rule of succession).

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
        The number of features is wrong.
    """
    if means.shape[1] != FEATURES:
        raise InputError(
            "unknown_kinds", f"found {means.shape[1]} features, expected {FEATURES}", field="means"
        )
    inner = means[:, 4 : FIRST_WIDTH - 4]  # the stiffness at the ends depends on their supports
    learned = []
    for part, generic in (
        (inner, UNKNOWN_CLASS_SIGMAS[:2]),
        (means[:, FIRST_WIDTH:HEIGHT], UNKNOWN_CLASS_SIGMAS[2:4]),
    ):
        level = part.mean(axis=1, keepdims=True)
        shape = part - level - (part - level).mean(axis=0)
        for squares, usual in ((level - level.mean(), generic[0]), (shape, generic[1])):
            learned.append(np.sqrt(((squares**2).mean(axis=1).sum() + usual**2) / len(means)))
    for index, usual in ((HEIGHT, UNKNOWN_CLASS_SIGMAS[4]), (CURVATURE, UNKNOWN_CLASS_SIGMAS[5])):
        squares = (means[:, index] - means[:, index].mean()) ** 2
        learned.append(np.sqrt((squares.sum() + usual**2) / len(means)))
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
    level: float,
    bend: float,
    size: float,
    shape: float,
    tall: float,
    curvature: float = 0.0,
    *,
    reach: float,
    even: bool = False,
) -> Float[np.ndarray, "p p"]:
    """Covariance of smooth profiles.

    Parameters
    ----------
    level, bend
        Standard deviations of the logarithm of stiffness, common part and by place.
    size, shape
        The same for the width.
    tall
        Standard deviation of the logarithm of the height.
    curvature
        Standard deviation of the relative quadratic coefficient.
    reach
        Number of places over which a profile is smooth (correlation length).
    even
        Round objects: all sides of a height are alike.
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
    out[HEIGHT, HEIGHT], out[CURVATURE, CURVATURE] = tall**2, curvature**2
    return out


def posterior_with_unknown(
    log_likelihood: Float[np.ndarray, "s"],
    chi2: Float[np.ndarray, "s m"],
    freedom: Int[np.ndarray, "m"],
    *,
    false_alarm: float = FALSE_ALARM,
) -> tuple[Float[np.ndarray, "s"], float]:
    """Probabilities of the states and of "none of them"; they sum to 1.

    Parameters
    ----------
    log_likelihood
        Of all evidence, by state.
    chi2
        Of every piece, by state.
    freedom
        Degrees of freedom (number of values) of every piece.
    false_alarm
        alpha, for all pieces together.
    """
    from scipy.stats import chi2 as chi2_distribution

    limit = chi2_distribution.isf(false_alarm / len(freedom), freedom)
    worst = 0.5 * (chi2 - limit).max(axis=1)
    parts = np.concatenate([log_likelihood, log_likelihood + worst])
    fraction = np.exp(parts - parts.max())
    fraction /= fraction.sum()
    known = len(log_likelihood)
    return fraction[:known], float(fraction[known:].sum())
