"""How a mesh is placed: its unit, the axis that points up, and the foot on which it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from ...core import InputError, check_choice
from ...core.geometry import area_vectors, so3_exp
from ...io.meshes.mesh import TriangleMesh
from ...io.meshes.mesh_state import MeshState, inspect_mesh
from .mesh_repair import FOOT_FRACTIONS
from .quantities import UNITS

#: Metres per unit, the usual ones first.
_UNITS = {name: UNITS["length"][name] for name in ("m", "mm", "cm", "dm", "in")}
#: Bounds of the largest extent of a hand-held container [m].
SMALLEST_m, LARGEST_m = 0.03, 0.6
#: Ratio of the two smallest eigenvalues of the normals above which a mesh has a distinct axis, and its maximum tilt.
RUNS_ALONG, MAX_LEAN_DEGREES = 1.6, 15.0
#: Vertices are in one plane within this fraction of the height: single precision of a file.
SAME_PLANE = 1e-6


@dataclass(frozen=True, slots=True)
class MeshConvention:
    """Convention of a mesh file, and the permitted changes to its triangles.

    ``auto`` repairs the load-bearing triangles where needed, on their own surface; ``never`` uses them unchanged
    or rejects them; ``cast`` resamples the wall on rings, which removes details between the rings. The mid-surface of a
    two-sided wall is always sampled, except for ``never``. Notes of the container state the effect of sampling.
    """

    #: unit of length: m, dm, cm, mm or in; None: as a COLLADA file states it, or guessed from the size
    unit: str | None = None
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = "z"  #: axis that points up
    remesh: Literal["auto", "cast", "never"] = "auto"  #: repair, resample on rings, or neither

    def __post_init__(self) -> None:
        if self.remesh not in {"auto", "cast", "never"}:
            raise InputError("remesh", f"found {self.remesh!r}, expected auto, cast or never")


def placed_mesh(mesh: TriangleMesh, convention: MeshConvention, where: str) -> tuple[MeshState, list[str]]:
    """The mesh in metres, upright.

    Parameters
    ----------
    mesh
        As stored in a file.
    convention
        Its unit, where known, and the axis that points up.
    where
        Its name in messages.

    Returns
    -------
    tuple
        The mesh, and notes: its unit, its defects, and by how much it leant.

    Raises
    ------
    InputError
        It has the size of a container in no unit, too few triangles, or lies on its side.
    """
    points = _turned_up(mesh.vertices, convention.up)
    scale, notes = _metres_per_unit(points[mesh.faces.ravel()], convention.unit, mesh.unit_m, where)
    state = inspect_mesh(points * scale, mesh.faces, where)
    notes += state.defects
    state, lean_notes = _stood_up(state)
    _check_upright(state, where)
    return state, notes + lean_notes


def _turned_up(vertices: Float[np.ndarray, "v 3"], up: str) -> Float[np.ndarray, "v 3"]:
    """Vertices in axes whose z is the given one."""
    if up not in {"x", "y", "z", "-x", "-y", "-z"}:
        raise InputError("up", f"found {up!r}, expected x, y, z, -x, -y or -z")
    order = {"z": (0, 1, 2), "x": (1, 2, 0), "y": (2, 0, 1)}[up[-1]]
    out: np.ndarray = vertices[:, order].copy()
    if up[0] == "-":
        out[:, 1:] *= -1.0
    return out


def _metres_per_unit(
    used: Float[np.ndarray, "n 3"], unit: str | None, stated_m: float | None, where: str
) -> tuple[float, list[str]]:
    """The unit of length [m] as given, as stated, or one in which it is as large as a container; and notes."""
    extent = float(np.ptp(used, axis=0).max())
    if unit is not None:
        check_choice("unit", _UNITS, unit)
        extent_m = extent * _UNITS[unit]
        doubt = f"the largest extent is {extent_m:.4g} m with the unit {unit}, of a container {SMALLEST_m:g} to {LARGEST_m:g} m"
        return _UNITS[unit], [] if SMALLEST_m <= extent_m <= LARGEST_m else [doubt]
    # Exporters write one metre whatever the unit is; another one is used if it makes a container.
    if stated_m not in (None, 1.0) and SMALLEST_m <= extent * stated_m <= LARGEST_m:
        return stated_m, [f"unit as stated in the file: {stated_m:g} m"]
    possible = [name for name, size in _UNITS.items() if SMALLEST_m <= extent * size <= LARGEST_m]
    if not possible:
        problem = f"the largest extent is {extent:.4g}: no container in {', '.join(_UNITS)}"
        raise InputError(where, problem, field="mesh", remedy="give the unit with --unit")
    name, *others = possible
    guess = f"unit taken as {name}: the largest extent is {extent:.4g}"
    if others:
        sizes = ", ".join(f"{1e3 * extent * _UNITS[one]:.3g} mm with --unit {one}" for one in others)
        guess += f", {1e3 * extent * _UNITS[name]:.3g} mm; it would be {sizes}"
    return _UNITS[name], [] if name == "m" else [guess]


def _stood_up(state: MeshState) -> tuple[MeshState, list[str]]:
    """Turn a container that leans by less than 15 degrees onto its foot, about the point below its centre of mass.

    A rigid body stands on that face of its convex hull which has its centre of mass above it, and the foot of a container
    is level. The foot of a scan may be ragged, so the wall has to agree: the line of its centres leans less when turned.
    A foot that is level within the height up to which it is clamped is left as it is.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(state.vertices[np.unique(state.faces)])
    except QhullError:  # flat
        return state, []
    area = np.linalg.norm(area_vectors(state.vertices, state.faces), axis=1)
    centre = np.average(state.vertices[state.faces].mean(axis=1), axis=0, weights=area)
    normal, offset = hull.equations[:, :3], hull.equations[:, 3]
    below = np.flatnonzero(normal[:, 2] < -np.cos(np.radians(MAX_LEAN_DEGREES)))
    below = below[np.argsort(normal[below, 2])]
    for face in below:
        foot = centre - (normal[face] @ centre + offset[face]) * normal[face]
        corner = hull.points[hull.simplices[face]]
        side = np.cross(np.roll(corner, -1, axis=0) - corner, foot - corner) @ normal[face]
        if (side >= 0).all() or (side <= 0).all():
            break
    else:
        return state, []
    height = float(np.ptp(hull.points[:, 2]))
    level = hull.points[np.abs(hull.points @ normal[face] + offset[face]) < SAME_PLANE * height, 2]
    if np.ptp(level) <= FOOT_FRACTIONS[0] * height:
        return state, []
    axis = np.cross(-normal[face], [0.0, 0.0, 1.0])
    angle = float(np.arcsin(np.linalg.norm(axis)))
    turned = (state.vertices - foot) @ so3_exp(axis * (angle / np.sin(angle))).T + foot
    if _lean(turned, state.faces) >= _lean(state.vertices, state.faces):
        return state, []
    note = (
        f"it leant by {np.degrees(angle):.2g} degrees and was turned about ({_listed(foot)}) m onto its foot"
    )
    return replace(state, vertices=turned), [note]


