"""Round container with a measured outline: stiffness of its wall between two fingers, and its contents."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.measurement import AIR_PA, GRAVITY_M_S2

#: Density of PET [kg/m^3].
PET_DENSITY = 1380.0
#: Thickness of the neck with its thread [m], and the fraction of the height where it starts.
NECK_M, NECK = 0.0012, 0.9
#: Minimum volume of air, as a fraction of the container's: liquids and their container are slightly compliant.
MIN_AIR = 0.01
#: Number of iterations for the wall thickness; the stiffness is proportional to this power of it.
WALL_ROUNDS, WALL_POWER = 5, 2.3
#: Correlation length of the error of an outline, the distance of its contacts [m]; number of sampled outlines, and of bodies.
ALONG_M, OUTLINES, SAMPLES = 0.02, 16, 32
#: Radius between fingers by that of the outline at the same height: 3 mm of height on walls that widen by a sixth of it [m].
RADIUS_M = 5e-4


@dataclass(frozen=True, slots=True)
class Filling:
    """Material that may fill a container."""

    kg_per_m3: float  #: bulk density, voids included
    sigma: float  #: relative standard deviation of mass, by density and level
    solid: float  #: fraction of the bulk volume that is not air


#: Random packings fill 0.56 to 0.64 of their space; the bulk density of rice, lentils, sugar and oats is 500 to 900 kg/m^3. For
#: a liquid, an outline error of 1 mm in 30 mm is 7 % of volume, and density and level contribute as much.
FILLINGS = {"liquid": Filling(1000.0, 0.1, 1.0), "grain": Filling(750.0, 0.15, 0.6)}
EMPTY = "empty"


@dataclass(frozen=True, slots=True, eq=False)
class RoundBody:
    """Wall mass, volume, and stiffness with and without a lid, for an outline."""

    z_m: Float[np.ndarray, "k"]
    radius_m: Float[np.ndarray, "k"]
    below_m3: Float[np.ndarray, "k"]  #: volume below each height
    wall_kg: float
    stiffness_N_per_m: tuple[
        Float[np.ndarray, "k"], Float[np.ndarray, "k"]
    ]  #: open, closed; not finite at places that do not deform

    def level_m(self, fill: float) -> float:
        """Height of the level of a filling [m].

        Parameters
        ----------
        fill
            Fraction of the volume, 0 to 1.
        """
        return float(np.interp(fill * self.below_m3[-1], self.below_m3, self.z_m))

    def wall_N_per_m(self, height_m: float, closed: bool) -> float:
        """Stiffness of the empty container between two fingers [N/m].

        Parameters
        ----------
        height_m
            Height of the fingers above the foot [m].
        closed
            Whether the rim is held.
        """
        stiffness = self.stiffness_N_per_m[closed]
        given = np.isfinite(stiffness)
        return float(np.interp(height_m, self.z_m[given], stiffness[given]))

    def force_N(
        self, hypothesis: tuple[bool, str, float], height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Force of the wall with the liquid behind it, and of the enclosed air, (n) each [N].

        Parameters
        ----------
        hypothesis
            Whether it is closed, its filling, and the fill level as a fraction of its volume.
        height_m
            Height of the fingers above the foot [m].
        deformation_m
            Of one side of the wall (n) [m].
        """
        closed, filling, fill = hypothesis
        k = self.wall_N_per_m(height_m, closed)
        r = float(np.interp(height_m, self.z_m, self.radius_m))
        d = np.maximum(deformation_m, 0.0)
        solid = FILLINGS[filling].solid if filling != EMPTY else 0.0
        if solid == 1.0:
            head_m = max(self.level_m(fill) - height_m, 0.0)
            k += 3.0 * math.pi * r * FILLINGS[filling].kg_per_m3 * GRAVITY_M_S2 * head_m
        if not closed:
            return k * d, np.zeros_like(d)
        air_m3 = max(1.0 - solid * fill, MIN_AIR) * float(self.below_m3[-1])
        lost_m3 = math.pi * (3.0 * d**2 * r - d**3)
        # Lower bound of the remaining volume: before it is reached, the air is stiffer than any wall.
        pressure_Pa = AIR_PA * lost_m3 / np.maximum(air_m3 - lost_m3, 0.1 * air_m3)
        # Two fingers: 2 F dd = p dV.
        return k * d, 0.5 * pressure_Pa * math.pi * (6.0 * d * r - 3.0 * d**2)


