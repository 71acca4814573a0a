"""The world at the table: the parts of its robots, and the ground truth behind them.

Each function of :data:`ROBOTS` creates one world of the mission and returns the parts of the robot in it, as
:func:`visuohaptic.io.remote.serve_robot` serves them. With ``visuohaptic demo --apart`` it does so in another process: then
only images, poses and commands cross. Ground truth for the evaluation is written to a file, which no task reads.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core import Camera, DeviceError, Frame, Pose
from ..io.remote.client import start_robot
from ..rigs.virtual_beam import VirtualProbe, probe_beam, weighing_frames, wrist_beam
from ..rigs.virtual_gripper import STRIP, TRACKING, VirtualHand, finger_sensor
from ..simulation.faults import FaultKind
from ..simulation.tabletop import DepthCamera, RefractingScene, SimulatedArm, disturb_pose
from .bottle import TableBottle, other_table_container, random_table_bottle, table_bottle, table_views

if TYPE_CHECKING:
    from .story import Mission

#: Images of the load sensor of the hand at rest, and with calibration weights hung below it, two of each [N, Nm].
REST = np.zeros((20, 6))
WEIGHTS = np.outer(np.repeat((0.0, 2.0, 4.0, 6.0, 8.0, 0.0), 2), np.eye(6)[0])
#: Arguments of a mission that determine its world.
_ARGUMENTS = ("seed", "quick", "world", "visit", "place", "attempt")


def place_bottle(mission: Mission) -> TableBottle:
    """Create the bottle on the simulated table, once.

    Parameters
    ----------
    mission
        Creates and stores the bottle.
    """
    if mission.bottle is None:
        rng, today = mission.world_rng(20), mission.day_rng(26)
        if mission.place:
            mission.bottle = other_table_container(rng, today)
        else:
            mission.bottle = random_table_bottle(rng, today) if mission.world else table_bottle(rng)
    return mission.bottle


def known_loads(mission: Mission) -> tuple[Float[np.ndarray, "n 6"], np.random.Generator]:
    """Loads applied to the probe to verify its zero [N, Nm], and the generator that drew them.

    Parameters
    ----------
    mission
        A quick one has few loads.
    """
    count, rng = 3 if mission.quick else 12, mission.rng(25)
    loads = np.zeros((count, 6))
    loads[:, :3] = rng.uniform(-1.0, 1.0, (count, 3)) * (2.0, 1.5, 1.5)
    return loads, rng


def rest_count(mission: Mission) -> int:
    """Number of images of the probe at rest.

    Parameters
    ----------
    mission
        A quick one has few of them.
    """
    return 8 if mission.quick else 20


def view_count(mission: Mission) -> int:
    """Number of depth views around the table.

    Parameters
    ----------
    mission
        A quick one has half of them, the second attempt twice as many.
    """
    return (30 if mission.quick else 60) * (1 + mission.attempt)


def _beam(mission: Mission) -> dict[str, Any]:
    """The probe's sensor on a bench: images at rest, then under known loads."""
    virtual = probe_beam()
    virtual.write(mission.folder / "beam")
    (loads, rng), rest = known_loads(mission), np.zeros((rest_count(mission), 6))

    def frames() -> Iterator[Frame]:
        yield from virtual.frames(rest, mission.rng(21), start_s=-2.0)
        yield from virtual.frames(loads, rng)

    return {"camera": _Frames(virtual.camera, frames())}


def _glass(mission: Mission) -> dict[str, Any]:
    """A depth camera that is carried around the table."""
    circling = _CirclingCamera(place_bottle(mission).scene, view_count(mission), mission.rng(22))
    return {"arm": circling, "depth": circling}


def _probe(mission: Mission) -> dict[str, Any]:
    """An arm with the probe, whose camera sees the rod."""
    bottle, rng = place_bottle(mission), mission.rng(23)
    arm = SimulatedArm(Pose(np.eye(3), np.array([0.3, 0.0, 0.4])), repeat_sigma_m=2e-4, rng=rng)
    return {"arm": arm, "camera": VirtualProbe(arm, bottle.probed(), rng, T_base_bottle=bottle.T_base_bottle)}


