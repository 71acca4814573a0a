"""The push demo: a platform drives against three obstacles, touches them, and reads force from a camera."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from ..core import EventKind, ForceProfile, FrameSource, HapticTag, InputError, PlaneView
from ..io import MeasurementWriter, OccupancyMap, TableWriter
from ..rigs.virtual_sensor import VirtualSensor
from ..sensing import EgoMotionSettings, SceneTracker
from ..sensing.scene import SceneSettings, write_scene
from ..simulation.mobile import FoamPushWorld, PlatformConfig, SimulatedObstacle, SimulatedSensorCamera
from ..simulation.mobile.office import ApproachPath, obstacles_for_map
from ..simulation.rendering.appearance import Look
from ..tasks import ExploreSettings, ExploreStep, ObstacleExploration, explore_obstacle
from ..tasks.framework.supervised_parts import Supervisor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..sensing.foam import FoamSensor, ObservedStrip
    from ..viewer.page import LivePage


log = logging.getLogger(__name__)

#: The table shows every n-th frame during contact.
_TABLE_FRAMES = 15
#: Contact at a speed at which the first peak is static friction and not the impact on the object's inertia: it breaks
#: away within two millimetres of foam, before a faster platform could decelerate.
#: The platform starts on free floor, slightly more than the camera's view away.
SLOW_EXPLORATION = ExploreSettings(approach_m_s=0.02, near_m=0.015, free_ahead_m=0.2, search_m=0.6)

_TABLE_HEAD = f"{'time':>9}  {'true force':>11}  {'measured':>11}  {'sigma':>9}   event"


@dataclass(frozen=True, slots=True, eq=False)
class DemoObject:
    """One obstacle with measurements and ground truth."""

    name: str
    path: ApproachPath
    exploration: ObstacleExploration
    samples: tuple[tuple[ForceProfile, float], ...]  #: readings of every frame, and the true force [N]
    picture_bgr: UInt8[np.ndarray, "rows columns 3"] | None  #: camera image at the maximum force
    strip: ObservedStrip | None  #: reading of the sensor in it
    end_pose: tuple[float, float, float]  #: pose of the obstacle in the world after the push

    @property
    def tag(self) -> HapticTag:
        """The measured tag."""
        return self.exploration.tag


@dataclass(frozen=True, slots=True, eq=False)
class DemoResult:
    """Result of the whole run."""

    objects: tuple[DemoObject, ...]
    sensor: FoamSensor
    duration_s: float


def run_demo(
    folder: Path | str,
    scene: tuple[OccupancyMap, Sequence[ApproachPath]] | Path | str,
    *,
    seed: int = 1,
    on_message: Callable[[str], None] = log.info,
    page: LivePage | None = None,
    explore: ExploreSettings = SLOW_EXPLORATION,
    wrap_frames: Callable[[FrameSource], FrameSource] = lambda source: source,
) -> DemoResult:
    """Create the scene, calibrate and zero the sensor, explore the obstacles.

    Parameters
    ----------
    folder
        Receives sensor files, ``run.mcap`` and ``run.csv``.
    scene
        A map and the obstacles in it, or a map_server YAML in which three are placed.
    seed
        Seed of all random numbers.
    on_message
        Called with the lines of the live table.
    page
        Live page.
    explore
        Parameters of the drive and the push; slow by default.
    wrap_frames
        Wrapper of the frame source, e.g. injected faults.
    """
    start_s = time.monotonic()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    grid, paths = scene if isinstance(scene, tuple) else _placed(scene, on_message)
    # In colour, like a webcam: in grey, a blue bin and a brown floor can look the same.
    virtual = VirtualSensor(look=Look.photo(colour=True))
    on_message("foam sensor: press, calibrate, mount, zero")
    sensor = virtual.build(folder, rng)
    material = sensor.setup.material
    on_message(
        f"  working range {material.working_strain[0]:.2f} to {material.working_strain[1]:.2f} strain, "
        f"saturated beyond {material.densification_strain:.2f}"
    )
    world = FoamPushWorld(
        [path.obstacle for path in paths], PlatformConfig(strip=virtual.geometry), virtual.law, seed
    )
    if page is not None:
        page.set_map(grid.cells, grid.resolution_m, grid.origin)
        for obstacle in world.obstacles:
            show_obstacle(page, obstacle, _pose_of(world, obstacle))
    objects: list[DemoObject] = []
    with MeasurementWriter(folder / "run.mcap") as recording, TableWriter(folder / "run.csv") as table:
        recording.write_camera(sensor.setup.camera, 0.0)
        recording.write_map(grid, 0.0)
        for number, path in enumerate(paths):
            push = _Push(world, virtual, sensor, on_message, page, recording, table, path, seed + number)
            objects.append(push.explore(explore, wrap_frames))
            if page is not None:
                page.set_tags({one.name: one.tag for one in objects})
    return DemoResult(tuple(objects), sensor, time.monotonic() - start_s)


def _placed(
    map_path: Path | str, on_message: Callable[[str], None]
) -> tuple[OccupancyMap, tuple[ApproachPath, ...]]:
    """A user's map with three obstacles."""
    grid = OccupancyMap.load(map_path)
    try:
        paths = obstacles_for_map(grid)
    except InputError as error:
        raise InputError(map_path, error.problem, remedy=error.remedy) from error
    on_message(f"map {map_path}: {grid.size_m[0]:.1f} m x {grid.size_m[1]:.1f} m")
    return grid, paths


