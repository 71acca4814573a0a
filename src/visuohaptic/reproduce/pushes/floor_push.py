"""MuJoCo simulation of a round platform that drives against an object on feet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError, needs
from ...core.measurement import GRAVITY_M_S2
from ...simulation.mobile.obstacles import FOOT_M

#: Deformation of the feet's springs under the object's weight (m), and mass of a foot (kg).
#: With more than three rigid feet, the load distribution would be indeterminate; springs determine it.
SAG_M, FOOT_KG = 5e-4, 0.01
#: Time in which the object sinks into its feet (s).
SETTLE_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class FloorBody:
    """A rigid object on explicit feet, in a frame whose origin is on the floor below its reference point.

    The platform is a sphere whose equator touches the outline at one height, and
    the outline is a ring of capsules: such pairs have closed-form
    contacts. (For cylinders and prisms, MuJoCo's contact normals are
    wrong by degrees at small penetration, and friction then leaves its cone.)
    """

    outline_m: Float[np.ndarray, "m 2"]  #: corners of the core; one point for a disc
    feet_m: Float[np.ndarray, "n 2"]
    round_m: float = 0.005  #: the outline is the core, dilated by this; the radius of a disc
    mass_kg: float = 2.0
    centre_m: tuple[float, float] = (0.0, 0.0)  #: of mass
    centre_height_m: float = 0.06  #: of mass above the floor
    push_height_m: float = 0.03  #: of the contact with the platform
    floor_friction: float = 0.4
    contact_friction: float = 0.2  #: with the platform's rim

    def __post_init__(self) -> None:
        if len(self.feet_m) < 3 or len(self.outline_m) < 1:
            raise InputError(
                "FloorBody",
                f"found {len(self.feet_m)} feet, {len(self.outline_m)} corners; expected 3 and 1 at least",
            )
        numbers = (self.mass_kg, self.floor_friction, self.centre_height_m)
        if not min(*numbers, self.round_m, self.push_height_m) > 0 or self.contact_friction < 0:
            raise InputError("FloorBody", f"found {self}, expected mass, friction, radii, heights > 0")


@dataclass(frozen=True, slots=True, eq=False)
class FloorTrace:
    """States at all recorded times."""

    platform_m: Float[np.ndarray, "k 3"]  #: x, y, heading [m, m, rad]
    object_m: Float[np.ndarray, "k 3"]  #: x, y, yaw [m, m, rad]
    touching: Bool[np.ndarray, "k"]

    @property
    def dropped(self) -> bool:
        """Whether the object was touched, and contact was lost before the last centimetre of the drive."""
        where = np.flatnonzero(self.touching)
        return bool(len(where) and self.driven_m[-1] - self.driven_m[where[-1]] > 0.01)

    @property
    def driven_m(self) -> Float[np.ndarray, "k"]:
        """Distance driven until each time."""
        steps = np.hypot(*np.diff(self.platform_m[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])


class FloorPush:
    """MuJoCo with a platform that moves exactly along the given poses.

    Parameters
    ----------
    body
        Pushed object.
    start_m
        Its pose (x [m], y [m], yaw [rad]) in the world.
    platform_m
        Start of the platform (x [m], y [m], heading [rad]).
    radius_m
        Radius of the platform [m].
    time_step_s
        Time step of the physics [s].
    """

    def __init__(
        self,
        body: FloorBody,
        start_m: Sequence[float],
        platform_m: Sequence[float],
        radius_m: float = 0.17,
        *,
        time_step_s: float = 0.0005,
    ) -> None:
        with needs("mujoco-core", "sim", "the simulated push"):
            import mujoco
        self._mujoco: Any = mujoco
        self.body, self.radius_m = body, radius_m
        self._model: Any = mujoco.MjModel.from_xml_string(_mjcf(body, radius_m, time_step_s))
        self._data: Any = mujoco.MjData(self._model)
        self._data.qpos[:3] = platform_m
        self._data.qpos[3:6] = start_m[0], start_m[1], 0.0
        self._data.qpos[6:10] = np.cos(start_m[2] / 2), 0.0, 0.0, np.sin(start_m[2] / 2)
        self._rim = self._model.geom("rim").id
        #: contact point in the world, NaN without contact
        self.contact_m = np.full(2, np.nan)
        #: of the centres, at which rim and outline may meet; a millimetre is more than a step of the drive
        self._reach_m = radius_m + float(np.hypot(*body.outline_m.T).max()) + body.round_m + 1e-3
        # It sinks into its feet before the platform moves.
        self._steps(np.zeros(3), math.ceil(SETTLE_S / time_step_s))

    @property
    def platform_m(self) -> Float[np.ndarray, "3"]:
        """x, y, heading of the platform."""
        return self._data.qpos[:3].copy()

    @property
    def object_m(self) -> Float[np.ndarray, "3"]:
        """x, y, yaw of the object."""
        w, x, y, z = self._data.qpos[6:10]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return np.array([self._data.qpos[3], self._data.qpos[4], yaw])

    def move(self, platform_m: Sequence[float], speed_m_s: float = 0.05) -> None:
        """Drive in a straight line to a pose (x, y, heading), slowly.

        Parameters
        ----------
        platform_m
            Pose (x [m], y [m], heading [rad]) to reach.
        speed_m_s
            Speed of the platform [m/s].
        """
        target = np.asarray(platform_m, dtype=np.float64)
        way = target - self._data.qpos[:3]
        duration = max(float(np.hypot(way[0], way[1])), self.radius_m * abs(float(way[2]))) / speed_m_s
        count = max(1, round(duration / self._model.opt.timestep))
        self._steps(way / (count * self._model.opt.timestep), count)
        self._data.qpos[:3] = target

    def drive(self, path_m: Float[np.ndarray, "k 3"], speed_m_s: float = 0.05) -> FloorTrace:
        """Drive along a path of poses and record at each of them.

        Parameters
        ----------
        path_m
            Poses (k, 3): x [m], y [m], heading [rad].
        speed_m_s
            Speed of the platform [m/s].
        """
        rows, touching = [], []
        for row, pose in enumerate(path_m):
            if row:
                self.move(pose, speed_m_s)
            rows.append(self.object_m)
            touching.append(bool(np.isfinite(self.contact_m[0])))
        return FloorTrace(np.array(path_m), np.array(rows), np.array(touching))

    def _apart(self) -> bool:
        """The object stands still, out of the platform's reach: only the platform moves."""
        at, speed = self._data.qpos, self._data.qvel[3:9]
        gap = math.hypot(at[3] - at[0], at[4] - at[1]) - self._reach_m
        # What slides at 0.1 mm/s stops within nanometres.
        return gap > 0 and self._data.time > SETTLE_S and bool(np.abs(speed).max() < 1e-4)

    def _steps(self, velocity: Float[np.ndarray, "3"], count: int) -> None:
        data, model = self._data, self._model
        place = data.qpos[:3].copy()
        total, moment = 0.0, np.zeros(2)
        force = np.zeros(6)
        for _ in range(count):
            data.qvel[:3] = velocity
            if moving := not self._apart():
                self._mujoco.mj_step(model, data)
            # Its mass is several tons, and it is still moved kinematically.
            place += velocity * model.opt.timestep
            data.qpos[:3] = place
            for c in np.flatnonzero((data.contact.geom == self._rim).any(axis=1)) if moving else ():
                self._mujoco.mj_contactForce(model, data, c, force)
                total += force[0]
                moment += force[0] * data.contact[c].pos[:2]
        self.contact_m = moment / total if total > 1e-3 else np.full(2, np.nan)


