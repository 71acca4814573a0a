"""Seeded depth sequences of a table with thin clear vessels, and of the same table with opaque copies.

A scene has 48 views, a close one 24, one of a walk around the table 24 to 60; smaller numbers are every second, fourth or sixth of
them, so that all campaigns share the rendered images.
Alternatively it is seen from a level ring, with any number of views.
Even seeds are open, odd ones closed; the kind of a scene depends on seed // 2, so that both halves contain all kinds.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .ray_objects import BLACK, KINDS, METAL, PLAIN, Vessel, can, carton, random_vessel, ring_handle
from .ray_optics import CLEAR, Box, Revolved
from .rays import DepthCamera, Imperfections, World, look, read

__all__ = ["FAMILIES", "VIEWS", "GlassSequence", "Layout", "layout", "sequence"]

#: Views of a scene, and of a close one.
VIEWS, _CLOSE_VIEWS = 48, 24
#: Counts up when the caster or the camera's imperfections change, so that scenes in a cache are rendered again.
_RENDERING = 1
#: Kinds of scenes: two vessels; nearly in line; one before a wall; three; a person walks; a hand-held arc.
_CLEAR = ("pair", "overlap", "wall", "three", "person", "hand")
#: Kinds of opaque scenes: copies of the vessels; black; shiny; a person walks; before a wall; a hand-held arc.
_OPAQUE = ("twin", "black", "metal", "person", "wall", "hand")
#: Kinds of close scenes, 2 to 4 cm between walls: two in a row as seen from the middle of the views; side by side; in a row within a
#: narrow arc, so that they overlap in most views; one before a box; single ones that are easily taken for two: a thin stem, a handle.
_CLOSE = ("row", "side", "narrow", "box", "stem", "handle")
#: Kinds of sequences of a hand, 24 to 60 views: three to six opaque objects; one clear vessel among them; a single can; nothing on the
#: table.
_WALK = ("objects", "glass", "can", "bare")
#: Number of opaque objects, 2 by default.
_BESIDE = {"wall": 0, "can": 0, "bare": 0, "glass": 4}
FAMILIES = {"clear": _CLEAR, "filled": ("pair",), "opaque": _OPAQUE, "close": _CLOSE, "walk": _WALK}


@dataclass(frozen=True, slots=True)
class Layout:
    """A scene before rendering."""

    family: str
    kind: str
    seed: int
    vessels: tuple[Vessel, ...]  #: clear ones, or those whose opaque twins stand there
    material: int  #: of the vessels
    objects: tuple[Revolved, ...]  #: opaque
    boxes: tuple[Box, ...]
    T_world_camera: np.ndarray  #: (views, 4, 4)
    walker_m: np.ndarray | None  #: foot of a person at each view, (views, 3)


@dataclass(frozen=True, slots=True)
class GlassSequence:
    """Depth images with poses, and the truth."""

    family: str
    kind: str
    seed: int
    vessels: tuple[Vessel, ...]  #: clear ones; none in an opaque scene
    depth_m: np.ndarray  #: (views, rows, columns) float32, NaN: nothing read
    T_world_camera: np.ndarray  #: (views, 4, 4), as far as the robot knows
    camera: DepthCamera

    def views(
        self, count: int, *, shuffle: bool = False, noise: tuple[float, float] = (0.0, 0.0)
    ) -> GlassSequence:
        """Evenly chosen views, in another order, with pose errors per axis of (metres, radians)."""
        rng = np.random.default_rng([self.seed, count, 5])
        chosen = np.arange(0, len(self.depth_m), len(self.depth_m) // count)[:count]
        if shuffle:
            chosen = rng.permutation(chosen)
        poses = self.T_world_camera[chosen].copy()
        for pose in poses:
            pose[:3, 3] += noise[0] * rng.standard_normal(3)
            pose[:3, :3] = pose[:3, :3] @ _turn(noise[1] * rng.standard_normal(3))
        return replace(self, depth_m=self.depth_m[chosen], T_world_camera=poses)


def _turn(vector: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def _rng(family: str, seed: int, part: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(family.encode()), seed, part])


def _towards(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Pose (4, 4) at an eye that looks at a target, rows level."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, eye])
    return pose


def _path(kind: str, count: int, middle_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Poses of an arm on a part of a hemisphere, or of a hand on an arc."""
    u = rng.uniform
    share = np.linspace(-0.5, 0.5, count)
    if kind in ("hand", *_WALK):
        span, radius = np.radians(u(80, 170)), u(0.45, 0.65)
        wobble = 0.03 * np.sin(2 * np.pi * (u(1, 3) * share[:, None] + rng.random((1, 3))))
        rise = np.radians(u(28, 45)) + np.radians(10) * np.sin(
            2 * np.pi * (u(0.5, 1.5) * share + rng.random())
        )
    else:
        # Views from behind the wall or the path of a person would be occluded.
        spans = {"wall": (90, 140), "person": (90, 140), "narrow": (60, 90)}
        span, radius = np.radians(u(*spans.get(kind, (120, 300)))), u(0.5, 0.7)
        wobble = 0.01 * rng.standard_normal((count, 3))
        # Rows of an arm that goes up and down; no whole number of them, so that every subset has high and low views.
        rise = np.radians(
            (27 if kind == "person" else 35) + 16 * np.sin(2 * np.pi * (5.37 * share + rng.random()))
        )
    turn = middle_rad + span * share
    eyes = radius * np.column_stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    target = np.array([0, 0, 0.07])
    aims = target + 0.015 * rng.standard_normal((count, 3))
    return np.array([_towards(eye + w + target, aim) for eye, w, aim in zip(eyes, wobble, aims, strict=True)])


