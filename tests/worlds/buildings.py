"""Floors of buildings as a robot maps them, with their open doors: offices, homes and labs.

Rooms tile a rectangle; walls have doors where two rooms are connected. Some doors are closed, which is wall on a map;
some have their leaf standing in the room. Furniture stands along walls and in rooms; large rooms have partitions with
gaps that are not doors. The floor is rotated slightly and scanned from a few places; what was not seen is
unknown. Even seeds are for training, odd ones for reporting.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from shapely.affinity import rotate
from shapely.geometry.base import BaseGeometry

from .maps import overlapped_cells

__all__ = ["Building", "building", "scanned"]

CELL_M = 0.05
#: Minimum length of a shared wall in addition to the door's width [m].
BESIDE_M = 0.5
SCAN_RAYS, SCAN_RANGE_M = 720, 8.0
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Building:
    """A map and the jambs of its open doors."""

    name: str
    cells: np.ndarray  #: int8, -1 unknown, 0 free, 100 occupied; row 0 at y = 0
    cell_m: float
    jambs_m: np.ndarray  #: (n, 2, 2): both jambs of each open door that was seen


def building(seed: int) -> Building:
    """Building of a number; kinds alternate."""
    rng = np.random.default_rng([20261122, 11, seed])
    kind = ("office", "home", "lab")[seed // 2 % 3]
    rooms = _office(rng) if kind == "office" else _split(rng, (0.0, 0.0, *_size(rng, kind)), kind)
    thickness = float(rng.uniform(0.08, 0.25))
    doors = _doors(rng, rooms, kind)
    outline = shapely.union_all([shapely.box(*room) for room in rooms])
    walls: BaseGeometry = shapely.union_all(
        [
            shapely.box(*room).exterior.buffer(thickness / 2, cap_style="square", join_style="mitre")
            for room in rooms
        ]
    )
    open_doors, wings = [], []
    for middle, along, width in doors:
        if rng.random() < 0.15:
            continue  # closed: wall on a map
        across = np.array([-along[1], along[0]])
        half = 0.5 * width * along
        reach = (0.5 * thickness + 0.02) * across
        walls = walls.difference(
            shapely.Polygon(
                [middle - half - reach, middle + half - reach, middle + half + reach, middle - half + reach]
            )
        )
        open_doors.append(np.array([middle - half, middle + half]))
        if rng.random() < 0.5:
            wings.append(_wing(rng, middle, half, across, thickness))
    solids = [*shapely.get_parts(walls), *wings, *_furniture(rng, rooms, open_doors, kind)]
    turn = float(rng.uniform(-6.0, 6.0)) if rng.random() < 0.6 else 0.0
    low = np.array(rotate(outline, turn, origin=(0, 0)).buffer(1.0).bounds[:2])
    high = np.array(rotate(outline, turn, origin=(0, 0)).buffer(1.0).bounds[2:])
    size = tuple(int(np.ceil(v / CELL_M)) for v in (high - low)[::-1])
    solid = np.zeros(size, dtype=bool)
    for shape in solids:
        placed = shapely.affinity.translate(rotate(shape, turn, origin=(0, 0)), *-low)
        found = overlapped_cells(placed, CELL_M, (size[0], size[1]))
        solid[found[:, 0], found[:, 1]] = True
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    to_map = np.array([[c, s], [-s, c]])
    places = [np.array([0.5 * (r[0] + r[2]), 0.5 * (r[1] + r[3])]) for r in rooms]
    places += [jambs.mean(axis=0) for jambs in open_doors]
    cells = scanned(rng, solid, np.array(places) @ to_map - low)
    jambs = (np.array(open_doors).reshape(-1, 2, 2) @ to_map - low).reshape(-1, 2, 2)
    seen = [bool((_around(cells, pair.mean(axis=0)) == 0).mean() > 0.3) for pair in jambs]
    return Building(f"{kind} {seed}", cells, CELL_M, jambs[np.array(seen, dtype=bool)])


def _around(cells: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    column, row = (at_m / CELL_M).astype(int)
    return cells[max(row - 6, 0) : row + 7, max(column - 6, 0) : column + 7]


def _size(rng: np.random.Generator, kind: str) -> tuple[float, float]:
    low, high = (8.0, 13.0) if kind == "home" else (13.0, 22.0)
    return float(rng.uniform(low, high)), float(rng.uniform(0.7 * low, 0.8 * high))


def _office(rng: np.random.Generator) -> list[Rectangle]:
    """Rooms on both sides of a corridor."""
    length, width = float(rng.uniform(16.0, 28.0)), float(rng.uniform(1.5, 2.4))
    below, above = (float(rng.uniform(3.0, 5.5)) for _ in range(2))
    rooms: list[Rectangle] = [(0.0, below, length, below + width)]
    for low, high in ((0.0, below), (below + width, below + width + above)):
        x = 0.0
        while x < length:
            end = x + float(rng.uniform(2.6, 5.5))
            end = length if length - end < 2.6 else end
            rooms.append((x, low, end, high))
            x = end
    return rooms


def _split(rng: np.random.Generator, room: Rectangle, kind: str) -> list[Rectangle]:
    """Halve a rectangle until rooms have a realistic size."""
    width, height = room[2] - room[0], room[3] - room[1]
    largest = float(rng.uniform(10.0, 22.0) if kind == "home" else rng.uniform(18.0, 60.0))
    if width * height < largest or max(width, height) < 4.4:
        return [room]
    part = float(rng.uniform(0.35, 0.65))
    if width > height:
        x = room[0] + max(2.0, min(width - 2.0, part * width))
        halves = ((room[0], room[1], x, room[3]), (x, room[1], room[2], room[3]))
    else:
        y = room[1] + max(2.0, min(height - 2.0, part * height))
        halves = ((room[0], room[1], room[2], y), (room[0], y, room[2], room[3]))
    return [leaf for half in halves for leaf in _split(rng, half, kind)]


def _doors(
    rng: np.random.Generator, rooms: list[Rectangle], kind: str
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Middle, direction of the wall and width of doors: a spanning tree of the rooms and some more."""
    shared = []
    for i, j in combinations(range(len(rooms)), 2):
        line = shapely.box(*rooms[i]).intersection(shapely.box(*rooms[j]))
        if line.length > 2 * BESIDE_M + 1.0 and line.geom_type == "LineString":
            # In an office the doors lead to the corridor, which is room 0.
            shared.append((float(rng.random()) + (1.0 if kind == "office" and i else 0.0), i, j, line))
    part = list(range(len(rooms)))
    found = []
    for _, i, j, line in sorted(shared, key=lambda entry: entry[0]):
        joins = part[i] != part[j]
        if not joins and rng.random() > 0.12:
            continue
        part = [part[i] if p == part[j] else p for p in part]
        width = float(rng.uniform(1.4, 1.8) if rng.random() < 0.08 else rng.uniform(0.7, 1.05))
        a, b = np.array(line.coords[0]), np.array(line.coords[-1])
        along = (b - a) / line.length
        room = line.length - width - 2 * BESIDE_M * 0.5
        at_m = 0.5 * width + BESIDE_M * 0.5 + float(rng.uniform(0, max(room, 0.0)))
        found.append((a + at_m * along, along, width))
    return found