@dataclass(slots=True)
class _Push:
    """One obstacle: drive to it, explore it, record everything."""

    world: FoamPushWorld
    virtual: VirtualSensor
    sensor: FoamSensor
    log: Callable[[str], None]
    page: LivePage | None
    recording: MeasurementWriter
    table: TableWriter
    path: ApproachPath
    seed: int
    samples: list[tuple[ForceProfile, float]] = field(default_factory=list)
    best: tuple[float, UInt8[np.ndarray, "rows columns 3"], ObservedStrip] | None = None

    def explore(
        self, settings: ExploreSettings, wrap_frames: Callable[[FrameSource], FrameSource]
    ) -> DemoObject:
        world, path = self.world, self.path
        world.place_platform(*path.start)
        world.forget_events()
        self.log("")
        self.log(f"{path.obstacle.name}")
        self.log(_TABLE_HEAD)
        self.sensor.reset()
        tracker = SceneTracker.of_sensor(
            self.sensor.setup,
            world.config.floor_below_m,
            SceneSettings(ego=EgoMotionSettings(foam_ahead_m=world.config.radius_m)),
            np.random.default_rng(self.seed),
        )
        camera = SimulatedSensorCamera(world, self.virtual.renderer(), duration_s=60.0, seed=self.seed)
        guard = Supervisor(clock=lambda: world.t_s)
        found = explore_obstacle(
            guard.base(world.base),
            guard.frames(wrap_frames(camera)),
            guard.sensor(self.sensor),
            settings,
            scene=tracker,
            on_step=self._step,
        )
        place = _pose_of(world, path.obstacle)
        picture, strip = None, None
        if self.best is not None:
            _, picture, strip = self.best
        touched = next((e.t_s for e in found.events if e.kind is EventKind.CONTACT), math.nan)
        times = [profile.t_s for profile in found.profiles]
        late = float(np.interp(touched, times, found.travel_m)) - found.expected_m if times else math.nan
        if math.isfinite(found.seen_ahead_m):
            contact = (
                f"contact {1e3 * abs(late):.1f} mm {'after' if late > 0 else 'before'} the predicted place"
            )
            contact = contact if math.isfinite(late) else "no contact"
            self.log(f"  seen {1e3 * found.seen_ahead_m:.0f} mm ahead, {contact}")
        return DemoObject(path.obstacle.name, path, found, tuple(self.samples), picture, strip, place)

    def _step(self, step: ExploreStep) -> None:
        profile, truth = step.profile, self.world.truth.load_N
        self.samples.append((profile, truth))
        self.recording.write_force(profile)
        self.table.write(profile)
        if step.scene is not None:
            write_scene(self.recording, step.scene)
        for event in step.events:
            self.recording.write_event(event)
        if step.events or (profile.contacts and len(self.samples) % _TABLE_FRAMES == 0):
            names = ", ".join(event.kind.value for event in step.events)
            measured = f"{profile.force_N:9.3f} N" if profile.valid else f"{profile.reason.value:>11}"
            sigma = f"{profile.force_sigma_N:7.3f} N" if profile.valid else " " * 9
            self.log(f"{profile.t_s:7.2f} s  {truth:9.3f} N  {measured}  {sigma}   {names}".rstrip())
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
            show_obstacle(self.page, self.path.obstacle, _pose_of(self.world, self.path.obstacle))


