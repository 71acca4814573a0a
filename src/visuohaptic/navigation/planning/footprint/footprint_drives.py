"""Drives of a convex footprint: forwards along straight lines, turns on the spot at the corners.

The search is A* over (place, one of 16 headings) on a lattice through the start, with the cost-to-go of a disc.
Every step and turn, and in the end every drive of the path, is tested by the cells that the outline sweeps: occupied cells
are closed squares, objects are the cells of at most 1 cm that they touch, where the size of the map permits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int32

from ..arrays import Path, Point, Shifts
from ..object_cells import fill_cells, window_around
from ..search._travel_kernels import UNITS, clearances_at, travel_field
from ..search.bodies import sampled
from ..search.cell_paths import resampled
from ..search.drives import pull_string
from ..search.push_states import Deadline, PushStep
from ..search.search_domain import SearchDomain
from . import _footprint_kernels as kernels

#: Maximum size of the cells on which objects are drawn, and spacing of the lattice [m].
FINE_M, STEP_M = 0.01, 0.05
#: Maximum number of these cells, and of places of the lattice.
MAX_FINE, MAX_PLACES = 30_000_000, 1_000_000
#: Margins around the drive of the inscribed circle within which the drive of the footprint is searched, in order [m].
MARGINS_M = (4.0, 30.0)
#: Headings with whole steps, in order.
MOVES = np.array(
    [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1),
     (-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1)]
)  # fmt: skip
#: Shares of a push by which the robot backs off where it has no room to turn, the first that helps.
BACK = (0.0, 0.5, 1.0)
#: Number of points of a path between which chords are tried.
CHORD_POINTS = 50


@dataclass(slots=True, eq=False)
class FootprintDrives:
    """Drives and pushes of a domain's robot, if it has a footprint."""

    domain: SearchDomain
    deadline: Deadline | None = None  #: no other drive is searched after it
    outline: Path = field(init=False)  #: corners of the robot [fine cells]
    factor: int = field(init=False)  #: fine cells per cell
    key: bytes = field(default=b"", init=False)  #: positions of the bodies that are counted
    #: fine cells that are occupied without the bodies, counts with them, and rows that contain one
    layers: tuple[Bool[np.ndarray, "r c"], Int32[np.ndarray, "r c1"], Bool[np.ndarray, "r"]] | None = field(
        default=None, init=False
    )

    def __post_init__(self) -> None:
        map = self.domain.map
        cells = map.cells.size
        self.factor = max(1, min(math.ceil(map.resolution_m / FINE_M - 1e-9), math.isqrt(MAX_FINE // cells)))
        self.outline = np.array(self.domain.robot.footprint_m) * self.factor / map.resolution_m

    def drive(
        self, shifts: Shifts, start: Point, goal: Point, begin: float = math.nan, end: float = math.nan
    ) -> tuple[Path, float]:
        """A collision-free drive; empty and infinite if none was found.

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        start, goal
            Grid coordinates [cells].
        begin, end
            Headings at start and goal on the grid [rad]; NaN: any.

        Returns
        -------
        corners in grid coordinates, cost of driving and turning [cells at full speed]
        """
        nowhere = np.zeros((0, 2)), math.inf
        disc, _ = pull_string(self.domain, shifts, start, goal)
        if not len(disc):
            return nowhere
        counts, clearance = self._counts(shifts), self.domain.clearance_with(shifts)
        if len(disc) == 1:
            turns = kernels.poses_clear(counts, self.outline, start[None] * self.factor, begin, end)
            return (disc, self._turns(disc, begin, end)) if turns else nowhere
        tried = None
        for margin_m in MARGINS_M:
            if self.deadline is not None and self.deadline.passed:
                break
            margin = margin_m / self.domain.map.resolution_m
            limit = np.array(clearance.shape[::-1], dtype=np.float64)
            low, high = np.maximum(disc.min(axis=0) - margin, 0), np.minimum(disc.max(axis=0) + margin, limit)
            if tried is not None and (tried == (low, high)).all():
                break
            tried = np.stack([low, high])
            path = self._searched(counts, clearance, tried, np.stack([start, goal]), (begin, end))
            if not len(path):
                continue
            for count in (0, CHORD_POINTS):
                path = self._chords(counts, clearance, resampled(path, count), begin, end)
            if kernels.poses_clear(counts, self.outline, path * self.factor, begin, end):
                return path, self.domain.driving_cost(shifts, path) + self._turns(path, begin, end)
        return nowhere

    def leg(
        self,
        shifts: Shifts,
        begin: tuple[Point, float],
        last: PushStep | None,
        step: PushStep | None,
        end: Point,
    ) -> tuple[Path, float, float]:
        """The drive to the next push, or to the goal; empty and infinite if that drive, or the push, is not possible.

        Parameters
        ----------
        shifts
            See :meth:`drive`.
        begin
            Grid coordinates [cells] and heading [rad] of its start.
        last, step
            The pushes before and after it.
        end
            Grid coordinates [cells].

        Returns
        -------
        corners, cost, and the share of the last push by which the robot backs off before it
        """
        if step is None or self.push_is_free(step):
            for share in BACK if last is not None else BACK[:1]:
                # No room to turn or to pass: farther back along the push.
                at = last.retreat + share * (last.approach - last.retreat) if last and share else begin[0]
                path, cost = self.drive(shifts, at, end, begin[1], self.heading(step))
                if len(path):
                    return path, cost, share
        return np.zeros((0, 2)), math.inf, 0.0

    def heading(self, step: PushStep | None) -> float:
        """Heading of a push on the grid [rad]; NaN without one.

        Parameters
        ----------
        step
            The push.
        """
        if step is None:
            return math.nan
        ahead = self.domain.bodies[step.body].push(step.contact).direction
        return math.atan2(ahead[1], ahead[0])

    def push_is_free(self, step: PushStep) -> bool:
        """Whether the robot sweeps no obstacle between approach and retreat pose of a push.

        Parameters
        ----------
        step
            The push.
        """
        body = self.domain.bodies[step.body]
        ahead = body.push(step.contact).direction
        touch = step.touch + step.length * ahead
        counts = self._counts(step.shifts_before, without=step.body)
        path = np.stack([step.approach, touch]) * self.factor
        heading = self.heading(step)
        return bool(kernels.poses_clear(counts, self.outline, path, heading, heading))

    def _counts(self, shifts: Shifts, without: int = -1) -> Int32[np.ndarray, "rows columns"]:
        """Number of occupied fine cells before each column of a row, the last one included."""
        if self.layers is None:
            occupied = self.domain.occupied.repeat(self.factor, axis=0).repeat(self.factor, axis=1)
            fill_cells(occupied, *(outline * self.factor for outline in self.domain.immovable_outlines))
            counts = np.pad(np.cumsum(occupied, axis=1, dtype=np.int32), ((0, 0), (1, 0)))
            self.layers = occupied, counts, np.zeros(len(counts), dtype=bool)
        occupied, counts, before = self.layers
        key = shifts.tobytes() + str(without).encode()
        if self.key != key:  # only rows with a body, now or before, are counted again
            bodies = [b.outline + s for b, s in zip(self.domain.bodies, shifts, strict=True)]
            outlines = [outline * self.factor for k, outline in enumerate(bodies) if k != without]
            rows = np.zeros(len(counts), dtype=bool)
            for outline in outlines:
                rows[window_around(occupied.shape, outline, 0.0)[0]] = True
            changed = rows | before
            still = occupied[changed]
            fill_cells(occupied, *outlines)
            counts[changed, 1:] = np.cumsum(occupied[changed], axis=1)
            occupied[changed] = still
            self.key, self.layers = key, (occupied, counts, rows)
        return counts

    def _searched(
        self,
        counts: Int32[np.ndarray, "rows columns"],
        clearance: Float[np.ndarray, "r c"],
        window: Float[np.ndarray, "2 2"],
        ends: Float[np.ndarray, "2 2"],
        headings: tuple[float, float],
    ) -> Path:
        """Corners of the cheapest path over the lattice in a window, and the goal; empty without one [cells]."""
        domain, fine = self.domain, self.factor
        step = max(1, round(STEP_M * fine / domain.map.resolution_m))
        step = max(step, math.ceil(math.sqrt(np.prod(fine * (window[1] - window[0])) / MAX_PLACES)))
        start, goal = ends * fine
        first = start - step * np.floor((start - window[0] * fine) / step)
        columns, rows = (np.floor((window[1] * fine - first) / step).astype(int) + 1).tolist()
        nodes = (first + step * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)) / fine
        free = clearances_at(clearance, nodes.reshape(-1, 2)).reshape(rows, columns)
        # The clearance between cell centres is interpolated: only what is closed for certain is left out here.
        price = np.where(free > domain.radius - 1.5, UNITS * self._slowness(free), 0.0)
        angles = np.arctan2(MOVES[:, 1], MOVES[:, 0]).astype(np.float64)
        runs, starts = self._swept(first, step, angles)
        place = np.array([*first, step])
        away = np.hypot(*((nodes * fine - goal) / step).reshape(-1, 2).T)
        near = np.flatnonzero(away < 1.5).astype(np.int32)
        none = np.zeros(0, np.int32)
        reach = domain.robot.reach_m * fine / domain.map.resolution_m
        target = np.array([*goal, headings[1], 2.0 * reach])
        passed = price.astype(bool)
        passed.flat[near] = True
        to_go = travel_field(
            np.where(passed, np.maximum(free, domain.radius + 0.01), 0.0).astype(np.float32), domain.radius, domain.slow,
            near, np.zeros_like(near), np.zeros((0, 0), np.int16), none, none, 0, none,
        )  # fmt: skip
        begin = headings[0]
        turn = [0.0 if math.isnan(begin) else abs(kernels.shorter_turn(begin, angle)) for angle in angles]
        possible = [
            k for k, angle in enumerate(angles)
            if kernels.poses_clear(counts, self.outline, start[None], angle if math.isnan(begin) else begin, angle)
        ]  # fmt: skip
        column, row = np.rint((start - first) / step).astype(int).tolist()
        node = row * columns + column
        seeds = np.array([node * len(MOVES) + k for k in possible], np.int64)
        costs = np.array([turn[k] * reach / step * UNITS for k in possible]).astype(np.int32)
        states = kernels.lattice_path(
            counts, self.outline, price, to_go, MOVES, angles, runs, starts, place, seeds, costs, target,
            UNITS * reach / step,
        )  # fmt: skip
        if not len(states):
            return np.zeros((0, 2))
        path = np.concatenate([nodes.reshape(-1, 2)[states[::-1] // len(MOVES)], ends[1:]])
        steps = np.diff(path, axis=0)
        path = path[np.concatenate([[True], np.hypot(*steps.T) > 1e-9])]
        ahead = np.arctan2(*np.diff(path, axis=0).T[::-1])
        return path[np.concatenate([[True], np.abs(np.diff(ahead)) > 1e-9, [True]])]

    def _swept(
        self, first: Point, step: int, angles: Float[np.ndarray, "h"]
    ) -> tuple[Int32[np.ndarray, "n 3"], Int32[np.ndarray, "m"]]:
        """Cells swept by the step of every heading and by the turn from it to the next one, from the node's cell."""
        parts = []
        x, y = first - np.floor(first)
        for (dx, dy), angle in zip(step * MOVES, angles, strict=True):
            placed = [
                kernels.turned(self.outline, x, y, angle, 1.0),
                kernels.turned(self.outline, x + dx, y + dy, angle, 1.0),
            ]
            parts.append(kernels.hull_runs(np.concatenate(placed)))
        for angle, following in zip(angles, np.roll(angles, -1), strict=True):
            turn = kernels.shorter_turn(angle, following)
            places = np.linspace(angle, angle + turn, math.ceil(turn / kernels.TURN_STEP) + 1)
            grow = 1.0 / math.cos(0.5 * (places[1] - places[0]))
            parts.append(
                kernels.hull_runs(
                    np.concatenate([kernels.turned(self.outline, x, y, place, grow) for place in places])
                )
            )
        return np.concatenate(parts), np.cumsum([0, *map(len, parts)])

    def _chords(
        self,
        counts: Int32[np.ndarray, "rows columns"],
        clearance: Float[np.ndarray, "r c"],
        path: Path,
        begin: float,
        end: float,
    ) -> Path:
        """A path with chords between its points where they are free and cheaper, the farthest first."""
        kept, heading, at = [0], begin, 0
        while at < len(path) - 1:
            for to in range(len(path) - 1, at, -1):
                rest = path[to : to + 2]
                following = end if len(rest) == 1 else math.atan2(*np.diff(rest, axis=0)[0][::-1])
                chord = path[[at, to]]
                dearer = self._cost(clearance, chord, heading, following) > 1e-9 + self._cost(
                    clearance, path[at : to + 1], heading, following
                )
                if to == at + 1 or (
                    not dearer
                    and kernels.poses_clear(counts, self.outline, chord * self.factor, heading, following)
                ):
                    break
            heading = math.atan2(*(path[to] - path[at])[::-1])
            kept.append(to)
            at = to
        return path[kept]

    def _cost(self, clearance: Float[np.ndarray, "r c"], path: Path, begin: float, end: float) -> float:
        """Cost (4.1) of a path by interpolated clearances, and of its turns [cells at full speed]."""
        places, lengths = sampled(path, 0.5)
        slow = self._slowness(clearances_at(clearance, places)) @ lengths
        return float(slow) + self._turns(path, begin, end)

    def _turns(self, path: Path, begin: float, end: float) -> float:
        """Cost of the turns of a path, at which the farthest corner moves at full speed [cells at full speed]."""
        headings = np.arctan2(*np.diff(path, axis=0).T[::-1])
        turns = np.diff(np.concatenate([[begin], headings, [end]]))
        turns = np.abs((turns + math.pi) % (2.0 * math.pi) - math.pi)
        return self.domain.robot.reach_m / self.domain.map.resolution_m * float(np.nansum(turns))

    def _slowness(self, clearance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """v_max over the speed at a clearance [cells]; the lowest speed below the radius, between cell centres."""
        share = np.clip((clearance / self.domain.radius - 1.0) * 0.5, 0.0, 1.0)
        return self.domain.slow + share * (1.0 - self.domain.slow)
