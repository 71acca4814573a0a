"""Containers from imported meshes: checked, repaired or rejected (Alt 2016, Sec. 6.1.1).

A mesh whose triangles suit a shell is used unchanged, any other is repaired on its own surface
(:mod:`.mesh_repair`). For a two-sided wall, the mid-surface is sampled on rings around its height axis
(:mod:`.resample`), which requires a wall that every ray from the axis hits; other meshes are sampled only on request.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import InputError
from ...io.meshes.mesh import load_mesh
from ...io.meshes.mesh_state import MeshState, boundary_loops, face_parts
from ..shells.shell import ShellMesh, ShellModel, enclosed_volume
from ..shells.shell_material import material_constants
from ..shells.stiffness_map import dual_tip_map, opposing_points
from .coverage import check_container, check_represented, closed_ends, represented_parts
from .mesh_repair import clamped_foot, face_lengths, large_faces, repair_mesh, why_not_as_it_is
from .mesher import ShellObject, mesh_rings, rim_zones, ring_counts, ring_lid
from .posture import MeshConvention, placed_mesh
from .resample import Wall, find_wall
from .wall_properties import WallProperties, wall_thickness

#: Surfaces farther apart than this fraction of the radius are two shells, not two sides of one wall.
NESTED_FRACTION = 0.1
#: Heights at which the wall's thickness is compared with its radius; ratio above which a note is added.
THICK_LEVELS, ROUGH_FRACTION = 20, 0.1
#: Thickness-to-radius ratio above which the shell model does not apply: the inner side is half as long as the outer.
THICKEST_FRACTION = 1 / 3
#: Near a shoulder the deformation varies within the root of radius times wall. With triangles of this fraction of it, a round bottle
#: is up to 2.5 % too stiff or too soft by its Fourier series; the error grows with the square.
SHOULDER_FRACTION = 0.6

#: Mesh, clamped vertices, lid, height axis, and notes.
_Shape = tuple[ShellMesh, Bool[np.ndarray, "v"], Int[np.ndarray, "l 3"], tuple[float, float], list[str]]


def import_container(
    path: Path | str,
    *,
    wall: WallProperties | None = None,
    convention: MeshConvention | None = None,
    open_top: bool = False,
    around: int = 96,
) -> ShellObject:
    """A mesh as a container whose foot is clamped.

    Parameters
    ----------
    path
        STL, PLY, OBJ, GLB or DAE; its surface is the mid-surface of the wall, or its two sides.
    wall
        Properties of the whole wall. By default PET, with the distance of inner and outer surface as thickness
        at each height, or 0.5 mm with 10 % uncertainty if the mesh has one surface only.
    convention
        Unit and height axis of the file, and permitted changes to its triangles. By default, the unit is guessed from the
        size of a container (stated in ``notes``), and z points up.
    open_top
        Remove the top if the mesh has one.
    around
        Vertices around the wall where it is resampled or simplified.

    Raises
    ------
    InputError
        The mesh cannot be used, with the defect and its location; or it is not a thin-walled container, with the reason.
    """
    where = str(path)
    given, convention = wall or WallProperties(), convention or MeshConvention()
    if around % 4 or not 16 <= around <= 1024:
        raise InputError("around", f"found {around}, expected a multiple of 4 from 16 to 1024")
    remesh = convention.remesh
    state, notes = placed_mesh(load_mesh(path), convention, where)
    found = find_wall(state.vertices, state.faces, where)
    thick, thickness_spread, thick_notes = wall_thickness(found.thickness_m, found.thickness_spread, given)
    notes += thick_notes
    floor, closed = closed_ends(state, found)
    notes.append(check_represented(state, found, closed=closed))
    check_container(state, found, closed=closed)
    if remesh != "cast" and not found.double:
        state, part_notes = represented_parts(state, found, closed=closed)
        notes += part_notes
        state, repair_notes = _suitable(state, float(thick[0, 1]), around, where, repair=remesh == "auto")
        notes += repair_notes
    elif remesh == "never":
        raise InputError(
            where,
            "cannot be used as it is: it has an inner and an outer surface",
            field="mesh",
            remedy="allow remeshing",
        )
    cast = found.double or remesh == "cast"
    if cast:
        _check_one_shell(state, found, where)
    mesh, fixed, lid, middle, shape_notes = (
        _resampled(found, thick, closed and not open_top, around)
        if cast
        else _as_it_is(state, float(thick[0, 1]), open_top, where)
    )
    if cast:
        notes.append(_cast_cost(mesh, found, thick, closed=closed and not open_top, around=around))
    constants, modulus_spread = given.elastic_constants(*material_constants("PET"))
    if not floor and closed and not open_top:
        notes.append(_turned_over(mesh, fixed, middle))
    return ShellObject(
        mesh,
        fixed,
        lid,
        middle,
        constants,
        modulus_spread,
        thickness_spread,
        Path(path).stem,
        (*notes, *shape_notes),
    )


def _suitable(
    state: MeshState, thickness_m: float, around: int, where: str, *, repair: bool
) -> tuple[MeshState, list[str]]:
    """The triangles unchanged, or repaired; rejected if that is not sufficient."""
    suits, large = why_not_as_it_is(state), large_faces(state)
    notes: list[str] = []
    if large and not repair:
        notes.append(
            f"{large} load-bearing triangles are coarse, near which the stiffness is up to a tenth wrong"
        )
    if (suits or large) and repair:
        state, notes = repair_mesh(state, thickness_m, around)
        suits = suits and why_not_as_it_is(state)
    if suits:
        remedy = "repair it, or resample it with --remesh cast" if repair else "allow remeshing"
        raise InputError(where, f"cannot be used as it is: {suits}", field="mesh", remedy=remedy)
    return state, notes


def _as_it_is(state: MeshState, thickness_m: float, open_top: bool, where: str) -> _Shape:
    """The triangles of the file, oriented outwards."""
    notes: list[str] = []
    faces, loops = state.faces, list(state.loops)
    if enclosed_volume(state.vertices - state.vertices.mean(axis=0), faces) < 0:
        faces, loops = faces[:, ::-1], [loop[::-1] for loop in loops]
        notes.append("all triangles looked inwards and were turned")
    low, high = state.vertices[:, 2].min(), state.vertices[:, 2].max()
    if open_top:
        faces, loops = _without_top(state.vertices, faces, low, high)
    lid = [ring_lid(loop[::-1]) for loop in loops]
    # Faces are oriented outwards, so the wall is on the left of its boundary: lids have the opposite orientation.
    mesh = ShellMesh(state.vertices, faces, thickness_m)
    used = state.vertices[np.unique(faces)]
    middle, axis_notes = _foot_centre(used, clamped_foot(used))
    notes += axis_notes
    level = np.linspace(low, high, THICK_LEVELS + 1)
    slab = np.clip(np.searchsorted(level, used[:, 2], side="right") - 1, 0, THICK_LEVELS - 1)
    reach = np.zeros(THICK_LEVELS)
    np.maximum.at(reach, slab, np.linalg.norm(used[:, :2] - middle, axis=1))
    seen = np.flatnonzero(reach > 0)  # a slab without vertices is ignored
    notes += _thick(level[seen], reach[seen], np.full(len(seen), thickness_m), where)
    notes += _coarse_shoulders(state.vertices, faces, level, reach, thickness_m)
    lids = np.concatenate(lid) if lid else np.zeros((0, 3), dtype=np.int64)
    return mesh, clamped_foot(state.vertices), lids, middle, notes


def _coarse_shoulders(
    vertices: np.ndarray, faces: np.ndarray, level: np.ndarray, reach: np.ndarray, thickness_m: float
) -> list[str]:
    """Note where the triangles are too long for the deformation near a shoulder: a radius that changes by more within one level."""
    seen, bend = np.flatnonzero(reach > 0), np.sqrt(reach * thickness_m)
    step = np.abs(np.diff(reach[seen])) > bend[seen[1:]]
    beside = np.union1d(seen[:-1][step], seen[1:][step])
    slab = np.clip(np.searchsorted(level, vertices[faces[:, 0], 2], side="right") - 1, 0, THICK_LEVELS - 1)
    near = np.isin(slab, beside)
    length = face_lengths(vertices, faces[near])
    limit = SHOULDER_FRACTION * bend[slab[near]]
    if not near.any() or np.median(length / limit) <= 1:
        return []
    return [
        f"triangles of {1e3 * float(np.median(length)):.2g} mm near a shoulder at height {level[beside[-1]]:.3g} m, expected up to "
        f"{1e3 * float(np.median(limit)):.2g} mm: the stiffness there is some percent wrong"
    ]


def _foot_centre(
    points: Float[np.ndarray, "v 3"], foot: Bool[np.ndarray, "v"]
) -> tuple[tuple[float, float], list[str]]:
    """Move the height axis to the centre of the foot, as in a description.

    If there is almost no foot, it is moved to the centre of the whole object.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    whole, size = 0.5 * (low + high), high - low
    some = points[foot, :2]
    if not len(some) or (np.ptp(some, axis=0) < 0.2 * size).any():
        return (float(whole[0]), float(whole[1])), []
    centre = 0.5 * (some.min(axis=0) + some.max(axis=0))
    notes = []
    if (np.abs(centre - whole) > 0.05 * size).any():
        notes.append(
            f"the height axis goes through the foot's middle ({1e3 * centre[0]:.3g}, {1e3 * centre[1]:.3g}) mm, "
            f"{1e3 * np.linalg.norm(centre - whole):.2g} mm from that of the whole"
        )
    return (float(centre[0]), float(centre[1])), notes


