"""Touches: contacts and free lines of a probe, planned touches, reachability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from ...core import POSITIVE, InputError, Pose, check_numbers, finite_array
from ...core.files import MAX_HAND_BYTES, CsvRow, read_csv
from ..mesh import SurfaceMesh


@dataclass(frozen=True, slots=True)
class CompletionSettings:
    """Settings of a completion."""

    visual_sigma_m: float = 0.0005  #: standard deviation of the visible surface [m]
    use_priors: bool = True  #: whether a touch predicts a ring from the visible cross-sections
    #: lower bound of missing parts and touches: the table plus the radius of the tip [m]
    floor_m: float = -np.inf


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """One movement of a point probe along a line.

    The line up to a contact was free; without a contact, the whole line.

    Examples
    --------
    >>> met = Touch([0.03, 0.0, 0.1], start_m=[0.2, 0.0, 0.1], sigma_m=0.0005)
    >>> missed = Touch(None, start_m=[0.2, 0.0, 0.1], end_m=[0.0, 0.0, 0.1])
    >>> met.contact_m.tolist(), missed.contact_m
    ([0.03, 0.0, 0.1], None)
    """

    contact_m: Float[np.ndarray, "3"] | None  #: point of the surface [m]; ``None``: no contact
    start_m: Float[np.ndarray, "3"] | None = None  #: start of the line [m]
    end_m: Float[np.ndarray, "3"] | None = None  #: end of the line without contact [m]
    sigma_m: float = 0.001  #: standard deviation of the contact [m]

    def __post_init__(self) -> None:
        for name in ("contact_m", "start_m", "end_m"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, finite_array("Touch", value, 3, field=name))
        if self.contact_m is None and (self.start_m is None or self.end_m is None):
            raise InputError("Touch", "has no contact, expected start and end of the free line")
        check_numbers("Touch", POSITIVE, sigma_m=self.sigma_m)

    def moved(self, pose: Pose) -> Touch:
        """The same touch in another frame.

        Parameters
        ----------
        pose
            Maps the frame of the touch to the other one.
        """
        points = (
            None if point is None else pose.apply(point)
            for point in (self.contact_m, self.start_m, self.end_m)
        )
        contact, start, end = points
        return Touch(contact, start, end, self.sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class TouchPlan:
    """A line for the probe: from the start, straight through the target, to the height axis."""

    target_m: Float[np.ndarray, "3"]  #: least supported point of the estimated surface [m]
    start_m: Float[np.ndarray, "3"]  #: start at a safe distance outside [m]
    end_m: Float[np.ndarray, "3"]  #: end on the height axis [m]: a probe that reaches it has missed
    score: float  #: biharmonic distance from the nearest support
    sigma_m: float  #: expected distance of the surface from the target [m]

    @property
    def direction(self) -> Float[np.ndarray, "3"]:
        """Horizontal unit vector from the start to the end."""
        way: Float[np.ndarray, "3"] = self.end_m - self.start_m
        return way / np.linalg.norm(way)


_AXES = ("x", "y", "z")


def read_touches(path: Path | str, *, sigma_m: float = 0.001) -> list[Touch]:
    """Read a table of touches.

    Columns ``x_m, y_m, z_m`` (contact; empty without contact), optionally
    ``start_x_m, start_y_m, start_z_m``, ``end_x_m, ...`` and ``sigma_m``.

    Parameters
    ----------
    path
        CSV file.
    sigma_m
        Standard deviation of contacts in a file without that column [m].

    Raises
    ------
    InputError
        The file is missing, lacks a column, or a row is not numeric.
    """
    touches = []
    for row in read_csv(path, [f"{axis}_m" for axis in _AXES], max_bytes=MAX_HAND_BYTES)[1]:
        sigma = row.number("sigma_m") if row.get("sigma_m") else sigma_m
        try:
            touches.append(Touch(_point(row), _point(row, "start_"), _point(row, "end_"), sigma))
        except InputError as error:
            raise row.problem(error.problem, error.field) from error
    return touches


def _point(row: CsvRow, prefix: str = "") -> Float[np.ndarray, "3"] | None:
    columns = [f"{prefix}{axis}_m" for axis in _AXES]
    return np.array([row.number(name) for name in columns]) if any(map(row.get, columns)) else None


def reachable(
    mesh: SurfaceMesh,
    axis_m: Float[np.ndarray, "2"],
    touches: Sequence[Touch],
    *,
    size_m: float,
    clear_m: float,
) -> Bool[np.ndarray, "v"]:
    """Vertices at which a horizontal line from outside meets the surface, away from earlier lines.

    What is behind a contact on its line is not met by the same line, and before it there is no surface.

    Parameters
    ----------
    mesh
        Estimated surface.
    axis_m
        x and y of the height axis [m].
    touches
        Touches so far.
    size_m
        Size of the region [m].
    clear_m
        Minimum distance from earlier lines [m].
    """
    outward = mesh.vertices_m[:, :2] - axis_m
    radius = np.linalg.norm(outward, axis=1)
    normals = mesh.vertex_normals
    facing = (normals[:, :2] * outward).sum(axis=1) / np.maximum(radius, 1e-9)
    ok = (facing > 0.2) & (radius > 0.02 * size_m)
    for touch in touches:
        end_m = touch.contact_m if touch.end_m is None else touch.end_m
        if touch.start_m is not None and end_m is not None:
            way = end_m - touch.start_m
            fraction = np.clip((mesh.vertices_m - touch.start_m) @ way / max(way @ way, 1e-12), 0, 1)
            gap = np.linalg.norm(mesh.vertices_m - touch.start_m - fraction[:, None] * way, axis=1)
            ok &= gap > clear_m
    return ok


def starts(
    targets_m: Float[np.ndarray, "n 3"],
    axis_m: Float[np.ndarray, "2"],
    supports_m: Float[np.ndarray, "s 3"],
    clear_m: float,
) -> Float[np.ndarray, "n 3"]:
    """Starts of lines to targets: outside the estimated radius and outside the radius of all supports.

    Parameters
    ----------
    targets_m
        Targets (n, 3) [m].
    axis_m
        x and y of the height axis [m].
    supports_m
        Known points (s, 3) of the surface [m].
    clear_m
        Clearance of the starts from the surface [m].
    """
    outward = targets_m[:, :2] - axis_m
    radius = np.linalg.norm(outward, axis=1, keepdims=True)
    reach = float(np.linalg.norm(supports_m[:, :2] - axis_m, axis=1).max())
    safe = np.maximum(2 * radius, reach + 2 * clear_m)
    found = targets_m.copy()
    found[:, :2] = axis_m + outward / np.maximum(radius, 1e-9) * safe
    return found
