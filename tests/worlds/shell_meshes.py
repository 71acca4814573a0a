"""Triangulated containers as users provide them, with known stiffness; and meshes that are not containers.

Bodies are those of :mod:`.shell_bodies`, with a wall of uniform thickness; the truth is their wall of revolution, or of
ellipses, clamped at the foot. Even seeds are open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from .oval_shells import Oval
from .shell_bodies import MATERIALS, Description, draw, knots_m, levels_m, radius_at, wall_of
from .shells import Revolution

__all__ = ["KINDS", "REFUSED", "MeshCase", "mesh_case", "refused_mesh"]

#: Heights of the comparison, as fractions of the height; this far from a kink [m].
ASKED, FROM_KINK_M = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9), 0.003
#: Noise of a scan along the normal [m].
SCAN_NOISE_M = 5e-5

_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class MeshCase:
    """A mesh and its ground truth."""

    kind: str
    vertices_m: np.ndarray
    faces: np.ndarray
    wall_m: float | None  #: None: it has two sides, and the wall is between them
    points_m: np.ndarray  #: (h, 3), points of the surface that are asked for
    stiffness_N_per_m: np.ndarray  #: (h,), there
    youngs_modulus_Pa: float
    poisson_ratio: float


def _span(low: float, high: float) -> list[float]:
    return [low * _MM, high * _MM]


def _body(base: tuple, *sections: tuple, wall: tuple = (0.4, 0.9), **more: object) -> Description:
    return {
        "base": {"shape": "circle", "radius": _span(*base)},
        "sections": [
            {
                "height": _span(*height),
                **({"radius": _span(*radius)} if radius else {}),
                "bulge": _span(*bulge),
            }
            for height, radius, bulge in sections
        ],
        "wall": _span(*wall),
        "material": "PET",
        "youngs_modulus": MATERIALS["PET"][0],
        **more,
    }


_POT = _body((24, 30), ((70, 110), (32, 40), (-1, 1)))
_TUMBLER = _body((28, 36), ((90, 140), None, (0, 2)))
_BOTTLE = _body(
    (28, 36), ((80, 110), None, (0, 2)), ((35, 50), (15, 18), (3, 6)), ((14, 20), None, (0, 0)),
    top={"kind": "closed"},
)  # fmt: skip
_TUB = _body((34, 42), ((55, 80), (36, 44), (0, 2)), top={"kind": "closed"})
_GROOVED = _body(
    (29, 35), ((100, 130), None, (0, 1)),
    rings=[{"z": _span(z, z + 4), "depth": _span(-1.8, -1.2), "width": _span(9, 9)} for z in (25, 50, 75)],
)  # fmt: skip
_FOOTED = _body((22, 26), ((4, 4), (27, 31), (0.4, 0.4)), ((75, 105), (33, 39), (0, 1)))
_WAISTED = _body((30, 36), ((45, 60), None, (-5, -2)), ((45, 60), None, (1, 3)))
_BOWL = _body((26, 32), ((50, 65), (55, 65), (5, 8)), wall=(0.7, 1.2))


def mesh_case(kind: str, seed: int) -> MeshCase:
    """A container of one kind."""
    rng = np.random.default_rng([seed, 40, list(KINDS).index(kind)])
    body, make = KINDS[kind]
    member = draw(body, rng)
    vertices, faces, truth = make(member, rng)
    heights, _radii = knots_m(member)
    z = np.array(ASKED) * heights[-1]
    for kink in heights[1:-1]:
        z = np.where(np.abs(z - kink) < FROM_KINK_M, kink + FROM_KINK_M, z)
    if isinstance(truth, Oval):
        axis, flat = np.arange(len(z)) % 2, member["flat"][0]
        angle = 0.5 * np.pi * axis
        both = [truth.pinch_stiffness(z, k) for k in range(2)]
        stiffness = np.where(axis, both[1], both[0])
    else:
        angle, flat = rng.uniform(0, 2 * np.pi, len(z)), 1.0
        stiffness = truth.pinch_stiffness(z)
    radius = radius_at(member, z)
    points = np.column_stack([radius * np.cos(angle), flat * radius * np.sin(angle), z])
    one_wall = kind != "two-sided"
    return MeshCase(
        kind, vertices, faces, member["wall"][0] if one_wall else None, points, stiffness,
        truth.youngs_modulus_Pa, truth.poisson_ratio,
    )  # fmt: skip


Made = tuple[np.ndarray, np.ndarray, Revolution | Oval]


def _truth(member: Description) -> Revolution:
    return wall_of(member, step_m=0.0008, ring_step_m=0.0003)


def _revolved(rings: np.ndarray, around: int, turn: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Rings (k, 2) of radius and height turned about the axis; all diagonals have the same direction, normals point outward."""
    angle = turn + 2 * np.pi * np.arange(around) / around
    vertices = np.stack(
        [
            np.outer(rings[:, 0], np.cos(angle)),
            np.outer(rings[:, 0], np.sin(angle)),
            np.repeat(rings[:, 1:], around, 1),
        ],
        axis=2,
    ).reshape(-1, 3)
    row, column = (part.ravel() for part in np.mgrid[: len(rings) - 1, :around])
    a, b = row * around + column, row * around + (column + 1) % around
    return vertices, np.concatenate(
        [np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)]
    )


