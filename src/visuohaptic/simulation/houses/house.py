"""Ground truth of a house: walls and furniture, objects in a doorway, and odometry errors on its floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile import OdometryErrors, SimulatedObstacle, furnished_office

#: Ratio of the resolution of the laser's grid to that of the walls.
FINER = 4


@dataclass(frozen=True, slots=True, eq=False)
class House:
    """Ground truth of one floor on one day."""

    grid: OccupancyMap  #: walls and furniture
    tour_m: tuple[tuple[float, float], ...]  #: corners of the path along which a person first leads the robot
    table_m: tuple[float, float]  #: position from which the table is reached; the tour stops there
    heading_rad: float  #: heading at the end of the tour, where its tasks start
    obstacles: tuple[SimulatedObstacle, ...] = ()  #: objects on the floor today
    odometry: OdometryErrors = field(default_factory=OdometryErrors)

    @property
    def start(self) -> tuple[float, float, float]:
        """Start of the tasks: x, y [m], heading [rad]."""
        return (*self.tour_m[-1], self.heading_rad)

    def fine_grid(self) -> OccupancyMap:
        """The map at a finer resolution, for objects on the floor."""
        fine = np.kron(self.grid.cells, np.ones((FINER, FINER), dtype=np.int8))
        return OccupancyMap(fine, self.grid.resolution_m / FINER, self.grid.origin)


def door_row(
    kinds: Sequence[SimulatedObstacle],
    centre_m: Sequence[float],
    heading_rad: float,
    width_m: float,
    rng: np.random.Generator,
) -> tuple[SimulatedObstacle, ...]:
    """Objects side by side in a doorway, with equal gaps.

    Parameters
    ----------
    kinds
        Objects from right to left in the direction of passage.
    centre_m
        Centre of the doorway (x, y) [m].
    heading_rad
        Direction of passage [rad].
    width_m
        Width of the doorway [m].
    rng
        Source of the random offset of each object along the passage.
    """
    widths = [min(one.width_m, one.length_m) if one.fixed else one.width_m for one in kinds]
    gap = (width_m - sum(widths)) / (len(kinds) + 1)
    beside, found = -0.5 * width_m, []
    turn = rotation_2d(heading_rad)
    for one, width in zip(kinds, widths, strict=True):
        beside += gap + 0.5 * width
        place: Float[np.ndarray, "2"] = turn @ np.array([float(rng.uniform(-0.01, 0.01)), beside])
        x, y = place + np.asarray(centre_m)
        found.append(one.moved(float(x), float(y), heading_rad))
        beside += 0.5 * width
    return tuple(found)


def office_house(rng: np.random.Generator) -> House:
    """The fixed office of :func:`~visuohaptic.simulation.mobile.furnished_office`, its doorway blocked.

    Parameters
    ----------
    rng
        Source of the random order of light bin, heavy box and fixed leg in the doorway.
    """
    office = furnished_office()
    kinds = [path.obstacle for path in office.paths]
    order = [kinds[int(k)] for k in rng.permutation(len(kinds))]
    tour = (
        (1.2, 1.8), (4.2, 1.4), (4.2, 2.95), (6.6, 2.9), (7.0, 1.8), (6.0, 2.9), (4.2, 3.2), (3.2, 4.6),
        (3.6, 2.95),
    )  # fmt: skip
    return House(
        office.map,
        tour,
        (6.6, 2.9),
        0.0,
        door_row(order, (5.0, 2.95), 0.0, 1.1, rng),
    )
