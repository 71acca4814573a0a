"""Haptic map: the primitive of each contact, weighted by the distance from the contact (Alt 2016, Eq. 3.12).

Values range from -1 (free) over 0 (unknown) to 1
(occupied). Objects that moved when they were pushed are kept in a separate layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core import InputError, Primitive, PrimitiveKind, finite_array, rotation_2d
from ...io.maps.occupancy_map import FREE, OCCUPIED, UNKNOWN, OccupancyMap

#: Weight below which a cell is not changed.
_MIN = 0.01
#: Maximum number of cells of a map.
_MAX_CELLS = 25_000_000


@dataclass(frozen=True, slots=True, eq=False)
class HapticContact:
    """Result of one touch, in the frame F of the sensor (x away from the robot, y along the strip)."""

    primitive: Primitive  #: in frame F
    points_foam_m: Float[np.ndarray, "k 2"]  #: contact points X_k
    T_map_foam: tuple[float, float, float]  #: (x [m], y [m], yaw [rad]) of F in the map
    confidence: float = 1.0  #: 0..1, for instance the score of the primitive
    movable: bool = False  #: whether it moved when it was pushed

    def __post_init__(self) -> None:
        points = finite_array("HapticContact", self.points_foam_m, None, 2, field="points_foam_m")
        if not (np.isfinite(self.T_map_foam).all() and 0 <= self.confidence <= 1):
            raise InputError(
                "HapticContact",
                f"found pose {self.T_map_foam} and confidence {self.confidence}, expected finite and 0..1",
            )
        object.__setattr__(self, "points_foam_m", points)

    @property
    def diameter_m(self) -> float:
        """D: diameter of the smallest circle around the contact points."""
        import cv2

        # OpenCV adds 1e-4 to the radius, in any unit: with micrometres this is negligible.
        centred = self.points_foam_m - self.points_foam_m.mean(axis=0)
        (_, _), radius_um = cv2.minEnclosingCircle((centred * 1e6).astype(np.float32))
        return 2e-6 * float(radius_um)


def primitive_occupancy(
    primitive: Primitive, places_foam_m: Float[np.ndarray, "*n 2"], *, depth_m: float = math.inf
) -> Float32[np.ndarray, "*n"]:
    """m_O: 1 inside the primitive's object, -1 outside, 0 where it is unknown.

    Inside means the disc of a circle, the half plane behind a line, the area between the edges of a
    corner, and a square behind a segment, because its depth was not measured.

    Parameters
    ----------
    primitive
        In frame F; the robot is on the side of negative x.
    places_foam_m
        Positions to evaluate.
    depth_m
        Depth behind its surface up to which a line or corner is used; not limited in the dissertation.
    """
    p, places = primitive.parameters, np.asarray(places_foam_m, dtype=np.float64)
    if primitive.kind == PrimitiveKind.CIRCLE:
        depth, depth_m = p[2] - np.hypot(places[..., 0] - p[0], places[..., 1] - p[1]), math.inf
    elif primitive.kind == PrimitiveKind.CORNER:
        depth = _behind_corner(p, places)
    elif primitive.kind == PrimitiveKind.SEGMENT:
        start, along = p[:2], p[2:] - p[:2]
        length = max(float(np.hypot(*along)), 1e-9)
        along = along / length
        across = (places - start) @ along
        # A square; the area behind it is hidden by it.
        depth = np.where((across >= 0) & (across <= length), (places - start) @ _away(along), -1.0)
        depth_m = length
    else:
        depth = (places - p[:2]) @ _away(np.array([np.cos(p[2]), np.sin(p[2])]))
    return np.where(depth < 0, -1.0, np.where(depth <= depth_m, 1.0, 0.0)).astype(np.float32)


def _away(along: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """Normal that points away from the robot."""
    normal = np.array([along[1], -along[0]])
    return normal if normal[0] >= 0 else -normal


def _behind_corner(p: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "*n"]:
    """Area between the edges, on the side away from the robot."""
    edges = [np.array([np.cos(angle), np.sin(angle)]) for angle in p[2:4]]
    bisector = edges[0] + edges[1]
    relative = places - p[:2]
    normals = []
    for edge, other in ((edges[0], edges[1]), (edges[1], edges[0])):
        normal = np.array([-edge[1], edge[0]])
        normals.append(normal if normal @ other >= 0 else -normal)
    distance = np.stack([relative @ normal for normal in normals])
    between = distance.min(axis=0)
    if bisector[0] < 0:
        # The wedge opens towards the robot: a corner of the room, touched from inside.
        between = np.maximum(-distance[0], -distance[1])
    return np.asarray(between)


@dataclass(slots=True, eq=False)
class HapticMap:
    """Static and movable layers on a grid whose axes are those of the map frame.

    Examples
    --------
    >>> wall = Primitive(PrimitiveKind.LINE, np.array([0.0, 0.0, np.pi / 2]), np.eye(3), 1.0)
    >>> points = np.column_stack([np.zeros(9), np.linspace(-0.1, 0.1, 9)])
    >>> haptic = HapticMap.empty((0.0, 0.0), (4.0, 4.0), 0.05)
    >>> haptic.add(HapticContact(wall, points, (2.0, 2.0, 0.0)))
    >>> haptic.value_at(np.array([[2.02, 2.0], [1.98, 2.0]])).astype(float).round(1).tolist()
    [0.4, -0.4]
    """

    static: Float32[np.ndarray, "rows columns"]  #: -1 free .. 1 occupied
    movable: Float32[np.ndarray, "rows columns"]
    resolution_m: float
    origin_m: tuple[float, float]  #: (x, y) of the corner of cell (0, 0)
    rate: float  #: c of Eq. (3.12): how quickly old contacts are replaced
    depth_m: float  #: depth behind a surface up to which cells count as occupied
    contacts: int = 0  #: number of added contacts

    @classmethod
    def empty(
        cls,
        corner_m: tuple[float, float],
        size_m: tuple[float, float],
        resolution_m: float = 0.025,
        *,
        rate: float = 0.5,
        depth_m: float = math.inf,
    ) -> HapticMap:
        """An empty map, with all cells unknown.

        Parameters
        ----------
        corner_m
            x, y of the corner of cell (0, 0) [m], map frame.
        size_m
            Extent along x and y [m].
        resolution_m
            Edge length of a cell [m].
        rate
            c of Eq. (3.12): how quickly old contacts are replaced.
        depth_m
            Depth behind a surface up to which cells count as occupied [m].

        Raises
        ------
        InputError
            A size that is not positive, or too many cells.
        """
        if not (np.isfinite([*corner_m, *size_m, resolution_m]).all() and resolution_m > 0 < min(size_m)):
            raise InputError("HapticMap", f"found size {size_m}, resolution {resolution_m}, expected > 0")
        if not (0 < rate <= 1 and depth_m > 0):
            raise InputError(
                "HapticMap", f"found rate {rate}, depth {depth_m}, expected 0 < rate <= 1, depth > 0"
            )
        columns, rows = (math.ceil(length / resolution_m) for length in size_m)
        if rows * columns > _MAX_CELLS:
            raise InputError("HapticMap", f"found {rows} x {columns} cells, expected at most {_MAX_CELLS}")
        shape = (rows, columns)
        return cls(
            np.zeros(shape, np.float32), np.zeros(shape, np.float32), resolution_m, corner_m, rate, depth_m
        )

    def add(self, contact: HapticContact) -> None:
        """Add a contact to its layer: M <- (1 - c T(m_d)) M + c T(m_O m_d), Eq. (3.12).

        The front of a movable object is free space in the static layer, too.

        Parameters
        ----------
        contact
            The contact.
        """
        from scipy.spatial import cKDTree

        window, places = self._window(contact)
        if places.size == 0:
            return
        # m_d; a single point has no extent, and a contact of less than a millimetre cannot be measured.
        diameters = cKDTree(contact.points_foam_m).query(places)[0] / max(contact.diameter_m, 1e-3)
        trust = contact.confidence * np.exp(-diameters)
        trust = np.where(trust >= _MIN * contact.confidence, trust, 0.0).astype(np.float32)
        occupancy = primitive_occupancy(contact.primitive, places, depth_m=self.depth_m)
        layer = self.movable if contact.movable else self.static
        _update(layer[window], occupancy, self.rate * trust)
        if contact.movable:
            _update(self.static[window], np.minimum(occupancy, 0.0), self.rate * trust)
        self.contacts += 1

    def value_at(self, points_m: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Values of the static layer at positions (x, y) [m]; 0 outside.

        Parameters
        ----------
        points_m
            x, y [m], map frame.
        """
        cells = np.floor((points_m - np.array(self.origin_m)) / self.resolution_m).astype(np.int64)
        inside = ((cells >= 0) & (cells < np.array(self.static.shape)[::-1])).all(axis=-1)
        cells = np.where(inside[..., None], cells, 0)
        return np.where(inside, self.static[cells[..., 1], cells[..., 0]], 0.0)

    def occupancy(self, min_rate: float = 0.05) -> OccupancyMap:
        """Occupancy map of the cells with sufficient confidence; free space in front of a contact never hides an obstacle.

        Parameters
        ----------
        min_rate
            Minimum magnitude of a value, 0 to 1.
        """
        cells = np.full(self.static.shape, UNKNOWN, dtype=np.int8)
        cells[self.static <= -min_rate] = FREE
        cells[self.static >= min_rate] = OCCUPIED
        cells[(self.movable <= -min_rate) & (cells == UNKNOWN)] = FREE
        cells[self.movable >= min_rate] = OCCUPIED
        return OccupancyMap(cells, self.resolution_m, (*self.origin_m, 0.0))

    def _window(
        self, contact: HapticContact
    ) -> tuple[tuple[slice, slice], Float[np.ndarray, "rows columns 2"]]:
        """Cells near the contact, and their positions in frame F."""
        x, y, yaw = contact.T_map_foam
        points = contact.points_foam_m @ rotation_2d(yaw).T + [x, y]
        reach = max(contact.diameter_m, 2 * self.resolution_m) * -math.log(_MIN)
        low = (points.min(axis=0) - reach - np.array(self.origin_m)) / self.resolution_m
        high = (points.max(axis=0) + reach - np.array(self.origin_m)) / self.resolution_m
        rows, columns = self.static.shape
        top, bottom = (int(np.clip(v, 0, rows)) for v in (math.floor(low[1]), math.ceil(high[1])))
        left, right = (int(np.clip(v, 0, columns)) for v in (math.floor(low[0]), math.ceil(high[0])))
        gx = self.origin_m[0] + (np.arange(left, right) + 0.5) * self.resolution_m - x
        gy = self.origin_m[1] + (np.arange(top, bottom) + 0.5) * self.resolution_m - y
        places = np.stack(np.meshgrid(gx, gy), axis=-1) @ rotation_2d(yaw)
        return (slice(top, bottom), slice(left, right)), places


def _update(layer: np.ndarray, occupancy: np.ndarray, weight: np.ndarray) -> None:
    """Eq. (3.12) in place, where the primitive is defined."""
    says: Bool[np.ndarray, "rows columns"] = occupancy != 0
    layer[says] = ((1 - weight) * layer + weight * occupancy)[says]
