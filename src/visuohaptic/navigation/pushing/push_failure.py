"""Probability that a push fails, by Monte Carlo simulation; from the tag alone: ``problem.push_costs``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.objects import HapticTag
from .push_model import PushModel
from .quasi_static import PushTrace

__all__ = ["PushUncertainty", "centre_from_tag", "push_from_outside", "simulated_failure"]

#: The object has arrived within this distance of where it was to go (m), turned by at most this (rad).
ARRIVAL_M, MAX_TURN_RAD = 0.1, 0.7
#: A platform that would begin in the object begins so much earlier (m): up to 4 sigma of place and turn.
BACK_M = (0.0, 0.04, 0.08, 0.16, 0.32)


@dataclass(frozen=True, slots=True)
class PushUncertainty:
    """Standard deviations of what a simulated push does not know."""

    contact_friction: float = 0.1
    centre_m: float = 0.015  #: of the centre of friction, along x and y
    place_m: float = 0.01  #: of the object against the platform, along x and y
    yaw_rad: float = 0.05

    def sample(
        self, model: PushModel, object_m: tuple[float, float, float], rng: np.random.Generator
    ) -> tuple[PushModel, Float[np.ndarray, "3"]]:
        """Sample a model and a pose about the nominal ones.

        Parameters
        ----------
        model
            Nominal model; its contact friction and its supports are varied.
        object_m
            Nominal pose: x, y [m], yaw [rad].
        rng
            Source of the samples.
        """
        friction = max(0.0, model.contact_friction + self.contact_friction * rng.standard_normal())
        support = model.support_m + self.centre_m * rng.standard_normal(2)
        sigma = np.array([self.place_m, self.place_m, self.yaw_rad])
        sampled = replace(model, contact_friction=friction, support_m=support)
        return sampled, np.asarray(object_m, dtype=np.float64) + sigma * rng.standard_normal(3)


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
    model
        Nominal model of the object.
    object_m
        Nominal pose: x, y [m], yaw [rad], map frame.
    path_m
        Poses of the platform: x, y [m], heading [rad].
    radius_m
        Of the platform [m].
    rng
        Source of the samples.
    uncertainty
        Standard deviations of friction, centre of friction and pose.
    samples
        Number of simulated pushes.
    """
    uncertainty = uncertainty if uncertainty is not None else PushUncertainty()
    path = np.asarray(path_m, dtype=np.float64)
    chord = path[-1, :2] - path[0, :2]
    target = np.asarray(object_m[:2]) + chord * max(
        0.0, 1.0 - _approach_m(model, object_m, path, radius_m) / max(float(np.hypot(*chord)), 1e-9)
    )
    failed = 0
    for _ in range(samples):
        sampled, place = uncertainty.sample(model, object_m, rng)
        trace = push_from_outside(sampled, place, path, radius_m)
        if trace is None:
            failed += 1
            continue
        error = np.hypot(*(trace.object_m[-1, :2] - target))
        turned = abs(trace.object_m[-1, 2] - place[2])
        failed += bool(error > ARRIVAL_M or turned > MAX_TURN_RAD)
    return failed / samples


def push_from_outside(
    model: PushModel,
    object_m: tuple[float, float, float] | Float[np.ndarray, "3"],
    path: Float[np.ndarray, "k 3"],
    radius_m: float,
) -> PushTrace | None:
    """The push; begun earlier on its line where the object was sampled into the platform.

    Parameters
    ----------
    model, object_m, path, radius_m
        As of :func:`~visuohaptic.navigation.pushing.quasi_static.simulate_push`.

    Returns
    -------
    ``None`` where the object blocks the whole approach.
    """
    from .quasi_static import simulate_push

    ahead = path[min(1, len(path) - 1), :2] - path[0, :2]
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    for back_m in BACK_M:
        begin = path[:1] - np.array([*(back_m * ahead), 0.0])
        try:
            return simulate_push(model, object_m, np.concatenate([begin, path]) if back_m else path, radius_m)
        except InputError:
            continue
    return None


def _approach_m(
    model: PushModel, object_m: tuple[float, float, float], path: Float[np.ndarray, "k 3"], radius_m: float
) -> float:
    """Length that the platform drives before it meets the object."""
    trace = push_from_outside(model, object_m, path, radius_m)
    if trace is None or len(trace.platform_m) > len(path):
        return 0.0  # it begins at the object
    rows = np.flatnonzero(np.isfinite(trace.contact_m[:, 0]))
    row = int(rows[0]) if len(rows) else len(path) - 1
    return float(np.hypot(*(path[row, :2] - path[0, :2])))
