"""Measured wall thickness by location, from an ultrasonic gauge or cut samples: read from CSV, applied to a container."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError, brief_list
from ...core.files import MAX_HAND_BYTES, read_csv
from ..shapes.mesher import ShellObject
from ..shells.shell import ShellMesh

#: Columns of a height profile, and of a table of points.
PROFILE, PLACES = ("z_m", "thickness_m"), ("x_m", "y_m", "z_m", "thickness_m")
#: Number of points that a triangle is interpolated from, and their maximum distance as a fraction of the height.
NEIGHBOURS, FARTHEST = 3, 0.25


def load_thickness_map(path: Path | str) -> Float[np.ndarray, "n c"]:
    """Read thickness by height (z_m, thickness_m) or by point (x_m, y_m, z_m, thickness_m) [m].

    Parameters
    ----------
    path
        CSV with those columns, in the frame of the stiffness map.

    Raises
    ------
    InputError
        Wrong columns, a cell that is not a number, or a thickness that is not positive; with the line number.
    """
    names, rows = read_csv(path, max_bytes=MAX_HAND_BYTES)
    if tuple(names) not in (PROFILE, PLACES):
        raise InputError(
            path, f"found columns {brief_list(names)}, expected {', '.join(PROFILE)} or {', '.join(PLACES)}"
        )
    values = []
    for row in rows:
        values.append([row.number(name) for name in names])
        if values[-1][-1] <= 0:
            raise row.problem(f"found {values[-1][-1]:g}, expected a positive thickness", names[-1])
    return np.array(values)


def with_thickness_map(container: ShellObject, values: Float[np.ndarray, "n c"], where: str) -> ShellObject:
    """The object with a variable wall thickness.

    Parameters
    ----------
    container
        Parametric or imported container.
    values
        See :func:`load_thickness_map`.
    where
        Name of the map in messages.

    Raises
    ------
    InputError
        Points that are far from the surface: probably another frame or unit.
    """
    mesh = container.mesh
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    if values.shape[1] == len(PROFILE):
        order = np.argsort(values[:, 0])
        thickness = np.interp(middle[:, 2], *values[order].T)
        away = np.maximum(values[:, 0] - middle[:, 2].max(), middle[:, 2].min() - values[:, 0])
    else:
        from scipy.spatial import cKDTree

        count = min(NEIGHBOURS, len(values))
        distance, number = cKDTree(values[:, :3]).query(middle, count)
        distance, number = distance.reshape(-1, count), number.reshape(-1, count)
        weight = 1.0 / np.maximum(distance, 1e-9)
        thickness = np.einsum("fk,fk->f", weight, values[number, 3]) / weight.sum(axis=1)
        away = cKDTree(middle).query(values[:, :3])[0]
    if float(np.max(away)) > FARTHEST * container.height_m:
        row = int(np.argmax(away))
        raise InputError(
            where,
            f"row {row + 1} is {1e3 * float(away[row]):.3g} mm from the wall, which is {1e3 * container.height_m:.3g} mm high",
            remedy="give places in metres, in the frame of the map that `stiffness` writes",
        )
    return replace(
        container,
        mesh=ShellMesh(mesh.vertices_m, mesh.faces, thickness, mesh.fraction),
        notes=(
            *container.notes,
            f"thickness from {len(values)} places: {1e3 * thickness.min():.3g} to {1e3 * thickness.max():.3g} mm",
        ),
    )