def _hand(mission: Mission) -> dict[str, Any]:
    """An arm with the gripper: cameras see the foam of a finger, and the beam from which the hand hangs."""
    if mission.kitchen is None:
        bottle = place_bottle(mission)
        x, y, _ = bottle.T_base_bottle.translation_m
        slip_s = 0.0 if mission.fault is FaultKind.SLIP else math.inf
        # Squeezes and grasp take at least 35 s: the fall occurs in the middle.
        falls = mission.fault is FaultKind.OBJECT_FALLS
        fall_s = float(mission.rng(30).uniform(2.0, 34.0)) if falls else math.inf
        mission.kitchen = VirtualHand(
            bottle.container, mission.rng(31), (float(x), float(y)), slip_at_s=slip_s, fall_at_s=fall_s,
            wrist=wrist_beam(mission.at(0).rng(31)) if mission.place else None,
        )  # fmt: skip
    hand, unread = mission.kitchen, mission.known.wrist is None
    if mission.known.finger is None:
        (folder := mission.folder / "finger").mkdir(parents=True, exist_ok=True)
        finger_sensor().build(folder, mission.at(0).rng(33), zero_frames=10, tracking=TRACKING, strip=STRIP)
    if unread:
        hand.wrist_camera.virtual.write(mission.folder / "wrist")

    def weighed() -> Iterator[Frame]:
        if unread:
            yield from weighing_frames(hand.wrist_camera, np.vstack([REST, WEIGHTS]))
        while True:
            yield hand.wrist_frame()

    def watched() -> Iterator[Frame]:
        for frame in hand:
            truth = {name: getattr(hand, name) for name in ("force_N", "deformation_m", "lifted_m", "fallen")}
            _truth_path(mission).write_text(json.dumps(truth), encoding="utf-8")
            yield frame

    return {
        "arm": hand.arm,
        "gripper": hand,
        "camera": _Frames(hand.camera, watched()),
        "load_camera": _Frames(hand.wrist_camera.virtual.camera, weighed()),
    }


#: Parts of each robot at the table.
ROBOTS: dict[str, Callable[[Mission], dict[str, Any]]] = {
    "beam": _beam,
    "glass": _glass,
    "probe": _probe,
    "hand": _hand,
}


@contextmanager
def robot_at_table(mission: Mission, name: str) -> Iterator[Any]:
    """The parts of a robot at the table as attributes, from this process or from one of its own.

    Parameters
    ----------
    mission
        Determines the world, and whether it runs apart.
    name
        One of ``ROBOTS``.
    """
    if not mission.apart:
        yield SimpleNamespace(**ROBOTS[name](mission))
        return
    arguments = {field: getattr(mission, field) for field in _ARGUMENTS}
    fault = None if mission.fault is None else mission.fault.value
    given = {"name": name, "folder": str(mission.folder.resolve()), "fault": fault, **arguments}
    with start_robot(f"{__name__}:serve", given) as robot:
        yield robot


def serve(name: str, folder: str, fault: str | None, attempt: int, **arguments: Any) -> dict[str, Any]:
    """Parts of a robot for :func:`visuohaptic.io.remote.start_robot`, in the world of a mission.

    Parameters
    ----------
    name
        One of ``ROBOTS``.
    folder
        Receives the sensor's files.
    fault
        Fault to inject.
    attempt
        1 for the second attempt of a chapter.
    arguments
        ``seed``, ``quick``, ``world``, ``visit`` and ``place`` of the :class:`.Mission`.
    """
    from .story import Mission

    mission = Mission(folder=Path(folder), fault=None if fault is None else FaultKind(fault), **arguments)
    mission.attempt = attempt
    return ROBOTS[name](mission)


def hand_truth(mission: Mission) -> dict[str, Any]:
    """Truth of the gripper's world at its last image: ``force_N``, ``deformation_m``, ``lifted_m`` and ``fallen``.

    Parameters
    ----------
    mission
        After a chapter of its hand.
    """
    found: dict[str, Any] = json.loads(_truth_path(mission).read_text(encoding="utf-8"))
    return found


def _truth_path(mission: Mission) -> Path:
    return mission.folder / "truth_of_the_hand.json"


@dataclass(slots=True)
class _Frames:
    """Frames of a world as a frame source; a new loop continues where the last one stopped."""

    camera: Camera
    frames: Iterator[Frame]
    frame_count: int | None = None

    def __iter__(self) -> Iterator[Frame]:
        while (frame := next(self.frames, None)) is not None:
            yield frame

    def close(self) -> None:
        """Nothing to release."""


@dataclass(slots=True)
class _CirclingCamera:
    """A depth camera that is moved around the table, one view per image, and whose pose is measured."""

    scene: RefractingScene
    views: int
    rng: np.random.Generator
    t_s: float = -0.1
    _poses: Iterator[Pose] = field(init=False)
    _measured: Pose | None = field(init=False, default=None)
    _model: DepthCamera = field(init=False)

    def __post_init__(self) -> None:
        self._poses, self._model = iter(table_views(self.views, self.rng)), DepthCamera.kinect(240)

    @property
    def camera(self) -> Camera:
        return self._model.camera

    def read(self) -> SimpleNamespace:
        """The image from the next pose."""
        pose = next(self._poses, None)
        if pose is None:
            raise DeviceError(f"the camera has taken all of its {self.views} views")
        depth_m = self._model.render(self.scene, pose, self.rng)
        self.t_s, self._measured = self.t_s + 0.1, disturb_pose(pose, self.rng, 0.0005, 0.001)
        return SimpleNamespace(t_s=self.t_s, depth_m=depth_m)

    def pose(self) -> tuple[float, Pose]:
        """Measured pose of the camera at the last image."""
        if self._measured is None:
            raise DeviceError("the pose is that of an image, and none was taken")
        return self.t_s, self._measured
