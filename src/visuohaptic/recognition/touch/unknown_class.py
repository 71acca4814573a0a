"""What objects may be that nobody has trained: of another profile or size than one that is known, or any container.

Any container is a shell of revolution drawn from the ranges of household containers, its stiffness solved by Fourier series
(:mod:`...deformation.shells.fourier_shell`): so stiffness, width and height go together as walls make them do. Symbols: k
trained classes, n drawn shells, p features as in :mod:`.haptic_model`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from ..data.places import HEIGHTS
from ..data.protocol import TouchProtocol

__all__ = [
    "FEATURES",
    "FIRST_WIDTH",
    "HEIGHT",
    "USUAL_HEIGHT_m",
    "any_containers",
    "drawn_containers",
    "smooth_profile",
    "unknown_kinds",
]

FIRST_WIDTH = HEIGHTS * 4  #: among the features
HEIGHT = HEIGHTS * 6  #: of the object, the last one
FEATURES = HEIGHT + 1
#: Unit of heights: where none is known, that of a usual container is taken, as uncertain as that of anything.
USUAL_HEIGHT_m = 0.12
#: Standard deviations of the logarithm of what any container may be: stiffness in common and by place, width in common and
#: by place, and height. Glass is 60 times as stiff as a thin cup, exp(2 * 2.05); a jar three times as wide as a tube, and a
#: bottle five times as tall as a bowl.
ANYTHING = (1.5, 0.25, 0.3, 0.2, 0.4)
#: Drawn shells: some four for each of their 33 different features, of each rim; points of a meridian and harmonics, with which
#: the stiffness is within 2 % of its limit on average.
SHELLS, POINTS, HARMONICS = 256, 49, 32
#: Walls [m] from foil to glass and moduli [Pa] from soft polyethylene to glass and aluminium, uniform in their logarithms.
WALLS_m, MODULI_Pa = (1e-4, 3e-3), (0.2e9, 70e9)


def unknown_kinds(means: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "3 p p"]:
    """Covariances by which an unknown object differs from a known class: as classes do, as anything may, and in its size alone.

    The first and last are learned from what the known classes differ by, as if :data:`ANYTHING` were one more class. Without
    the last a can is a tub the surer the more it is touched: every further place agrees with the tub's profile.

    Parameters
    ----------
    means
        Features of the trained classes.
    """
    inner = means[:, 4 : FIRST_WIDTH - 4]  # what holds the ends says nothing of the wall
    learned = []
    for part, generic in ((inner, ANYTHING[:2]), (means[:, FIRST_WIDTH:HEIGHT], ANYTHING[2:4])):
        level = part.mean(axis=1, keepdims=True)
        shape = part - level - (part - level).mean(axis=0)
        for squares, usual in ((level - level.mean(), generic[0]), (shape, generic[1])):
            learned.append(np.sqrt(((squares**2).mean(axis=1).sum() + usual**2) / len(means)))
    tall = means[:, HEIGHT] - means[:, HEIGHT].mean()
    learned.append(np.sqrt(((tall**2).sum() + ANYTHING[4] ** 2) / len(means)))
    level, _, size, _, height = learned
    other = smooth_profile(level, 0.0, size, 0.0, height, reach=4.0, grooves=0.0)
    return np.stack([smooth_profile(*learned, reach=4.0), smooth_profile(*ANYTHING, reach=5.0), other])


def any_containers(
    protocol: TouchProtocol,
) -> list[tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p p"]]]:
    """Mean and covariance of the features of any containers with a free rim, and with one that is held.

    Parameters
    ----------
    protocol
        Resolution of the stiffness.
    """
    stiffness, width, tall, held = drawn_containers()
    level, size = protocol.seen_stiffness(stiffness)[0], np.log(width)
    drawn = np.column_stack(
        [np.repeat(level, 4, axis=1), np.repeat(size, 2, axis=1), np.log(tall / USUAL_HEIGHT_m)]
    )
    return [(drawn[rim].mean(axis=0), np.cov(drawn[rim].T)) for rim in (~held, held)]


@lru_cache(maxsize=1)
def drawn_containers() -> tuple[
    Float[np.ndarray, "n 16"], Float[np.ndarray, "n 16"], Float[np.ndarray, "n"], Bool[np.ndarray, "n"]
]:
    """Stiffness [N/m] and width [m] at the 16 heights of any containers, their heights [m], and whether their rims are held."""
    from ...deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness
    from ...deformation.shells.shell_material import IsotropicMaterial

    rng = np.random.default_rng(7)
    at = (np.arange(HEIGHTS) + 0.5) / HEIGHTS
    place = np.linspace(0, 1, POINTS)
    stiffness, width, tall = (np.empty((SHELLS, HEIGHTS)) for _ in range(3))
    held = np.arange(SHELLS) % 2 == 1
    for k in range(SHELLS):
        radius, height = _meridian(rng, place)
        wall, young = np.exp([rng.uniform(*np.log(part)) for part in (WALLS_m, MODULI_Pa)])
        shell = RevolutionShell(radius, height * place, wall, rim_held=bool(held[k]))
        found = pinch_stiffness(shell, IsotropicMaterial(young, 0.38), harmonics=HARMONICS)
        stiffness[k] = 1 / np.interp(at, place, 1 / found)
        width[k], tall[k] = 2 * np.interp(at, place, radius), height
    return stiffness, width, tall[:, 0], held


def _meridian(
    rng: np.random.Generator, place: Float[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "m"], float]:
    """Radii [m] and height [m] of one to three sections, as containers of 2 to 6 cm radius and 5 to 25 cm height have them."""
    height, foot = 0.11 * np.exp(0.45 * rng.standard_normal()), 0.033 * np.exp(0.3 * rng.standard_normal())
    count = int(rng.integers(1, 4))
    cut = np.r_[0.0, np.sort(rng.uniform(0.15, 0.85, count - 1)), 1.0]
    # Two of three sections are cones, every second one bulges.
    steps = 0.35 * rng.standard_normal(count) * (rng.random(count) < 0.7)
    bulge = 0.12 * rng.standard_normal(count) * (rng.random(count) < 0.5)
    which = np.clip(np.searchsorted(cut, place) - 1, 0, count - 1)
    part = (place - cut[which]) / np.diff(cut)[which]
    radius = np.interp(place, cut, np.exp(np.r_[0.0, np.cumsum(steps)])) + 4 * bulge[which] * part * (
        1 - part
    )
    near = np.exp(-0.5 * ((place[:, None] - place) / 0.035) ** 2)  # rounded by 4 mm
    return foot * np.maximum(near @ radius / near.sum(axis=1), 0.25), float(height)


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
