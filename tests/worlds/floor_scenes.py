"""Scenes of navigation among movable obstacles, each determined by a seed; geometry in whole centimetres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely

from .maps import Body, Robot, World, at, bar, box, disc, ell, place_bodies, walled

__all__ = [
    "CENTRE_M", "blind_corridor", "campus", "closed_room", "doors_in_series", "idle_objects", "narrow_gap", "off_centre", "plank", "random_body", "random_rooms",
    "six_boxes", "small_room",
]  # fmt: skip

DOOR_M = 0.9
#: Standard deviation of the mass of a body from its centroid, along x and y, in :func:`off_centre` [m].
CENTRE_M = 0.01


def _rng(kind: int, seed: int) -> np.random.Generator:
    """Random generator of a scene; independent for different kinds with the same seed."""
    return np.random.default_rng([20261122, kind, seed])


def _cm(value: float) -> float:
    return round(float(value), 2)


def _wall_with_doors(
    x_m: float, height_m: float, doors: list[tuple[float, float]], thickness_m: float = 0.2
) -> list[shapely.Polygon]:
    """A wall across a floor at ``x_m`` with openings (middle, width) [m]."""
    edges = [0.0]
    for middle, width in sorted(doors):
        edges += [middle - width / 2, middle + width / 2]
    edges.append(height_m)
    return [
        bar(x_m, low, x_m + thickness_m, high)
        for low, high in zip(edges[::2], edges[1::2], strict=True)
        if high > low
    ]


def doors_in_series(seed: int = 0, doors: int = 2) -> World:
    """Rooms of 4 x 4 m in a row; a box of 0.4 m in each door of 0.9 m. Seed 0 has round numbers."""
    rng = _rng(1, seed)
    height, room = 4.0, 4.0
    width = room * (doors + 1)
    walls = walled(width, height)
    bodies = []
    for index in range(doors):
        x = room * (index + 1)
        middle = (1.2 if index % 2 == 0 else 2.8) if seed == 0 else _cm(rng.uniform(0.9, 3.1))
        walls += _wall_with_doors(x - 0.1, height, [(middle, DOOR_M)])
        shift = 0.0 if seed == 0 else _cm(rng.uniform(-0.08, 0.08))
        bodies.append(Body(f"box{index}", at(box(0.4, 0.4), x + shift, middle)))
    start = (1.0, 2.0) if seed == 0 else (_cm(rng.uniform(0.6, 2.6)), _cm(rng.uniform(0.6, 3.4)))
    goal = (
        (width - 1.0, 2.0) if seed == 0 else (_cm(width - rng.uniform(0.6, 2.6)), _cm(rng.uniform(0.6, 3.4)))
    )
    return World(f"{doors} doors in series", (width, height), tuple(walls), tuple(bodies), start, goal)


def idle_objects(seed: int, count: int) -> World:
    """Two rooms of 5 x 5 m, a box in the door, and ``count`` more bodies that need not be moved."""
    rng = _rng(2, seed)
    walls = [*walled(10.0, 5.0), *_wall_with_doors(4.9, 5.0, [(2.5, DOOR_M)])]
    start, goal = (0.8, 2.5), (9.2, 2.5)
    bodies = [Body("blocker", at(box(0.4, 0.4), 5.0, 2.5))]
    shapes: list[tuple[np.ndarray, float]] = []
    where = []
    for index in range(count):
        shapes.append(_shape(rng, 0.2, 0.4))
        left = index % 2 == 0
        low = 0.4 if index % 4 < 2 else 3.5  # beside the path, above and below
        where.append((0.4, low, 3.6, low + 1.1) if left else (6.4, low, 9.6, low + 1.1))
    placed = place_bodies(rng, shapes, where, walls, [start, goal])
    if placed is None:
        return idle_objects(seed + 1_000_000, count)
    bodies += [_body(f"idle{i}", outline, round_m, rng) for i, (outline, round_m) in enumerate(placed)]
    return World(f"{count} idle", (10.0, 5.0), tuple(walls), tuple(bodies), start, goal)


def blind_corridor(seed: int = 0, others: int = 1) -> World:
    """A goal at the end of a blind corridor behind a box that fills it, and bodies elsewhere: no plan exists."""
    rng = _rng(3, seed)
    walls = [*walled(6.0, 4.0), bar(3.0, 0.1, 5.9, 1.62), bar(3.0, 2.38, 5.9, 3.9)]
    x = 3.6 if seed == 0 else _cm(rng.uniform(3.4, 4.4))
    bodies = [Body("plug", at(box(0.58, 0.58), x, 2.0))]
    shapes = [_shape(rng, 0.25, 0.4) for _ in range(others)]
    placed = place_bodies(rng, shapes, [(0.4, 0.4, 2.4, 3.6)] * others, walls, [(0.7, 2.0)])
    for index, (outline, round_m) in enumerate(placed or ()):
        bodies.append(_body(f"other{index}", outline, round_m, rng))
    return World("blind corridor", (6.0, 4.0), tuple(walls), tuple(bodies), (0.7, 2.0), (5.5, 2.0))


def six_boxes(seed: int = 0, radius_m: float = 0.19) -> World:
    """A floor of 8 x 5 m, a wall with two doors, and six boxes, two of them in the doors."""
    rng = _rng(4, seed)
    walls = [*walled(8.0, 5.0), *_wall_with_doors(3.9, 5.0, [(1.2, 0.9), (3.8, 0.9)])]
    start, goal = (0.7, 2.5), (7.3, 2.5)
    shapes = [(box(0.4, 0.4), 0.0)] * 2 + [
        (box(_cm(rng.uniform(0.3, 0.5)), _cm(rng.uniform(0.3, 0.5))), 0.0) for _ in range(4)
    ]
    where = [(3.95, 1.18, 4.05, 1.22), (3.95, 3.78, 4.05, 3.82)]
    where += [(1.4, 0.6, 3.2, 4.4)] * 2 + [(4.8, 0.6, 6.6, 4.4)] * 2
    placed = place_bodies(rng, shapes, where, walls, [start, goal])
    if placed is None:
        return six_boxes(seed + 1_000_000, radius_m)
    bodies = tuple(_body(f"box{i}", outline, 0.0, rng) for i, (outline, _) in enumerate(placed))
    return World("six boxes", (8.0, 5.0), tuple(walls), bodies, start, goal, Robot(radius_m))


def _shape(rng: np.random.Generator, smallest_m: float, largest_m: float) -> tuple[np.ndarray, float]:
    """A box, a disc or an L, at any angle."""
    kind = int(rng.integers(3))
    a, b = (_cm(v) for v in rng.uniform(smallest_m, largest_m, 2))
    turn = float(rng.uniform(-np.pi, np.pi))
    if kind == 0:
        return box(a, b, turn), 0.0
    if kind == 1:
        return disc(a / 2), a / 2
    return ell(a, b, 0.45 * min(a, b), turn), 0.0


def _body(name: str, outline: np.ndarray, round_m: float, rng: np.random.Generator) -> Body:
    """Friction of 2 to 9 N: pushed at full speed by a robot of 20 N."""
    force_N = float(rng.uniform(2.0, 9.0))
    return Body(name, outline, round(force_N / (9.81 * 0.3), 4), 0.3, round_m=round_m)


def random_body(name: str, rng: np.random.Generator) -> Body:
    """A body of 0.2 to 0.55 m about the origin, its centre of mass off by a centimetre or two."""
    outline, round_m = _shape(rng, 0.2, 0.55)
    offset = rng.normal(0.0, 0.015, 2)
    return replace(_body(name, outline, round_m, rng), centre_offset_m=(float(offset[0]), float(offset[1])))


def random_rooms(seed: int, objects: int | None = None) -> World:
    """Three to six rooms on a grid with doors, 1 to 10 bodies, most of them in or beside the doors."""
    rng = _rng(5, seed)
    while True:
        columns, rows = int(rng.integers(2, 4)), int(rng.integers(1, 3))
        widths = [_cm(w) for w in rng.uniform(2.8, 4.2, columns)]
        heights = [_cm(h) for h in rng.uniform(2.8, 4.2, rows)]
        # A floor of whole decimetres, so that it has whole cells at 10, 5, 2 and 1 cm.
        width, height = np.ceil(sum(widths) * 10) / 10, np.ceil(sum(heights) * 10) / 10
        size = (round(float(width), 1), round(float(height), 1))
        walls, doors = _partition(rng, widths, heights, size)
        start = (_cm(rng.uniform(0.5, widths[0] - 0.6)), _cm(rng.uniform(0.5, heights[0] - 0.6)))
        goal = (
            _cm(size[0] - rng.uniform(0.5, widths[-1] - 0.6)),
            _cm(size[1] - rng.uniform(0.5, heights[-1] - 0.6)),
        )
        count = int(rng.integers(1, 11)) if objects is None else objects
        shapes, where = [], []
        for index in range(count):
            if index == 0 or rng.random() < 0.6:
                x, y = doors[int(rng.integers(len(doors)))]
                shapes.append(_shape(rng, 0.3, 0.42))
                where.append((x - 0.1, y - 0.1, x + 0.1, y + 0.1))
            else:
                shapes.append(_shape(rng, 0.25, 0.6))
                where.append((0.5, 0.5, size[0] - 0.5, size[1] - 0.5))
        placed = place_bodies(rng, shapes, where, walls, [start, goal], gap_m=0.11)
        if placed is not None:
            break
    bodies = tuple(_body(f"body{i}", outline, r, rng) for i, (outline, r) in enumerate(placed))
    return World(f"rooms {seed}", size, tuple(walls), bodies, start, goal)


def _partition(
    rng: np.random.Generator, widths: list[float], heights: list[float], size: tuple[float, float]
) -> tuple[list[shapely.Polygon], list[tuple[float, float]]]:
    """Walls between rooms on a grid, each with a door, and the doors' middles."""
    walls = walled(*size)
    doors: list[tuple[float, float]] = []
    xs = np.round(np.cumsum([0.0, *widths[:-1], size[0] - sum(widths[:-1])]), 2)
    ys = np.round(np.cumsum([0.0, *heights[:-1], size[1] - sum(heights[:-1])]), 2)
    half = 0.06
    for i, x in enumerate(xs[1:-1], start=1):
        for j in range(len(ys) - 1):
            width, door = _cm(rng.uniform(0.75, 1.0)), _cm(rng.uniform(ys[j] + 0.8, ys[j + 1] - 0.8))
            walls += [
                bar(x - half, ys[j], x + half, door - width / 2),
                bar(x - half, door + width / 2, x + half, ys[j + 1]),
            ]
            doors.append((float(xs[i]), door))
    for y in ys[1:-1]:
        for i in range(len(xs) - 1):
            if i and rng.random() < 0.4:  # no door here
                walls.append(bar(xs[i], y - half, xs[i + 1], y + half))
                continue
            width, door = _cm(rng.uniform(0.75, 1.0)), _cm(rng.uniform(xs[i] + 0.8, xs[i + 1] - 0.8))
            walls += [
                bar(xs[i], y - half, door - width / 2, y + half),
                bar(door + width / 2, y - half, xs[i + 1], y + half),
            ]
            doors.append((door, float(y)))
    return walls, doors


