"""What is of no known kind: features of objects of no trained class, and states of an object that are none of the known ones.

Beside simulated classes, other containers are simulated as well: thin walls of revolution with random outlines, materials, rims and
lids (:func:`simulated_kinds`), each of which is a class of its own that varies as the known ones do. Beside classes that were
learned from squeezes, which need not be containers, untrained objects are similar to a known class, but with another profile
(:func:`unknown_kinds`). Symbols: k trained classes, p features as in :mod:`.haptic_model`.

Of states (:func:`posterior_with_unknown`): evidence consists of pieces i of n_i numbers, such as one squeeze or one weight.
State s predicts a piece with a Gaussian whose chi-square is q_si. For the piece that s predicts worst, the unknown state
has a broad density: it is everywhere that of s where a test with the stated false-alarm rate just rejects it,

    log p(y | like s, but unknown) = log p(y | s) + (q_si - Q_i) / 2,

with Q_i the quantile of chi-square with n_i degrees of freedom at 1 - alpha / m for m pieces (Bonferroni).
A state at the limit of its test is therefore as probable as the unknown state, and the probability of one far beyond it
vanishes, however much worse the other states are.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ..data.data_set import FeatureSet
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
#: Simulated containers, and nodes of a meridian. With 30 to 400 containers, as many unknown objects are recognised (within .03).
SIMULATED, NODES = 48, 65
#: Ranges of simulated containers, uniform in the logarithm: height and radius of the foot [m], thickness [m], Young's modulus [Pa]:
#: from a foil cup to a glass jar, from LDPE to aluminium.
SIZES = ((0.05, 0.25), (0.015, 0.06), (0.06e-3, 3e-3), (0.2e9, 70e9))
#: Poisson's ratio, from that of glass to that of LDPE.
POISSON = (0.22, 0.45)
#: Meridians: maximum number of parts, and distance of their ends from foot and mouth as a fraction of the height; standard deviation of the
#: logarithm of the ratio of the radii of mouth and foot, of which two thirds are between 0.6 and 1.65. Bulge of a part as long as half
#: of the height or longer, as a standard deviation relative to its radius, and fraction of the parts that bulge.
PARTS, PART_END, TAPER_SIGMA, BULGE_SIGMA, BULGED = 4, 0.05, 0.5, 0.15, 0.6
#: Fraction of containers with grooves; maximum number of these, their width and range of depths [m], and distance from foot and mouth.
GROOVED, GROOVES, GROOVE_m, GROOVE_DEPTH_m, GROOVE_END = 0.25, 4, 0.012, (5e-4, 3e-3), 0.1
#: Fraction of containers with a thicker rim; its thickness relative to that of the wall, and height [m]; and fraction with a lid.
RIMMED, RIM, RIM_m, LIDDED = 0.3, (2, 5), 0.003, 0.5
#: Standard deviation of the logarithm of the ratio of the axes of an oval container; seven of eight are less than twice as wide as deep.
OVAL_SIGMA = 0.45
#: Probability that a known state is rejected, alpha, for all pieces together.
FALSE_ALARM = 1e-3


@lru_cache(maxsize=1)
def simulated_kinds(seed: int = 0) -> FeatureSet:
    """Containers of no trained class: random thin walls of revolution, in half a second; those of the last seed are kept.

    The meridian has one to :data:`PARTS` parts, whose radii are a random walk in the logarithm, and which may bulge; some containers have
    grooves, a thicker rim, or a lid that holds the mouth.

    Parameters
    ----------
    seed
        Of all numbers that are drawn.
    """
    from ...deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness
    from ...deformation.shells.shell_material import IsotropicMaterial

    rng, along = np.random.default_rng(seed), np.linspace(0, 1, NODES)
    middle = (np.arange(HEIGHTS) + 0.5) / HEIGHTS
    stiffness, width, tall = [], [], []
    for _ in range(SIMULATED):
        height, foot, wall, modulus = (np.exp(rng.uniform(*np.log(pair))) for pair in SIZES)
        cuts = np.sort([0.0, *rng.uniform(PART_END, 1 - PART_END, rng.integers(0, PARTS)), 1.0])
        size = np.diff(cuts)
        walk = np.cumsum([0.0, *(TAPER_SIGMA * np.sqrt(size) * rng.standard_normal(len(size)))])
        radius = foot * np.exp(np.interp(along, cuts, walk))
        part = np.clip(np.searchsorted(cuts, along) - 1, 0, len(size) - 1)
        inside = (along - cuts[part]) / size[part]
        bulge = BULGE_SIGMA * rng.standard_normal(len(size)) * (rng.uniform(size=len(size)) < BULGED)
        radius *= 1 + (4 * bulge * np.minimum(1, 2 * size))[part] * inside * (1 - inside)
        grooves = rng.integers(1, GROOVES + 1) if rng.uniform() < GROOVED else 0
        for place in rng.uniform(GROOVE_END, 1 - GROOVE_END, grooves):
            away = (along - place) * height / GROOVE_m
            depth_m = rng.uniform(*GROOVE_DEPTH_m)
            radius -= np.where(np.abs(away) < 0.5, depth_m * np.cos(np.pi * away) ** 2, 0.0)
        rim = rng.uniform(*RIM) if rng.uniform() < RIMMED else 1.0
        thick = np.where(along > 1 - RIM_m / height - 0.5 / NODES, rim * wall, wall)
        shell = RevolutionShell(radius, along * height, thick, rim_held=bool(rng.uniform() < LIDDED))
        found = pinch_stiffness(shell, IsotropicMaterial(modulus, rng.uniform(*POISSON)), harmonics=40)
        stiffness.append(np.exp(np.interp(middle, along, np.log(np.minimum(found, 1e9)))))
        width.append(2 * np.interp(middle, along, radius))
        tall.append(height)
    sides, axes = (
        np.repeat(np.array(part)[:, :, None], count, axis=2) for part, count in ((stiffness, 4), (width, 2))
    )
    return replace(FeatureSet.of_stiffness(sides, axes, ["simulated"] * SIMULATED), height_m=np.array(tall))


def simulated_spread() -> Float[np.ndarray, "2 p p"]:
    """What simulated containers leave open: their level, outline and height are those of any; for round ones, and for oval ones.

    A point load on a shallow shell deforms it by an amount proportional to its radius of curvature (Reissner 1947). At the ends
    of the axes of an ellipse with the ratio q of its axes, those of a circle are divided by q^1.5 and multiplied by it.
    """
    level, _, *rest = UNKNOWN_CLASS_SIGMAS
    round_ = smooth_profile(level, 0.0, *rest, reach=5.0, even=True)
    wide = np.where(np.arange(FEATURES) < FIRST_WIDTH, 3.0, 1.0) * OVAL_SIGMA / 2
    sign = np.where(np.arange(FIRST_WIDTH) % 4 < 2, 1.0, -1.0)
    wide *= np.concatenate([sign, np.where(np.arange(FIRST_WIDTH, HEIGHT) % 2, -1.0, 1.0), [0.0, 0.0]])
    return np.stack([round_, round_ + np.outer(wide, wide)])


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
    fraction = round_fraction(means)
    return np.stack(out), 0.5 * np.array([1 - fraction, 1 - fraction, fraction, fraction])


def round_fraction(means: Float[np.ndarray, "k p"]) -> float:
    """Fraction of round objects, learned from the known classes (Laplace's rule of succession).

    Parameters
    ----------
    means
        As of :func:`unknown_kinds`.
    """
    sides = means[:, 4 : FIRST_WIDTH - 4].reshape(len(means), -1, 2, 2).mean(axis=3)
    even = np.sqrt(((sides[..., 0] - sides[..., 1]) ** 2).mean(axis=1)) < GROOVE_SIGMA
    return float((even.sum() + 1) / (len(means) + 2))


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
    """
    from scipy.stats import chi2 as chi2_distribution

    limit = chi2_distribution.isf(FALSE_ALARM / len(freedom), freedom)
    worst = 0.5 * (chi2 - limit).max(axis=1)
    parts = np.concatenate([log_likelihood, log_likelihood + worst])
    fraction = np.exp(parts - parts.max())
    fraction /= fraction.sum()
    known = len(log_likelihood)
    return fraction[:known], float(fraction[known:].sum())
