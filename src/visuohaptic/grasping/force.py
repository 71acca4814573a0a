"""Grip force of two fingers required to hold an object (Alt 2016, Sec. 6.2).

The dissertation names friction, weight, contents and, below the centre of mass, the friction torque against
tilting, but gives no formula. Here each finger is a soft contact with an elliptic limit
surface (Howe and Cutkosky 1996): it holds a tangential force f and a moment m about its normal as
long as ``f^2 + (m / r_t)^2 <= (mu N)^2``, with ``r_t = 2/3`` of the radius of its patch (uniform pressure
on a disc). A point contact holds no moment.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core import NON_NEGATIVE, POSITIVE, InputError, Ranged, at_least, check_numbers, within
from ..core.measurement import GRAVITY_M_S2
from ..deformation import ShellObject, liquid_level_m
from ..deformation.shells.shell import enclosed_volume

#: Moments below this are rounding errors [N m].
NO_MOMENT = 1e-9
#: Equally probable errors of the hand's position over which the probability of a slip is averaged: to less than 1 / PARTS.
PARTS = 64


@dataclass(frozen=True, slots=True)
class GripperModel(Ranged):
    """A gripper with two parallel fingers."""

    opening_m: float = field(default=0.11, metadata=POSITIVE)  #: maximum
    finger_radius_m: float = field(default=0.01, metadata=NON_NEGATIVE)  #: of the contact patch; 0 is a point
    max_force_N: float = field(default=60.0, metadata=POSITIVE)  #: of one finger
    #: mu; 0.2 for steel on polyethylene, about 1 for rubber (Alt 2016, Sec. 6.2)
    friction: float = field(default=0.6, metadata=POSITIVE)
    friction_spread: float = field(default=0.15, metadata=within(0, 1))  #: relative standard deviation of mu
    #: from the palm to the centre of the patch
    finger_length_m: float = field(default=0.06, metadata=POSITIVE)
    finger_thickness_m: float = field(default=0.012, metadata=POSITIVE)  #: along the closing direction
    #: across the closing direction, and in depth
    palm_thickness_m: float = field(default=0.06, metadata=POSITIVE)
    #: standard deviation of its centre along the closing direction: the wall unloads one finger by as much as it loads the other
    position_sigma_m: float = field(default=0.0, metadata=NON_NEGATIVE)


@dataclass(frozen=True, slots=True)
class Handling(Ranged):
    """Handling of the object after it is grasped."""

    #: of the arm, worst case upwards
    acceleration_m_per_s2: float = field(default=1.0, metadata=within(0, 1000))
    #: tilt about the grasp axis to withstand (10 degrees)
    tilt_rad: float = field(default=0.17, metadata=within(0, np.pi / 2))
    safety: float = field(default=1.5, metadata=within(1, 100))  #: safety factor of the force


@dataclass(frozen=True, slots=True)
class Load(Ranged):
    """The load to lift."""

    mass_kg: float = field(metadata=POSITIVE)
    #: centre of mass in the object's frame
    centre_m: tuple[float, float, float] = field(metadata=at_least(-np.inf))
    mass_spread: float = field(default=0.0, metadata=within(0, 1))  #: relative standard deviation of the mass


def object_load(
    container: ShellObject,
    fill: float = 0.0,
    *,
    liquid_kg_per_m3: float = 1000.0,
    wall_kg_per_m3: float | None = None,
) -> Load:
    """Mass and centre of mass of wall and liquid of an upright container.

    Parameters
    ----------
    container
        Parametric or imported container.
    fill
        Fraction of the volume that is liquid, 0 to 1.
    liquid_kg_per_m3
        Density of the liquid [kg/m^3].
    wall_kg_per_m3
        Density of the wall [kg/m^3]; that of the material by default. Required if the material is not in the
        library.

    Raises
    ------
    InputError
        A number out of range, an unknown density, or no enclosed volume.
    """
    check_numbers("object_load", within(0, 1), fill=fill)
    check_numbers("object_load", POSITIVE, liquid_kg_per_m3=liquid_kg_per_m3, wall_kg_per_m3=wall_kg_per_m3)
    mesh = container.mesh
    if wall_kg_per_m3 is None:
        wall_kg_per_m3 = container.material.density_kg_per_m3
        if wall_kg_per_m3 is None:
            raise InputError(
                f"material {container.material.name}", "has no density", remedy="give wall_kg_per_m3"
            )
    corners = mesh.vertices_m[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    wall = wall_kg_per_m3 * area * np.asarray(mesh.fraction) * np.asarray(mesh.thickness_m)
    mass, moment = float(wall.sum()), wall @ corners.mean(axis=1)
    wall_mass = mass
    if fill > 0:
        level = mesh.vertices_m[:, 2].min() + liquid_level_m(container, fill)
        cut = mesh.vertices_m.copy()
        cut[:, 2] = np.minimum(cut[:, 2], level)
        volume, first = 0.0, np.zeros(3)
        for faces, fraction in (
            (mesh.faces, np.asarray(mesh.fraction)),
            (container.lid, np.ones(len(container.lid))),
        ):
            a, b, c = (cut[faces[:, k]] for k in range(3))
            part = fraction * np.einsum("fi,fi->f", a, np.cross(b, c)) / 6
            volume += float(part.sum())
            # Tetrahedra from the origin: the foot is at z = 0, or has its own triangles.
            first = first + part @ (a + b + c) / 4
        if volume <= 0 or enclosed_volume(mesh.vertices_m, mesh.faces, mesh.fraction) <= 0:
            raise InputError(container.name, "encloses no volume that could be filled")
        # In a mesh with inner walls the cut is not exactly the requested fraction.
        liquid = liquid_kg_per_m3 * fill * container.volume_m3
        mass += liquid
        moment = moment + liquid * first / volume
    centre = moment / mass
    place = (float(centre[0]), float(centre[1]), float(centre[2]))
    return Load(mass, place, min(1.0, container.wall_spread * wall_mass / mass))


def required_force_N(
    load: Load,
    first_m: Float[np.ndarray, "m 3"],
    second_m: Float[np.ndarray, "m 3"],
    slant_rad: Float[np.ndarray, "m"],
    gripper: GripperModel,
    handling: Handling | None = None,
) -> Float[np.ndarray, "m"]:
    """Force of each finger required to hold the load [N]; infinite where friction is not sufficient.

    Parameters
    ----------
    first_m, second_m
        Contact points of the fingers.
    slant_rad
        Angle between force and inward normal: its tangential part uses part of the friction.
    load
        Mass and centre of mass.
    gripper
        Friction and radius of the fingers.
    handling
        Acceleration, tilt and safety factor.

    Notes
    -----
    With W = m (g + a), s the distance of the centre of mass from the centre of the grasp along it, b
    the width, l the horizontal distance of the centre of mass from the grasp axis and h its height
    above the axis: the finger with the larger load carries ``W (1/2 + |s| / b)``, both share the moment
    ``W (l + max(h, 0) sin tilt)``.
    """
    handling = handling or Handling()
    across = second_m - first_m
    width = np.linalg.norm(across, axis=1)
    unit = across / np.maximum(width, 1e-12)[:, None]
    offset = np.array(load.centre_m) - 0.5 * (first_m + second_m)
    along = np.einsum("mi,mi->m", offset, unit)
    rest = offset - along[:, None] * unit
    aside = np.linalg.norm(rest[:, :2], axis=1)
    above = np.maximum(rest[:, 2], 0.0)
    weight_N = load.mass_kg * (GRAVITY_M_S2 + handling.acceleration_m_per_s2)
    tangential_N = weight_N * (0.5 + np.abs(along) / np.maximum(width, 1e-12))
    moment_Nm = 0.5 * weight_N * (aside + above * np.sin(handling.tilt_rad))
    moment_Nm = np.where(moment_Nm < NO_MOMENT, 0.0, moment_Nm)
    with np.errstate(divide="ignore", invalid="ignore"):
        twist_N = np.where(moment_Nm > 0, moment_Nm / (2 / 3 * gripper.finger_radius_m), 0.0)
        left = gripper.friction * np.cos(slant_rad) - np.sin(slant_rad)
        force = handling.safety * np.hypot(tangential_N, twist_N) / left
    return np.where((left > 0) & np.isfinite(force), force, np.inf)


def success_probability(
    force_N: Float[np.ndarray, "m"],
    needed_N: Float[np.ndarray, "m"],
    slant_rad: Float[np.ndarray, "m"],
    load: Load,
    gripper: GripperModel,
    handling: Handling | None = None,
    *,
    unloaded_sigma_N: float | Float[np.ndarray, "m"] = 0.0,
) -> Float[np.ndarray, "m"]:
    """Probability that a load does not slip, with friction and mass log-normal.

    Parameters
    ----------
    force_N
        Force of each finger.
    needed_N
        Result of :func:`required_force_N`, including the safety factor.
    slant_rad
        Angle between force and inward normal.
    load, gripper
        Load and gripper with the relative standard deviations of mass and friction.
    handling
        Handling with the safety factor, which is removed again.
    unloaded_sigma_N
        Standard deviation of the force by which the position of the hand loads one finger and unloads the other, normal.

    Notes
    -----
    The required force is proportional to ``m / (mu cos - sin)``: its logarithm has the standard deviation
    ``hypot(s_m, s_mu mu cos / (mu cos - sin))``. The unloaded finger decides; its force is averaged over equally probable values.
    """
    from scipy.special import ndtr, ndtri

    handling = handling or Handling()
    hold = gripper.friction * np.cos(slant_rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.hypot(load.mass_spread, gripper.friction_spread * hold / (hold - np.sin(slant_rad)))
        unloaded = ndtri(0.5 + 0.5 * (np.arange(PARTS) + 0.5) / PARTS)[:, None] * unloaded_sigma_N
        weaker_N = np.maximum(force_N - unloaded, 1e-9)
        margin = np.log(weaker_N * handling.safety / needed_N) / np.maximum(spread, 1e-9)
        holds = ndtr(margin).mean(axis=0)
    return np.where(np.isfinite(needed_N) & (hold > np.sin(slant_rad)), holds, 0.0)
