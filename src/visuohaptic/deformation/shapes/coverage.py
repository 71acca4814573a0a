"""Fraction of a mesh's surface that the container model represents: its wall, foot and lid."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.geometry import area_vectors
from ...io.meshes.mesh_state import MeshState, face_parts, inspect_mesh
from .resample import ANGLES, Wall

#: Sample points on the mesh: a fraction of one half has the standard error 0.5 / sqrt(10 000) = 0.5 %.
SAMPLES = 10_000
#: Heights at which the wall is sampled.
LEVELS = 200
#: Maximum height above ground without a closed wall, as a fraction of a container's height; a handle is at most 1.6
#: times as long as the radius of the container.
LEGS, LONGEST_REACH = 0.1, 2.6
#: A ledge is a change of radius by this fraction within a two-hundredth of the height, in that fraction of the directions.
LEDGE = 0.25
#: A lid is level, or a roof plane, within 10 degrees in the uppermost tenth; a ball has ``pi (r sin 10)^2`` of that.
LEVEL_rad, TOP = np.radians(10.0), 0.1
#: Slope up to which a plane is one of a roof (cartons: 40 to 55 degrees), not of a wall, and directions tried.
STEEPEST_rad, DIRECTIONS = np.radians(60.0), 200


def represented_fraction(
    vertices_m: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    wall: Wall,
    *,
    closed: bool,
    parts: Int[np.ndarray, "f"] | None = None,
) -> Float[np.ndarray, "p"]:
    """Fraction of the area of each part of a mesh that is wall, foot or lid of a container.

    Parameters
    ----------
    vertices_m
        Vertices of the mesh [m].
    faces
        Triangles of the mesh.
    wall
        The star-shaped wall found in it.
    closed
        There is a lid at the upper end of the wall.
    parts
        Index of the part of each triangle, from 0; one part by default.

    Notes
    -----
    A point belongs to the wall if it is within half its thickness of the mid-surface. The wall is sampled at points
    ``d`` apart (the diagonal of their grid), so that any point of it has a sample within ``d / 2``. Foot and lid
    are inside the wall's lowest and highest ring and below, or above: both are clamped or stiff,
    whatever their shape.
    """
    from scipy.spatial import cKDTree

    place_m, face = _spread(vertices_m, faces)
    points = place_m - np.array([*wall.axis_point_m, 0.0])
    heights = np.linspace(wall.low_m, wall.high_m, LEVELS)
    radius = wall.radius_m(heights, ANGLES)
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    grid = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(heights[:, None], radius.shape)],
        axis=2,
    )
    along = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    around = np.linalg.norm(grid - np.roll(grid, 1, axis=1), axis=2)
    half = 0.5 * np.hypot(
        np.maximum(np.pad(along, ((0, 1), (0, 0))), np.pad(along, ((1, 0), (0, 0)))), around
    )
    if wall.double:
        half = half + 0.5 * wall.measured_m(heights)[:, None]
    away, place = cKDTree(grid.reshape(-1, 3)).query(points)
    found = away <= half.ravel()[place]
    column = np.round(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * ANGLES).astype(int) % ANGLES
    reach = np.hypot(points[:, 0], points[:, 1])
    ends = [(0, points[:, 2] <= wall.low_m + half[0].max())]
    if closed:
        ends.append((-1, points[:, 2] >= wall.high_m - half[-1].max()))
    for row, beyond in ends:
        found |= beyond & (reach <= (radius[row] + half[row])[column])
    part = np.zeros(len(face), dtype=np.int64) if parts is None else parts[face]
    return np.bincount(part, found) / np.maximum(np.bincount(part), 1)


def _spread(vertices: np.ndarray, faces: np.ndarray) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """Low-discrepancy points, uniform over the area, and their triangles."""
    corner, first, second = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(first - corner, second - corner), axis=1)
    place = (np.arange(SAMPLES) + 0.5) / SAMPLES
    face = np.searchsorted(np.cumsum(area) / area.sum(), place).clip(max=len(faces) - 1)
    # Roberts' R2 sequence: fractional parts of multiples of the plastic number's powers.
    u, v = np.modf(np.arange(1, SAMPLES + 1)[:, None] / 1.324717957244746 ** np.array([1, 2]))[0].T
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    return corner[face] + u[:, None] * (first - corner)[face] + v[:, None] * (second - corner)[face], face


def check_represented(state: MeshState, wall: Wall, *, closed: bool) -> str:
    """Check that a container model represents most of the mesh; returns a note about the fraction.

    Parameters
    ----------
    state
        The imported mesh.
    wall
        The wall found in it.
    closed
        There is a lid at the upper end of the wall.

    Raises
    ------
    InputError
        It is less than half: most of the touchable surface is not in the model.
    """
    fraction = float(represented_fraction(state.vertices, state.faces, wall, closed=closed)[0])
    if fraction < 0.5:
        raise InputError(
            wall.where,
            f"only {100 * fraction:.0f} % of its surface is wall, foot or lid of a container around the axis at "
            f"({wall.axis_point_m[0]:.4g}, {wall.axis_point_m[1]:.4g}) m, expected more than half",
            field="mesh",
            remedy="remove everything that is not part of the container, or turn it with --up so that z is the height axis",
        )
    return f"{100 * fraction:.0f} % of the surface of the mesh is wall, foot or lid of the container"


def check_container(state: MeshState, wall: Wall, *, closed: bool) -> None:
    """Reject a mesh that is not a container although rays from an axis hit it all around.

    Parameters
    ----------
    state, wall
        As of :func:`check_represented`.
    closed
        It is closed at the upper end.

    Raises
    ------
    InputError
        It stands on legs or extends far beyond its wall. For one surface without a mouth: its top is as round as a
        ball, or it overhangs like a tool. A single surface contains no information about the interior, so it must look like a
        container: a lid or a folded roof, and a wall without ledges.
    """
    points = state.vertices[np.unique(state.faces)]
    height = float(np.ptp(points[:, 2]))
    heights = np.linspace(wall.low_m, wall.high_m, LEVELS)
    radius = wall.radius_m(heights, ANGLES)
    widest = float(radius.max())
    reach = float(np.hypot(*(points[:, :2] - np.array(wall.axis_point_m)).T).max())
    reason = ""
    if reach > LONGEST_REACH * widest:
        reason = f"it reaches {1e3 * reach:.0f} mm from its axis, its wall {1e3 * widest:.0f} mm"
    elif not wall.double:
        cut = float((wall.low_m - points[:, 2].min()) / height)
        ends = int(TOP * LEVELS)  # foot and lid may be recessed
        overhang = (np.diff(radius[ends:-ends], axis=0) > LEDGE * widest).any(axis=0).mean()
        if cut > LEGS:
            reason = f"it stands on legs: the lowest {100 * cut:.0f} % of its height are not closed around the axis"
        elif closed and overhang > LEDGE:
            reason = f"it is closed and overhangs, like a tool, in {100 * overhang:.0f} % of the directions"
        elif closed and (flat := _lid_area(state, height)) < 2 * _ball_area(wall, points[:, 2].max(), height):
            reason = f"it has neither a mouth nor a lid: of its top {1e6 * flat:.0f} mm2 are in one plane, as of a ball"
    if reason:
        raise InputError(
            wall.where,
            f"not a thin-walled container: {reason}",
            field="mesh",
            remedy="remove everything that is not part of the container, or cut its mouth open",
        )


def _ball_area(wall: Wall, top_m: float, height: float) -> float:
    """Area of the level part of the top of a ball as wide as the wall [m^2].

    Its radius is that of the ball through the top and the ring below the uppermost tenth, i.e. of the end of the wall, which
    may be a nozzle on a wide body; at most that of the wall.
    """
    deep = TOP * height
    ring, widest = (
        float(wall.radius_m(rows, ANGLES).max())
        for rows in (np.array([top_m - deep]), np.linspace(wall.low_m, wall.high_m, LEVELS))
    )
    ball = min(widest, 0.5 * (ring**2 + deep**2) / deep)
    return float(np.pi * (np.sin(LEVEL_rad) * ball) ** 2)


def _lid_area(state: MeshState, height: float) -> float:
    """Area of the top that is level, or of the largest plane of its roof [m^2].

    A ball has the same area within ``LEVEL_rad`` of every direction. Planes are sought along the normals at places that are
    uniform over the area of the rising top: the triangles of a plane with several times 1 / ``DIRECTIONS`` of it have some.
    """
    area = area_vectors(state.vertices, state.faces)
    low, middle, high = np.sort(state.vertices[state.faces, 2], axis=1).T
    cut = high.max() - TOP * height
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (cut - low) ** 2 / ((middle - low) * (high - low))
        above = (high - cut) ** 2 / ((high - middle) * (high - low))
    fraction = np.select([cut < low, cut < middle, cut < high], [1.0, 1 - below, above], 0.0)
    whole = np.linalg.norm(area, axis=1)
    size = fraction * whole
    outward = area / np.maximum(whole, 1e-300)[:, None]
    outward[outward[:, 2] < 0] *= -1
    rising = (outward[:, 2] > np.cos(STEEPEST_rad)) & (size > 0)
    outward, size = outward[rising], size[rising]
    if not len(size):
        return 0.0
    place = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    chosen = np.searchsorted(np.cumsum(size) / size.sum(), place).clip(max=len(size) - 1)
    towards = np.vstack([[0.0, 0.0, 1.0], outward[np.unique(chosen)]])
    return float(((outward @ towards.T > np.cos(LEVEL_rad)).T @ size).max())


def represented_parts(state: MeshState, wall: Wall, *, closed: bool) -> tuple[MeshState, list[str]]:
    """Remove unconnected parts of a mesh that are not part of the container, like a handle.

    Parameters
    ----------
    state, wall, closed
        As of :func:`check_represented`.

    Returns
    -------
    tuple
        The mesh, and a description of the removed parts for display.
    """
    number = face_parts(state.faces)
    if not number.any():
        return state, []
    fraction = represented_fraction(state.vertices, state.faces, wall, closed=closed, parts=number)
    kept = fraction[number] >= 0.5
    if kept.all() or not kept.any():
        return state, []
    middle = state.vertices[state.faces[~kept]].mean(axis=(0, 1))
    place = ", ".join(f"{value:.4g}" for value in middle)
    rest = inspect_mesh(state.vertices, state.faces[kept], wall.where)
    return rest, [
        f"parts that do not belong to the container (a handle?) are ignored: {int((~kept).sum())} triangles around ({place}) m"
    ]


def closed_ends(state: MeshState, wall: Wall) -> tuple[bool, bool]:
    """Whether a mesh has a floor, and a top, which vertical rays near the axis hit.

    Parameters
    ----------
    state, wall
        As of :func:`check_represented`.

    Returns
    -------
    tuple
        A floor is in the lower half, however far it is recessed; a top within a twentieth of the height below the wall's end.
    """
    corners = state.vertices[state.faces] - np.array([*wall.axis_point_m, 0.0])
    reach = 0.35 * float(np.ptp(state.vertices[:, :2], axis=0).min()) / 2
    height = float(np.ptp(state.vertices[:, 2]))
    floors = tops = 0
    for turn in np.arange(8) * 2 * np.pi / 8 + 0.1:
        a, b, c = ((corners[:, k, :2] - reach * np.array([np.cos(turn), np.sin(turn)])) for k in range(3))
        areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))], axis=1)
        inside = (areas > 0).all(axis=1) | (areas < 0).all(axis=1)
        if inside.any():
            z = np.einsum("fk,fk->f", areas[inside], corners[inside][:, :, 2]) / areas[inside].sum(axis=1)
            floors += bool(z.min() < wall.high_m - 0.5 * height)
            tops += bool(z.max() > wall.high_m - 0.05 * height)
    return floors > 4, tops > 4
