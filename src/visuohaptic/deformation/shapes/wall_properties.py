"""Properties of a container's wall: given by the user, measured in an imported mesh, or defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ...core import POSITIVE, InputError, Ranged, load_yaml_model, within
from ..shells import IsotropicMaterial, Laminate, Ply, material_constants
from .quantities import Angle, Length, Pressure

#: Default wall thickness if neither mesh nor user specify it [m], and its relative standard deviation.
USUAL_WALL_m, USUAL_SPREAD = 0.0005, 0.1

#: Harmonics of the thickness around the wall, and rows of levels over which they are averaged.
HARMONICS, ROWS_TOGETHER = 4, 9


@dataclass(frozen=True, slots=True)
class WallProperties(Ranged):
    """Wall properties given by the user; None keeps that of the description or the mesh."""

    material: str | None = (
        None  #: name of a material of the library, or a YAML file of plies; PET by default for a mesh
    )
    thickness_m: float | None = field(default=None, metadata=POSITIVE)  #: of the whole wall
    #: relative standard deviation
    thickness_spread: float | None = field(default=None, metadata=within(0, 0.5))
    youngs_modulus_Pa: float | None = field(default=None, metadata=POSITIVE)  #: overrides the material's
    poisson_ratio: float | None = None  #: overrides the material's

    @property
    def whole_m(self) -> float | None:
        """The given thickness, or that of the plies [m]."""
        if self.thickness_m is None and self._plies is not None:
            return load_laminate(self._plies)[0].thickness_m
        return self.thickness_m

    @property
    def _plies(self) -> str | None:
        file = self.material is not None and self.material.lower().endswith((".yaml", ".yml"))
        return self.material if file else None

    def elastic_constants(
        self, material: IsotropicMaterial | Laminate, modulus_spread: float
    ) -> tuple[IsotropicMaterial | Laminate, float]:
        """Constants of the wall; given ones replace those of the description.

        Parameters
        ----------
        material
            Constants if no material is given.
        modulus_spread
            Relative standard deviation of its Young's modulus.

        Returns
        -------
        tuple
            Constants, and the relative standard deviation of the modulus: 0 for one that is given.

        Raises
        ------
        InputError
            Unknown material, or a modulus together with plies.
        """
        if self._plies is not None:
            material, modulus_spread = load_laminate(self._plies)
        elif self.material is not None:
            material, modulus_spread = material_constants(self.material)
        if self.youngs_modulus_Pa is None and self.poisson_ratio is None:
            return material, modulus_spread
        if isinstance(material, Laminate):
            raise InputError(
                self.material or material.name,
                "found a modulus or Poisson's ratio together with plies, which have their own",
                remedy="give them in the file",
            )
        given = self.youngs_modulus_Pa is not None
        # A named material keeps its name, and with it its density.
        name = "given" if given and self.material is None else material.name
        constants = IsotropicMaterial(
            self.youngs_modulus_Pa or material.youngs_modulus_Pa,
            material.poisson_ratio if self.poisson_ratio is None else self.poisson_ratio,
            name,
        )
        return constants, 0.0 if given else modulus_spread


class _PlyEntry(BaseModel):
    """One layer of a file: a material of the library, or moduli along and across the grain."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    thickness: Length  #: of the ply
    material: str | None = None  #: of the library; alternatively the moduli below
    along: Pressure | None = None  #: Young's modulus along the grain
    across: Pressure | None = None  #: Young's modulus across the grain
    shear: Pressure | None = None  #: in-plane shear modulus
    poisson: float | None = None  #: Poisson's ratio for loading along the grain
    angle: Angle = (0.0, 0.0)  #: angle of the grain from the height axis
    density: float | None = None  #: [kg/m^3]

    @model_validator(mode="after")
    def _single(self) -> _PlyEntry:
        if (self.material is None) == (self.along is None):
            raise ValueError("expected either material or along, Young's modulus along the grain")
        if self.material is not None:
            material_constants(self.material)
        return self


