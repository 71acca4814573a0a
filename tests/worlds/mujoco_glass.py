"""Depth sequences of glass on a table by the rays of a physics engine, with other optics than the library's simulation.

Glass is no refracting body here: of its rays some return nothing, some what is behind, displaced by a smooth field and
lengthened, some the glass itself, mostly at its rim. A stereo camera of unknown make quantises disparities and reads nothing beside edges
of depth. Opaque scenes contain cups, boxes and a cable, or what a stereo camera loses most: black, glossy and chromed objects and the
reflection of a lamp. A scene has 24 views all around the table; fewer are every second or third of them.
Even seeds are open, odd ones closed; the kind of a scene depends on seed // 2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

__all__ = ["KINDS", "VIEWS", "RayScene", "StandingGlass", "ray_scene"]

VIEWS = 24
#: A wine glass, a jar, each beside opaque objects; two tumblers apart and in a row; opaque objects, and those that are hard to read.
KINDS = ("wine", "jar", "two", "row", "opaque", "dark")
_WIDTH, _HEIGHT, _FOCAL = 424, 240, 305.0
_BASELINE_M = 0.05
#: Errors of the poses the robot knows, per axis [m, rad].
_POSE_NOISE = (0.001, float(np.radians(0.15)))
_OPAQUE, _GLASS = 0, 1
#: Table, floor and the walls of the room: half edges, centre.
_ROOM = (
    ((0.6, 0.4, 0.02), (0.0, 0.0, -0.02)),
    ((3.0, 3.0, 0.05), (0.0, 0.0, -0.75)),
    ((3.0, 0.05, 2.0), (0.0, 1.3, 0.0)),
    ((0.05, 3.0, 2.0), (1.6, 0.0, 0.0)),
    ((3.0, 0.05, 2.0), (0.0, -1.5, 0.0)),
    ((0.05, 3.0, 2.0), (-1.7, 0.0, 0.0)),
)


@dataclass(frozen=True, slots=True)
class StandingGlass:
    """A round vessel of glass: stacked discs, each (bottom, top, radius) [m]."""

    kind: str
    position_m: np.ndarray  #: middle of its foot, (3,)
    discs: tuple[tuple[float, float, float], ...]
    bounds_m: np.ndarray = field(init=False)  #: lowest and highest corner of its box, (2, 3)

    def __post_init__(self) -> None:
        r, top = max(r for *_, r in self.discs), max(z for _, z, _ in self.discs)
        object.__setattr__(self, "bounds_m", self.position_m + np.array([[-r, -r, 0.0], [r, r, top]]))


@dataclass(frozen=True, slots=True)
class RayCamera:
    """Size in pixels and matrix of a camera."""

    width: int
    height: int
    matrix: np.ndarray  #: (3, 3)


@dataclass(frozen=True, slots=True)
class RayScene:
    """Depth images with poses, and the truth."""

    kind: str
    seed: int
    vessels: tuple[StandingGlass, ...]
    depth_m: np.ndarray  #: (views, rows, columns) float32, NaN: nothing read
    T_world_camera: np.ndarray  #: (views, 4, 4), as far as the robot knows
    camera: RayCamera

    def views(self, count: int) -> RayScene:
        """Evenly chosen views, all around."""
        chosen = np.arange(count) * len(self.depth_m) // count
        return replace(self, depth_m=self.depth_m[chosen], T_world_camera=self.T_world_camera[chosen])


def _glass(kind: str, x: float, y: float, rng: np.random.Generator) -> StandingGlass:
    """A vessel of random size."""
    size = rng.uniform(0.9, 1.1)
    if kind == "wine":
        bowl = [
            (0.09 + 0.09 * i / 12, 0.09 + 0.09 * (i + 1) / 12, 0.038 * (1 - ((i - 6) / 8) ** 2) ** 0.5)
            for i in range(12)
        ]
        discs = [(0.0, 0.004, 0.034), (0.004, 0.09, 0.004), *bowl]
    elif kind == "jar":
        discs = [(0.0, 0.12, 0.042), (0.12, 0.135, 0.034)]
    else:
        tall, wide = rng.uniform(0.09, 0.12), rng.uniform(0.032, 0.037)
        discs = [(tall * i / 10, tall * (i + 1) / 10, wide * (0.85 + 0.15 * i / 9)) for i in range(10)]
    scaled = tuple((size * a, size * b, size * r) for a, b, r in discs)
    return StandingGlass(kind, np.array([x, y, 0.0]), scaled)


def _cylinder(x: float, y: float, tall: float, wide: float) -> str:
    return f'<geom type="cylinder" size="{wide} {tall / 2}" pos="{x} {y} {tall / 2}" group="{_OPAQUE}"/>'


def _box(x: float, y: float, edges: tuple[float, float, float], yaw_deg: float) -> str:
    a, b, c = (edge / 2 for edge in edges)
    return f'<geom type="box" size="{a} {b} {c}" pos="{x} {y} {c}" euler="0 0 {yaw_deg}" group="{_OPAQUE}"/>'


def _layout(kind: str, rng: np.random.Generator) -> tuple[tuple[StandingGlass, ...], list[str]]:
    """The vessels and the opaque objects of a scene."""
    u = rng.uniform
    x, y = u(-0.03, 0.03), u(-0.03, 0.03)
    if kind in ("wine", "jar"):
        beside = [_cylinder(u(0.13, 0.17), u(-0.1, 0.1), 0.095, 0.04),
                  _box(u(-0.18, -0.14), u(-0.1, 0.1), (0.1, 0.06, u(0.1, 0.2)), u(0, 90))]  # fmt: skip
        return (_glass(kind, x, y, rng),), beside
    if kind == "two":
        first, second = (
            _glass("tumbler", x - 0.07, y + u(0, 0.03), rng),
            _glass("tumbler", x + 0.07, y - u(0, 0.03), rng),
        )
        return (first, second), [_cylinder(x, y + 0.17, 0.095, 0.04)]
    if kind == "row":
        way, angle = 0.045, u(0, np.pi)
        return tuple(
            _glass("tumbler", x + s * way * np.cos(angle), y + s * way * np.sin(angle), rng) for s in (-1, 1)
        ), []
    if kind == "opaque":
        cable = (
            f'<geom type="capsule" size=".003" fromto="-.2 -.15 .004 .2 {u(-0.15, -0.1)} .004" group="0"/>'
        )
        return (), [_cylinder(u(0.06, 0.12), u(0.06, 0.12), 0.095, 0.04), _box(-0.1, y, (0.12, 0.05, 0.15), u(0, 90)),
                    _box(0.1, -0.1, (0.04, 0.2, 0.05), u(0, 90)), _cylinder(-0.03, 0.13, 0.006, 0.05), cable]  # fmt: skip
    chrome = (
        f'<geom type="sphere" size=".045" pos="{u(-0.02, 0.06)} {u(0.12, 0.18)} .045" group="{_OPAQUE}"/>'
    )
    return (), [_cylinder(u(-0.03, 0.1), u(-0.1, 0.0), 0.095, 0.04),
                _box(-0.14, u(-0.05, 0.05), (0.1, 0.06, 0.13), u(0, 90)), chrome, _cylinder(0.17, -0.12, 0.1, 0.03)]  # fmt: skip


def _model(vessels: tuple[StandingGlass, ...], objects: list[str]) -> mujoco.MjModel:
    room = [
        f'<geom type="box" size="{" ".join(map(str, half))}" pos="{" ".join(map(str, middle))}" group="{_OPAQUE}"/>'
        for half, middle in _ROOM
    ]
    glass = [
        f'<geom type="cylinder" size="{r} {(b - a) / 2}" pos="{v.position_m[0]} {v.position_m[1]} {(a + b) / 2}" group="{_GLASS}"/>'
        for v in vessels
        for a, b, r in v.discs
    ]
    text = "".join(room + objects + glass)
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{text}</worldbody></mujoco>")


def _cast(
    model: mujoco.MjModel, rays: np.ndarray, pose: np.ndarray, groups: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] and number of the body hit for every ray (rows, columns, 3), of the bodies in ``groups``."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ways = rays.reshape(-1, 3) @ pose[:3, :3].T
    length = np.linalg.norm(ways, axis=1)
    hit, far = np.zeros(len(ways), np.int32), np.zeros(len(ways))
    shown = np.zeros(6, np.uint8)
    shown[list(groups)] = 1
    unit = np.ascontiguousarray((ways / length[:, None]).reshape(-1, 1))
    eye = np.ascontiguousarray(pose[:3, 3]).reshape(3, 1)
    mujoco.mj_multiRay(model, data, eye, unit, shown, 1, -1, hit, far, None, len(ways), 10.0)
    return (far / length).reshape(rays.shape[:2]), hit.reshape(rays.shape[:2])


def _smooth(rng: np.random.Generator, shape: tuple[int, int], sigma: float) -> np.ndarray:
    """Smooth random field of deviation 1."""
    drawn = gaussian_filter(rng.normal(size=shape), sigma)
    return drawn / drawn.std()


def _seen(opaque: np.ndarray, first: np.ndarray, glass: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the camera reads through glass and beside it, 0 where nothing."""
    shape = opaque.shape
    column, row = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape[::-1]))
    away = [(5 * _smooth(rng, shape, 4)).astype(np.float32) for _ in range(2)]
    behind = cv2.remap(
        opaque.astype(np.float32),
        column + away[0],
        row + away[1],
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_REPLICATE,
    )
    behind = behind * (1 + 0.15 * np.abs(gaussian_filter(rng.normal(size=shape), 3)))
    score = _smooth(rng, shape, 2.5)
    face = cv2.erode(glass.astype(np.uint8), np.ones((5, 5))) > 0
    through = np.where(score < -0.1, 0.0, np.where(score < 1.2, behind, np.where(face, first, opaque)))
    seen = np.where(glass, through, opaque)
    return np.where(glass & ~face & (rng.random(shape) < 0.35), first, seen)


