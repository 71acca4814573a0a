"""Files of the scene tracking: its configuration ``scene.yaml``, and a table with the platform's odometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from ...core import BaseState, Camera, ForceProfile, Frame, InputError, Pose, load_yaml_model
from ...io.sinks.table_reader import read_columns
from ..config_fields import PoseSection, Positive, Section
from ..foam import FoamSensor, FoamSensorConfig, FoamSetup, ZeroReference
from .ego_motion import EgoMotionSettings
from .obstacle_parallax import ObstacleSettings
from .scene_regions import SceneSettings
from .scene_tracker import SceneReading, SceneTracker


class SceneStripSection(Section):
    """The foam as an occluder of the floor."""

    length_m: Positive = 0.25  #: along the robot
    front_m: Positive = 0.02  #: x of its front edge in frame F


class SceneConfig(Section):
    """Fields of ``scene.yaml``; file names are relative to its folder.

    Either ``sensor`` names the foam sensor's file: then its force is also read, and the touched object
    is tracked; or ``camera`` and ``T_camera_foam`` give the pose of frame F.
    """

    kind: Literal["scene"] = "scene"
    sensor: str | None = None  #: sensor.yaml of the foam, instead of camera and T_camera_foam
    camera: str | None = None  #: ROS camera_info
    T_camera_foam: PoseSection | None = None  #: maps the strip's frame F to the camera
    strip: SceneStripSection = SceneStripSection()  #: the foam as an occluder of the floor
    floor_below_m: Positive = 0.05  #: height of the foam's visible edge above the floor
    foam_ahead_m: Annotated[float, Field(ge=0, allow_inf_nan=False)] = (
        0.17  #: from the platform's centre to F
    )
    strip_rows_px: Annotated[int, Field(ge=8)] = 450  #: the image's upper rows are monitored for obstacles

    @model_validator(mode="after")
    def _one_source(self) -> SceneConfig:
        named = self.camera is not None and self.T_camera_foam is not None
        if (self.sensor is None) != named or (
            self.sensor is not None and (self.camera is not None or self.T_camera_foam is not None)
        ):
            raise ValueError("expected either sensor, or camera and T_camera_foam")
        return self

    @classmethod
    def load(cls, path: Path | str) -> SceneSetup:
        """Read the file and the files that it names.

        Parameters
        ----------
        path
            ``scene.yaml``.

        Raises
        ------
        InputError
            As of :meth:`.FoamSensorConfig.load`, also of a sensor that it names.
        """
        path = Path(path)
        config = load_yaml_model(path, cls)
        if config.sensor is not None:
            sensor = FoamSensorConfig.load(path.parent / config.sensor)
            return SceneSetup(config, sensor.camera, sensor.T_camera_foam, sensor)
        assert config.camera is not None
        assert config.T_camera_foam is not None
        try:
            pose = config.T_camera_foam.pose()
        except InputError as error:
            raise InputError(path, error.problem, field="T_camera_foam") from error
        return SceneSetup(config, Camera.load(path.parent / config.camera), pose, None)


@dataclass(frozen=True, slots=True)
class SceneSetup:
    """A validated configuration with the content of all files that it names."""

    config: SceneConfig
    camera: Camera
    T_camera_foam: Pose
    sensor: FoamSetup | None  #: of the foam, if its force is also read

    def tracker(self, rng: np.random.Generator | None = None) -> SceneTracker:
        """A tracker in its initial state.

        Parameters
        ----------
        rng
            Source of RANSAC's random samples; a fixed seed by default.
        """
        config = self.config
        settings = SceneSettings(
            ego=EgoMotionSettings(foam_ahead_m=config.foam_ahead_m),
            obstacles=ObstacleSettings(rows=config.strip_rows_px),
            front_m=config.strip.front_m,
            foam_half_m=0.5 * config.strip.length_m,
        )
        if self.sensor is not None:
            return SceneTracker.of_sensor(self.sensor, config.floor_below_m, settings, rng)
        return SceneTracker(self.camera, self.T_camera_foam, config.floor_below_m, settings, rng)


class SceneSensor:
    """The scene ahead as a sensor: reads the foam if there is one, and tracks its surroundings.

    Parameters
    ----------
    setup
        Result of :meth:`SceneConfig.load`.
    rng
        Source of RANSAC's random samples; a fixed seed by default.
    """

    def __init__(self, setup: SceneSetup, *, rng: np.random.Generator | None = None) -> None:
        self.setup, self._rng = setup, rng
        #: newest state of the platform at a time [s], as :meth:`Odometry.at`; without it the floor alone gives the motion
        self.odometry: Callable[[float], BaseState | None] | None = None
        self.foam = None if setup.sensor is None else FoamSensor.of_setup(setup.sensor)
        self.tracker = setup.tracker(rng)
        self.profile: ForceProfile | None = None  #: reading of the foam in the last frame

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """A sensor as described by ``scene.yaml``; its foam with the zero reference if there is one.

        Parameters
        ----------
        path
            The file; those that it names are relative to its folder.

        Raises
        ------
        InputError
            A file or field cannot be used.
        """
        return cls(SceneConfig.load(path))

    @property
    def camera(self) -> Camera:
        """Camera model of the frames that it reads."""
        return self.setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether its foam has a zero reference; True without foam, as only foam needs one."""
        return self.foam is None or self.foam.zeroed

    def zero(self, frames: Iterable[Frame]) -> ZeroReference | None:
        """Take the zero reference of the foam; without foam, None is returned and no frame is read.

        Parameters
        ----------
        frames
            Frames of an unloaded strip.

        Raises
        ------
        CalibrationError
            The contours were not found, or the strip moved during zeroing.
        """
        return None if self.foam is None else self.foam.zero(frames)

    def read(self, frame: Frame) -> SceneReading:
        """Motion, obstacles and the touched object in one frame.

        Parameters
        ----------
        frame
            The next frame in time order.
        """
        self.profile = None if self.foam is None else self.foam.read(frame)
        state = None if self.odometry is None else self.odometry(frame.t_s)
        return self.tracker.update(frame, self.profile, state)

    def reset(self) -> None:
        """Reset the state of all frames; the zero reference is kept."""
        if self.foam is not None:
            self.foam.reset()
        self.tracker, self.profile = self.setup.tracker(self._rng), None

    def close(self) -> None:
        """Nothing to release: the scene has no threads."""


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Odometry of the platform over time, N rows in time order."""

    t_s: Float[np.ndarray, "N"]
    speed_m_s: Float[np.ndarray, "N"]
    turn_rate_rad_s: Float[np.ndarray, "N"]
    max_gap_s: float = 0.25  #: maximum time to the adjacent rows; beyond it there is no odometry

    def at(self, t_s: float) -> BaseState | None:
        """State at a time, interpolated linearly between two rows; None outside the recorded time.

        Parameters
        ----------
        t_s
            Time [s].
        """
        after = int(np.searchsorted(self.t_s, t_s))
        near = [self.t_s[k] for k in (after - 1, after) if 0 <= k < len(self.t_s)]
        if not near or min(abs(t - t_s) for t in near) > self.max_gap_s:
            return None
        if len(near) == 2 and near[1] - near[0] > 2.0 * self.max_gap_s:
            return None
        speed = float(np.interp(t_s, self.t_s, self.speed_m_s))
        turn = float(np.interp(t_s, self.t_s, self.turn_rate_rad_s))
        # The position is unknown here, and not needed: velocities are fused.
        return BaseState(t_s, math.nan, math.nan, math.nan, speed, turn)


def read_odometry(path: Path | str) -> Odometry:
    """Read a CSV with columns t_s, speed_m_s, turn_rate_rad_s; others are ignored.

    Parameters
    ----------
    path
        CSV file, a row for each time.

    Raises
    ------
    InputError
        States the location of the first invalid field.
    """
    path, names = Path(path), ("t_s", "speed_m_s", "turn_rate_rad_s")
    columns = read_columns(path, names)
    values = np.array([columns[name] for name in names], dtype=np.float64)
    if not values.size:
        raise InputError(path, "has no rows, expected at least one")
    row, column = np.nonzero(~np.isfinite(values.T))
    if len(row):
        raise InputError(
            path, "found no finite number, expected one", field=f"line {row[0] + 2}, {names[column[0]]}"
        )
    late = np.flatnonzero(np.diff(values[0]) <= 0)
    if len(late):
        raise InputError(
            path,
            f"found {values[0, late[0] + 1]:g} s after {values[0, late[0]]:g} s, expected times that increase",
            field=f"line {int(late[0]) + 3}, t_s",
        )
    return Odometry(*values)