def _mjcf(body: FloorBody, radius_m: float, step_s: float) -> str:
    """The model. Every foot is a small body on its own spring."""
    geoms, pairs = "", ""
    corners, height, r = body.outline_m, body.push_height_m, body.round_m
    count = len(corners) if len(corners) > 2 else max(1, len(corners) - 1)
    for i in range(count):
        (x0, y0), (x1, y1) = corners[i], corners[(i + 1) % len(corners)]
        if len(corners) == 1:
            shape = f'type="sphere" size="{r}" pos="{x0} {y0} {height}"'
        else:
            shape = f'type="capsule" size="{r}" fromto="{x0} {y0} {height} {x1} {y1} {height}"'
        geoms += f'<geom name="part{i}" {shape} mass="0" contype="0" conaffinity="0"/>'
        f = body.contact_friction
        cone = f'condim="3" friction="{f} {f} 0 0 0"' if f > 0 else 'condim="1"'
        pairs += f'<pair geom1="rim" geom2="part{i}" {cone} solref="0.004 1" solimp="0.99 0.99 0.001"/>'
    stiffness = body.mass_kg * GRAVITY_M_S2 / (len(body.feet_m) * SAG_M)
    # Critical damping of the object on all its feet.
    damping = 2.0 * math.sqrt(stiffness * body.mass_kg / len(body.feet_m))
    feet = ""
    for i, (x, y) in enumerate(body.feet_m):
        feet += (
            f'<body name="foot{i}" pos="{x} {y} {FOOT_M}"><inertial pos="0 0 0" mass="{FOOT_KG}" '
            f'diaginertia="1e-5 1e-5 1e-5"/><joint type="slide" axis="0 0 1" stiffness="{stiffness}" '
            f'damping="{damping}"/><geom name="foot{i}" type="sphere" size="{FOOT_M}" contype="0" '
            'conaffinity="0"/></body>'
        )
        f = body.floor_friction
        pairs += (
            f'<pair geom1="floor" geom2="foot{i}" condim="3" friction="{f} {f} 0 0 0" solref="0.005 1" '
            'solimp="0.9 0.9 0.001"/>'
        )
    inertia = 0.02 * body.mass_kg
    cx, cy = body.centre_m
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="false"/>
    <option timestep="{step_s}" cone="elliptic" impratio="10" noslip_iterations="5" integrator="implicitfast"
      gravity="0 0 {-GRAVITY_M_S2}"/>
    <worldbody><geom name="floor" type="plane" size="50 50 1" contype="0" conaffinity="0"/>
    <body name="platform"><inertial pos="0 0 0" mass="1e5" diaginertia="1e4 1e4 1e4"/>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
      <geom name="rim" type="sphere" size="{radius_m}" pos="0 0 {body.push_height_m}"
        contype="0" conaffinity="0"/></body>
    <body name="thing"><freejoint/>
      <inertial pos="{cx} {cy} {body.centre_height_m}" mass="{body.mass_kg}"
        diaginertia="{inertia} {inertia} {inertia}"/>{geoms}{feet}</body></worldbody>
    <contact>{pairs}</contact></mujoco>"""