def _wing(
    rng: np.random.Generator, middle: np.ndarray, half: np.ndarray, across: np.ndarray, thickness: float
) -> shapely.Polygon:
    """An open door leaf: hinged at a jamb, standing in the room at 60 to 120 degrees."""
    side, hinge = (float(rng.choice([-1.0, 1.0])) for _ in range(2))
    angle = float(rng.uniform(np.radians(60), np.radians(120)))
    foot = middle + hinge * half + side * 0.5 * thickness * across
    length = 2.0 * float(np.hypot(*half)) * (0.5 if np.hypot(*half) > 0.65 else 1.0)
    toward = -hinge * half / np.hypot(*half)
    tip = foot + length * (np.cos(angle) * toward + np.sin(angle) * side * across)
    return shapely.LineString([foot, tip]).buffer(0.02, cap_style="flat")


def _furniture(
    rng: np.random.Generator, rooms: list[Rectangle], doors: list[np.ndarray], kind: str
) -> list[shapely.Polygon]:
    """Cupboards along walls, tables on legs, partitions with gaps in large rooms of labs."""
    near_doors = shapely.union_all([shapely.Point(*jambs.mean(axis=0)).buffer(0.9) for jambs in doors])
    found: list[shapely.Polygon] = []
    for x0, y0, x1, y1 in rooms:
        if min(x1 - x0, y1 - y0) < 2.5:
            continue
        for _ in range(int(rng.integers(0, 5))):
            a, b = float(rng.uniform(0.4, 1.6)), float(rng.uniform(0.3, 0.7))
            if rng.random() < 0.5:
                a, b = b, a
            left, low = (
                float(rng.uniform(x0 + 0.05, x1 - a - 0.05)),
                float(rng.uniform(y0 + 0.05, y1 - b - 0.05)),
            )
            if rng.random() < 0.6:  # along a wall
                low = y0 + 0.12 if rng.random() < 0.5 else y1 - b - 0.12
            piece = shapely.box(left, low, left + a, low + b)
            if rng.random() < 0.4:  # a table: a scanner sees its legs
                corners = np.array(piece.exterior.coords)[:4]
                found += [
                    shapely.Point(*p).buffer(0.03)
                    for p in corners
                    if not near_doors.contains(shapely.Point(*p))
                ]
            elif not piece.intersects(near_doors):
                found.append(piece)
        if kind == "lab" and (x1 - x0) * (y1 - y0) > 20.0:
            x = float(rng.uniform(x0 + 1.5, x1 - 1.5))
            gap, width = float(rng.uniform(y0 + 1.0, y1 - 1.5)), float(rng.uniform(0.9, 1.6))
            for low, high in (
                (y0 + float(rng.uniform(0.0, 1.0)), gap),
                (gap + width, y1 - float(rng.uniform(0.0, 1.0))),
            ):
                wall = shapely.box(x - 0.03, low, x + 0.03, max(high, low + 0.05))
                if not wall.intersects(near_doors):
                    found.append(wall)
    return found


