"""Output of scene readings: ROS 2 messages in an MCAP file, and rows of a table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core import Frame, Pose
from ...core.files import GrowingCsv, check_target
from ...io.ros import ros_messages as ros

if TYPE_CHECKING:
    from ...io.sinks.measurement_sink import MeasurementSink
    from .scene_tracker import SceneReading

SCENE_COLUMNS = (
    "t_s", "valid", "reason", "x_m", "y_m", "heading_rad", "x_sigma_m", "y_sigma_m", "heading_sigma_rad",
    "floor_valid", "floor_points", "object_valid", "object_reason", "object_angle_rad", "object_angle_sigma_rad",
    "object_tilt_rad", "object_shift_x_m", "object_shift_y_m", "object_points", "obstacle_valid", "proximity_m",
    "proximity_sigma_m", "proximity_remembered", "events",
)  # fmt: skip


def _values(reading: SceneReading) -> dict[str, Any]:
    moved, obstacle = reading.object_motion, reading.obstacle
    sigma = np.sqrt(np.diag(reading.pose_covariance))
    return {
        "t_s": float(reading.t_s),
        "valid": bool(reading.motion.valid),
        "reason": str(reading.motion.reason),
        **{name: float(v) for name, v in zip(SCENE_COLUMNS[3:6], reading.pose, strict=True)},
        **{name: float(v) for name, v in zip(SCENE_COLUMNS[6:9], sigma, strict=True)},
        "floor_valid": bool(reading.floor_motion.valid),
        "floor_points": int(reading.floor_points),
        "object_valid": bool(moved.valid),
        "object_reason": str(moved.reason),
        "object_angle_rad": float(reading.object_angle_rad),
        "object_angle_sigma_rad": moved.turn_sigma_rad if moved.valid else math.inf,
        "object_tilt_rad": float(moved.tilt_rad),
        "object_shift_x_m": float(moved.shift_m[0]),
        "object_shift_y_m": float(moved.shift_m[1]),
        "object_points": int(moved.points),
        "obstacle_valid": bool(obstacle.valid),
        "proximity_m": float(obstacle.proximity_m),
        "proximity_sigma_m": float(obstacle.proximity_sigma_m),
        "proximity_remembered": bool(obstacle.remembered),
        "events": " ".join(event.kind.value for event in reading.events),
    }


def write_scene(
    recording: MeasurementSink, reading: SceneReading, name: str = "scene", *, mask: bool = False
) -> None:
    """One reading as messages.

    ``/NAME/pose`` is a ``geometry_msgs/PoseWithCovarianceStamped`` of frame F since the start, in frame
    ``odom``; ``/NAME/diagnostics`` has all numbers with their validity and reason; with ``mask``
    ``/NAME_obstacles/image/compressed`` is the obstacle mask. Events are recorded by the caller.

    Parameters
    ----------
    recording
        Receives the messages.
    reading
        Scene of one frame.
    name
        First part of the topics.
    mask
        Also write the obstacle mask.
    """
    x, y, heading = (float(v) for v in reading.pose)
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = reading.pose_covariance
    pose = Pose.from_rotation_vector([0.0, 0.0, heading], [x, y, 0.0])
    recording.write_pose(pose, reading.t_s, f"/{name}/pose", frame="odom", covariance=covariance)
    values = _values(reading)
    message = ros.diagnostics(reading.t_s, "odom", name, values.pop("valid"), values.pop("reason"), values)
    recording.write(f"/{name}/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", reading.t_s, message)
    if mask:
        recording.write_frame(Frame(reading.mask, reading.t_s, 0), f"{name}_obstacles")


class SceneTable(GrowingCsv):
    """Writes readings to a CSV file, one row each, columns :data:`SCENE_COLUMNS`.

    Parameters
    ----------
    path
        Output CSV file.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__(check_target(path, (".csv",)), SCENE_COLUMNS)

    def write(self, reading: SceneReading) -> None:
        """Append one reading.

        Parameters
        ----------
        reading
            Scene of one frame.

        Raises
        ------
        InputError
            The disk is full: the rows so far stay in ``NAME.part``.
        """
        values = _values(reading)
        self.add(values[name] for name in SCENE_COLUMNS)