def _ring(count: int, middle_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Poses all around the table at one height, as of a turntable."""
    radius, height = rng.uniform(0.55, 0.7), rng.uniform(0.3, 0.42)
    turn = middle_rad + 2 * np.pi * np.arange(count) / count
    eyes = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, height)])
    return np.array([_towards(eye, np.array([0, 0, 0.07])) for eye in eyes])


def _places(
    count: int, rng: np.random.Generator, apart_m: float, taken: list[np.ndarray]
) -> list[np.ndarray]:
    """Places on the table that are apart from each other and from those taken."""
    found: list[np.ndarray] = []
    while len(found) < count:
        place = rng.uniform(-0.2, 0.2, 2)
        if all(np.hypot(*(place - other)) > apart_m for other in [*found, *taken]):
            found.append(place)
    return found


def layout(family: str, seed: int, ring: int = 0) -> Layout:
    """What stands where, and the path of the camera: a ring of so many views, past no wall, hand or person, or its own."""
    kinds = [kind for kind in FAMILIES[family] if not ring or kind not in ("wall", "person", "hand")]
    kind = kinds[seed // 2 % len(kinds)]
    rng = _rng(family, seed, 0)
    middle = rng.uniform(-np.pi, np.pi)
    view = np.array([np.cos(middle), np.sin(middle)])
    boxes = [
        Box(np.array([0, 0, -0.015]), np.array([0.5, 0.5, 0.015]), rng.uniform(0, 1.5), PLAIN),
        Box(np.array([0, 0, -0.78]), np.array([4, 4, 0.03]), 0.0, PLAIN),
    ]
    placed = {"close": _close, "walk": _among}.get(family)
    vessels, near = placed(kind, view, rng) if placed else _apart(family, kind, view, rng)
    places = [vessel.position_m[:2] for vessel in vessels]
    boxes += [one for one in near if isinstance(one, Box)]
    if kind == "wall":
        depth = vessels[0].outer[:, 0].max() + 0.02 + 0.01
        centre = np.append(places[0] - depth * view, 0.2)
        boxes.append(Box(centre, np.array([0.01, 0.4, 0.2]), middle, PLAIN))
    material = CLEAR
    if family == "opaque":
        material = {"black": BLACK, "metal": METAL}.get(kind, PLAIN)
    beside = int(rng.integers(3, 7)) if kind == "objects" else _BESIDE.get(kind, 2)
    objects, cartons = _beside(beside, places, rng)
    if kind == "can":
        objects = (can(rng.uniform(0.03, 0.05), rng.uniform(0.08, 0.15), (0.0, 0.0, 0.0), PLAIN),)
    objects += tuple(one for one in near if isinstance(one, Revolved))
    walker = None
    if kind == "person":
        across = np.array([-view[1], view[0]])
        steps = np.linspace(-0.8, 0.8, VIEWS)[:, None]
        walker = np.column_stack([-rng.uniform(0.65, 0.8) * view + steps * across, np.full(VIEWS, -0.75)])
    count = {"close": _CLOSE_VIEWS, "walk": 24 + 12 * (seed // 8 % 4)}.get(family, VIEWS)
    poses = _ring(ring, middle, rng) if ring else _path(kind, count, middle, rng)
    return Layout(family, kind, seed, vessels, material, objects, (*boxes, *cartons), poses, walker)


def _apart(
    family: str, kind: str, view: np.ndarray, rng: np.random.Generator
) -> tuple[tuple[Vessel, ...], list[Box | Revolved]]:
    """Vessels 18 cm apart from each other, or nearly in line; nothing is close to them."""
    names = rng.permutation(KINDS)
    if kind == "wall":
        places = [rng.uniform(-0.03, 0.03, 2)]
    elif kind == "overlap":
        near = rng.uniform(-0.03, 0.03, 2) + 0.055 * view
        places = [near, near - rng.uniform(0.105, 0.125) * view]
        names = rng.choice(["glass", "glass", "bottle", "jar"], 2, replace=False)
    else:
        places = _places(3 if kind == "three" else 2, rng, 0.18, [])
    filled = family == "filled"
    if filled:
        names = rng.choice(["glass", "bottle", "jar", "wine glass"], 2, replace=False)
    vessels = tuple(
        random_vessel(str(name), rng, tuple(place), filled=filled)
        for name, place in zip(names, places, strict=False)
    )
    return vessels, []


def _among(
    kind: str, view: np.ndarray, rng: np.random.Generator
) -> tuple[tuple[Vessel, ...], list[Box | Revolved]]:
    """The clear vessel of a sequence of a hand, if it has one."""
    name, place = str(rng.choice(["glass", "bottle", "jar", "wine glass"])), 0.05 * view
    return ((random_vessel(name, rng, tuple(place)),) if kind == "glass" else ()), []


def _close(
    kind: str, view: np.ndarray, rng: np.random.Generator
) -> tuple[tuple[Vessel, ...], list[Box | Revolved]]:
    """One or two vessels, and what stands close to them."""
    names = {"stem": ["wine glass"], "handle": ["jar"], "box": ["glass", "bottle", "jar", "wine glass"]}
    first = random_vessel(str(rng.choice(names.get(kind, ["glass", "bottle", "jar"]))), rng, (0.0, 0.0))
    start = rng.uniform(-0.03, 0.03, 2)
    gap, turn = rng.uniform(0.02, 0.04), rng.uniform(-0.3, 0.3)
    c, s = np.cos(turn), np.sin(turn)
    away = -np.array([c * view[0] - s * view[1], s * view[0] + c * view[1]])
    if kind == "side":
        away = np.array([-away[1], away[0]])
    near: list[Box | Revolved] = []
    if kind in ("stem", "handle"):
        first = replace(first, position_m=first.position_m + np.append(start, 0.0))
        if kind == "handle":
            near.append(ring_handle(first, rng.uniform(-np.pi, np.pi), rng))
        return (first,), near
    reach = first.outer[:, 0].max() + gap
    if kind == "box":
        first = replace(first, position_m=first.position_m + np.append(start, 0.0))
        edges = rng.uniform([0.05, 0.08, 0.08], [0.08, 0.16, 0.2])
        centre = start + (reach + 0.5 * edges[0]) * away
        return (first,), [carton(edges, tuple(centre), float(np.arctan2(away[1], away[0])), PLAIN)]
    second = random_vessel(str(rng.choice(["glass", "bottle", "jar"])), rng, (0.0, 0.0))
    half = 0.5 * (reach + second.outer[:, 0].max()) * away
    return tuple(
        replace(vessel, position_m=vessel.position_m + np.append(place, 0.0))
        for vessel, place in ((first, start - half), (second, start + half))
    ), near


def _beside(
    count: int, places: list[np.ndarray], rng: np.random.Generator
) -> tuple[tuple[Revolved, ...], tuple[Box, ...]]:
    """Bright opaque cans and cartons between the vessels."""
    objects, cartons = [], []
    for place in _places(count, rng, 0.15, places):
        if rng.random() < 0.5:
            objects.append(can(rng.uniform(0.02, 0.04), rng.uniform(0.06, 0.15), (*place, 0.0), PLAIN))
        else:
            edges = rng.uniform([0.05, 0.04, 0.05], [0.1, 0.08, 0.16])
            cartons.append(carton(edges, tuple(place), rng.uniform(0, np.pi), PLAIN))
    return tuple(objects), tuple(cartons)


def _render(scene: Layout, camera: DepthCamera) -> np.ndarray:
    """Depth of all views in millimetres, 0: nothing read."""
    rng = _rng(scene.family, scene.seed, 1)
    objects = [vessel.solid(scene.material) for vessel in scene.vessels] + list(scene.objects)
    world = World(objects, scene.boxes)
    raws = []
    for number, pose in enumerate(scene.T_world_camera):
        if scene.walker_m is not None:
            person = can(0.16, 1.7, tuple(scene.walker_m[number]), PLAIN)
            world = World([*objects, person], scene.boxes)
        raws.append(look(world, camera, pose[:3, 3], pose[:3, :3]))
    # Of the glass pixels of a real D435 29 to 77 % are invalid, 53 % typically.
    flaws = Imperfections(
        lost_glass=rng.triangular(0.29, 0.53, 0.77),
        near_glass=rng.uniform(0.01, 0.05),
        lost_black=rng.uniform(0.3, 0.7),
    )
    depth = np.array(read(raws, flaws, rng))
    return np.rint(1000 * np.nan_to_num(depth)).astype(np.uint16)


def _fingerprint(scene: Layout, camera: DepthCamera) -> int:
    """Changes with the layout, the camera and with ``_RENDERING``, so that no cache holds another scene's images."""
    parts = [scene.T_world_camera, *(vessel.outer for vessel in scene.vessels)]
    if scene.walker_m is not None:
        parts.append(scene.walker_m)
    if camera != DepthCamera():
        parts.append(camera.matrix)
    return zlib.crc32(np.concatenate([np.ravel(part) for part in parts]).round(6).tobytes(), _RENDERING)


def sequence(
    family: str, seed: int, cache: Path | None = None, camera: DepthCamera | None = None, ring: int = 0
) -> GlassSequence:
    """A rendered scene, from the folder ``cache`` where it is there; from a ring of so many views, or its own path."""
    scene = layout(family, seed, ring)
    camera = camera or DepthCamera()
    path = cache and cache / f"{family}_{seed:04d}_{_fingerprint(scene, camera):08x}.npz"
    if path and path.exists():
        with np.load(path, allow_pickle=False) as kept:
            units = kept["depth_mm"]
    else:
        units = _render(scene, camera)
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            partial = path.with_suffix(".part.npz")
            np.savez_compressed(partial, depth_mm=units)
            partial.replace(path)
    depth = np.where(units > 0, units / np.float32(1000), np.float32(np.nan)).astype(np.float32)
    vessels = scene.vessels if scene.material == CLEAR else ()
    return GlassSequence(family, scene.kind, seed, vessels, depth, scene.T_world_camera, camera)