def wall_from_stiffness(
    outline_m: Float[np.ndarray, "k 2"], stiffness_N_per_m: Sequence[tuple[float, float]], start_m: float
) -> float:
    """Wall thickness [m] with which the stiffness of a measured outline matches the measured stiffness; the modulus is that of PET.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    stiffness_N_per_m
        (height [m], stiffness [N/m]) of gentle squeezes; values that are not finite and positive are ignored.
    start_m
        Initial guess [m].

    Raises
    ------
    InputError
        No squeeze has a stiffness.
    """
    felt = [(z, k) for z, k in stiffness_N_per_m if math.isfinite(k) and k > 0]
    wall, (z_m, r_m) = start_m, _meridian(outline_m)
    for _ in range(WALL_ROUNDS):
        # In a gentle squeeze, the force of enclosed air is negligible; a lid has little effect below the rim.
        stiffness = _stiffness(z_m, r_m, wall, closed=True)
        given = np.isfinite(stiffness)
        expected = [float(np.interp(z, z_m[given], stiffness[given])) for z, _ in felt]
        ratios = [k / one for (_, k), one in zip(felt, expected, strict=True) if one > 0]
        if not ratios:
            raise InputError("wall_from_stiffness", "found no squeeze with a stiffness")
        wall *= float(np.exp(np.mean(np.log(ratios)))) ** (1 / WALL_POWER)
    return wall


