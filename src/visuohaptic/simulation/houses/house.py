"""A house as it truly is: walls and furniture, what stands in a doorway today, and how badly wheels count there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile.obstacles import SimulatedObstacle
from ..mobile.odometry import OdometryErrors
from ..mobile.office import furnished_office

__all__ = ["House", "door_row", "office_house"]

#: The laser looks at cells this many times finer than those in which walls are drawn.
FINER = 4


@dataclass(frozen=True, slots=True, eq=False)
class House:
    """The truth of one floor on one day."""

    grid: OccupancyMap  #: walls and furniture
    tour_m: tuple[tuple[float, float], ...]  #: corners of the path on which a person leads the robot at first
    table_m: tuple[float, float]  #: from where the table is served; the tour stops there
    heading_rad: float  #: in which the robot stands at the end of the tour, where its errands begin
    obstacles: tuple[SimulatedObstacle, ...] = ()  #: what stands on the floor today
    odometry: OdometryErrors = field(default_factory=OdometryErrors)

    @property
    def start(self) -> tuple[float, float, float]:
        """Where errands begin: x, y [m], heading [rad]."""
        return (*self.tour_m[-1], self.heading_rad)

    def fine_grid(self) -> OccupancyMap:
        """The map in finer cells, for what stands on the floor."""
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
        From right to left as seen by who goes through.
    centre_m
        Of the doorway (x, y) [m].
    heading_rad
        In which it is gone through [rad].
    width_m
        Of the doorway [m].
    rng
        Draws by how much each stands before or behind the row.
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
        Draws the order of light bin, heavy box and fixed leg in the doorway.
    """
    office = furnished_office()
    kinds = [path.obstacle for path in office.paths]
    order = [kinds[int(k)] for k in rng.permutation(len(kinds))]
    tour = (
        (1.2, 1.8), (4.2, 1.4), (4.2, 2.95), (6.6, 2.9), (7.0, 1.8), (6.0, 2.9), (4.2, 3.2), (3.2, 4.6),
        (3.6, 2.95),
    )  # fmt: skip
    return House(
        OccupancyMap(office.cells, office.resolution_m, office.origin),
        tour,
        (6.6, 2.9),
        0.0,
        door_row(order, (5.0, 2.95), 0.0, 1.1, rng),
    )
