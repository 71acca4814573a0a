"""Containers lifted by two soft pads in MuJoCo: does a grasp at one height, with one force, hold?

A container is rigid for its motion: slices of its wall, the mass of wall and liquid, a foot on a table. Pads
are discs of individual springs, so that their resistance against rotation follows from where they press and
not from a formula. The deformation of the wall is computed by :mod:`.shells`, from its linear stiffness. Even seeds are open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from .shell_bodies import CLASSES, OTHERS, Description, draw, wall_of
from .shells import Revolution, opposite, side_stiffness

__all__ = [
    "FRICTION",
    "KINDS",
    "RIM_KINDS",
    "LiftObject",
    "Lifted",
    "lift",
    "lift_object",
    "lift_rim",
    "wall_load",
]

#: Twelve kinds that fit into a hand of 11 cm.
KINDS = ("pot", "beaker", "shampoo", "milk", "water", "tub", "can", "jar", "mug", "tube", "funnel", "goblet")
#: Kinds that are open above; a bowl is too wide for that hand.
RIM_KINDS = ("bowl", "pot", "beaker", "foil cup", "goblet", "mug")
#: Density [kg/m^3] of wall and liquid.
DENSITY = {"LDPE": 920, "HDPE": 955, "PP": 905, "PET": 1370, "PS": 1050, "aluminium": 2700, "glass": 2500}
LIQUID = 1000.0
#: Friction of the pads: median and standard deviation of its logarithm; of thickness, modulus and fill of one piece.
FRICTION, FRICTION_SPREAD, WALL_SPREAD, MODULUS_SPREAD, FILL_SPREAD = 0.6, 0.15, 0.1, 0.05, 0.02
GRAVITY_m_per_s2, STEP_s = 9.81, 5e-4
#: Lift: up with this acceleration for half of the time, and down to rest for the other [m/s^2, s]; pressing and holding [s].
ACCELERATION_m_per_s2, LIFT_s, CLOSE_s, HOLD_s = 1.0, 0.5, 0.4, 0.4
#: A pad is pressed this deep by its force [m]; its springs are in rings, of balls; speed of closing.
PAD_DEPTH_m, RINGS, PAD_BALL_m, CLOSING_m_per_s = 0.003, (1, 6, 12), 0.002, 0.03
#: Held: within this of the hand, and upright to this [m, rad].
MAX_SLIP_m, MAX_TURN_rad = 0.01, 0.35
#: Slices of the wall next to the pads [m], and corners around.
REACH_m, SLICE_m, AROUND = 0.025, 0.0025, 48
#: Thickness of the plates that stand for a wall between two fingers [m]: balls would penetrate thinner ones.
MIN_PLATE_m = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class LiftObject:
    """A container as described to the planner, and its true properties."""

    kind: str
    described: Description  #: without ranges
    fill: float  #: fraction of the volume, as described
    wall: Revolution  #: as it is
    mass_kg: float
    centre_m: float  #: height of the centre of mass
    inertia_kg_m2: tuple[
        float, float
    ]  #: about a horizontal line through the centre of mass, and about the axis
    friction: float

    def give_m(self, height_m: float, force_N: float) -> float:
        """Deformation of each side of the wall, by its linear stiffness [m]."""
        return force_N / float(side_stiffness(self.wall.compliance([opposite(height_m)]))[0].min())


@dataclass(frozen=True, slots=True)
class Lifted:
    """Result of a lift."""

    slip_m: float  #: how far the hand rose more than the container
    turn_rad: float  #: of its axis

    @property
    def held(self) -> bool:
        """Whether it was lifted, and upright."""
        return self.slip_m < MAX_SLIP_m and self.turn_rad < MAX_TURN_rad


def lift_object(seed: int, kinds: Sequence[str] = KINDS) -> LiftObject:
    """A member of alternating kinds; bottles alternate between empty, half and nearly full."""
    kind = kinds[seed // 2 % len(kinds)]
    rng = np.random.default_rng([seed, 40])
    described = draw((CLASSES | OTHERS)[kind], rng)
    closed = described.get("top", {"kind": "open"})["kind"] != "open"
    fill = (0.0, 0.5, 0.9)[seed // 2 // len(kinds) % 3] if closed else 0.0
    wall = wall_of(described, modulus=float(np.exp(MODULUS_SPREAD * rng.standard_normal())))
    wall = replace(wall, wall_m=wall.wall_m * np.clip(1 + WALL_SPREAD * rng.standard_normal(), 0.7, 1.3))
    true_fill = float(np.clip(fill + FILL_SPREAD * rng.standard_normal(), 0.0, 1.0)) if fill else 0.0
    load = wall_load(wall, DENSITY[described["material"]], true_fill)
    friction = FRICTION * float(np.exp(FRICTION_SPREAD * rng.standard_normal()))
    return LiftObject(kind, described, fill, wall, *load, friction)


def wall_load(
    wall: Revolution, wall_kg_per_m3: float, fill: float
) -> tuple[float, float, tuple[float, float]]:
    """Mass [kg], height of its centre [m] and moments of inertia across and about the axis [kg m^2], by rings and discs."""
    points = wall.meridian_m
    step = np.diff(points, axis=0)
    middle, length = 0.5 * (points[1:] + points[:-1]), np.linalg.norm(step, axis=1)
    radius, height = middle.T
    shell = 2 * np.pi * radius * length * wall.wall_m * wall_kg_per_m3
    foot = np.pi * points[0, 0] ** 2 * float(wall.wall_m[0]) * wall_kg_per_m3
    slices = np.pi * radius**2 * np.maximum(step[:, 1], 0.0)
    level = float(np.interp(fill * slices.sum(), np.cumsum(slices), points[1:, 1])) if fill else 0.0
    liquid = LIQUID * slices * (height <= level)
    mass = np.concatenate([shell, liquid, [foot]])
    z = np.concatenate([height, height, [0.0]])
    about = np.concatenate([shell * radius**2, 0.5 * liquid * radius**2, [0.5 * foot * points[0, 0] ** 2]])
    total = float(mass.sum())
    centre = float(mass @ z) / total
    across = 0.5 * about.sum() + mass @ (z - centre) ** 2
    return total, centre, (float(across), float(about.sum()))


def lift(thing: LiftObject, height_m: float, force_N: float, *, pad_radius_m: float = 0.01) -> Lifted:
    """Close two pads at one height from opposite sides, lift, and hold."""
    widest, assets, slices = _solid_slices(thing, height_m)
    fingers = _fingers((0.0, 0.0, height_m), 0.0, widest + 0.0005, force_N, pad_radius_m, thing.friction)
    outer = _outer(thing)
    gap_m = widest - float(np.interp(height_m, outer[:, 1], outer[:, 0]))
    return _lifted(_mjcf(thing, assets, slices, fingers), force_N, np.zeros(3), gap_m)


def lift_rim(
    thing: LiftObject,
    place_m: tuple[float, float],
    outward: tuple[float, float],
    force_N: float,
    *,
    pad_radius_m: float = 0.01,
) -> Lifted:
    """Close two pads on both sides of the wall, at a place (radius, height) of it with the normal ``outward``, and lift."""
    half = 0.5 * MIN_PLATE_m
    anchor = (place_m[0], 0.0, place_m[1])
    plates = _wall_plates(thing, place_m[1], half)
    tilt = float(np.arctan2(-outward[1], outward[0]))
    fingers = _fingers(anchor, tilt, half + 0.0005, force_N, pad_radius_m, thing.friction)
    return _lifted(_mjcf(thing, [], plates, fingers), force_N, np.array(anchor))


def _lifted(mjcf: str, force_N: float, anchor_m: np.ndarray, gap_m: float = 0.0) -> Lifted:
    """Close over a gap at each side, lift and hold; slip is that of a point of the container."""
    close_s = CLOSE_s + gap_m / CLOSING_m_per_s
    model = mujoco.MjModel.from_xml_string(mjcf)
    data = mujoco.MjData(model)
    model.opt.timestep = STEP_s
    data.ctrl[1:] = force_N

    def heights() -> np.ndarray:
        body = data.body("container")
        return np.array([(body.xpos + body.xmat.reshape(3, 3) @ anchor_m)[2], data.joint("up").qpos[0]])

    start: np.ndarray | None = None
    while data.time < close_s + LIFT_s + HOLD_s:
        if start is None and data.time >= close_s:
            start = heights()
        data.ctrl[0] = _risen_m(data.time - close_s)
        mujoco.mj_step(model, data)
    assert start is not None
    risen = heights() - start
    up = data.body("container").xmat.reshape(3, 3)[2, 2]
    return Lifted(float(risen[1] - risen[0]), float(np.arccos(np.clip(up, -1, 1))))


def _risen_m(time_s: float) -> float:
    half = LIFT_s / 2
    first, second = np.clip(time_s, 0, half), np.clip(time_s - half, 0, half)
    return float(0.5 * ACCELERATION_m_per_s2 * (first**2 + 2 * half * second - second**2))


def _solid_slices(thing: LiftObject, height_m: float) -> tuple[float, list[str], list[str]]:
    """Largest radius next to the pads [m], meshes and geoms of slices of the container there."""
    outer = _outer(thing)
    low, high = max(height_m - REACH_m, 0.0), min(height_m + REACH_m, float(outer[-1, 1]))
    cuts = np.linspace(low, high, max(2, round((high - low) / SLICE_m) + 1))
    radii = np.interp(cuts, outer[:, 1], outer[:, 0])
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assets, slices = [], []
    for k in range(len(cuts) - 1):
        corners = np.concatenate(
            [np.column_stack([radii[j] * ring, np.full(AROUND, cuts[j])]) for j in (k, k + 1)]
        )
        text = " ".join(f"{value:.7f}" for value in corners.ravel())
        assets.append(f'<mesh name="s{k}" vertex="{text}" inertia="convex"/>')
        # MuJoCo centres a mesh and compensates by its pose.
        slices.append(f'<geom type="mesh" mesh="s{k}" {_touched(thing)}/>')
    return float(radii.max()), assets, slices


def _wall_plates(thing: LiftObject, height_m: float, half_m: float) -> list[str]:
    """Small plates of the wall around azimuth 0, from below a place of it up to the mouth."""
    outer = _outer(thing)
    top = float(outer[-1, 1])
    cuts = np.linspace(
        max(height_m - REACH_m, 0.0), top, max(2, round((top - height_m + REACH_m) / SLICE_m) + 1)
    )
    radii = np.interp(cuts, outer[:, 1], outer[:, 0])
    plates = []
    for k in range(len(cuts) - 1):
        rise, run = cuts[k + 1] - cuts[k], radii[k + 1] - radii[k]
        radius, height, length = (
            0.5 * (radii[k] + radii[k + 1]),
            0.5 * (cuts[k] + cuts[k + 1]),
            np.hypot(rise, run),
        )
        # A plate's own x looks outward.
        tilt = np.arctan2(run, rise)
        for angle in np.arange(-REACH_m, REACH_m + 1e-9, SLICE_m) / radius:
            place = f"{radius * np.cos(angle):.6f} {radius * np.sin(angle):.6f} {height:.6f}"
            size = f"{half_m:.6f} {0.5 * SLICE_m:.6f} {0.5 * length:.6f}"
            turn = Rotation.from_euler("ZY", [angle, tilt]).as_quat(scalar_first=True)
            quat = " ".join(f"{value:.6f}" for value in turn)
            plates.append(f'<geom type="box" pos="{place}" quat="{quat}" size="{size}" {_touched(thing)}/>')
    return plates


def _outer(thing: LiftObject) -> np.ndarray:
    """Meridian up to the mouth: the top is flat, of its points the first counts."""
    outer = thing.wall.meridian_m
    return outer[: int(outer[:, 1].argmax()) + 1]


def _touched(thing: LiftObject) -> str:
    return f'mass="0" contype="1" conaffinity="3" friction="{thing.friction:.5f}"'


def _mjcf(thing: LiftObject, assets: Sequence[str], solids: Sequence[str], fingers: str) -> str:
    """Model: table, container, and a hand whose two fingers move alike."""
    across, about = thing.inertia_kg_m2
    inertia = f"{across:.3e} {across:.3e} {min(about, 1.99 * across):.3e}"
    foot_m = float(thing.wall.meridian_m[0, 0])
    body = (
        '<body name="container"><freejoint/>'
        f'<inertial pos="0 0 {thing.centre_m:.5f}" mass="{thing.mass_kg:.6f}" diaginertia="{inertia}"/>'
        f'<geom type="cylinder" size="{0.9 * foot_m:.5f} 0.001" pos="0 0 0.001" mass="0" contype="1" '
        f'conaffinity="1" friction="0.3"/>{"".join(solids)}</body>'
    )
    return (
        f'<mujoco><option timestep="{STEP_s}" gravity="0 0 -{GRAVITY_m_per_s2}" cone="elliptic" impratio="50" '
        'integrator="implicitfast" noslip_iterations="5"/>'
        f'<asset>{"".join(assets)}</asset><worldbody><geom type="plane" size="1 1 0.1" contype="1" conaffinity="1"/>'
        f'{body}<body name="hand" gravcomp="1"><joint name="up" type="slide" axis="0 0 1" damping="2000"/>'
        '<inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>'
        f'{fingers}</body></worldbody><equality><joint joint1="close-1" joint2="close1" polycoef="0 1 0 0 0"/></equality>'
        '<actuator><position joint="up" kp="2e5"/><motor joint="close-1"/><motor joint="close1"/></actuator></mujoco>'
    )


def _fingers(
    middle_m: tuple[float, float, float],
    tilt_rad: float,
    reach_m: float,
    force_N: float,
    radius_m: float,
    friction: float,
) -> str:
    """Two fingers on both sides of a place, their line turned about y."""
    place = " ".join(f"{value:.6f}" for value in middle_m)
    both = "".join(_finger(side, reach_m, force_N, radius_m, friction) for side in (-1, 1))
    turn = f"{np.cos(tilt_rad / 2):.6f} 0 {np.sin(tilt_rad / 2):.6f} 0"
    return f'<body pos="{place}" quat="{turn}">{both}</body>'


def _finger(side: int, reach_m: float, force_N: float, radius_m: float, friction: float) -> str:
    """One finger at ``side * reach``, that closes inwards, with a disc of springs."""
    count = sum(RINGS)
    stiffness, mass = force_N / PAD_DEPTH_m / count, 0.002
    springs = []
    for ring, number in enumerate(RINGS):
        # Rings of equal area: the mean radius of each.
        away = radius_m * 2 * ring / (2 * len(RINGS) - 1)
        for k in range(number):
            angle = 2 * np.pi * k / number
            springs.append(
                f'<body pos="0 {away * np.cos(angle):.6f} {away * np.sin(angle):.6f}" gravcomp="1">'
                f'<joint type="slide" axis="{side} 0 0" stiffness="{stiffness:.4f}" '
                f'damping="{2 * np.sqrt(stiffness * mass):.5f}"/>'
                f'<geom type="sphere" size="{PAD_BALL_m}" mass="{mass}" contype="2" conaffinity="0" '
                f'friction="{friction:.5f}" solref="0.004 1"/></body>'
            )
    return (
        f'<body pos="{side * (reach_m + PAD_BALL_m):.5f} 0 0" gravcomp="1">'
        f'<joint name="close{side}" type="slide" axis="{-side} 0 0" damping="{force_N / CLOSING_m_per_s:.6f}"/>'
        f'<inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>{"".join(springs)}</body>'
    )