def small_room(seed: int) -> World:
    """4 x 3 m in whole decimetres with one or two boxes or discs in the door: small enough for the oracle."""
    rng = _rng(6, seed)
    while True:
        wall = round(float(rng.uniform(1.5, 2.4)), 1)
        middles = [round(float(rng.uniform(0.7, 2.3)), 1)]
        if rng.random() < 0.3:
            middles = [0.7, 2.3]
        walls = [
            *walled(4.0, 3.0),
            *_wall_with_doors(wall, 3.0, [(m, 0.8 if rng.random() < 0.5 else 0.9) for m in middles], 0.1),
        ]
        start = (_cm(rng.uniform(0.4, wall - 0.3)), _cm(rng.uniform(0.4, 2.6)))
        goal = (_cm(rng.uniform(wall + 0.4, 3.6)), _cm(rng.uniform(0.4, 2.6)))
        shapes, where = [], []
        for index in range(1 + int(rng.random() < 0.5)):
            side = round(float(rng.uniform(0.32, 0.45)), 2)
            shapes.append(
                (box(side, side), 0.0) if index or rng.random() < 0.7 else (disc(side / 2), side / 2)
            )
            y = middles[index % len(middles)]
            near = 0.1 if index < len(middles) else 0.5
            where.append((wall + 0.05 - near, y - 0.05, wall + 0.05 + near, y + 0.05))
        placed = place_bodies(rng, shapes, where, walls, [start, goal], gap_m=0.11)
        if placed is not None:
            break
    bodies = tuple(_body(f"body{i}", outline, r, rng) for i, (outline, r) in enumerate(placed))
    return World(f"small room {seed}", (4.0, 3.0), tuple(walls), bodies, start, goal)


