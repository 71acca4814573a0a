"""The wrench at the tip from the motion of the rod's cross sections: least squares, weighted by covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import so3_log
from .mechanics import Beam, compliance, shortening, stress_ratio
from .observation import SectionMotion
from .rod import base_wrench, rod_from_base

BeamModel = Literal["auto", "linear", "exact"]

#: The exact rod is used if the error of the linear beam exceeds this many standard deviations of any component.
#: A quarter, so that the error is not visible in the mean of ten frames either.
LINEAR_LIMIT = 0.25
#: Maximum number of Gauss-Newton steps of the exact rod.
_MAX_STEPS = 30


@dataclass(frozen=True, slots=True, eq=False)
class BeamEstimate:
    """Wrench with the best fit to the observed motion."""

    wrench: Float[np.ndarray, "6"]  #: at the tip, frame S [N, Nm]
    noise: Float[np.ndarray, "6 6"]  #: covariance due to the poses of the frame
    zero: Float[np.ndarray, "6 6"]  #: covariance due to the zero reference
    setup: Float[np.ndarray, "6 6"]  #: covariance due to position errors of the templates
    setup_left: Float[np.ndarray, "6 6"]  #: the part of it that the calibration does not contain
    exact: bool  #: computed with the exact rod; otherwise with the linear beam
    chi2: float  #: sum of squared residuals, weighted by noise, zero and setup
    freedom: int  #: number of observations minus unknowns
    residual: Float[np.ndarray, "6n"]  #: observed minus predicted (d, phi) of each section [m, rad]
    stress: float  #: maximum equivalent stress in the rod over the yield stress


def estimate_wrench(
    beam: Beam,
    motion: SectionMotion,
    *,
    model: BeamModel = "auto",
    linear_limit: float = LINEAR_LIMIT,
    place_left: Float[np.ndarray, "6"] | None = None,
) -> BeamEstimate:
    """Wrench from the motion of one or more cross sections.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    motion
        Observed motion of n cross sections with its covariances.
    model
        ``linear``: Eq. (3.4) at every template with the slopes of Sec. 3.4, and the shortening removed from
        d_X. ``exact``: the large-deflection rod. ``auto``: linear, unless it differs from the exact rod
        by more than ``linear_limit`` standard deviations in any component.
    linear_limit
        Error of the linear beam, in standard deviations of any component, above which the exact rod is
        used.
    place_left
        As of :class:`.Correction`; None: ones.

    Raises
    ------
    InputError
        There are no observations, or the exact rod cannot have the observed shape.
    """
    if not len(motion.xi):
        raise InputError("motion", "has no cross section, expected at least one")
    try:
        setup = setup_variance(beam, motion)
        whiten = np.linalg.inv(np.linalg.cholesky(motion.covariance + np.diag(setup)))
    except np.linalg.LinAlgError as error:
        raise InputError("motion", "its covariance is not positive definite") from error
    matrix = np.vstack([compliance(beam, float(xi)) for xi in motion.xi])
    start, gain, residual = _linear(beam, motion, matrix, whiten)
    place_left = np.ones(6) if place_left is None else place_left
    moved = motion.vector - matrix @ ((1 - place_left) * start)
    weights = _Weights(motion, setup, setup_variance(beam, motion, moved), whiten)
    if model == "linear":
        moment = base_wrench(beam, start)[3:]
        stress = max(stress_ratio(beam, moment, start[0]), stress_ratio(beam, start[3:], start[0]))
        return weights.estimate(start, gain, residual, stress, exact=False)
    exact = _exact(beam, weights, start)
    if model == "auto":
        linear = weights.estimate(start, gain, residual, exact.stress, exact=False)
        sigma = np.sqrt(np.diag(exact.noise + exact.zero))
        if (np.abs(exact.wrench - start) <= linear_limit * sigma).all():
            return linear
    return exact


def setup_variance(
    beam: Beam,
    motion: SectionMotion,
    placed: Float[np.ndarray, "6n"] | None = None,
) -> Float[np.ndarray, "6n"]:
    """Variance of the disagreement between templates due to errors of their declared positions.

    Grows with the load: a template that is ``place_tolerance_m`` further along
    the rod moves by the slope times that and rotates by the curvature times that;
    a fraction ``shape_tolerance`` of each motion accounts for all other causes.
    Without it, the weights of a tracker with micrometre noise would convert a position error of half a
    millimetre into newtons.

    Parameters
    ----------
    beam
        Parts of the sensor and their tolerances.
    motion
        Observed motion of n cross sections.
    placed
        The part (d, phi) of it [m, rad] in which errors of position count; None: all of it.

    Returns
    -------
    ndarray, shape (6n,)
        Variances of (d, phi) of each section [m^2, rad^2].
    """
    size = np.linalg.norm(motion.vector.reshape(-1, 2, 3), axis=2)
    turned = (motion.vector if placed is None else placed).reshape(-1, 2, 3)[:, 1]
    place = beam.place_tolerance_m * np.linalg.norm(turned, axis=1)
    reach = np.maximum(motion.xi, 0.2) * beam.length_m
    shape = beam.shape_tolerance * size
    both = np.stack([np.hypot(shape[:, 0], place), np.hypot(shape[:, 1], place / reach)], axis=1)
    return np.repeat(both**2, 3, axis=1).ravel()


def _linear(
    beam: Beam, motion: SectionMotion, matrix: np.ndarray, whiten: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Generalised least squares with Eq. (3.4), the compliances of all sections; returns wrench, gain and residual."""
    rotation = motion.rotation
    # Slopes as in Sec. 3.4; the sign of phi_Y is that of mechanics.py.
    slope_y, slope_z = rotation[:, 1, 0] / rotation[:, 0, 0], rotation[:, 2, 0] / rotation[:, 0, 0]
    turns = so3_log(rotation)
    observed = np.column_stack([motion.translation_m, turns[:, 0], -slope_z, slope_y]).ravel()
    white = whiten @ matrix
    # Columns of forces and moments differ by a length; scaled, the normal equations are well conditioned.
    scale = np.array([1.0, 1.0, 1.0, beam.length_m, beam.length_m, beam.length_m])
    gain = scale[:, None] * (np.linalg.pinv(white * scale) @ whiten)
    wrench = gain @ observed
    for _ in range(2):  # the shortening requires the wrench, and changes F_X only
        lifted = observed.copy()
        lifted[::6] += [shortening(beam, float(xi), wrench) for xi in motion.xi]
        wrench = gain @ lifted
    return wrench, gain, lifted - matrix @ wrench