def _pose_of(world: FoamPushWorld, obstacle: SimulatedObstacle) -> tuple[float, float, float]:
    """True pose of an obstacle."""
    if not obstacle.movable:
        return obstacle.x_m, obstacle.y_m, obstacle.yaw_rad
    body = world.truth.body(obstacle.name)
    return body.x_m, body.y_m, body.yaw_rad


def show_obstacle(page: LivePage, obstacle: SimulatedObstacle, pose: tuple[float, float, float]) -> None:
    """Draw an obstacle on the live page.

    Parameters
    ----------
    page
        The page.
    obstacle
        Its outline and height.
    pose
        x, y [m] and yaw [rad] in the map.
    """
    from ..core.camera.pose import Pose

    x, y, yaw = pose
    T_world_obstacle = Pose.from_rotation_vector([0.0, 0.0, yaw], [x, y, 0.0])
    outline = obstacle.outlines[0].polygon_m()
    page.set_obstacle(
        obstacle.name, outline, T_world_obstacle, height_m=obstacle.height_m, fixed=not obstacle.movable
    )


def force_of_push(one: DemoObject) -> Figure:
    """Force over time of one push, with ground truth and its events.

    Parameters
    ----------
    one
        The push.
    """
    from ..report.charts import force_over_time

    felt, truth_N = zip(*one.samples, strict=True)
    return force_over_time(
        *(
            np.array([getattr(profile, name) for profile in felt])
            for name in ("t_s", "force_N", "force_sigma_N")
        ),
        truth_N=np.array(truth_N),
        valid=np.array([profile.valid for profile in felt]),
        reasons=[profile.reason.value for profile in felt],
        events=one.exploration.events,
    )


def annotated_push(result: DemoResult, one: DemoObject) -> UInt8[np.ndarray, "rows columns 3"] | None:
    """The camera's view at the largest force, with contours, contact and fitted shape (figure 3.10).

    Parameters
    ----------
    result
        Result with the sensor's setup.
    one
        The push.
    """
    from ..report.annotation import FrameNotes, annotated_frame, primitive_outline
    from ..report.run_tables import primitive_text

    if one.picture_bgr is None or one.strip is None:
        return None
    setup = result.sensor.setup
    plane = PlaneView(setup.camera, setup.T_camera_foam)
    strip = one.strip
    profile = max((p for p in one.exploration.profiles if p.valid), key=lambda p: p.force_N)
    # Where it is compressed: beside the object, the foam is only dragged along.
    pressed = [contact.delta_m > 0.1 * np.max(contact.delta_m) for contact in profile.contacts]
    contacts = [
        plane.project(contact.points_foam_m[inside])
        for contact, inside in zip(profile.contacts, pressed, strict=True)
        if np.count_nonzero(inside) > 1
    ]
    shapes = []
    best = one.exploration.fit.best if one.exploration.fit is not None else None
    if best is not None:
        shapes.append(plane.project(primitive_outline(best, reach_m=0.06)))
    return annotated_frame(
        one.picture_bgr,
        FrameNotes(
            reference_px=strip.reference_points_px,
            front_px=strip.front_points_px,
            front_valid=strip.usable | strip.low_confidence,
            contacts_px=contacts,
            primitives_px=shapes,
            lines=(
                f"{one.name}: {profile.force_N:.2f} N ± {profile.force_sigma_N:.2f} N",
                primitive_text(best) or "no primitive",
            ),
        ),
        split=False,
    )