def narrow_gap(seed: int) -> World:
    """4 x 6 m whose cheapest plan most likely passes a gap of up to 3 cm more than the robot; the way around is 8 m longer.

    Kinds: a slit in the wall, a fixed body in a door, a body that a post stops when it has been pushed just far enough.
    Walls are on cells of 5 cm, and the gap is measured by the robot or a body.
    """
    rng = _rng(11, seed)
    kind = seed // 2 % 3
    low, room, radius = 0.05 * int(rng.integers(10, 25)), float(rng.uniform(0.0, 0.03)), 0.17
    door = (0.35, 0.9, 0.5)[kind]
    x = 0.05 * int(rng.integers(30, 41))
    walls = [*walled(4.0, 6.0), *_wall_with_doors(x, 6.0, [(low + door / 2, door), (5.4, 0.8)], 0.1)]
    bodies: list[Body] = []
    if kind == 0:
        radius = (door - room) / 2.0
    elif kind == 1:
        width = door - 2.0 * radius - room
        bodies.append(Body("fixed", at(box(0.2, width), x + 0.05, low + width / 2.0), fixed=True))
    else:
        face = x + 0.1 + 2.0 * radius + room + 0.4
        bodies.append(_body("box", at(box(0.4, 0.4), x + 0.05, low + door / 2.0), 0.0, rng))
        bodies.append(Body("post", at(box(0.1, 0.1), face + 0.05, low + door / 2.0), fixed=True))
    start = (_cm(rng.uniform(0.5, x - 0.9)), _cm(rng.uniform(0.5, 2.0)))
    goal = (3.5, _cm(rng.uniform(0.5, 2.0)))
    return World(
        f"narrow gap {seed} kind {kind}", (4.0, 6.0), tuple(walls), tuple(bodies), start, goal, Robot(radius)
    )