def _fan(
    vertices: np.ndarray, faces: np.ndarray, ring: np.ndarray, height: float, up: bool
) -> tuple[np.ndarray, ...]:
    """Close a ring by a fan from the axis."""
    centre = len(vertices)
    vertices = np.concatenate([vertices, [[0.0, 0.0, height]]])
    after = np.roll(ring, -1)
    fan = np.stack([np.full(len(ring), centre), *((ring, after) if up else (after, ring))], axis=1)
    return vertices, np.concatenate([faces, fan])


def _rings(member: Description, step: float, ring_step: float = 0.9e-3) -> np.ndarray:
    z = levels_m(member, step, ring_step)
    return np.column_stack([radius_at(member, z), z])


def _grid(
    member: Description, around: int, step: float, *, foot: float | None = 0.0, turn: float = 0.0
) -> Made:
    """Revolved, with a fan for the foot (whose middle is raised by ``foot``) and for a cap."""
    rings = _rings(member, step)
    vertices, faces = _revolved(rings, around, turn)
    if foot is not None:
        vertices, faces = _fan(vertices, faces, np.arange(around), foot, up=False)
    if "top" in member:
        last = (len(rings) - 1) * around + np.arange(around)
        vertices, faces = _fan(vertices, faces, last, rings[-1, 1], up=True)
    return vertices, faces, _truth(member)


def _oval(member: Description, around: int, step: float) -> Made:
    """The same, flattened along y."""
    flat = member["flat"][0]
    vertices, faces, _round = _grid(member, around, step)
    wall = wall_of(member, step_m=0.002, ring_step_m=0.002)
    levels = np.column_stack([wall.meridian_m[:, 0], flat * wall.meridian_m[:, 0], wall.meridian_m[:, 1]])
    truth = Oval(levels, wall.wall_m, wall.youngs_modulus_Pa, wall.poisson_ratio)
    return vertices * [1.0, flat, 1.0], faces, truth


def _fine_cap(member: Description, around: int, step: float) -> Made:
    """Foot and cap on rings too, down to a fan of a tenth of the radius; every triangle with its own corners."""
    wall = _rings(member, step)
    inwards = np.linspace(1, 0.1, 8)
    foot = np.column_stack([wall[0, 0] * inwards[:0:-1], np.zeros(7)])
    cap = np.column_stack([wall[-1, 0] * inwards[1:], np.full(7, wall[-1, 1])])
    rings = np.concatenate([foot, wall, cap])
    vertices, faces = _revolved(rings, around)
    vertices, faces = _fan(vertices, faces, np.arange(around), 0.0, up=False)
    last = (len(rings) - 1) * around + np.arange(around)
    vertices, faces = _fan(vertices, faces, last, wall[-1, 1], up=True)
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3), _truth(member)


