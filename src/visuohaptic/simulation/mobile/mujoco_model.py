"""MuJoCo models of platform and obstacles, as MJCF text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...core.measurement import GRAVITY_M_S2
from .obstacles import FOOT_M, ObstacleKind, SimulatedObstacle
from .platform import PlatformConfig


def feet_mjcf(obstacle: SimulatedObstacle) -> str:
    """Contact of the feet with the floor.

    MuJoCo's friction is associated: a foot that slides is also lifted, in
    proportion to the damping of its friction rows, and with the default
    constants boxes hop on their feet and stop too late. Friction rows that are four
    times slower than a soft normal row keep the feet down and the friction
    Coulomb-like; the no-slip solver prevents creep of obstacles at rest.

    Parameters
    ----------
    obstacle
        Obstacle with feet.
    """
    if not obstacle.movable or obstacle.kind is ObstacleKind.DOOR:
        return ""
    friction = obstacle.friction * obstacle.static_ratio
    return "".join(
        f'<pair name="foot{i}:{obstacle.name}" geom1="floor" geom2="foot{i}:{obstacle.name}" condim="3" '
        f'friction="{friction} {friction} 0 0 0" solref="0.005 1" solreffriction="0.02 1" '
        'solimp="0.1 0.1 0.001"/>'
        for i in range(6 if obstacle.kind is ObstacleKind.CYLINDER else 4)
    )


def obstacle_mjcf(obstacle: SimulatedObstacle) -> str:
    """MuJoCo body of an obstacle; its frame is on the floor below its centre (door: at the hinge).

    Parameters
    ----------
    obstacle
        Shape, mass and friction.
    """
    o = obstacle
    place = f'pos="{o.x_m} {o.y_m} 0" euler="0 0 {o.yaw_rad}"'
    half = 0.5 * o.height_m
    # Obstacles and floor collide with each other (bit 1); the rigid platform collides with obstacles (bit 2).
    mask = 'contype="3" conaffinity="3"'
    name = f"obstacle:{o.name}"
    if o.kind is ObstacleKind.TABLE:
        shape = "cylinder" if o.round_legs else "box"
        size = f"{o.leg_m / 2} {half}" if o.round_legs else f"{o.leg_m / 2} {o.leg_m / 2} {half}"
        centres = (np.asarray(leg.vertices_m).mean(axis=0) for leg in o.outlines)
        geoms = "".join(
            f'<geom type="{shape}" size="{size}" pos="{c[0]} {c[1]} {half}" {mask}/>' for c in centres
        )
        return f'<body name="{name}" {place}>{geoms}</body>'
    if o.kind is ObstacleKind.DOOR:
        size = f"{o.length_m / 2} {o.width_m / 2} {half - 0.01}"
        joint = (
            ""
            if o.fixed
            else (
                f'<joint name="{name}" type="hinge" axis="0 0 1" limited="true" range="-1.7 1.7" '
                f'frictionloss="{o.hinge_friction_Nm}" damping="{o.hinge_damping_Nms}"/>'
            )
        )
        pose = f'pos="{o.length_m / 2} 0 {half + 0.01}"'
        geom = f'<geom type="box" size="{size}" {pose} mass="{o.mass_kg}" {mask}/>'
        return f'<body name="{name}" {place}>{joint}{geom}</body>'
    if o.kind is ObstacleKind.CYLINDER:
        shape, size = "cylinder", f"{o.length_m / 2} {half - FOOT_M / 2}"
        angle = np.arange(6) * math.pi / 3
        feet = (0.5 * o.length_m - FOOT_M) * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        shape, size = "box", f"{o.length_m / 2} {o.width_m / 2} {half - FOOT_M / 2}"
        corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        feet = (0.5 * np.array([o.length_m, o.width_m]) - FOOT_M) * corners
    solid = (
        f'<geom type="{shape}" size="{size}" pos="0 0 {half + FOOT_M / 2}" mass="{o.mass_kg}" '
        f'friction="{o.friction} 0 0" {mask}/>'
    )
    if o.fixed:
        return f'<body name="{name}" {place}>{solid}</body>'
    stand = "".join(
        f'<geom name="foot{i}:{o.name}" type="sphere" size="{FOOT_M}" pos="{x} {y} {FOOT_M}" mass="0" '
        'contype="0" conaffinity="0"/>'
        for i, (x, y) in enumerate(feet)
    )
    return f'<body name="{name}" {place}><freejoint name="{name}"/>{solid}{stand}</body>'


def platform_mjcf(config: PlatformConfig) -> str:
    """MuJoCo body of the platform: three planar joints; only its rigid hull collides with obstacles.

    Parameters
    ----------
    config
        Shape and mass.
    """
    c = config
    top = 0.15
    # Slightly in front of the back contour: rigid contact starts when the foam has bottomed out.
    proud = 0.04 * c.strip.width_m
    if c.round:
        shape = f'type="cylinder" size="{c.radius_m + proud} {top}" pos="0 0 {top + 0.01}"'
    else:
        shape = f'type="box" size="{c.radius_m + proud} {c.width_m / 2} {top}" pos="0 0 {top + 0.01}"'
    inertia = 0.5 * c.mass_kg * c.radius_m**2
    return f"""<body name="platform">
      <inertial pos="0 0 0.1" mass="{c.mass_kg}" diaginertia="{inertia} {inertia} {inertia}"/>
      <joint name="platform:x" type="slide" axis="1 0 0"/><joint name="platform:y" type="slide" axis="0 1 0"/>
      <joint name="platform:yaw" type="hinge" axis="0 0 1"/>
      <geom {shape} friction="0.3 0 0" contype="2" conaffinity="0"/></body>"""


def world_mjcf(config: PlatformConfig, obstacles: Sequence[SimulatedObstacle]) -> str:
    """MuJoCo model of platform, obstacles and floor.

    Elliptic cones and no-slip iterations prevent creep of boxes at rest.

    Parameters
    ----------
    config
        Shape and mass of the platform.
    obstacles
        Obstacles with unique names.
    """
    bodies = "\n".join(obstacle_mjcf(o) for o in obstacles)
    feet = "\n".join(feet_mjcf(o) for o in obstacles)
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="auto"/>
    <option cone="elliptic" impratio="10" noslip_iterations="5" integrator="implicitfast"
      gravity="0 0 {-GRAVITY_M_S2}"/>
    <worldbody><geom name="floor" type="plane" size="100 100 1" friction="0.3 0 0"
      contype="1" conaffinity="1"/>
    {platform_mjcf(config)}
    {bodies}</worldbody><contact>{feet}</contact></mujoco>"""