def alike(z_m: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k k"]:
    """Correlation of smooth errors at heights [m], over :data:`ALONG_M`.

    Parameters
    ----------
    z_m
        Heights [m].
    """
    return np.asarray(np.exp(-0.5 * ((z_m[:, None] - z_m) / ALONG_M) ** 2))


def smooth_errors(outline_m: Float[np.ndarray, "k 2"], sigma_m: float) -> Float[np.ndarray, "k k"]:
    """Covariance of the errors of the log radii of an outline of which one standard deviation is known.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    sigma_m
        Standard deviation of the radius [m].
    """
    radius_m, z_m = outline_m.T
    return np.asarray(sigma_m**2 * alike(z_m) / np.outer(radius_m, radius_m))


def stiffness_scatter(
    outline_m: Float[np.ndarray, "k 2"], wall_m: float, sigma_m: float
) -> Float[np.ndarray, "s q"]:
    """Deviations of the logarithm of stiffness from its mean by height, of outlines with the error of the measured one.

    Parameters
    ----------
    outline_m, wall_m
        As of :func:`round_body`.
    sigma_m
        Standard deviation of the radius [m].
    """
    z, r = _meridian(outline_m)
    if sigma_m <= 0.0:
        return np.zeros((OUTLINES, len(z)))
    rng = np.random.default_rng(0)
    near = alike(z) + 1e-9 * np.eye(len(z))
    off_m = sigma_m * rng.standard_normal((OUTLINES, len(z))) @ np.linalg.cholesky(near).T
    logs = []
    for one in off_m:
        stiffness = _stiffness(z, np.maximum(r + one, 0.2 * r), wall_m, closed=False)
        logs.append(np.log(np.where(np.isfinite(stiffness), stiffness, 1.0)))
    return np.asarray(logs - np.mean(logs, axis=0))


def stiffness_samples(
    outline_m: Float[np.ndarray, "k 2"],
    errors: Float[np.ndarray, "k k"],
    wall_m: float,
    closed: float,
    *,
    height_sigma_m: float = 0.0,
    widths_m: Sequence[tuple[float, float]] = (),
) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "s q"]]:
    """Heights [m], and logarithms of the stiffness [N/m] there, of bodies that agree with what was measured.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    errors
        Covariance of the errors of its log radii.
    wall_m
        Wall thickness that fits the squeezes, see :func:`wall_from_stiffness` [m]; of the neck :data:`NECK_M`.
    closed
        Probability of a lid, which holds the rim, as where contents are identified.
    height_sigma_m
        Standard deviation of the total height, by which all heights change in proportion [m].
    widths_m
        (height, radius) where fingers touched both sides [m].
    """
    z, r = _meridian(outline_m)
    rng, many = np.random.default_rng(0), len(z)
    at = np.concatenate([z, [height for height, _ in widths_m]])
    spread = np.array([np.interp(at, outline_m[:, 1], one) for one in np.diag(outline_m[:, 0])])
    covariance = spread.T @ errors @ spread
    felt = covariance[many:, many:] + RADIUS_M**2 * np.eye(len(widths_m))
    gain = np.linalg.solve(felt, covariance[many:, :many]).T
    off_m = np.array([radius for _, radius in widths_m]) - np.interp(at[many:], z, r)
    size, modes = np.linalg.eigh(covariance[:many, :many] - gain @ covariance[many:, :many])
    modes = modes * np.sqrt(np.maximum(size, 0.0))
    logs = np.empty((SAMPLES, many))
    for k in range(SAMPLES):
        radii = np.maximum(r + gain @ off_m + modes @ rng.standard_normal(many), 0.2 * r)
        heights = z * max(1.0 + height_sigma_m / z[-1] * rng.standard_normal(), 0.5)
        log = np.log(_stiffness(heights, radii, wall_m, closed=bool(rng.random() < closed)))
        given = np.isfinite(log)  # a held rim itself does not deform
        logs[k] = np.interp(z, heights[given], log[given])
    return z, logs


def round_body(outline_m: Float[np.ndarray, "k 2"], wall_m: float) -> RoundBody:
    """Round body with a measured outline and a wall thickness.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    wall_m
        Wall thickness [m].
    """
    z, r = _meridian(outline_m)
    thickness = _thickness(z, wall_m)
    open_, closed = (_stiffness(z, r, wall_m, closed=closed) for closed in (False, True))
    slices = 0.5 * math.pi * (r[1:] ** 2 + r[:-1] ** 2) * np.diff(z)
    area = math.pi * (r[1:] + r[:-1]) * np.hypot(np.diff(r), np.diff(z))
    wall_kg = PET_DENSITY * float(np.sum(area * 0.5 * (thickness[1:] + thickness[:-1])))
    return RoundBody(z, r, np.concatenate([[0.0], np.cumsum(slices)]), wall_kg, (open_, closed))


def _meridian(outline_m: Float[np.ndarray, "k 2"]) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "q"]]:
    """Heights at equal distances, and the radius there [m]."""
    z = np.linspace(outline_m[0, 1], outline_m[-1, 1], 81)
    return z, np.interp(z, outline_m[:, 1], outline_m[:, 0])


def _thickness(z: Float[np.ndarray, "q"], wall_m: float) -> Float[np.ndarray, "q"]:
    """Thickness of the wall and of the neck [m]."""
    return np.where(z > NECK * z[-1], max(NECK_M, wall_m), wall_m)


def _stiffness(
    z: Float[np.ndarray, "q"], r: Float[np.ndarray, "q"], wall_m: float, *, closed: bool
) -> Float[np.ndarray, "q"]:
    """Stiffness between two fingers by height [N/m]."""
    from ...deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness

    shell = RevolutionShell(r, z, _thickness(z, wall_m), rim_held=closed)
    return np.asarray(pinch_stiffness(shell, "PET"))