def _hard(seen: np.ndarray, opaque: np.ndarray, hit: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Drop-outs of a black mug, a glossy box, a chromed ball, a can of which a part is black, and of a lamp on the table."""
    shape, table = seen.shape, len(_ROOM)
    score = _smooth(rng, shape, 2.5)
    large = _smooth(rng, shape, 8)
    farther = opaque * (1 + 0.75 * np.abs(gaussian_filter(rng.normal(size=shape), 2)))
    seen = np.where((hit == table) & (score < 0.3), 0, seen)
    seen = np.where((hit == table + 1) & (large > 0.2), 0, seen)
    seen = np.where(hit == table + 2, np.where(score < 0.2, 0, farther), seen)
    seen = np.where((hit == table + 3) & (large < -0.5), 0, seen)
    return np.where((hit == 0) & (_smooth(rng, shape, 10) > 1.6), 0, seen)


def _stereo(seen: np.ndarray, opaque: np.ndarray, focal: float, rng: np.random.Generator) -> np.ndarray:
    """Disparities in steps of a sixteenth of a pixel, nothing beside edges; whole tenths of a millimetre, NaN: nothing read."""
    noise = 0.08 * _smooth(rng, seen.shape, 1)
    shift = np.where(seen > 0, focal * _BASELINE_M / np.maximum(seen, 0.05), 0)
    shift = np.where(shift > 0, np.round((shift + noise) * 16) / 16, 0)
    edge = np.abs(cv2.Sobel(opaque, cv2.CV_64F, 1, 0)) > 0.08
    beside = cv2.dilate(edge.astype(np.uint8), np.ones((3, 5))) > 0
    read = (shift > 0) & ~(beside & (rng.random(seen.shape) < 0.6))
    depth = np.round(1e4 * focal * _BASELINE_M / np.where(read, shift, 1.0)) / 1e4
    return np.where(read & (depth < 6.5), depth, np.nan).astype(np.float32)


def _pose(number: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Pose (4, 4) of a hand that walks all around the table."""
    turn, rise = 2 * np.pi * number / count + rng.normal(0, 0.05), np.radians(rng.uniform(25, 50))
    way = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    eye = rng.uniform(0.5, 0.65) * way + [0, 0, 0.05]
    forward = np.append(rng.normal(0, 0.02, 2), 0.05) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, eye])
    return pose


