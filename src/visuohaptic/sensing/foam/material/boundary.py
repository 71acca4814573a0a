"""How the foam beside a contact carries load: three laws for the boundary effect (Alt 2016, Sec. 3.2).

Symbols: eps = delta / w strain, theta slope angle of the front contour
(tan theta = d delta / d s), m(eps) calibrated stress, h height, w width, F force.

``local``
    Only the touched points are included. Underestimates the force, because the flanks pull as well.
``enlarged``
    Published baseline: every deflected point is included, ``F = h * integral m ds``.
``tension``
    A Pasternak foundation whose tension depends on the strain,

        p h = h m - (T delta')' + T' delta'^2 / 2,    T(eps) = kappa h w G(eps) / 3.

    With a constant T the tension cancels in the integral over a whole impression
    and the law gives the same force as ``enlarged``. Because foam softens, the remaining force is

        F = h * integral [ m(eps) + kappa / 6 * dG/deps * sin(theta)^2 ] ds,

    with sin(theta) instead of delta' because steep flanks rotate more than they
    shear. G follows from m, see :mod:`~visuohaptic.sensing.foam.material.tension`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ....core.errors import CalibrationError
from .foam_material import FoamMaterial
from .records import PlateRecord
from .tension import Tension, softening

Boundary = Literal["tension", "enlarged", "local"]
#: Relative scatter of the force of a calibrating plate about the law, from depth to depth.
PLATE_SIGMA = 0.002
#: Error of the calibrated law by the force that sheared foam bears, ``h * integral m sin(theta)^2 ds``. Over seven bodies on
#: five simulated foams this is the most likely value, and that of parts which scale with the whole force or with the
#: tension is zero: the errors are 1.0 standard deviations (rms; 0.8 to 1.3 on each foam), 89 % are within 1.645.
SHEARED_SIGMA = 0.05
BOUNDARIES: tuple[Boundary, ...] = ("local", "enlarged", "tension")  #: index = number used by the kernel


def contour_force(
    s_m: Float[np.ndarray, "k"], delta_m: Float[np.ndarray, "k"], material: FoamMaterial
) -> tuple[float, float]:
    """Force of one whole impression by the enlarged law, and its reduction for unit kappa.

    The force of the tension law is ``first - kappa * second``. Trapezoid rule on
    the actual spacing of the points.

    Parameters
    ----------
    s_m
        Increasing positions along the strip [m].
    delta_m
        Deflection at them [m].
    material
        Calibrated foam.

    Returns
    -------
    tuple of float
        Force of the enlarged law, and its reduction for kappa = 1 [N].
    """
    strain = np.maximum(delta_m, 0.0) / material.width_m
    spacing = np.diff(s_m)
    enlarged = material.height_m * float(np.trapezoid(material.stress(strain), s_m))
    slope = np.diff(np.maximum(delta_m, 0.0)) / spacing
    middle = 0.5 * (strain[1:] + strain[:-1])
    sine2 = slope**2 / (1 + slope**2)
    return enlarged, material.height_m * float(softening(material.narrow, middle) @ (sine2 * spacing))


def calibrate_tension(
    records: Sequence[PlateRecord],
    material: FoamMaterial,
    *,
    spacing_m: float = 0.003,
    where: str = "plate records",
) -> Tension:
    """Fit kappa and lambda to contours under a body that is narrower than the strip.

    The contours are resampled at the point spacing of the sensor (mean over
    eight phases), because the slope of the flank of a plate depends on the spacing. The forces F of all depths obey
    ``F_enlarged / F - 1 = kappa relief / F + lambda c int h m eps^2 ds / F + e``, with the part c that remains at the
    breadth of the plate; e is the scatter of a plate, that of the residuals, and the errors that all depths share: of the law by
    sheared foam, and of the curve, from which another press differs. lambda has its prior.

    Parameters
    ----------
    records
        Contours at several depths, with the force on the body.
    material
        Calibrated foam.
    spacing_m
        Distance between the points of the sensor [m].
    where
        Source named in error messages.

    Raises
    ------
    CalibrationError
        The plate covers the whole record, or its forces do not fit the material.
    """
    material = replace(material, tension=Tension())
    taken, rows, bases = [], [], []
    for record in records:
        top = float(record.delta_m.max())
        if not 0.04 * material.width_m <= top <= material.densification_strain * material.width_m:
            continue
        ends = max(float(record.delta_m[0]), float(record.delta_m[-1]))
        if ends > 0.05 * top:
            raise CalibrationError(
                where,
                f"at depth {record.depth_m:g} m the contour ends {ends * 1e3:.2f} mm deep, expected 0",
                remedy="use a plate narrower than the strip and record the contour beyond its flanks",
            )
        taken.append(record.force_N)
        effects, basis = _effects(record, material, spacing_m)
        rows.append(effects)
        bases.append(basis / record.force_N)
    if len(taken) < 2:
        raise CalibrationError(
            where,
            f"found {len(taken)} usable depths between strain 0.04 and densification, expected 2 or more",
        )
    enlarged, effect, sheared, lateral = np.array(rows).T / np.array(taken)
    excess = enlarged - 1
    weight = float(effect @ effect)
    worst = float(np.max(np.abs(excess)))
    if worst > 0.25:
        raise CalibrationError(
            where,
            f"the forces differ by {100 * worst:.0f} % from the material's curve, expected less than 25 %",
            remedy="calibrate with the same strip; check its height and width",
        )
    if weight < 1e-6:
        raise CalibrationError(where, "the contours have no flanks", remedy="use a narrower plate")
    design = np.column_stack([effect, lateral])
    curve = np.array(bases) @ material.loading.covariance @ np.array(bases).T
    (kappa, expansion), covariance = _regressed(
        design, excess, SHEARED_SIGMA**2 * np.outer(sheared, sheared) + curve, material.tension.lateral_sigma
    )
    sigma, expansion_sigma = (float(x) for x in np.sqrt(np.diag(covariance)))
    if not -2 * sigma <= kappa <= 2.0:
        raise CalibrationError(
            where,
            f"found a tension ratio of {kappa:.2f} +- {sigma:.2f}, expected 0 to 2",
            remedy="the plate and the strip calibration disagree; repeat both",
        )
    correlation = float(covariance[0, 1]) / (sigma * expansion_sigma)
    return Tension(max(float(kappa), 0.0), sigma, True, float(expansion), expansion_sigma, correlation)


def _regressed(
    design: Float[np.ndarray, "n 2"],
    excess: Float[np.ndarray, "n"],
    common: Float[np.ndarray, "n n"],
    lateral_sigma: float,
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Posterior mean and covariance of kappa, with a flat prior, and lambda; ``common`` is the covariance that depths share."""
    information, variance = np.diag([0.0, lateral_sigma**-2]), PLATE_SIGMA**2
    for _ in range(2):  # the second fit uses the residuals of the first one
        weighted = np.linalg.solve(variance * np.eye(len(excess)) + common, design)
        covariance = np.linalg.inv(design.T @ weighted + information)
        mean = covariance @ weighted.T @ excess
        variance = PLATE_SIGMA**2 + float(np.mean((excess - design @ mean) ** 2))
    return mean, covariance


def _effects(
    record: PlateRecord, material: FoamMaterial, spacing_m: float
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "p"]]:
    """Forces of a contour as the sensor samples it [N]: enlarged law, relief, of sheared foam, by lambda; and by parameters of the curve [m^2]."""
    samples = []
    for phase in np.arange(8) / 8:
        s = np.arange(record.s_m[0] + phase * spacing_m, record.s_m[-1], spacing_m)
        delta = np.maximum(np.interp(s, record.s_m, record.delta_m), 0.0)
        stress, tangent = material.stress(delta / material.width_m), np.diff(delta) / np.diff(s)
        borne = 0.5 * (stress[1:] + stress[:-1]) * np.diff(s) * tangent**2 / (1 + tangent**2)
        samples.append([*contour_force(s, delta, material), material.height_m * borne.sum()])
    strain = np.maximum(record.delta_m, 0.0) / material.width_m
    basis = material.height_m * np.trapezoid(material.loading.basis(strain), record.s_m, axis=0)
    _, lateral_N = material.expansion_N(basis[None], strain.max(keepdims=True))
    return np.array([*np.mean(samples, axis=0), -lateral_N[0]]), basis
