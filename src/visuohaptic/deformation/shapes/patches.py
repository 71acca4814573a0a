"""Structured triangle meshes of simple shells, for checks, reference solutions and quick estimates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from ..shells.shell import ShellMesh


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