def _exact(beam: Beam, weights: _Weights, start: np.ndarray) -> BeamEstimate:
    """Gauss-Newton on the base wrench, with step halving."""
    motion, whiten = weights.motion, weights.whiten
    order = np.argsort(motion.xi, kind="stable")
    back = np.argsort(order, kind="stable")
    rest = np.zeros((len(order), 3))
    rest[:, 0] = motion.xi * beam.length_m
    scale = np.array([1.0, 1.0, 1.0, beam.length_m, beam.length_m, beam.length_m])

    def look(base: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
        shape = rod_from_base(beam, base, motion.xi[order])
        moved = shape.position_m[back] - rest
        turned = np.einsum("nij,nkj->nik", motion.rotation, shape.rotation[back])
        residual = np.hstack([motion.translation_m - moved, so3_log(turned)]).ravel()
        jacobian = shape.jacobian[back].reshape(-1, 6)
        chi2 = float(((whiten @ residual) ** 2).sum())
        return residual, jacobian, chi2, shape.wrench, shape.wrench_jacobian

    base = base_wrench(beam, np.clip(start, -2 * beam.full_scale, 2 * beam.full_scale))
    residual, jacobian, chi2, wrench, to_tip = look(base)
    for _ in range(_MAX_STEPS):
        white = whiten @ (jacobian * scale)
        step = scale * np.linalg.lstsq(white, whiten @ residual, rcond=None)[0]
        # Distance to the solution in standard deviations.
        left = float(np.linalg.norm(white @ (step / scale)))
        if not np.isfinite(left):
            raise InputError("motion", "the observed poses do not fit any shape of the rod")
        fraction = 1.0
        while fraction > 1e-3:
            trial = look(base + fraction * step)
            if trial[2] <= chi2 * (1 + 1e-9) + 1e-9:
                break
            fraction *= 0.5
        else:
            break
        base = base + fraction * step
        residual, jacobian, chi2, wrench, to_tip = trial
        # With residual noise, the last steps would fluctuate by thousandths of a standard deviation endlessly.
        if left < 0.01:
            break
    white = whiten @ (jacobian * scale)
    gain = to_tip @ (scale[:, None] * (np.linalg.pinv(white) @ whiten))
    stress = max(stress_ratio(beam, base[3:], base[0]), stress_ratio(beam, wrench[3:], base[0]))
    return weights.estimate(wrench, gain, residual, stress, exact=True)


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """An observed motion, and the uncertainty of its components."""

    motion: SectionMotion
    setup: Float[np.ndarray, "6n"]  #: variance due to position errors of the templates
    setup_left: Float[np.ndarray, "6n"]  #: the part of it that the calibration does not contain
    whiten: Float[np.ndarray, "6n 6n"]

    def estimate(
        self, wrench: np.ndarray, gain: np.ndarray, residual: np.ndarray, stress: float, *, exact: bool
    ) -> BeamEstimate:
        """The estimate with its covariances, from the gain of the least squares."""
        return BeamEstimate(
            wrench,
            gain @ self.motion.noise @ gain.T,
            gain @ self.motion.zero @ gain.T,
            (gain * self.setup) @ gain.T,
            (gain * self.setup_left) @ gain.T,
            exact,
            float(((self.whiten @ residual) ** 2).sum()),
            len(residual) - 6,
            residual,
            stress,
        )