def ray_scene(seed: int, *, kind: str = "", views: int = VIEWS, scale: float = 1.0) -> RayScene:
    """Render a scene of a seed; ``kind`` is one of `KINDS`, that of the seed by default, ``scale`` that of the image."""
    kind = kind or KINDS[seed // 2 % len(KINDS)]
    rng = np.random.default_rng([seed, KINDS.index(kind), 61])
    vessels, objects = _layout(kind, rng)
    model = _model(vessels, objects)
    width, height, focal = round(_WIDTH * scale), round(_HEIGHT * scale), _FOCAL * scale
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack(
        [(column - matrix[0, 2]) / focal, (row - matrix[1, 2]) / focal, np.ones_like(row, float)], -1
    )
    depths, poses = [], []
    for number in range(views):
        pose = _pose(number, views, rng)
        opaque, hit = _cast(model, rays, pose, (_OPAQUE,))
        first, body = _cast(model, rays, pose, (_OPAQUE, _GLASS))
        glass = (model.geom_group[np.maximum(body, 0)] == _GLASS) & (first < opaque - 1e-4)
        seen = _seen(opaque, first, glass, rng)
        if kind == "dark":
            seen = _hard(seen, opaque, hit, rng)
        depths.append(_stereo(seen, opaque, focal, rng))
        pose[:3, 3] += _POSE_NOISE[0] * rng.normal(size=3)
        pose[:3, :3] = Rotation.from_rotvec(_POSE_NOISE[1] * rng.normal(size=3)).as_matrix() @ pose[:3, :3]
        poses.append(pose)
    return RayScene(kind, seed, vessels, np.array(depths), np.array(poses), RayCamera(width, height, matrix))
