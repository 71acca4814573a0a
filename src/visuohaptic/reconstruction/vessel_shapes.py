"""Profiles of upright vessels, drawn from classes of shapes with uniform parameters.

Four classes that people make: straight (tumblers, jars), with a shoulder and a neck (bottles), with a stem (wine glasses, goblets),
and bowls. The ranges of the parameters are wide; what is known of a vessel weights the draws.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

#: Number of draws of each class, and of heights at which a profile is given.
DRAWS, STEPS = 8000, 65


@cache
def vessel_profiles() -> Float[np.ndarray, "draws steps"]:
    """Radii of vessels (draws, steps) from foot to rim at equal steps of the height, in units of the largest one."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 1.0, STEPS)
    found = np.concatenate(
        [kind(t, *rng.random((6, DRAWS, 1))) for kind in (_straight, _shouldered, _stemmed, _bowl)]
    )
    return found / found.max(axis=1, keepdims=True)


def _ramp(x: np.ndarray) -> np.ndarray:
    """Smooth step from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return x**2 * (3 - 2 * x)


def _straight(t: np.ndarray, foot: np.ndarray, *_: np.ndarray) -> np.ndarray:
    foot = 0.5 + foot
    return foot + (1 - foot) * t


def _shouldered(
    t: np.ndarray, start: np.ndarray, width: np.ndarray, neck: np.ndarray, *_: np.ndarray
) -> np.ndarray:
    return 1 - (0.05 + 0.75 * neck) * _ramp((t - 0.35 - 0.55 * start) / (0.05 + 0.35 * width))


def _stemmed(
    t: np.ndarray,
    foot: np.ndarray,
    edge: np.ndarray,
    stem: np.ndarray,
    start: np.ndarray,
    width: np.ndarray,
    rim: np.ndarray,
) -> np.ndarray:
    stem, start, width = 0.05 + 0.25 * stem, 0.2 + 0.5 * start, 0.15 + 0.45 * width
    base = stem + (0.5 + 0.6 * foot - stem) * (1 - _ramp(t / (0.02 + 0.13 * edge)))
    x = np.clip((t - start) / width, 0.0, 1.0)
    bowl = stem + (1 - stem) * np.sqrt(x * (2 - x))
    taper = np.clip((t - start - width) / np.maximum(1 - start - width, 1e-3), 0.0, 1.0)
    return np.maximum(base, bowl * (1 - (0.35 * rim) * taper))


def _bowl(t: np.ndarray, foot: np.ndarray, power: np.ndarray, *_: np.ndarray) -> np.ndarray:
    foot = 0.3 + 0.6 * foot
    return foot + (1 - foot) * t ** (0.3 + 0.9 * power)
