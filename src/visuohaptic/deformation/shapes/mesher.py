"""Structured shell meshes of containers: exactly symmetric, in milliseconds (Alt 2016, Sec. 6.1.2)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import POSITIVE, InputError, check_numbers
from ..shells import IsotropicMaterial, Laminate, material_constants
from ..shells.shell import ShellMesh, ShellModel, enclosed_volume
from .container import ContainerDescription
from .wall_profile import WallProfile

#: Default thickness of a stiff cap [m].
STIFF_CAP_M = 0.005
#: Refinement towards a free rim: distance in cells of the wall, relative height of the cells, number of doublings around.
#: A force on an edge bends it within a few cells, as sharply around the rim as along the wall: finer rings
#: alone are not sufficient.
RIM_ZONES = ((3.0, 0.5, 2), (1.5, 0.35, 4))


@dataclass(frozen=True, slots=True, eq=False)
class ShellObject:
    """A container as a shell: the input of a stiffness map."""

    mesh: ShellMesh  #: z is the height axis, the foot is at z = 0
    fixed: Bool[np.ndarray, "v"]  #: vertices of the foot
    lid: Int[np.ndarray, "l 3"]  #: triangles that close the volume; without stiffness
    axis_point_m: tuple[float, float]  #: x and y of the height axis
    material: IsotropicMaterial | Laminate
    youngs_modulus_spread: float = 0.0  #: relative standard deviation
    wall_spread: float = 0.1  #: relative standard deviation of the thickness
    name: str = "object"
    notes: tuple[str, ...] = ()  #: guesses and repairs, for display
    springs: Float[np.ndarray, "v 6"] | None = None  #: elastic base [N/m], see :func:`with_elastic_base`

    @property
    def height_m(self) -> float:
        """Distance from the foot to the highest vertex."""
        return float(np.ptp(self.mesh.vertices_m[:, 2]))

    @property
    def surface_faces(self) -> Int[np.ndarray, "f 3"]:
        """Triangles that cover the wall once, for files and figures."""
        return self.mesh.faces[self.covers_once]

    @property
    def covers_once(self) -> Bool[np.ndarray, "f"]:
        """Mask of triangles that cover the wall once."""
        fraction = np.asarray(self.mesh.fraction)
        # Of the four halves of a cell with both diagonals, the first two belong to one diagonal.
        out: np.ndarray = (fraction == 1.0) | (np.arange(len(fraction)) % 4 < 2)
        return out

    @property
    def volume_m3(self) -> float:
        """Enclosed volume, with plane foot and mouth."""
        mesh = self.mesh
        return enclosed_volume(mesh.vertices_m, mesh.faces, mesh.fraction) + enclosed_volume(
            mesh.vertices_m, self.lid
        )

    def model(self) -> ShellModel:
        """Linear elastic shell with the foot clamped or on its springs."""
        return ShellModel(self.mesh, self.material, self.fixed, springs=self.springs)


def mesh_container(
    container: ContainerDescription, *, around: int = 72, even: bool = False, levels: int = 0
) -> ShellObject:
    """Shell of a container without ranges.

    Parameters
    ----------
    container
        Description; see :meth:`.ContainerDescription.middle` and ``variant`` for classes.
    around
        Vertices around the wall, a multiple of 4. The distance of the rings is about the same, smaller
        at reinforcement rings; towards a free rim they are closer and have two to four times as many vertices.
    even
        The same number of vertices in all rings.
    levels
        Divide the height into this many equal parts with a ring at the centre of each, where the features are.
    """
    if around % 4 or not 8 <= around <= 2048:
        raise InputError(
            "mesh_container", f"found {around}, expected a multiple of 4 from 8 to 2048", field="around"
        )
    profile = WallProfile.of(container)
    marks = (np.arange(levels) + 0.5) * profile.height_m / max(levels, 1)
    z, counts = _ring_heights(profile, around, marks, free=container.top.kind == "open")
    if even:
        counts[:] = around
    if counts.sum() > 400_000:
        raise InputError(
            f"container {container.name}",
            f"would have {counts.sum()} vertices, expected at most 400000",
            remedy="lower around, or shorten sections and widen rings",
        )
    points: list[np.ndarray] = []
    for count, some in itertools.groupby(range(len(z)), key=lambda ring: int(counts[ring])):
        points += list(profile.ring(z[list(some)], count))
    thickness = profile.wall_m(0.5 * (z[:-1] + z[1:]))
    cap = None
    if container.top.kind != "open":
        default = container.wall[0] if container.top.kind == "closed" else STIFF_CAP_M
        cap = container.top.wall[0] if container.top.wall else default
    constants, spread = material_constants(container.material)
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


def with_elastic_base(container: ShellObject, stiffness_N_per_m: float) -> ShellObject:
    """The object on springs instead of a clamped foot.

    Parameters
    ----------
    container
        Container with a clamped foot.
    stiffness_N_per_m
        Stiffness of the whole foot in each direction, distributed evenly along it; the foot may rotate and become
        non-circular, as on a soft mat.
    """
    check_numbers("with_elastic_base", POSITIVE, stiffness_N_per_m=stiffness_N_per_m)
    if not container.fixed.any():
        raise InputError("with_elastic_base", f"{container.name} has no clamped foot")
    used = np.zeros_like(container.fixed)
    used[container.mesh.faces] = True
    foot = np.flatnonzero(container.fixed & used)
    edges = container.mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = np.unique(np.sort(edges[np.isin(edges, foot).all(axis=1)], axis=1), axis=0)
    ends = container.mesh.vertices_m[edges]
    length = np.repeat(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), 2)
    weight = np.bincount(edges.ravel(), length, minlength=len(container.fixed))
    if not weight.any():
        weight[foot] = 1.0
    springs = np.zeros((len(weight), 6))
    springs[:, :3] = (stiffness_N_per_m * weight / weight.sum())[:, None]
    return replace(container, fixed=np.zeros_like(container.fixed), springs=springs)


def mesh_rings(
    points: Sequence[Float[np.ndarray, "n 3"]],
    thickness_m: Float[np.ndarray, "k"],
    *,
    cap_m: float | None = None,
) -> tuple[ShellMesh, Int[np.ndarray, "l 3"]]:
    """Shell through closed rings from below upwards, with a flat cap or a mouth.

    Parameters
    ----------
    points
        m rings of vertices, counter-clockwise from above; each has as many as the one below, a
        multiple of 4, or twice as many.
    thickness_m
        Thickness of the m - 1 bands between rings.
    cap_m
        Thickness of the cap, or None for an open mouth.

    Returns
    -------
    ShellMesh, lid
        Vertices, ring by ring, then those of the cap. ``lid`` closes an open mouth.
    """
    counts = [len(ring) for ring in points]
    begin = np.concatenate([[0], np.cumsum(counts)])
    around, top = counts[-1], int(begin[-2])
    vertices = list(points)
    faces, thickness, fraction = [], [], []
    for band, (below, above) in enumerate(itertools.pairwise(counts)):
        even = below == above
        # A band is a multiple of four triangles: see ShellObject.covers_once.
        some = grid_faces(below, 1, closed=True, crossed=True) if even else _doubling_faces(below)
        faces.append(some + begin[band])
        thickness.append(np.full(len(some), thickness_m[band]))
        fraction.append(np.full(len(some), 0.5 if even else 1.0))
    lid = np.zeros((0, 3), dtype=np.int64)
    if cap_m is None:
        lid = ring_lid(top + np.arange(around))
    else:
        centre = points[-1].mean(axis=0)
        steps = max(2, round(around / 12))
        inner = np.linspace(1.0, 0.0, steps + 1)[1:-1]
        vertices.append((centre + inner[:, None, None] * (points[-1] - centre)).reshape(-1, 3))
        vertices.append(centre[None])
        flat = grid_faces(around, steps - 1, closed=True, crossed=True) + top
        last = top + (steps - 1) * around
        place = np.arange(around)
        tip = np.stack([last + place, last + (place + 1) % around, np.full(around, last + around)], 1)
        faces += [flat, tip]
        fraction += [np.full(len(flat), 0.5), np.ones(around)]
        thickness.append(np.full(len(flat) + around, cap_m))
    mesh = ShellMesh(
        np.concatenate(vertices), np.concatenate(faces), np.concatenate(thickness), np.concatenate(fraction)
    )
    return mesh, lid


def _doubling_faces(below: int) -> Int[np.ndarray, "f 3"]:
    """Triangles between a ring and one of twice as many vertices above it; each cell is mirror-symmetric."""
    a = np.arange(below)
    b = (a + 1) % below
    c, d, e = below + 2 * a, below + 2 * a + 1, below + 2 * b
    return np.concatenate([np.stack(corners, axis=1) for corners in ((a, d, c), (a, b, d), (b, e, d))])


def ring_lid(loop: Int[np.ndarray, "n"]) -> Int[np.ndarray, "l 3"]:
    """Triangles that connect each vertex of a ring to its mirror image.

    Parameters
    ----------
    loop
        Vertex numbers around the ring, an even number; the first and the middle one are on the mirror plane.
    """
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


def rim_zones(
    cells: Float[np.ndarray, "m"], rim_cell: float = 1.0
) -> tuple[Float[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """Relative height of cells, and number of doublings of the rings, towards a free rim.

    Parameters
    ----------
    cells
        Distance from the rim in cells of the wall.
    rim_cell
        Width of a cell at the rim without doubling, relative to the height of the others: a narrow neck
        needs fewer.
    """
    check_numbers("rim_zones", POSITIVE, rim_cell=rim_cell)
    fraction, times = np.ones(len(cells)), np.ones(len(cells), dtype=np.int64)
    for begin, height, more in RIM_ZONES:
        inside = cells <= begin + 1e-6
        fraction[inside] = height
        # To within a factor of sqrt 2 of the target width.
        halvings = np.clip(np.ceil(np.log2(rim_cell * more / np.sqrt(2.0))), 0, np.log2(more))
        times[inside] = 2 ** int(halvings)
    return fraction, times


def ring_counts(times: Int[np.ndarray, "m"], around: int) -> Int[np.ndarray, "m"]:
    """Numbers of vertices of the rings from the foot upwards: at most doubled from one to the next.

    Parameters
    ----------
    times
        Target number of vertices of each ring, as a multiple of ``around``.
    around
        Vertices of the lowest ring.
    """
    out = np.full(len(times), around)
    for ring in range(1, len(times)):
        out[ring] = min(around * times[ring], 2 * out[ring - 1])
    return out


def _ring_heights(
    profile: WallProfile, around: int, levels_m: Float[np.ndarray, "l"], *, free: bool
) -> tuple[Float[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """Heights of the rings, and their numbers of vertices."""
    z = profile.z_m
    slant = np.hypot(
        np.diff(z), np.maximum(np.abs(np.diff(profile.radius_x_m)), np.abs(np.diff(profile.radius_y_m)))
    )
    length = np.concatenate([[0.0], np.cumsum(slant)])
    mean = 0.5 * (profile.radius_x_m + profile.radius_y_m)
    cell = 2 * np.pi * float(np.max(mean)) / around
    fine = z
    if free:
        # The zones start between the knots.
        edges = np.clip(length[-1] - np.array([zone[0] for zone in RIM_ZONES]) * cell, 0.0, None)
        edges = np.interp(np.concatenate([edges - 1e-6 * cell, edges + 1e-6 * cell]), length, z)
        fine = np.unique(np.concatenate([z, edges]))
    at = np.interp(fine, z, length)

    def zones(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rim_zones((length[-1] - along) / cell, float(mean[-1] / np.max(mean)))

    fraction = zones(at)[0] if free else np.ones(len(fine))
    density = (
        np.concatenate([[0.0], np.cumsum(np.diff(at) * 0.5 * (1 / fraction[1:] + 1 / fraction[:-1]))]) / cell
    )
    # A level close to a break is dropped to avoid slivers.
    apart = np.abs(levels_m[:, None] - profile.breaks_m).min(axis=1) > 0.25 * cell
    heights = np.sort(np.concatenate([profile.breaks_m, levels_m[apart]]))
    marks = np.interp(heights, fine, density)
    out = [np.zeros(1)]
    for low, high in itertools.pairwise(marks):
        count = max(1, int(np.ceil(high - low - 0.3)))
        out.append(np.interp(np.linspace(low, high, count + 1)[1:], density, fine))
    found = np.concatenate(out)
    found[-1] = z[-1]
    times = zones(np.interp(found, z, length))[1] if free else np.ones(len(found), dtype=np.int64)
    return found, ring_counts(times, around)


def grid_faces(
    columns: int, rows: int, *, closed: bool = False, crossed: bool = False
) -> Int[np.ndarray, "f 3"]:
    """Two triangles per cell of a structured grid, diagonals alternating; vertex = row * width + column.

    Parameters
    ----------
    columns, rows
        Cells.
    closed
        Connect the last column to the first.
    crossed
        Return the two triangles of both diagonals, to be used with ``fraction=0.5``. Alternating diagonals cause
        two kinds of vertices, and the stiffness of a round tube varies around the ring by a percent; with both diagonals
        it does not.
    """
    width = columns if closed else columns + 1
    row, column = (part.ravel() for part in np.mgrid[:rows, :columns])
    a = row * width + column
    b = row * width + (column + 1) % width
    c, d = b + width, a + width
    even = ((row + column) % 2 == 0)[:, None, None]
    one = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1)
    other = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1)
    if crossed:
        return np.concatenate([one, other], axis=1).reshape(-1, 3)
    return np.where(even, one, other).reshape(-1, 3)


def tube_mesh(
    radius_m: float, height_m: float, thickness_m: float, *, around: int, along: int, crossed: bool = True
) -> ShellMesh:
    """An open tube along z, vertex = ring * around + place; the first ring is at z = 0.

    Parameters
    ----------
    radius_m, height_m, thickness_m
        Dimensions of the tube [m].
    around, along
        Cells around the tube and along it.
    crossed
        Both diagonals in each cell, see :func:`grid_faces`.
    """
    ring, place = (part.ravel() for part in np.mgrid[: along + 1, :around])
    angle = 2 * np.pi * place / around
    vertices = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), height_m * ring / along], 1)
    faces = grid_faces(around, along, closed=True, crossed=crossed)
    return ShellMesh(vertices, faces, thickness_m, 0.5 if crossed else 1.0)
