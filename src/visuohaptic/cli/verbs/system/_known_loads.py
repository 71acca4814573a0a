"""Stress curve of a foam from a few known loads, as measured by a kitchen scale.

Symbols
-------
F_i : load i [N], read from a scale while the strip is pressed against it
delta_i(s) : deflection along the strip that the camera sees meanwhile [m]
mu, alpha : modulus [Pa] and exponent of the foam's loading curve

The curve is the Ogden-Hill (Storakers) law of open-cell foam with a Poisson ratio of zero,
``m(eps) = (2 mu / alpha) (1 - lambda^alpha) / lambda`` with ``lambda = 1 - eps``: alpha decides
how sharply the plateau begins. Force is its integral over the contour, so that (mu, alpha) is a
regression on the loads; its posterior covariance becomes that of the curve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ....core.errors import CalibrationError
from ....sensing.foam import FoamMaterial, PlateRecord, StrainStress, calibrate_foam
from ....sensing.foam.material.boundary import contour_force

#: Flexible polyurethane: between 4 (a latex-like bow) and 16 (a sharp plateau) in two of three foams.
_LOG_ALPHA, _LOG_ALPHA_SIGMA = np.log(8.0), np.log(2.0)
#: A kitchen scale shows whole grams; foam creeps by some per cent while a hand holds it.
_SCALE_SIGMA_N, _CREEP_SIGMA = 0.01, 0.05
#: Strains of the curve; deeper is saturated.
_STRAIN = np.linspace(0.0, 0.6, 61)


def typical_foam(width_m: float, height_m: float) -> FoamMaterial:
    """A soft open-cell foam of unknown stiffness: enough to see deflections, not to read forces.

    Parameters
    ----------
    width_m, height_m
        Size of the strip: along the compression, and across the contour.
    """
    return _material(np.array([np.log(1e4), _LOG_ALPHA]), width_m, height_m)


def fit_known_loads(loads: Sequence[PlateRecord], width_m: float, height_m: float) -> FoamMaterial:
    """Stress curve with its covariance from one known load or more.

    Parameters
    ----------
    loads
        Force and deflection of each; two of different depth determine both parameters.
    width_m, height_m
        Size of the strip: along the compression, and across the contour.

    Raises
    ------
    CalibrationError
        The loads contradict each other, or no deflection was measured.
    """
    from scipy.optimize import least_squares

    truth_N = np.array([load.force_N for load in loads])
    sigma_N = np.hypot(_SCALE_SIGMA_N, _CREEP_SIGMA * truth_N)

    def residuals(parameters: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n"]:
        material = _material(parameters, width_m, height_m)
        read_N = np.array([_force_N(load, material) for load in loads])
        return np.append((read_N - truth_N) / sigma_N, (parameters[1] - _LOG_ALPHA) / _LOG_ALPHA_SIGMA)

    start_N = np.array([_force_N(load, typical_foam(width_m, height_m)) for load in loads])
    if not (len(loads) and (start_N > 0).all()):
        raise CalibrationError("known loads", "no deflection was measured", remedy="press deeper and repeat")
    start = np.array([np.log(1e4 * float(np.median(truth_N / start_N))), _LOG_ALPHA])
    # Steps of 1 %: the fitted spline of the curve is not smooth in less.
    found = least_squares(residuals, start, diff_step=0.01)
    # 1e-3 of the chi-square distribution: slips of a decimal point or of a load, not creep.
    worst = int(np.argmax(np.abs(found.fun[:-1])))
    if abs(found.fun[worst]) > 3.3:
        raise CalibrationError(
            "known loads",
            f"load {worst + 1} of {truth_N[worst]:.2f} N contradicts the others, which expect "
            f"{truth_N[worst] + found.fun[worst] * sigma_N[worst]:.2f} N",
            remedy="was it typed in grams, and held still? Repeat the loads",
        )
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return _with_covariance(_material(found.x, width_m, height_m), found.x, covariance)


def _stress_Pa(parameters: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n"]:
    modulus_Pa, alpha = np.exp(parameters)
    stretch = 1.0 - _STRAIN
    return 2 * modulus_Pa / alpha * (1 - stretch**alpha) / stretch


def _material(parameters: Float[np.ndarray, "2"], width_m: float, height_m: float) -> FoamMaterial:
    log = StrainStress(_STRAIN, _stress_Pa(parameters), np.ones(len(_STRAIN), dtype=int), "known loads")
    return calibrate_foam(log, width_m=width_m, height_m=height_m).material


def _force_N(load: PlateRecord, material: FoamMaterial) -> float:
    enlarged_N, softened_N = contour_force(load.s_m, load.delta_m, material)
    return enlarged_N - material.tension.ratio * softened_N


def _with_covariance(
    material: FoamMaterial, parameters: Float[np.ndarray, "2"], covariance: Float[np.ndarray, "2 2"]
) -> FoamMaterial:
    """The material whose curve is as uncertain as the two parameters are."""
    step = 1e-3
    slopes = [
        (_stress_Pa(parameters + step * axis) - _stress_Pa(parameters - step * axis)) / (2 * step)
        for axis in np.eye(2)
    ]
    basis = material.loading.basis(_STRAIN)
    jacobian = np.linalg.lstsq(basis, np.array(slopes).T, rcond=None)[0]
    curve = replace(material.loading, covariance=jacobian @ covariance @ jacobian.T)
    return replace(material, loading=curve)