def off_centre(seed: int) -> World:
    """Two rooms, and in the short passage between them a body whose mass is about a centimetre off its centroid."""
    rng = _rng(9, seed)
    walls = [*walled(7.0, 4.0), *_wall_with_doors(3.1, 4.0, [(2.0, 0.8)], 0.6)]
    turn = 0.0 if rng.random() < 0.5 else float(rng.uniform(-np.pi, np.pi))
    outline, round_m = _shape(rng, 0.38, 0.44)
    outline = at(outline @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]), 3.2, 2.0)
    offset = rng.normal(0.0, CENTRE_M, 2)
    body = replace(
        _body("thing", outline, round_m, rng), centre_offset_m=(float(offset[0]), float(offset[1]))
    )
    start, goal = (
        (_cm(rng.uniform(0.6, 2.4)), _cm(rng.uniform(0.6, 3.4))),
        (_cm(rng.uniform(5.0, 6.4)), _cm(rng.uniform(0.6, 3.4))),
    )
    return World(f"off centre {seed}", (7.0, 4.0), tuple(walls), (body,), start, goal)


def plank(seed: int) -> World:
    """Two rooms; in the door a plank across it, with a post behind its middle: it can be turned, not pushed out of the way."""
    rng = _rng(10, seed)
    width, thick = _cm(rng.uniform(0.95, 1.15)), _cm(rng.uniform(0.14, 0.22))
    behind, middle = _cm(rng.uniform(0.35, 0.6)), _cm(rng.uniform(1.3, 1.7))
    post = bar(3.1 + behind, middle - 0.05, 3.2 + behind, middle + 0.05)
    walls = [*walled(6.0, 3.0), *_wall_with_doors(2.95, 3.0, [(middle, width)], 0.1), post]
    outline = at(box(thick, width - _cm(rng.uniform(0.06, 0.16))), 3.0, middle)
    body = _body("plank", outline, 0.0, rng)
    start, goal = (
        (_cm(rng.uniform(0.6, 2.2)), _cm(rng.uniform(0.6, 2.4))),
        (_cm(rng.uniform(4.4, 5.4)), _cm(rng.uniform(0.6, 2.4))),
    )
    return World(
        f"plank {seed}", (6.0, 3.0), tuple(walls), (body,), start, goal, notes={"push": "off_centre"}
    )


