"""The first story: a platform drives at three obstacles, touches them, and reads force from a camera."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from ..core.errors import InputError
from ..core.measurement import Event, EventKind
from ..core.objects import HapticTag
from ..core.robots import FrameSource
from ..io.maps.occupancy_map import OccupancyMap
from ..io.sinks.mcap_out import MeasurementWriter
from ..io.sinks.tables import TableWriter
from ..rigs.virtual_sensor import VirtualSensor
from ..sensing.scene.ego_motion import EgoMotionSettings
from ..sensing.scene.scene_record import write_scene
from ..sensing.scene.scene_regions import SceneSettings
from ..sensing.scene.scene_tracker import SceneTracker
from ..simulation.mobile.office import ApproachPath, furnished_office, obstacles_for_map
from ..simulation.mobile.platform import PlatformConfig
from ..simulation.mobile.push_world import FoamPushWorld
from ..simulation.mobile.sensor_camera import SimulatedSensorCamera
from ..simulation.rendering.appearance import Look
from ..tasks.mobile.explore import ExploreStep, ObstacleExploration, explore_obstacle
from ..tasks.mobile.explore_records import ExploreSettings

if TYPE_CHECKING:
    from ..sensing.foam.sensor import FoamSensor
    from ..sensing.foam.strip.optics import ObservedStrip
    from ..viewer.page import LivePage

__all__ = ["SLOWLY", "DemoObject", "DemoResult", "DemoSample", "run_demo"]

log = logging.getLogger(__name__)

#: The table shows every so many frames while something is touched.
_TABLE_FRAMES = 6
#: Slow enough that the first peak is friction and not the blow of an object that has to be set in motion.
#: The platform begins on free floor, a little more than the camera's view.
SLOWLY = ExploreSettings(
    approach_m_s=0.03, push_m_s=0.02, cruise_m_s=0.06, near_m=0.015, free_ahead_m=0.2, search_m=0.6
)

_TABLE_HEAD = f"{'time':>9}  {'ahead':>8}  {'true force':>11}  {'measured':>11}  {'sigma':>9}   event"


@dataclass(frozen=True, slots=True)
class DemoSample:
    """One frame of a push."""

    t_s: float
    truth_N: float
    measured_N: float
    sigma_N: float
    valid: bool
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class DemoObject:
    """One obstacle, what was measured, and what is true."""

    name: str
    path: ApproachPath
    exploration: ObstacleExploration
    samples: tuple[DemoSample, ...]
    picture_bgr: UInt8[np.ndarray, "rows columns 3"] | None  #: the camera's view at the largest force
    strip: ObservedStrip | None  #: what the sensor saw in it
    true_events: tuple[Event, ...]
    end_pose: tuple[float, float, float]  #: of the obstacle in the world after the push
    touch_error_m: float = math.nan  #: by how much later than the scene expected it was touched
    turn_true_rad: float = math.nan  #: of the obstacle in the world from touch to stand

    @property
    def tag(self) -> HapticTag:
        """What was felt."""
        return self.exploration.tag


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """The whole run."""

    grid: OccupancyMap
    objects: tuple[DemoObject, ...]
    sensor: FoamSensor
    folder: Path
    duration_s: float
    track_m: Float[np.ndarray, "n 2"]  #: where the platform was
    notes: dict[str, str] = field(default_factory=dict)


def run_demo(
    folder: Path | str,
    *,
    map_path: Path | str | None = None,
    seed: int = 1,
    say: Callable[[str], None] = log.info,
    page: LivePage | None = None,
    scene: tuple[OccupancyMap, Sequence[ApproachPath]] | None = None,
    explore: ExploreSettings | None = None,
    through: Callable[[FrameSource], FrameSource] = lambda source: source,
) -> DemoResult:
    """Set the scene, calibrate and zero the sensor, explore three obstacles.

    Parameters
    ----------
    folder
        Receives sensor files, ``run.mcap``, ``run.csv`` and the map.
    map_path
        A map_server YAML; without it the project's own office.
    say
        Receives the lines of the live table.
    page
        Shows it live.
    scene
        A map and the obstacles in it, instead of ``map_path`` and our own office.
    explore
        How to drive and push; slowly by default.
    through
        What the frames go through before the sensor has them, as faults that are switched on.
    """
    begin = time.monotonic()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    grid, paths = scene if scene is not None else _scene(folder, map_path, say)
    # In colour, as a webcam sees it: in grey a blue bin and a brown floor can look the same.
    virtual = VirtualSensor(look=Look.photo(colour=True))
    say("foam sensor: press, calibrate, mount, zero")
    sensor = virtual.build(folder, rng)
    material = sensor.setup.material
    say(
        f"  working range {material.working_strain[0]:.2f} to {material.working_strain[1]:.2f} strain, "
        f"saturated beyond {material.densification_strain:.2f}"
    )
    world = FoamPushWorld(
        [path.obstacle for path in paths], PlatformConfig(strip=virtual.geometry), virtual.law, seed
    )
    if page is not None:
        _show_world(page, grid, world)
    objects: list[DemoObject] = []
    track: list[tuple[float, float]] = []
    with MeasurementWriter(folder / "run.mcap") as recording, TableWriter(folder / "run.csv") as table:
        recording.write_camera(sensor.setup.camera, 0.0)
        recording.write_map(grid, 0.0)
        for number, path in enumerate(paths):
            run = _Push(world, virtual, sensor, path, seed + number, say, page, recording, table, track)
            objects.append(run.explore(explore or SLOWLY, through))
            if page is not None:
                page.set_tags({one.name: one.tag for one in objects})
    return DemoResult(
        grid, tuple(objects), sensor, folder, time.monotonic() - begin, np.array(track).reshape(-1, 2)
    )


def _scene(
    folder: Path, map_path: Path | str | None, say: Callable[[str], None]
) -> tuple[OccupancyMap, tuple[ApproachPath, ...]]:
    """The map and three obstacles in it."""
    if map_path is not None:
        grid = OccupancyMap.load(map_path)
        try:
            paths = obstacles_for_map(grid.cells, grid.resolution_m, grid.origin)
        except InputError as error:
            raise InputError(map_path, error.problem, remedy=error.remedy) from error
        say(f"map {map_path}: {grid.size_m[0]:.1f} m x {grid.size_m[1]:.1f} m")
        return grid, paths
    office = furnished_office()
    grid = OccupancyMap(office.cells, office.resolution_m, office.origin)
    grid.save(folder / "office.yaml")
    say(f"our own office, {grid.size_m[0]:.1f} m x {grid.size_m[1]:.1f} m, drawn to {folder / 'office.yaml'}")
    return grid, office.paths


class _Push:
    """One obstacle: drive there, explore it, record everything."""

    def __init__(
        self,
        world: FoamPushWorld,
        virtual: VirtualSensor,
        sensor: FoamSensor,
        path: ApproachPath,
        seed: int,
        say: Callable[[str], None],
        page: LivePage | None,
        recording: MeasurementWriter,
        table: TableWriter,
        track: list[tuple[float, float]],
    ) -> None:
        self.world, self.virtual, self.sensor, self.path = world, virtual, sensor, path
        self.seed, self.say, self.page, self.recording, self.table = seed, say, page, recording, table
        self.track = track
        self.samples: list[DemoSample] = []
        self.best: tuple[float, UInt8[np.ndarray, "rows columns 3"], ObservedStrip] | None = None
        self.touching = False
        self.yaw_rad: list[float] = []  # of a movable obstacle, from its touch on

    def explore(self, settings: ExploreSettings, through: Callable[[FrameSource], FrameSource]) -> DemoObject:
        world, path = self.world, self.path
        world.place_platform(*path.start)
        world.forget_events()
        self.say("")
        self.say(f"{path.obstacle.name}")
        self.say(_TABLE_HEAD)
        self.sensor.reset()
        tracker = SceneTracker.of_sensor(
            self.sensor.setup,
            world.config.floor_below_m,
            SceneSettings(ego=EgoMotionSettings(foam_ahead_m=world.config.radius_m)),
            np.random.default_rng(self.seed),
        )
        camera = SimulatedSensorCamera(world, self.virtual.renderer(), duration_s=60.0, seed=self.seed)
        found = explore_obstacle(
            world.base, through(camera), self.sensor, settings, scene=tracker, on_step=self._step
        )
        events = tuple(event for name, event in world.events if name == path.obstacle.name)
        place = (path.obstacle.x_m, path.obstacle.y_m, path.obstacle.yaw_rad)
        if path.obstacle.movable:
            body = world.truth.body(path.obstacle.name)
            place = (body.x_m, body.y_m, body.yaw_rad)
        picture, strip = None, None
        if self.best is not None:
            _, picture, strip = self.best
        turn = self.yaw_rad[-1] - self.yaw_rad[0] if self.yaw_rad else math.nan
        touched = next((e.t_s for e in found.events if e.kind is EventKind.CONTACT), math.nan)
        times = [profile.t_s for profile in found.profiles]
        late = float(np.interp(touched, times, found.travel_m)) - found.expected_m if times else math.nan
        if math.isfinite(found.seen_ahead_m):
            self.say(
                f"  seen {1e3 * found.seen_ahead_m:.0f} mm ahead, touched {1e3 * late:+.1f} mm from where expected"
            )
        return DemoObject(
            path.obstacle.name, path, found, tuple(self.samples), picture, strip, events, place, late, turn
        )

    def _step(self, step: ExploreStep) -> None:
        profile, truth = step.profile, self.world.truth.load_N
        self.samples.append(
            DemoSample(
                profile.t_s,
                truth,
                profile.force_N,
                profile.force_sigma_N,
                profile.valid,
                profile.reason.value,
            )
        )
        x, y, _ = self.world.platform_pose()
        self.track.append((x, y))
        self.recording.write_force(profile)
        self.table.write(profile)
        if step.scene is not None:
            write_scene(self.recording, step.scene)
        for event in step.events:
            self.recording.write_event(event)
        self.touching = bool(profile.contacts)
        if self.path.obstacle.movable and self.touching and step.phase in ("push", "halt"):
            self.yaw_rad.append(self.world.truth.body(self.path.obstacle.name).yaw_rad)
        near = step.scene is not None and np.isfinite(step.scene.proximity_m) and step.phase == "approach"
        if step.events or ((self.touching or near) and len(self.samples) % _TABLE_FRAMES == 0):
            names = ", ".join(event.kind.value for event in step.events)
            measured = f"{profile.force_N:9.3f} N" if profile.valid else f"{profile.reason.value:>11}"
            sigma = f"{profile.force_sigma_N:7.3f} N" if profile.valid else " " * 9
            ahead = f"{1e3 * step.scene.proximity_m:5.0f} mm" if near and step.scene else " " * 8
            self.say(f"{profile.t_s:7.2f} s  {ahead}  {truth:9.3f} N  {measured}  {sigma}   {names}".rstrip())
        strip = self.sensor.strip
        if profile.valid and strip is not None and (self.best is None or profile.force_N > self.best[0]):
            self.best = (profile.force_N, step.frame.image, strip)
        if self.page is not None:
            self._show(step, truth)

    def _show(self, step: ExploreStep, truth_N: float) -> None:
        assert self.page is not None
        scene = self.world.scene()
        self.page.update(
            step.profile.t_s,
            frame_bgr=step.frame.image,
            profile=step.profile,
            truth_N=truth_N,
            T_world_foam=scene.T_world_foam,
            note=", ".join(event.kind.value for event in step.events),
        )
        if self.path.obstacle.movable:
            _show_obstacle(self.page, self.world, self.path.obstacle.name)


def _show_world(page: LivePage, grid: OccupancyMap, world: FoamPushWorld) -> None:
    page.set_map(grid.cells, grid.resolution_m, grid.origin)
    for obstacle in world.obstacles:
        _show_obstacle(page, world, obstacle.name)


def _show_obstacle(page: LivePage, world: FoamPushWorld, name: str) -> None:
    from ..core.camera.pose import Pose

    obstacle = next(one for one in world.obstacles if one.name == name)
    x, y, yaw = obstacle.x_m, obstacle.y_m, obstacle.yaw_rad
    if obstacle.movable:
        body = world.truth.body(name)
        x, y, yaw = body.x_m, body.y_m, body.yaw_rad
    outline = obstacle.outlines[0].polygon_m()
    pose = Pose.from_rotation_vector([0.0, 0.0, yaw], [x, y, 0.0])
    page.set_obstacle(name, outline, pose, height_m=obstacle.height_m, fixed=not obstacle.movable)