def _check_one_shell(state: MeshState, wall: Wall, where: str) -> None:
    """Reject two nested shells: their mid-surface is the wall of neither."""
    middle = 0.5 * (wall.low_m + wall.high_m)
    around = float(np.median(wall.radius_m(np.array([middle]), 48)))
    if not wall.double or wall.wall_m < NESTED_FRACTION * around:
        return
    label = face_parts(state.faces)
    boxes = [
        (state.vertices[state.faces[label == name]].min(axis=(0, 1)),
         state.vertices[state.faces[label == name]].max(axis=(0, 1)))
        for name in np.unique(label)
    ]  # fmt: skip
    for one, (low, high) in enumerate(boxes):
        for other, (least, most) in enumerate(boxes):
            if one != other and (low[:2] > least[:2]).all() and (high[:2] < most[:2]).all():
                raise InputError(
                    where,
                    f"two shells inside each other, {1e3 * wall.wall_m:.2g} mm apart around height {middle:.4g} m",
                    field="mesh",
                    remedy="remove one of them",
                )


def _without_top(
    vertices: np.ndarray, faces: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, list[np.ndarray]]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    level = normal[:, 2] > 0.7 * np.linalg.norm(normal, axis=1)
    top = level & (vertices[faces, 2].min(axis=1) > high - 0.02 * (high - low))
    faces = faces[~top]
    return faces, list(boundary_loops(faces))


