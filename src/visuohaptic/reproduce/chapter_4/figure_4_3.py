"""Search for push goals (Fig. 4.3).

Detail of the map of Fig. 4.2: candidate positions (+) of the crate with the path that encircles it there,
points closer to obstacles than the platform's radius in red. Only the position in the door frame has
two occupied parts. Green: all goals according to the map M_g (synthetic floor plan).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_office import ROBOT
from .._building import OBJECTS, draw_map, outline, with_all
from ..output import Output
from ..pushes.goal_maps import GoalMap, blocked_parts, goal_map
from ..pushes.local_costmap import FootprintSamples, LocalCostmap

REACH_m = 1.6


def run(out: Output) -> None:
    """Goal map around the crate, and details of four candidates.

    Parameters
    ----------
    out
        Receives the tables ``candidates`` and ``goals``, picture ``push_goals``, and the comparisons; its seed and size are used.
    """
    item = OBJECTS[0]
    centre = item.centre_m
    radius = ROBOT.radius_m
    costmap = LocalCostmap.around(with_all(), item.footprint_m, 2.2)
    footprint = FootprintSamples.of(item.footprint_m - centre, radius, costmap.map.resolution_m)
    at = (float(centre[0]), float(centre[1]), 0.0)
    path = np.array([[centre[0], centre[1] - 1.3], [centre[0], centre[1] + 1.2]])
    goals = goal_map(costmap, footprint, at, radius, blocked_path_m=path, reach_m=REACH_m)
    anywhere = goal_map(costmap, footprint, at, radius, reach_m=REACH_m)
    # In free space, at a wall, in the hallway, in the door frame.
    spots = np.array([[6.1, 2.1], [8.2, 3.05], [8.1, 4.5], [float(centre[0]), 3.55]])
    parts = blocked_parts(costmap, footprint, np.column_stack([spots, np.zeros(len(spots))]), radius)
    found = [bool(_value(costmap, anywhere, spot)) for spot in spots]
    out.table("candidates", {"x_m": spots[:, 0], "y_m": spots[:, 1], "occupied_parts": parts, "goal": found})
    cells = np.argwhere(goals.goal)
    places = costmap.map.world_from_cell(cells)
    out.table("goals", {"x_m": places[:, 0], "y_m": places[:, 1]})
    out.picture("push_goals", draw_axes(1, 1, lambda axes: _draw(axes, costmap, goals, footprint, spots, path),
                                        size=(7.0, 6.4)))  # fmt: skip
    out.compare("candidates with two occupied parts", sum(n >= 2 for n in parts), f"of {len(spots)}",
                dissertation=1, note="the one in the door frame")  # fmt: skip
    out.compare("occupied parts in the door frame", parts[-1], dissertation=2)
    out.compare("goals that open the path", float(goals.goal.sum()) * costmap.map.resolution_m**2, "m^2")


def _value(costmap: LocalCostmap, goals: GoalMap, spot: np.ndarray) -> bool:
    row, column = costmap.map.cell_from_world(spot)
    return bool(goals.goal[row, column])


def _draw(
    axes: Any,
    costmap: LocalCostmap,
    goals: GoalMap,
    footprint: FootprintSamples,
    spots: np.ndarray,
    path: np.ndarray,
) -> None:
    draw_map(axes, costmap.map)
    x, y, _ = costmap.map.origin
    wide, high = costmap.map.size_m
    green = np.zeros((*goals.goal.shape, 4))
    green[goals.goal] = (0.3, 0.75, 0.35, 0.45)
    axes.imshow(green, origin="lower", extent=(x, x + wide, y, y + high), interpolation="nearest")
    outline(axes, OBJECTS[0].footprint_m, color="#8a5a2b", lw=2, label="crate")
    axes.plot(*path.T, "--", color=COLOURS["ink"], lw=1.2, label="path to be opened")
    for number, spot in enumerate(spots):
        ring = footprint.ring_m + spot
        bad = costmap.distance_at(ring) < ROBOT.radius_m
        outline(axes, footprint.outline_m + spot, color="#8a5a2b", lw=0.8, ls=":")
        axes.plot(*ring[~bad].T, ".", color=COLOURS["blue"], ms=3, label="free" if number == 0 else None)
        axes.plot(*ring[bad].T, "x", color="red", ms=4, label="occupied" if number == 1 else None)
        axes.plot(*spot, "+", color=COLOURS["blue"], ms=10, mew=2)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
    axes.set(xlim=(x, x + wide), ylim=(y, y + high))
