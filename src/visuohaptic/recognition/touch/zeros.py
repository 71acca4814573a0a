"""Zeros of the gripper's sensors, which its curves themselves show, whatever the class of the object.

A line through the curve of a stiff wall has no force at

    c = z - f / k + u r^2 / 6 + e

with the errors z of the contact and f of the force's zero, the relative quadratic coefficient u of the curve (F = k d (1 + u d)) and
its reach r. Of a wall that yields by 0.5 mm at 20 N, an error of 0.1 mm changes the stiffness by 30 %, the quadratic coefficient of
any container changes c by 0.004 mm, and the noise of six samples by 0.08 mm. All curves of an exploration share z and f.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.objects import NOMINAL_m
from ..data.readings import TouchReading
from .haptic_model import HapticModel
from .nuisances import NUISANCES
from .unknown_class import UNKNOWN_CLASS_SIGMAS

_ZEROS = [NUISANCES.index(name) for name in ("zero of the force", "zero of the deformation")]


def with_zeros(model: HapticModel, readings: Sequence[TouchReading]) -> HapticModel:
    """Model given where the curves of an exploration have no force: each Gaussian is conditioned on the zeros of the sensors.

    Classes that were learned from explorations contain these errors in their variation, and remain as they are. Where the
    curvature of a curve is evidence for the class, it is not used a second time.

    Parameters
    ----------
    model
        Of the candidates.
    readings
        Touches of one object.
    """
    settings = model.settings
    sides = [side for one in readings for side in one.sides if side is not None]
    rows = np.array([(side.contact_m, side.contact_sigma_m, side.i_N_per_m) for side in sides]).reshape(-1, 3)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows) or np.isfinite(settings.curvature):
        return model
    start, sigma, stiffness = rows.T
    bent = UNKNOWN_CLASS_SIGMAS[5] / NOMINAL_m * _reach(model, stiffness) ** 2 / 6
    # Standard normal: the zeros of force and deformation, and the curvature of the object.
    effect = np.stack([-settings.zero_N / stiffness, np.full_like(start, settings.zero_m), bent], axis=1)
    effect /= sigma[:, None]
    covariance = np.linalg.inv(np.eye(3) + effect.T @ effect)
    mean = covariance @ effect.T @ (start / sigma)
    moved = model.nuisance[:, _ZEROS]
    known = np.eye(2) - covariance[:2, :2]
    return replace(
        model,
        mean=model.mean + mean[:2] @ moved,
        covariance=model.covariance - moved.transpose(0, 2, 1) @ known @ moved,
    )


def curvatures(
    model: HapticModel, readings: Sequence[TouchReading]
) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "q"], Float[np.ndarray, "q"]]:
    """Relative quadratic coefficients of the curves, independent variances, and effects of the zeros' standard deviation.

    A constant c, fitted by a d + b d^2 up to the reach r, has b = -10 c / (3 r^2).

    Parameters
    ----------
    model
        Defines the errors of the zeros, and the reach of a touch.
    readings
        Touches of one object.
    """
    sides = [side for one in readings for side in one.sides if side is not None]
    rows = np.array([(*side.curvature, side.i_N_per_m) for side in sides]).reshape(-1, 3)
    # The error of a ratio is Gaussian if it is small; the others are known worse than objects differ.
    known = np.isfinite(rows).all(axis=1) & (rows[:, 1] < UNKNOWN_CLASS_SIGMAS[5])
    bent, sigma, stiffness = rows[known].T
    settings = model.settings
    reach = _reach(model, stiffness)
    zero = 10 / 3 * NOMINAL_m / reach**2 * np.hypot(settings.zero_m, settings.zero_N / stiffness)
    return bent, sigma**2, zero


def _reach(model: HapticModel, stiffness: Float[np.ndarray, "q"]) -> Float[np.ndarray, "q"]:
    """Largest deformation of curves [m]."""
    return np.minimum(model.protocol.max_deformation_m, model.protocol.max_force_N / stiffness)