class _PlyFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    plies: list[_PlyEntry] = Field(min_length=1, max_length=64)  #: from the inside outwards


def load_laminate(path: Path | str) -> tuple[Laminate, float]:
    """Read plies, from the inside outwards, and the relative standard deviation of their moduli in bending.

    Parameters
    ----------
    path
        YAML file: ``plies``, each with ``thickness`` and either ``material`` of the library or ``along`` the grain,
        ``across``, ``shear``, ``poisson``, ``angle`` from the height, ``density`` [kg/m^3]. For a range, the centre is used;
        its half-width is two standard deviations.

    Raises
    ------
    InputError
        Lists all invalid fields.
    """
    plies, spreads = [], []
    for entry in load_yaml_model(path, _PlyFile).plies:
        constants, spread = material_constants(entry.material or "PET")
        along = constants.youngs_modulus_Pa
        if entry.along is not None:
            along, spread = fmean(entry.along), 0.25 * (entry.along[1] - entry.along[0]) / fmean(entry.along)
            constants = IsotropicMaterial(along, 0.3, "given")
        across, shear = (None if span is None else fmean(span) for span in (entry.across, entry.shear))
        density = constants.density_kg_per_m3 if entry.density is None else entry.density
        nu = constants.poisson_ratio if entry.poisson is None else entry.poisson
        plies.append(Ply(fmean(entry.thickness), along, nu, across, shear, fmean(entry.angle), density))
        spreads.append(spread)
    found = Laminate(tuple(plies), Path(path).stem)
    return found, float(np.linalg.norm(found.shares * spreads))


def thickness_range(low_m: float, high_m: float) -> tuple[float, float]:
    """Mean [m] and relative standard deviation of a thickness between two bounds.

    Parameters
    ----------
    low_m, high_m
        Bounds of a uniform distribution [m].

    Raises
    ------
    InputError
        Bounds that are not positive and ascending.
    """
    if not 0 < low_m < high_m < float("inf"):
        raise InputError("thickness", f"found {low_m:g} to {high_m:g} m, expected 0 < low < high")
    mean = 0.5 * (low_m + high_m)
    return mean, (high_m - low_m) / 12**0.5 / mean


def wall_thickness(
    measured_m: Float[np.ndarray, "k 2"], measured_spread: float, given: WallProperties
) -> tuple[Float[np.ndarray, "k 2"], float, list[str]]:
    """Thickness of an imported wall by height.

    Parameters
    ----------
    measured_m
        Heights and the distance of two surfaces there [m]; empty for a mesh of one surface.
    measured_spread
        Relative standard deviation of that distance around the wall.
    given
        Thickness [m] and its relative standard deviation given by the user, or None.

    Returns
    -------
    tuple
        Heights and thickness there [m], relative standard deviation, notes for the user.
    """
    thickness_m, spread = given.whole_m, given.thickness_spread
    if not len(measured_m):
        one = USUAL_WALL_m if thickness_m is None else thickness_m
        notes = [] if thickness_m else [f"the mesh has one surface: its wall is taken as {1e3 * one:.2g} mm"]
        return np.array([[0.0, one]]), USUAL_SPREAD if spread is None else spread, notes
    usual = float(np.median(measured_m[:, 1]))
    measured = f"{1e3 * usual:.3g} mm ± {100 * measured_spread:.2f} %"
    if thickness_m is None:
        low, high = 1e3 * measured_m[:, 1].min(), 1e3 * measured_m[:, 1].max()
        said = f"the wall is as thick as measured: {measured} by the median, {low:.2g} to {high:.2g} mm along the height"
        return measured_m, measured_spread if spread is None else spread, [said]
    spread = USUAL_SPREAD if spread is None else spread
    notes = []
    # Two-sided, at 5 %: the standard deviations of both add up.
    if abs(thickness_m - usual) > 1.96 * np.hypot(spread * thickness_m, measured_spread * usual):
        notes = [
            f"the thickness given, {1e3 * thickness_m:.2g} mm, contradicts the mesh, {measured}; it is used"
        ]
    return np.array([[0.0, thickness_m]]), spread, notes