def _resampled(wall: Wall, thickness_m: Float[np.ndarray, "k 2"], closed: bool, around: int) -> _Shape:
    """Sample the wall on rings around the height axis."""
    fine = np.linspace(wall.low_m, wall.high_m, 241)
    mean = wall.radius_m(fine, around).mean(axis=1)
    slant = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(fine), np.diff(mean)))])
    spacing = 2 * np.pi * float(mean.max()) / around

    def zones(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rim_zones((slant[-1] - along) / spacing, float(mean[-1] / mean.max()))

    fraction = np.ones_like(fine) if closed else zones(slant)[0]
    density = np.concatenate([[0.0], np.cumsum(np.diff(slant) * (1 / fraction[1:] + 1 / fraction[:-1]) / 2)])
    count = int(np.clip(np.ceil(density[-1] / spacing), 8, 600))
    heights = np.interp(np.linspace(0, density[-1], count + 1), density, fine)
    heights[-1] = wall.high_m
    times = np.ones(len(heights), dtype=np.int64)
    if not closed:
        times = zones(np.interp(heights, fine, slant))[1]
    counts = ring_counts(times, around)
    points = []
    # One sampling for all densities: coarser rings are every second or fourth sample of the finest.
    most = int(counts.max())
    radius = wall.radius_m(heights, most)
    thick = np.interp(heights, *thickness_m.T)
    thick_notes = _thick(heights, radius.min(axis=1), thick, wall.where)
    angle = 2 * np.pi * np.arange(most) / most
    for height, row, number in zip(heights, radius, counts, strict=True):
        some = slice(None, None, most // int(number))
        ring = np.full((int(number), 3), height)
        ring[:, 0] = wall.axis_point_m[0] + row[some] * np.cos(angle[some])
        ring[:, 1] = wall.axis_point_m[1] + row[some] * np.sin(angle[some])
        points.append(ring)
    mesh, lid = mesh_rings(points, (thick[1:] + thick[:-1]) / 2, cap_m=float(thick[-1]) if closed else None)
    if len(thickness_m) > 1:  # as measured
        place = mesh.vertices_m[mesh.faces].mean(axis=1)
        mesh = ShellMesh(
            mesh.vertices_m, mesh.faces, mesh.thickness_m * wall.unevenness(place), mesh.fraction
        )
    floor = ring_lid(np.arange(around)[::-1])
    foot = np.arange(len(mesh.vertices_m)) < around
    middle, axis_notes = _foot_centre(mesh.vertices_m, foot)
    lids = np.concatenate([lid, floor])
    return mesh, foot, lids, middle, [*wall.notes, *thick_notes, *axis_notes]


def _cast_cost(
    mesh: ShellMesh, wall: Wall, thickness_m: Float[np.ndarray, "k 2"], *, closed: bool, around: int
) -> str:
    """Effect of the sampling on rings, by Richardson extrapolation from rings of half the density (second order)."""
    rows = np.linspace(wall.low_m, wall.high_m, 33)[4:-4]
    found = []
    for shell in (mesh, _resampled(wall, thickness_m, closed, max(16, around // 8 * 4))[0]):
        points = shell.vertices_m - np.array([*wall.axis_point_m, 0.0])
        use = np.unique(shell.faces)
        columns = [use[(points[use, axis] > 0) & (np.abs(points[use, 1 - axis]) < 1e-9)] for axis in (0, 1)]
        columns = [line[np.argsort(points[line, 2])] for line in columns]
        tips = opposing_points(shell, np.concatenate(columns), axis_point_m=wall.axis_point_m)
        fixed = shell.vertices_m[:, 2] <= wall.low_m + 1e-9
        stiffness = np.log(dual_tip_map(ShellModel(shell, "PET", fixed), tips))
        parts = np.split(stiffness, [len(columns[0])])
        found.append(
            [np.interp(rows, points[line, 2], part) for line, part in zip(columns, parts, strict=True)]
        )
    once, coarse = np.array(found)
    use = np.isfinite(once) & np.isfinite(coarse)
    worst = 100 * float(np.abs(once[use] - coarse[use]).max(initial=0.0)) / 3
    return f"resampling on rings changes the stiffness by up to {worst:.2g} % (from rings half as dense)"


def _turned_over(mesh: ShellMesh, fixed: Bool[np.ndarray, "v"], axis_point_m: tuple[float, float]) -> str:
    """Note of a container whose only opening is its foot: the price of the other way up, at half its height."""
    z = mesh.vertices_m[:, 2]
    ring = np.flatnonzero(np.abs(z - 0.5 * (z.min() + z.max())) < 0.5 * np.ptp(z) / THICK_LEVELS)
    tips = opposing_points(mesh, ring[:: max(1, len(ring) // THICK_LEVELS)], axis_point_m=axis_point_m)
    given, other = (
        np.nanmedian(dual_tip_map(ShellModel(mesh, "PET", foot), tips))
        for foot in (fixed, clamped_foot(mesh.vertices_m * np.array([1.0, 1.0, -1.0])))
    )
    return (
        "its only opening is its foot: the file leaves out the floor, or it is upside down; turned over with --up, its "
        f"stiffness at half its height is {100 * (other / given - 1):+.0f} %"
    )


def _thick(heights: np.ndarray, radius: np.ndarray, thickness_m: np.ndarray, where: str) -> list[str]:
    """Reject a wall that is too thick for its radius; add a note where the shell model is inaccurate."""
    row = int(np.argmin(radius / thickness_m))
    if radius[row] <= thickness_m[row]:
        raise InputError(
            where,
            f"the wall is {radius[row]:.3g} m from the axis at height {heights[row]:.4g} m, expected more than "
            f"its thickness of {thickness_m[row]:.3g} m",
            field="mesh",
            remedy="give its thickness in metres with --thickness, or the unit of the mesh with --unit",
        )
    fraction = float(np.median(thickness_m) / np.median(radius))
    if fraction > THICKEST_FRACTION:
        raise InputError(
            where,
            f"its wall is {1e3 * float(np.median(thickness_m)):.3g} mm, {100 * fraction:.0f} % of its radius: not a thin-walled "
            f"container, which has less than {100 * THICKEST_FRACTION:.0f} %",
            field="mesh",
            remedy="give the thickness with --thickness if the mesh is wrong",
        )
    if fraction > ROUGH_FRACTION:
        return [f"the wall is {100 * fraction:.0f} % of the radius, the relative error of a shell model"]
    return []