def _scattered(
    member: Description, rng: np.random.Generator, along: float, across: float, noise: float = 0.0
) -> Made:
    """Vertices at random places, ``along`` the height and ``across`` apart, joined by Delaunay's rule."""
    rings = _rings(member, 0.0005)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rings, axis=0), axis=1))])
    typical = float(rings[:, 0].mean())
    around = int(round(2 * np.pi * typical / across))
    rows = int(np.ceil(length[-1] / along))
    places = []
    for row in range(rows + 1):
        turn = 2 * np.pi * (np.arange(around) + 0.5 * (row % 2)) / around
        inner = 0 < row < rows
        turn = turn + inner * rng.uniform(-0.35, 0.35, around) * 2 * np.pi / around
        at = length[-1] * (row + inner * rng.uniform(-0.35, 0.35, around)) / rows
        places.append(np.column_stack([turn, np.broadcast_to(at, around)]))
    plane = np.concatenate(places)
    count = len(plane)
    copies = np.concatenate([np.add(plane, [shift, 0.0]) for shift in (-2 * np.pi, 0.0, 2 * np.pi)])
    # In the plane an angle is as long as on a typical ring, and the height is shrunk as the places are.
    sheet = copies * [typical / across, 1 / along]
    cells = Delaunay(sheet).simplices
    middle = copies[cells, 0].mean(axis=1)
    cells = cells[(middle >= 0) & (middle < 2 * np.pi)]
    a, b, c = (sheet[cells[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    cells[area < 0] = cells[area < 0][:, ::-1]
    faces = np.unique(cells % count, axis=0)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    z = np.interp(plane[:, 1], length, rings[:, 1])
    radius = radius_at(member, z) + noise * rng.standard_normal(count)
    vertices = np.column_stack([radius * np.cos(plane[:, 0]), radius * np.sin(plane[:, 0]), z])
    vertices, faces = _fan(vertices, faces, np.arange(around), 0.0, up=False)
    if "top" in member:
        vertices, faces = _fan(vertices, faces, count - around + np.arange(around), rings[-1, 1], up=True)
    return vertices, faces, _truth(member)


def _two_sided(member: Description, rng: np.random.Generator) -> Made:
    """Outer and inner surface of a wall that is thinner towards the mouth, joined at the mouth, over a solid floor."""
    rings = _rings(member, 0.0012)
    slope = np.gradient(rings[:, 0], rings[:, 1])
    normal = np.column_stack([np.ones_like(slope), -slope]) / np.hypot(1, slope)[:, None]
    fraction = rings[:, 1] / rings[-1, 1]
    wall = member["wall"][0] * (1.0 - rng.uniform(0.1, 0.3) * fraction)
    outer, inner = rings + 0.5 * wall[:, None] * normal, rings - 0.5 * wall[:, None] * normal
    # The foot is level: the sides are cut off at the lowest height of the middle.
    outer[0, 1] = 0.0
    inside = inner[inner[:, 1] > 1.2e-3]
    loop = np.concatenate([outer, inside[::-1]])
    vertices, faces = _revolved(loop, 144)
    vertices, faces = _fan(vertices, faces, np.arange(144), 0.0, up=False)
    last = (len(loop) - 1) * 144 + np.arange(144)
    vertices, faces = _fan(vertices, faces, last, float(loop[-1, 1]), up=True)
    # The floor is solid and held below: the wall begins where the floor ends.
    whole, floor = _truth(member).meridian_m, float(loop[-1, 1])
    above = whole[whole[:, 1] > floor + 2e-4]
    above = np.concatenate([[[float(radius_at(member, np.array([floor]))[0]), floor]], above])
    middle = 0.5 * (above[1:, 1] + above[:-1, 1])
    thick = np.interp(middle, rings[:, 1], wall)
    truth = Revolution(above, thick, member["youngs_modulus"], MATERIALS[member["material"]][1])
    return vertices, faces, truth


#: Body and how it is triangulated, by kind.
KINDS: dict[str, tuple[Description, Callable[[Description, np.random.Generator], Made]]] = {
    "revolved, fan foot": (_POT, lambda m, rng: _grid(m, 96, 0.0022, turn=rng.uniform(0, 6))),
    "fan foot and cap": (_TUB, lambda m, rng: _grid(m, 128, 0.0018, turn=rng.uniform(0, 6))),
    "long quads": (_TUMBLER, lambda m, rng: _grid(m, 160, 0.006)),
    "chamfered foot with a punt": (_FOOTED, lambda m, rng: _grid(m, 96, 0.002, foot=0.006)),
    "grooves": (_GROOVED, lambda m, rng: _grid(m, 120, 0.0018)),
    "shoulder and cap, loose corners": (_BOTTLE, lambda m, rng: _fine_cap(m, 96, 0.0022)),
    "2,000 triangles": (_WAISTED, lambda m, rng: _grid(m, 48, 0.0046, foot=None)),
    "60,000 triangles": (_POT, lambda m, rng: _grid(m, 256, 0.0008)),
    "300,000 triangles, grooves": (_GROOVED, lambda m, rng: _grid(m, 640, 0.00047, turn=rng.uniform(0, 6))),
    "decimated": (_WAISTED, lambda m, rng: _scattered(m, rng, 0.005, 0.0025)),
    "scanned": (_TUMBLER, lambda m, rng: _scattered(m, rng, 0.0018, 0.0018, SCAN_NOISE_M)),
    "two-sided": (_body((30, 36), ((80, 110), (34, 42), (0, 1)), wall=(0.9, 1.6)), _two_sided),
    "oval": (_TUMBLER | {"flat": [0.55, 0.8]}, lambda m, rng: _oval(m, 128, 0.0022)),
    "oval bottle with a cap": (_BOTTLE | {"flat": [0.6, 0.8]}, lambda m, rng: _oval(m, 128, 0.0022)),
    "64 edges around": (_WAISTED, lambda m, rng: _grid(m, 64, 0.0028, turn=rng.uniform(0, 6))),
}


def refused_mesh(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of one closed skin that is no thin-walled container standing on its foot."""
    from skimage.measure import marching_cubes

    scale = np.random.default_rng([seed, 41]).uniform(0.9, 1.1)
    low, high, field = REFUSED[kind]
    step = 0.0025
    axes = [np.arange(a - 3.37 * step, b + 3 * step, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    vertices, faces, _normals, _values = marching_cubes(-field(grid), 0.0, spacing=(step,) * 3)
    return scale * (vertices + [axis[0] for axis in axes]), faces[:, ::-1]


def _ball(p: np.ndarray, centre: tuple, half: tuple) -> np.ndarray:
    """Rough distance from an ellipsoid."""
    out: np.ndarray = (np.linalg.norm((p - np.array(centre)) / np.array(half), axis=-1) - 1) * min(half)
    return out


def _block(p: np.ndarray, centre: tuple, half: tuple) -> np.ndarray:
    out: np.ndarray = (np.abs(p - np.array(centre)) - np.array(half)).max(axis=-1)
    return out


def _round(p: np.ndarray, centre: tuple, radius: float, half: float) -> np.ndarray:
    away = np.hypot(p[..., 0] - centre[0], p[..., 1] - centre[1]) - radius
    return np.maximum(away, np.abs(p[..., 2] - centre[2]) - half)


def _pig(p: np.ndarray) -> np.ndarray:
    parts = [_ball(p, (0, 0, 0.075), (0.07, 0.05, 0.05)), _ball(p, (0.07, 0, 0.085), (0.032, 0.03, 0.03))]
    parts += [_round(p, (0.1, 0, 0.08), 0.012, 0.01), _ball(p, (0.06, 0.02, 0.115), (0.006, 0.012, 0.014))]
    parts += [_ball(p, (0.06, -0.02, 0.115), (0.006, 0.012, 0.014))]
    parts += [_round(p, (x, y, 0.02), 0.012, 0.02) for x in (-0.04, 0.04) for y in (-0.025, 0.025)]
    return np.min(parts, axis=0)


def _drill(p: np.ndarray) -> np.ndarray:
    return np.min(
        [
            _block(p, (0, 0, 0.02), (0.055, 0.035, 0.02)),
            _block(p, (0.005, 0, 0.085), (0.02, 0.017, 0.055)),
            _block(p, (0.01, 0, 0.165), (0.075, 0.03, 0.03)),
            _ball(p, (0.1, 0, 0.165), (0.03, 0.018, 0.018)),
        ],
        axis=0,
    )


def _bulb(p: np.ndarray) -> np.ndarray:
    glass = _ball(p, (0, 0, 0.075), (0.032, 0.032, 0.034))
    return np.minimum(glass, _round(p, (0, 0, 0.023), 0.0135, 0.023))


def _thick_vase(p: np.ndarray) -> np.ndarray:
    return np.maximum(_round(p, (0, 0, 0.06), 0.04, 0.06), -_round(p, (0, 0, 0.08), 0.02, 0.065))


def _pan(p: np.ndarray) -> np.ndarray:
    body = np.maximum(_round(p, (0, 0, 0.02), 0.1, 0.02), -_round(p, (0, 0, 0.03), 0.095, 0.025))
    return np.minimum(body, _block(p, (0.18, 0, 0.035), (0.085, 0.012, 0.005)))


#: Bodies that are not containers: bounds of its field [m], and the field, negative inside.
REFUSED: dict[str, tuple[tuple, tuple, Callable[[np.ndarray], np.ndarray]]] = {
    "drill": ((-0.07, -0.04, 0.0), (0.14, 0.04, 0.2), _drill),
    "bulb": ((-0.035, -0.035, 0.0), (0.035, 0.035, 0.11), _bulb),
    "piggy bank": ((-0.075, -0.055, 0.0), (0.12, 0.055, 0.135), _pig),
    "thick vase": ((-0.045, -0.045, 0.0), (0.045, 0.045, 0.125), _thick_vase),
    "frying pan": ((-0.105, -0.105, 0.0), (0.27, 0.105, 0.045), _pan),
}
