"""Foam rods whose cross section is thinner at the front (Alt 2016, Fig. 3.2 and 3.4).

Symbols: y position through the width, h(y) height of the section there, N force
per length of the strip. Slabs of the rod are columns of foam in series: all
carry the same N, so that the thin front compresses first,

    m(eps(y)) = N / h(y),    strain of the rod = mean over y of eps(y),

and the stress of the rod is N / h with the full height h, "related to the same
area" as the rectangle for comparison.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ....core.errors import InputError
from .calibration import fit_curve, plateau
from .foam_material import FoamMaterial
from .stress_curve import StressCurve

Section = Literal["rectangle", "triangle", "trapezoid"]

#: Height of the front of each section relative to its back; a triangle is truncated at a fiftieth,
#: because the stress at a sharp edge is infinite.
FRONT_RATIO: dict[Section, float] = {"rectangle": 1.0, "triangle": 0.02, "trapezoid": 0.5}

#: Slabs in series: their midpoint rule is exact to 1e-4.
_SLABS = 200
#: Camera of Fig. 3.4: distance d [m], focal length f [px], and angle gamma between the line of sight and the deflection.
_DISTANCE_M, _FOCAL_PX, _GAMMA_RAD = 0.3, 1800.0, np.radians(70.0)


def section_height(section: Section, y_relative: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Height of a cross section relative to its back.

    Parameters
    ----------
    section
        Shape of the cross section.
    y_relative
        Position through the width, 0 at the back, 1 at the front.
    """
    if section not in FRONT_RATIO:
        raise InputError("section", f"found {section!r}, expected one of {', '.join(FRONT_RATIO)}")
    return 1.0 - (1.0 - FRONT_RATIO[section]) * y_relative


def section_stress(
    curve: StressCurve, section: Section
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Strain of the rod and its stress related to the full height [Pa].

    The table ends where the front slab reaches the end of the calibration of the base
    material; beyond it the stress of a rod is unknown. For the triangle, whose sharp front
    is crushed at any load, the curve of the slabs is extrapolated along its tangent, at most
    to a strain of 0.9, and the table ends when half of the rod is beyond the calibration.

    Parameters
    ----------
    curve
        Loading curve of the foam itself.
    section
        Shape of the cross section.
    """
    height = section_height(section, (np.arange(_SLABS) + 0.5) / _SLABS)
    # Inverse of the monotone curve by a dense table.
    strain = np.linspace(0.0, curve.max_strain, 4000)
    stress = curve.stress(strain)
    end_slope = float(curve.slope(np.array(curve.max_strain)))
    load = stress[-1] * np.linspace(0.0, 1.0, 400) ** 1.5
    load = load * (0.5 if section == "triangle" else FRONT_RATIO[section])
    local = load[:, None] / height[None, :]
    inside = np.interp(local, stress, strain)
    # Foam densifies: the tangent underestimates its stiffness, and the strain is limited.
    beyond = np.maximum(local - stress[-1], 0.0) / end_slope
    limit = max(0.9, curve.max_strain)
    return np.minimum(inside + beyond, limit).mean(axis=1), load


def section_material(material: FoamMaterial, section: Section) -> FoamMaterial:
    """Material of a rod of the given section, cut from the same foam as the rectangle.

    The covariance is propagated by finite differences of the parameters. The rod
    has no unloading curve and keeps the tension ratio; for better accuracy both are
    calibrated on the rod itself.

    Parameters
    ----------
    material
        Foam calibrated as a rectangle.
    section
        Shape of the cross section.
    """
    if section == "rectangle":
        return replace(material, section=section)
    strain, stress = section_stress(material.loading, section)
    strain, keep = np.unique(strain, return_index=True)
    stress = stress[keep]
    fit = fit_curve(strain, stress, where=f"{section} section")
    base = material.loading
    design = fit.curve.basis(strain)
    inverse = np.linalg.pinv(design)
    deviations, directions = np.linalg.eigh(base.covariance)
    columns = []
    for variance, direction in zip(deviations, directions.T, strict=True):
        # One standard deviation along each principal direction: a step of the relevant size.
        shift = np.sqrt(max(variance, 0.0)) * direction
        if not np.any(shift):
            continue
        moved = replace(base, parameters=base.parameters + shift)
        if moved.minimum_slope()[1] <= 0:
            shift = 0.1 * shift
            moved = replace(base, parameters=base.parameters + shift)
            factor = 10.0
        else:
            factor = 1.0
        other = section_stress(moved, section)
        columns.append(factor * (inverse @ (np.interp(strain, *other) - stress)))
    jacobian = np.array(columns).reshape(len(columns), design.shape[1])
    curve = replace(fit.curve, covariance=jacobian.T @ jacobian)
    working, densification = plateau(curve)
    return replace(
        material,
        loading=curve,
        unloading=None,
        unloading_peak_strain=0.0,
        hysteresis=None,
        working_strain=working,
        densification_strain=densification,
        residual_Pa=float(np.hypot(material.residual_Pa, fit.residual_Pa)),
        section=section,
    )


def sensitivity(material: FoamMaterial, strain: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "n"]:
    """Change of pressure per pixel, Eq. (3.9): ``dm/d delta * d / (f sin gamma)`` [Pa/px], for the camera of Fig. 3.4.

    The printed sin^-1 means 1 / sin.

    Parameters
    ----------
    material
        Calibrated foam.
    strain
        Compressive strain.
    """
    pixel_m = _DISTANCE_M / (_FOCAL_PX * np.sin(_GAMMA_RAD))
    return material.slope(strain) / material.width_m * pixel_m