def _lean(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Slope of the line of centres of the steep triangles against the height axis; infinite if they have no height."""
    vector = area_vectors(vertices, faces)
    area = np.linalg.norm(vector, axis=1)
    steep = np.abs(vector[:, 2]) < np.sqrt(0.5) * area
    middle = vertices[faces[steep]].mean(axis=1)
    if not len(middle) or not np.ptp(middle[:, 2]):
        return np.inf
    middle = middle - np.average(middle, axis=0, weights=area[steep])
    moment = (area[steep, None] * middle).T @ middle
    return float(np.hypot(moment[0, 2], moment[1, 2]) / moment[2, 2])


def _listed(place: np.ndarray) -> str:
    return ", ".join(f"{value:.4g}" for value in place.round(5) + 0.0)


def _check_upright(state: MeshState, where: str) -> None:
    """Reject an object that lies on its side or is tilted: its wall has another axis, and it has no foot to stand on.

    The normals of a wall are perpendicular to its axis. Trays and pouches may also be longer than high, but their
    foot is about as long and as wide as they are.
    """
    normal = area_vectors(state.vertices, state.faces)
    size = np.linalg.norm(normal, axis=1)
    fraction, axes = np.linalg.eigh(
        np.einsum("fi,fj->ij", normal / np.maximum(size, 1e-300)[:, None], normal)
    )
    lean = float(np.degrees(np.arccos(min(1.0, abs(axes[2, 0])))))
    if fraction[1] < RUNS_ALONG * fraction[0] or lean < MAX_LEAN_DEGREES:
        return
    used = state.vertices[np.unique(state.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    foot = used[used[:, 2] <= low[2] + 0.02 * (high[2] - low[2])]
    stands = np.ptp(foot[:, :2], axis=0) / (high - low)[:2]
    if stands.min() > 0.5:
        return
    axis = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0])
    along = ", ".join(f"{value:.2g}" for value in axis.round(2) + 0.0)
    middle = ", ".join(f"{value:.4g}" for value in foot.mean(axis=0))
    nearest = "xyz"[int(np.abs(axes[:, 0]).argmax())]
    raise InputError(
        where,
        f"its wall runs along ({along}), {lean:.0f} degrees from the height axis, and it stands on an edge at "
        f"({middle}) m",
        field="mesh",
        remedy=f"turn it with --up {nearest} or --up -{nearest}" if nearest != "z" else "turn it upright",
    )