def closed_room(seed: int) -> World:
    """A task that most likely has no plan, with 1 to 3 bodies; ``impossible`` in ``push_truth`` proves it.

    Kinds: a plug in a blind corridor, two plugs in series, a door that is narrower than the robot, a fixed body in
    the only door.
    """
    rng = _rng(7, seed)
    kind = seed // 2 % 4
    size = (5.0, 3.0)
    walls = walled(*size)
    start, goal = (0.6, 1.5), (4.6, 1.5)
    bodies: list[Body] = []
    half = round(float(rng.uniform(0.3, 0.38)), 2)
    others = int(rng.integers(0, 3))
    if kind in (0, 1):
        walls += [bar(2.4, 0.1, 4.9, 1.5 - half), bar(2.4, 1.5 + half, 4.9, 2.9)]
        radius = round(half - float(rng.uniform(0.04, 0.08)), 2)
        for index in range(1 + kind):
            outline = disc(radius) if rng.random() < 0.5 else box(2 * radius, 2 * radius)
            bodies.append(Body(f"plug{index}", at(outline, 2.8 + 0.75 * index, 1.5)))
        others = min(others, 2 - kind)
    elif kind == 2:
        walls += _wall_with_doors(2.6, 3.0, [(1.5, 0.3)])
        others = max(others, 1)
    else:
        walls += _wall_with_doors(2.6, 3.0, [(1.5, 0.8)])
        bodies.append(Body("fixed", at(box(0.46, 0.46), 2.7, 1.5), fixed=True))
        others = min(others, 2)
    shapes = [_shape(rng, 0.25, 0.4) for _ in range(others)]
    placed = place_bodies(rng, shapes, [(0.4, 0.4, 1.9, 2.6)] * others, walls, [start])
    for index, (outline, round_m) in enumerate(placed or ()):
        bodies.append(_body(f"other{index}", outline, round_m, rng))
    return World(f"closed {seed} kind {kind}", size, tuple(walls), tuple(bodies), start, goal)


def campus(seed: int, rooms: int = 20, objects: int = 200) -> World:
    """200 x 200 m: 20 x 20 rooms with doors and 200 bodies, half of them in doors; 4000 x 4000 cells of 5 cm."""
    rng = _rng(8, seed)
    side = 10.0
    size = (rooms * side, rooms * side)
    walls = walled(*size, thickness_m=0.2)
    doors: list[tuple[float, float]] = []
    for line in range(1, rooms):
        for room in range(rooms):
            for across in (False, True):
                low = room * side
                middle = low + _cm(rng.uniform(1.5, side - 1.5))
                ends = ((low, middle - 0.5), (middle + 0.5, low + side))
                line_m = line * side
                walls += [
                    bar(a, line_m - 0.1, b, line_m + 0.1) if across else bar(line_m - 0.1, a, line_m + 0.1, b)
                    for a, b in ends
                ]
                doors.append((middle, line_m) if across else (line_m, middle))
    start, goal = (5.0, 5.0), (size[0] - 5.0, size[1] - 5.0)
    chosen = rng.permutation(len(doors))[: objects // 2]
    shapes, where = [], []
    for index in chosen:
        x, y = doors[index]
        shapes.append((box(0.5, 0.5), 0.0))
        where.append((x - 0.02, y - 0.02, x + 0.02, y + 0.02))
    for _ in range(objects - len(chosen)):
        shapes.append(_shape(rng, 0.3, 0.8))
        where.append((1.0, 1.0, size[0] - 1.0, size[1] - 1.0))
    placed = place_bodies(rng, shapes, where, walls, [start, goal])
    if placed is None:
        return campus(seed + 1_000_000, rooms, objects)
    bodies = tuple(_body(f"body{i}", outline, r, rng) for i, (outline, r) in enumerate(placed))
    return World(f"campus {seed}", size, tuple(walls), bodies, start, goal)
