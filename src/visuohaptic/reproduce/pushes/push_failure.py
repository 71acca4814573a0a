"""Probability that a push fails, by Monte Carlo simulation; and what a tag says of the centre of friction."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.objects import HapticTag
from ...navigation.pushing.push_failure import PushUncertainty, sampled_pushes
from ...navigation.pushing.push_model import PushModel
from ...navigation.pushing.quasi_static import simulate_push

__all__ = ["centre_from_tag", "simulated_failure"]

#: The object has arrived within this distance of where it was to go (m), turned by at most this (rad).
ARRIVAL_M, MAX_TURN_RAD = 0.1, 0.7


def centre_from_tag(
    tag: HapticTag | None, direction_rad: float, model: PushModel, radius_m: float
) -> Float[np.ndarray, "2"]:
    """Where the centre of friction lies from the footprint's centre, as a first push implies.

    A push through the centre of friction does not turn the object. Beside it
    by b, an object that sticks to the rim turns by H_R = b / (b^2 + c^2) per
    metre, c being the largest friction moment by force; the small root for b
    is the offset (positive to the left of the push, where the object turned
    left). Where H_R was not observed, it follows from the drift: on the rim
    of a disc the contact of a turning face rolls by radius x turn.

    Parameters
    ----------
    tag
        Of one push.
    direction_rad
        Of that push, in the frame of the answer.
    model
        For c.
    radius_m
        Of the platform.

    Returns
    -------
    Offset [m], across the push only: along it nothing was learnt.
    """
    if tag is None or (tag.rotation_rad_per_m is None and tag.drift is None):
        return np.zeros(2)
    if tag.rotation_rad_per_m is not None:
        turn = tag.rotation_rad_per_m.value
    else:
        assert tag.drift is not None
        turn = tag.drift.value / radius_m
    lever = max(model.lever_m, 1e-3)
    # H_R has its largest value, 1 / (2 c), at b = c: what is beyond cannot be of one steady push.
    turn = min(max(turn, -0.5 / lever), 0.5 / lever)
    aside = 0.0 if turn == 0.0 else (1.0 - math.sqrt(max(0.0, 1.0 - (2 * lever * turn) ** 2))) / (2 * turn)
    if tag.contact_offset_m is not None:
        aside += tag.contact_offset_m.value
    return aside * np.array([-math.sin(direction_rad), math.cos(direction_rad)])


def simulated_failure(
    model: PushModel,
    object_m: tuple[float, float, float],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
    rng: np.random.Generator,
    *,
    uncertainty: PushUncertainty | None = None,
    samples: int = 32,
) -> float:
    """Fraction of simulated direct pushes that do not bring the object where the platform goes.

    The object has to end within ``ARRIVAL_M`` of the place it would have if it
    stuck to the platform, turned by no more than ``MAX_TURN_RAD``.

    Parameters
    ----------
    model, object_m, path_m, radius_m, rng, uncertainty, samples
        As of :func:`~visuohaptic.navigation.pushing.push_failure.sampled_pushes`.
    """
    path = np.asarray(path_m, dtype=np.float64)
    chord = path[-1, :2] - path[0, :2]
    target = np.asarray(object_m[:2]) + chord * max(
        0.0, 1.0 - _approach_m(model, object_m, path, radius_m) / max(float(np.hypot(*chord)), 1e-9)
    )
    before, along, blocked = sampled_pushes(
        model, object_m, path, radius_m, rng, uncertainty=uncertainty, samples=samples
    )
    after = along[:, -1]
    off = np.hypot(*(after[:, :2] - target).T) > ARRIVAL_M
    return float((blocked | off | (np.abs(after[:, 2] - before[:, 2]) > MAX_TURN_RAD)).mean())


def _approach_m(
    model: PushModel, object_m: tuple[float, float, float], path: Float[np.ndarray, "k 3"], radius_m: float
) -> float:
    """Length that the platform drives before it meets the object; 0 where it begins at it."""
    try:
        trace = simulate_push(model, object_m, path, radius_m)
    except InputError:
        return 0.0
    rows = np.flatnonzero(np.isfinite(trace.contact_m[:, 0]))
    row = int(rows[0]) if len(rows) else len(path) - 1
    return float(np.hypot(*(path[row, :2] - path[0, :2])))
