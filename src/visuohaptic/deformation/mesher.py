"""Structured shell meshes of containers: exactly symmetric, in milliseconds (Alt 2016, Sec. 6.1.2)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..errors import InputError
from .container import ContainerDescription
from .material import IsotropicMaterial, material
from .patches import grid_faces
from .profile import Profile
from .shell import ShellMesh, ShellModel, enclosed_volume

__all__ = ["ShellObject", "mesh_container", "mesh_rings", "ring_lid", "with_elastic_base"]

#: Thickness of a stiff cap that has none of its own [m].
STIFF_CAP_M = 0.005
#: Rings towards a free rim are down to this share of the others, over RIM_CELLS of them.
FINEST_SHARE, RIM_CELLS = 0.35, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class ShellObject:
    """A container as a shell: what is needed for stiffness maps."""

    mesh: ShellMesh  #: z is the height axis, the foot is at z = 0
    fixed: Bool[np.ndarray, "v"]  #: vertices of the foot
    lid: Int[np.ndarray, "l 3"]  #: triangles that close the volume; they have no stiffness
    axis_point_m: tuple[float, float]  #: x and y of the height axis
    material: IsotropicMaterial
    youngs_modulus_spread: float = 0.0  #: relative standard deviation
    wall_spread: float = 0.1  #: relative standard deviation of the thickness
    name: str = "object"
    notes: tuple[str, ...] = ()  #: what was guessed or repaired, for people
    springs: Float[np.ndarray, "v 6"] | None = None  #: elastic base [N/m], see :func:`with_elastic_base`

    @property
    def height_m(self) -> float:
        """From the foot to the highest vertex."""
        return float(np.ptp(self.mesh.vertices_m[:, 2]))

    @property
    def surface_faces(self) -> Int[np.ndarray, "f 3"]:
        """Triangles that cover the wall once, for files and pictures."""
        return self.mesh.faces[self.covers_once]

    @property
    def covers_once(self) -> Bool[np.ndarray, "f"]:
        """Which triangles cover the wall once."""
        share = np.asarray(self.mesh.share)
        # Of the four halves of a crossed cell, the first two are one way to cut it.
        out: np.ndarray = (share == 1.0) | (np.arange(len(share)) % 4 < 2)
        return out

    @property
    def volume_m3(self) -> float:
        """Enclosed volume, the foot and the mouth taken as planes."""
        mesh = self.mesh
        return enclosed_volume(mesh.vertices_m, mesh.faces, mesh.share) + enclosed_volume(
            mesh.vertices_m, self.lid
        )

    def model(self) -> ShellModel:
        """Linear elastic shell, the foot clamped or on its springs."""
        return ShellModel(self.mesh, self.material, self.fixed, springs=self.springs)


def mesh_container(container: ContainerDescription, *, around: int = 64) -> ShellObject:
    """Shell of a container without ranges.

    Parameters
    ----------
    container
        Description; see :meth:`.ContainerDescription.middle` and ``variant`` for classes.
    around
        Vertices round the wall, a multiple of 4. Rings are about as far apart as these, closer
        at reinforcement rings and towards a free rim.
    """
    if around % 4 or not 8 <= around <= 2048:
        raise InputError(
            "mesh_container", f"found {around}, expected a multiple of 4 from 8 to 2048", field="around"
        )
    profile = Profile.of(container)
    z = _ring_heights(profile, around, free=container.top.kind == "open")
    if len(z) * around > 400_000:
        raise InputError(
            f"container {container.name}",
            f"would have {len(z) * around} vertices, expected at most 400000",
            remedy="lower around, or shorten sections and widen rings",
        )
    points = profile.ring(z, around)
    thickness = profile.wall_m(0.5 * (z[:-1] + z[1:]))
    cap = None
    if container.top.kind != "open":
        default = container.wall[0] if container.top.kind == "closed" else STIFF_CAP_M
        cap = container.top.wall[0] if container.top.wall else default
    entry = material(container.material)
    constants = IsotropicMaterial.of(entry)
    spread = entry.youngs_modulus_Pa.sigma / entry.youngs_modulus_Pa.value if entry.youngs_modulus_Pa else 0.0
    if container.youngs_modulus:
        constants = IsotropicMaterial(container.youngs_modulus[0], constants.poisson_ratio, constants.name)
    mesh, lid = mesh_rings(points, thickness, cap_m=cap)
    return ShellObject(
        mesh,
        np.arange(len(mesh.vertices_m)) < around,
        lid,
        (0.0, 0.0),
        constants,
        spread,
        container.wall_spread[0],
        container.name,
    )


def with_elastic_base(thing: ShellObject, stiffness_N_per_m: float) -> ShellObject:
    """The object on springs instead of a clamped foot.

    Parameters
    ----------
    thing
        Container with a clamped foot.
    stiffness_N_per_m
        Of the whole foot in each direction, spread evenly along it; the foot may turn and go out of
        round, as on a soft mat.
    """
    if not 0 < stiffness_N_per_m < float("inf"):
        raise InputError("with_elastic_base", f"found {stiffness_N_per_m} N/m, expected > 0")
    if not thing.fixed.any():
        raise InputError("with_elastic_base", f"{thing.name} has no clamped foot")
    used = np.zeros_like(thing.fixed)
    used[thing.mesh.faces] = True
    foot = np.flatnonzero(thing.fixed & used)
    edges = thing.mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = np.unique(np.sort(edges[np.isin(edges, foot).all(axis=1)], axis=1), axis=0)
    ends = thing.mesh.vertices_m[edges]
    length = np.repeat(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), 2)
    weight = np.bincount(edges.ravel(), length, minlength=len(thing.fixed))
    if not weight.any():
        weight[foot] = 1.0
    springs = np.zeros((len(weight), 6))
    springs[:, :3] = (stiffness_N_per_m * weight / weight.sum())[:, None]
    return replace(thing, fixed=np.zeros_like(thing.fixed), springs=springs)


def mesh_rings(
    points: Float[np.ndarray, "m n 3"],
    thickness_m: Float[np.ndarray, "k"],
    *,
    cap_m: float | None = None,
) -> tuple[ShellMesh, Int[np.ndarray, "l 3"]]:
    """Shell through closed rings from below upwards, with a flat cap or a mouth.

    Parameters
    ----------
    points
        m rings of n vertices, counter-clockwise from above.
    thickness_m
        Of the m - 1 bands between rings.
    cap_m
        Thickness of the cap, or None for an open mouth.

    Returns
    -------
    ShellMesh, lid
        Vertex = ring * n + place; then those of the cap. ``lid`` closes an open mouth.
    """
    rings, around = points.shape[:2]
    vertices = [points.reshape(-1, 3)]
    faces = [grid_faces(around, rings - 1, closed=True, crossed=True)]
    thickness = [np.repeat(thickness_m, 4 * around)]
    share = [np.full(len(faces[0]), 0.5)]
    top = (rings - 1) * around
    lid = np.zeros((0, 3), dtype=np.int64)
    if cap_m is None:
        lid = ring_lid(top + np.arange(around))
    else:
        centre = points[-1].mean(axis=0)
        steps = max(2, round(around / 12))
        inner = np.linspace(1.0, 0.0, steps + 1)[1:-1]
        vertices.append((centre + inner[:, None, None] * (points[-1] - centre)).reshape(-1, 3))
        vertices.append(centre[None])
        faces.append(grid_faces(around, steps - 1, closed=True, crossed=True) + top)
        last = top + (steps - 1) * around
        place = np.arange(around)
        faces.append(np.stack([last + place, last + (place + 1) % around, np.full(around, last + around)], 1))
        share += [np.full(len(faces[1]), 0.5), np.ones(around)]
        thickness.append(np.full(len(faces[1]) + around, cap_m))
    mesh = ShellMesh(
        np.concatenate(vertices), np.concatenate(faces), np.concatenate(thickness), np.concatenate(share)
    )
    return mesh, lid


def ring_lid(loop: Int[np.ndarray, "n"]) -> Int[np.ndarray, "l 3"]:
    """Triangles over a ring of vertices that join each to its mirror image."""
    around = len(loop)
    out = []
    for place in range(around // 2):
        a, b = place, place + 1
        c, d = (around - place) % around, around - place - 1
        if a != c:
            out.append((a, b, c))
        if b != d:
            out.append((b, d, c))
    return loop[np.array(out, dtype=np.int64).reshape(-1, 3)]


def _ring_heights(profile: Profile, around: int, *, free: bool) -> Float[np.ndarray, "m"]:
    z = profile.z_m
    slant = np.hypot(
        np.diff(z), np.maximum(np.abs(np.diff(profile.radius_x_m)), np.abs(np.diff(profile.radius_y_m)))
    )
    length = np.concatenate([[0.0], np.cumsum(slant)])
    mean = 0.5 * (profile.radius_x_m + profile.radius_y_m)
    spacing = np.full_like(z, 2 * np.pi * float(np.max(mean)) / around)
    if free:
        away = (length[-1] - length) / (RIM_CELLS * spacing)
        spacing = spacing * np.minimum(1.0, FINEST_SHARE + (1 - FINEST_SHARE) * away)
    density = np.concatenate([[0.0], np.cumsum(slant * 0.5 * (1 / spacing[1:] + 1 / spacing[:-1]))])
    marks = np.interp(profile.breaks_m, z, density)
    out = [np.zeros(1)]
    for low, high in itertools.pairwise(marks):
        count = max(1, int(np.ceil(high - low - 0.3)))
        out.append(np.interp(np.linspace(low, high, count + 1)[1:], density, z))
    found = np.concatenate(out)
    found[-1] = z[-1]
    return found