def measured_thickness(
    first: Float[np.ndarray, "h a"], pair: Float[np.ndarray, "h a"], heights: Float[np.ndarray, "h"]
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k h"], float]:
    """Thickness by height, its variation around the wall, and the relative standard deviation of the remainder.

    The horizontal distance of two close surfaces ``r = R(angle, z)`` is ``sqrt(1 + (R_angle / R)^2 + R_z^2)``
    times that along the normal. A row is the median around the wall, which excludes a handle. An uneven wall
    (eccentric, oval, four corners) is a short Fourier series over it; the remainder of each row (facets, noise of a
    scan) is the deviation, also from the median.

    Parameters
    ----------
    first, pair
        Radius of the inner and the outer surface at each height and angle [m], not finite where there is none.
    heights
        Heights of the rows [m].

    Returns
    -------
    tuple
        Heights and thickness [m], coefficients of :func:`harmonics` (a factor on the thickness), relative standard deviation.
    """
    middle = (first + pair) / 2
    middle[~np.isfinite(middle)] = np.nan
    step = 2 * np.pi / first.shape[1]
    turn = (np.roll(middle, -1, axis=1) - np.roll(middle, 1, axis=1)) / (2 * step * middle)
    rise = np.gradient(middle, heights, axis=0)
    local = (pair - first) / np.sqrt(1 + turn**2 + rise**2)
    known = np.isfinite(local).mean(axis=1) > 0.5
    usual = row_median(local)[known]
    ratio = local[known] / usual
    uneven = _fitted(ratio)
    left = np.abs(np.log(ratio / (uneven @ harmonics(step * np.arange(first.shape[1])).T)))
    spread = float(np.nanmedian(left) / 0.6745)  # of a normal distribution
    height, thick = heights[known], usual[:, 0]
    # A lip is rounded within one thickness of the rim: a shell does not resolve this, and a force spreads as far.
    below = max(1, int(np.sum(height <= height[-1] - np.median(thick))))
    thick[below:], uneven[below:] = thick[below - 1], uneven[below - 1]
    return np.column_stack([height, thick]), uneven, spread


def harmonics(angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n h"]:
    """1, cosines and sines of the multiples of an angle.

    Parameters
    ----------
    angle
        About the height axis [rad].
    """
    turns = np.arange(1, HARMONICS + 1) * angle[:, None]
    return np.concatenate([np.ones((len(angle), 1)), np.cos(turns), np.sin(turns)], axis=1)


def _fitted(ratio: Float[np.ndarray, "k a"]) -> Float[np.ndarray, "k h"]:
    """Coefficients of each row from those around it; outliers (a handle) count as 1."""
    from scipy.ndimage import uniform_filter1d

    clean = np.where(np.abs(np.log(ratio)) < np.log(2.0), ratio, 1.0)
    terms = harmonics(2 * np.pi * np.arange(ratio.shape[1]) / ratio.shape[1])
    # Orthogonal on equally spaced angles: least squares are means.
    out = clean @ terms / np.einsum("ah,ah->h", terms, terms)
    return np.asarray(uniform_filter1d(out, ROWS_TOGETHER, axis=0, mode="nearest"))


def row_median(values: Float[np.ndarray, "h a"]) -> Float[np.ndarray, "h 1"]:
    """Median of each row, ignoring NaN; NaN if a row contains only NaN.

    Parameters
    ----------
    values
        Array of any values.
    """
    out = np.full((len(values), 1), np.nan)
    some = np.isfinite(values).any(axis=1)
    out[some, 0] = np.nanmedian(values[some], axis=1)
    return out
