"""Occupancy maps: cells, pose in the world, and conversion to map_server files and ROS messages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ...core import MAX_PIXELS, POSITIVE, InputError, check_numbers, rotation_2d
from ._map_image import FREE, OCCUPIED, UNKNOWN, cells_from_image, read_map_image

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "OccupancyMap"]


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyMap:
    """A grid of cells on the floor; created from an array of -1..100, or of booleans (true = occupied).

    Row 0 is at the bottom: cell (row, column) covers ``column..column + 1`` cells
    along the grid's x axis and ``row..row + 1`` cells along its y axis. ``origin``
    is the pose of the outer corner of cell (0, 0) in the map frame.

    Examples
    --------
    >>> walls = np.zeros((4, 6), dtype=bool)
    >>> walls[0] = True
    >>> grid = OccupancyMap(walls, resolution_m=0.5)
    >>> grid.size_m, int(grid.occupied.sum()), grid.cell_from_world(np.array([1.2, 0.1])).tolist()
    ((3.0, 2.0), 6, [0, 2])
    """

    cells: Int8[np.ndarray, "rows columns"]  #: -1 unknown, 0 free .. 100 occupied
    resolution_m: float  #: edge of a cell
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: (x, y, yaw) [m, m, rad]

    def __post_init__(self) -> None:
        cells = np.asarray(self.cells)
        if cells.dtype == bool:
            cells = np.where(cells, np.int8(OCCUPIED), np.int8(FREE))
        if cells.ndim != 2 or cells.size == 0 or cells.size > MAX_PIXELS:
            raise InputError(
                "OccupancyMap",
                f"found shape {cells.shape}, expected rows x columns, 1 to {MAX_PIXELS} cells",
                field="cells",
            )
        if not np.issubdtype(cells.dtype, np.integer) or cells.min() < -1 or cells.max() > 100:
            raise InputError(
                "OccupancyMap", f"found {cells.dtype} {cells.min()} to {cells.max()}, expected -1 to 100"
            )
        check_numbers("OccupancyMap", POSITIVE, resolution_m=self.resolution_m)
        origin = tuple(float(value) for value in self.origin)
        if len(origin) != 3 or not np.isfinite(origin).all():
            raise InputError(
                "OccupancyMap", f"found {origin}, expected x, y, yaw, all finite", field="origin"
            )
        object.__setattr__(self, "cells", cells.astype(np.int8, copy=False))
        object.__setattr__(self, "origin", origin)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return int(self.cells.shape[0]), int(self.cells.shape[1])

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent along the grid's x and y axes [m]."""
        return self.shape[1] * self.resolution_m, self.shape[0] * self.resolution_m

    @property
    def occupied(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells that are definitely occupied (100)."""
        return self.cells == OCCUPIED

    @property
    def free(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells that are definitely free (0)."""
        return self.cells == FREE

    @property
    def unknown(self) -> Bool[np.ndarray, "rows columns"]:
        """Cells that were never observed (-1)."""
        return self.cells == UNKNOWN

    def _rotation(self) -> Float[np.ndarray, "2 2"]:
        return rotation_2d(self.origin[2])

    def world_from_cell(self, cells: Int[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Centres of cells in the map frame.

        Parameters
        ----------
        cells
            Cells (row, column), shape (..., 2).

        Returns
        -------
        array
            Points (x, y), shape (..., 2) [m].
        """
        grid = (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution_m
        return grid @ self._rotation().T + np.array(self.origin[:2])

    def cell_from_world(self, points_m: Float[np.ndarray, "*batch 2"]) -> Int[np.ndarray, "*batch 2"]:
        """Cells that contain points of the map frame.

        Parameters
        ----------
        points_m
            Points (x, y) in the map frame, shape (..., 2) [m].

        Returns
        -------
        array
            Cells (row, column), shape (..., 2); may be outside the map, see :meth:`inside`.
        """
        grid = (np.asarray(points_m, dtype=np.float64) - np.array(self.origin[:2])) @ self._rotation()
        # Far outside, or NaN, would wrap around to a valid index.
        cell = np.clip(np.nan_to_num(np.floor(grid / self.resolution_m), nan=-1.0), -(2**31), 2**31)
        return cell[..., ::-1].astype(np.int64)

    def inside(self, cells: Int[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
        """Which cells are on the map.

        Parameters
        ----------
        cells
            Cells (row, column), shape (..., 2).
        """
        cells = np.asarray(cells)
        return np.asarray(((cells >= 0) & (cells < np.array(self.shape))).all(axis=-1))

    def value_at(self, points_m: Float[np.ndarray, "*batch 2"]) -> Int8[np.ndarray, "*batch"]:
        """Occupancy at points; unknown outside the map.

        Parameters
        ----------
        points_m
            As in :meth:`cell_from_world`.

        Returns
        -------
        array
            -1 unknown, 0 free .. 100 occupied, shape (...).
        """
        cells = self.cell_from_world(points_m)
        inside = self.inside(cells)
        values = self.cells[np.where(inside, cells[..., 0], 0), np.where(inside, cells[..., 1], 0)]
        return np.where(inside, values, np.int8(UNKNOWN))

    @classmethod
    def load(cls, path: Path | str) -> OccupancyMap:
        """Read a map_server YAML file with its image (PGM, PNG, BMP or JPEG).

        Modes trinary, scale and raw, ``negate``, and both thresholds as in Nav2.
        Non-opaque pixels of an alpha channel are unknown.
        The image must be inside the folder of the YAML file; for an absolute
        path from another computer, the file name is looked up there.

        Parameters
        ----------
        path
            The YAML file.

        Raises
        ------
        InputError
            Names the file and field, what was found, and what was expected.
        """
        from ._map_server import load

        return cls(*load(Path(path)))

    @classmethod
    def from_image(
        cls, path: Path | str, resolution_m: float, *, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> OccupancyMap:
        """Read an image without YAML file.

        Parameters
        ----------
        path
            PGM, PPM, PNG, BMP or JPEG file.
        resolution_m
            Edge of a cell [m].
        origin
            Position (x, y) of the image's lower left corner in the map frame [m], and rotation about it
            [rad].

        Raises
        ------
        InputError
            The image is missing, of another format, too large or damaged.
        """
        image = read_map_image(Path(path))
        cells = cells_from_image(image, "trinary", False, 0.65, 0.196)  # as map_server writes them
        return cls(cells, resolution_m, origin)

    @classmethod
    def from_probability(
        cls,
        probability: Float[np.ndarray, "rows columns"],
        resolution_m: float,
        *,
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
        occupied_thresh: float = 0.65,
        free_thresh: float = 0.196,
    ) -> OccupancyMap:
        """Create a map from occupancy probabilities; cells between the thresholds are unknown.

        Parameters
        ----------
        probability
            Probabilities 0..1, NaN where unknown, row 0 at the bottom, shape (rows, columns).
        resolution_m
            Edge of a cell [m].
        origin
            Position (x, y) of the outer corner of cell (0, 0) in the map frame [m], and rotation about it
            [rad].
        occupied_thresh, free_thresh
            Probabilities above which a cell is occupied and below which it is free.

        Raises
        ------
        InputError
            A probability is outside 0..1.
        """
        values = np.asarray(probability, dtype=np.float64)
        if values.ndim != 2 or np.any((values < 0) | (values > 1)):
            raise InputError(
                "probability", f"found shape {values.shape}, expected rows x columns of 0..1 or NaN"
            )
        cells = np.full(values.shape, UNKNOWN, dtype=np.int8)
        cells[values < free_thresh] = FREE
        cells[values > occupied_thresh] = OCCUPIED
        return cls(cells, resolution_m, origin)

    def save(self, path: Path | str) -> None:
        """Write a map_server YAML file and a PGM image of the same name in the same folder.

        A map of unknown, free and occupied cells is written in mode trinary;
        one with intermediate values in mode raw. Both are lossless.

        Parameters
        ----------
        path
            YAML file that is created or replaced.

        Raises
        ------
        InputError
            The name does not end in ``.yaml`` or ``.yml``, or the file cannot be written.
        """
        from ._map_server import save

        save(Path(path), self.cells, self.resolution_m, self.origin)

    def to_message(self, t_s: float, frame: str = "map") -> dict[str, Any]:
        """Fields of ``nav_msgs/OccupancyGrid``.

        Parameters
        ----------
        t_s
            Time of the map, seconds since the epoch.
        frame
            Name of the map frame.
        """
        from ..ros.ros_messages import header

        x, y, yaw = self.origin
        head = header(t_s, frame)
        quaternion = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
        return {
            "header": head,
            "info": {
                "map_load_time": head["stamp"],
                "resolution": float(self.resolution_m),
                "width": self.shape[1],
                "height": self.shape[0],
                "origin": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": quaternion},
            },
            "data": self.cells.ravel().tolist(),
        }

    @classmethod
    def from_message(cls, message: Any, where: str = "OccupancyGrid") -> OccupancyMap:
        """Map of a decoded ``nav_msgs/OccupancyGrid``.

        Parameters
        ----------
        message
            The message.
        where
            File and topic, for messages.

        Raises
        ------
        InputError
            Size and data are inconsistent, or the grid is not horizontal.
        """
        info = message.info
        width, height = int(info.width), int(info.height)
        if width <= 0 or height <= 0 or width * height > MAX_PIXELS or len(message.data) != width * height:
            raise InputError(
                where,
                f"found {width} x {height} with {len(message.data)} cells, "
                f"expected as many, 1 to {MAX_PIXELS}",
                field="data",
            )
        q = info.origin.orientation
        if not (abs(q.x) < 1e-6 and abs(q.y) < 1e-6 and np.hypot(q.z, q.w) > 1e-9):
            raise InputError(
                where, f"found a tilted origin (x {q.x}, y {q.y}, z {q.z}, w {q.w})", field="orientation"
            )
        position = info.origin.position
        # The message stores the resolution in single precision: 0.05 is read as 0.05000000074505806.
        resolution = float(np.format_float_positional(np.float32(info.resolution), unique=True))
        cells = np.array(message.data, dtype=np.int8).reshape(height, width)
        return cls(cells, resolution, (position.x, position.y, float(2 * np.arctan2(q.z, q.w))))

    @classmethod
    def from_mcap(cls, path: Path | str, topic: str | None = None) -> OccupancyMap:
        """The last ``nav_msgs/OccupancyGrid`` of an MCAP file.

        Parameters
        ----------
        path
            The file.
        topic
            Topic of the map; may be omitted if there is only one: a local costmap is no map of the building.

        Raises
        ------
        InputError
            The file contains no map, or maps on several topics.
        """
        from ..ros.sqlite_bag import open_bag

        file = open_bag(path)
        found = {
            message.topic: message
            for message in file.messages({topic} if topic else None)
            if message.datatype == "nav_msgs/msg/OccupancyGrid"
        }
        if not found:
            raise InputError(path, "has no nav_msgs/msg/OccupancyGrid" + (f" on {topic}" if topic else ""))
        if len(found) > 1:
            raise InputError(path, f"has maps on {', '.join(sorted(found))}", remedy="name one topic")
        (last,) = found.values()
        return cls.from_message(file.decode(last), f"{path}:{last.topic}")
