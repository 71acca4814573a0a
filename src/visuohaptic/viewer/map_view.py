"""A map with a plan: the robot's path and the pushed objects."""

from __future__ import annotations

import numpy as np

from ..io.maps.occupancy_map import OccupancyMap
from ..navigation.problem.path_plan import Plan
from .map_layer import draw_map
from .server import markdown_text
from .stage import Stage

#: Height of the drawn paths above the floor [m].
_LIFT_M = 0.02
_COLOURS = {
    "navigate": (0, 114, 178),
    "push": (213, 94, 0),
    "sideward": (230, 159, 0),
    "turn": (176, 60, 40),
    "explore": (204, 121, 167),
    "wait": (120, 120, 120),
    "door": (0, 158, 115),
}


class MapView:
    """A map, a plan, or both; without a map, the plan is drawn on an empty floor.

    Parameters
    ----------
    title
        Headline.
    grid
        Occupancy map, or None.
    plan
        Plan on that map, or None.
    """

    def __init__(self, title: str, grid: OccupancyMap | None = None, plan: Plan | None = None) -> None:
        self.title, self.grid, self.plan = title, grid, plan

    def draw(self, stage: Stage) -> None:
        """Draw the map on the floor, paths and pushes above it, and the tasks as a table.

        Parameters
        ----------
        stage
            Empty stage.
        """
        centre, reach = (0.0, 0.0, 0.0), 2.0
        if self.grid is not None:
            grid = self.grid
            handle, centre, reach = draw_map(stage.scene, grid.cells, grid.resolution_m, grid.origin)
            stage.keep("map", handle)
        if self.plan is not None:
            ways = [np.array(task.path_m) for task in self.plan.tasks if len(task.path_m) > 1]
            if self.grid is None and ways:
                points = np.concatenate(ways)
                low, high = points.min(axis=0), points.max(axis=0)
                x, y = (0.5 * (low + high)).tolist()
                centre, reach = (x, y, 0.0), max(float(np.ptp(points, axis=0).max()), 0.5)
            self._draw_plan(stage, self.plan, reach)
        stage.keep("tasks", stage.gui.add_markdown(self._text(), order=10))
        stage.look(centre, 0.75 * reach)

    def _draw_plan(self, stage: Stage, plan: Plan, reach_m: float) -> None:
        thick = 0.006 * reach_m
        for number, task in enumerate(plan.tasks):
            colour = _COLOURS[task.kind]
            way = np.array(task.path_m, dtype=np.float64).reshape(-1, 2)
            if len(way) > 1:
                points = np.column_stack([way, np.full(len(way), _LIFT_M)]).astype(np.float32)
                segments = np.stack([points[:-1], points[1:]], axis=1)
                # A path with physical width: visible from above and from the side.
                node = stage.scene.add_line_segments(f"/view/way{number}", segments, colour, thickness=thick)
                stage.keep(f"way{number}", node)
            if task.goal_m is not None and task.displacement_m is not None:
                end = np.array([*task.goal_m, 2 * _LIFT_M])
                start = end - np.array([*task.displacement_m, 0.0])
                arrow = np.stack([start, end])[None].astype(np.float32)
                node = stage.scene.add_arrows(
                    f"/view/push{number}",
                    arrow,
                    colour,
                    shaft_radius=0.6 * thick,
                    head_radius=1.6 * thick,
                    head_length=3 * thick,
                )
                stage.keep(f"push{number}", node)
                name = stage.scene.add_label(
                    f"/view/name{number}", task.object or task.kind, position=tuple(end.tolist())
                )
                stage.keep(f"name{number}", name)

    def _text(self) -> str:
        lines = [f"**{markdown_text(self.title)}**"]
        if self.grid is not None:
            width, height = self.grid.size_m
            lines.append(f"{width:.1f} x {height:.1f} m, cells of {100 * self.grid.resolution_m:.3g} cm")
        if self.plan is None:
            return "  \n".join(lines)
        if not self.plan.reachable:
            return "  \n".join([*lines, f"No plan: {markdown_text(self.plan.reason)}."])
        risk = self.plan.failure_probability
        lines.append(
            f"{self.plan.cost_s:.1f} s, {self.plan.length_m:.2f} m, {len(self.plan.pushes)} pushes, "
            f"failure probability {risk:.2f}"
        )
        table = ["", "| task | object | s | m | fails |", "|---|---|---|---|---|"]
        table += [
            f"| {task.kind} | {markdown_text(task.object)} | {task.cost_s:.1f} | {task.length_m:.2f} "
            f"| {task.failure_probability:.2f} |"
            for task in self.plan.tasks
        ]
        return "  \n".join(lines) + "\n" + "\n".join(table)