def scanned(rng: np.random.Generator, solid: np.ndarray, places_m: np.ndarray) -> np.ndarray:
    """Map of a floor by a scanner at a few places: rays from near each place, hits with noise of a cell."""
    cells = np.full(solid.shape, -1, np.int8)
    hits = np.zeros(solid.shape, dtype=bool)
    angle = np.arange(SCAN_RAYS) * (2 * np.pi / SCAN_RAYS)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.arange(0.0, SCAN_RANGE_M / CELL_M, 0.5)
    for place in np.repeat(places_m, 2, axis=0):
        at = (place + rng.normal(0.0, 0.3, 2)) / CELL_M
        if not (0 <= at[1] < solid.shape[0] and 0 <= at[0] < solid.shape[1]) or solid[int(at[1]), int(at[0])]:
            continue
        points = at + along[None, :, None] * direction[:, None]
        column, row = (np.clip(points[..., k].astype(int), 0, solid.shape[1 - k] - 1) for k in (0, 1))
        hit = solid[row, column]
        first = np.where(hit.any(axis=1), hit.argmax(axis=1), len(along))
        before = np.arange(len(along))[None] < first[:, None]
        cells[row[before], column[before]] = 0
        met = np.flatnonzero(first < len(along))
        hits[row[met, first[met]], column[met, first[met]]] = True
    # One hit in fifty is displaced by a cell, as for a pose error.
    rows, columns = np.nonzero(hits)
    wrong = rng.random(len(rows)) < 0.02
    rows = np.clip(rows + wrong * rng.integers(-1, 2, len(rows)), 0, solid.shape[0] - 1)
    columns = np.clip(columns + wrong * rng.integers(-1, 2, len(rows)), 0, solid.shape[1] - 1)
    cells[hits] = 100
    cells[rows, columns] = 100
    return cells
