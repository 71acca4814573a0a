"""Poses of a moving camera: TUM text, 4 x 4 matrices as text, or MCAP."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import InputError, Pose, read_head, read_text, write_text
from ...core.ranges import SECONDS, check_numbers
from ..ros.ros_messages import stamp_s
from ..ros.sqlite_bag import is_bag, open_bag

POSE_HEADER = "# t_s tx_m ty_m tz_m qx qy qz qw, camera to world\n"

#: Matrices that deviate less from a rotation are rounded text, and are orthonormalised.
_ROUNDING = 1e-3
#: A comment that names the columns with the real part of the quaternion first, as EuRoC's tables do.
_W_FIRST = re.compile(r"^\s*#.*\bq_?w\b.*\bq_?x\b", re.MULTILINE | re.IGNORECASE)
#: Messages that contain a pose.
POSE_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)


@dataclass(frozen=True, slots=True)
class StampedPose:
    """A pose as read from a file; an unusable one has a reason."""

    t_s: float  #: time [s]; NaN if the file has none
    pose: Pose | None  #: ``T_world_camera``
    problem: str = ""  #: why there is no pose


@dataclass(frozen=True, slots=True)
class EstimatedPose:
    """A pose that was estimated from images."""

    pose: Pose | None  #: camera to world; ``None`` if it could not be estimated
    sigma_m: float = float("nan")  #: standard deviation of the camera's centre, rms of its axes [m]
    sigma_rad: float = float("nan")  #: standard deviation of the rotation, rms of its axes [rad]
    problem: str = ""  #: why there is no pose


def read_poses(path: Path | str, topic: str | None = None) -> list[StampedPose]:
    """Camera-to-world poses of a file, in file order.

    Lines with eight numbers are TUM (``t tx ty tz qx qy qz qw``); 16 or 12 are a
    row-major matrix; 17 are the same after an index; four are one row of a matrix
    (Redwood's logs, with a header of three numbers, are such files). ``#``
    starts a comment; one that names ``qw`` before ``qx`` gives the order of the quaternions. An MCAP file supplies its stamped poses, transforms or
    odometry. A line with non-finite numbers or without a valid rigid transformation is kept
    with its problem, so that the order of the others is preserved.

    Parameters
    ----------
    path
        The file.
    topic
        Topic of an MCAP file; may be omitted if only one contains poses.

    Raises
    ------
    InputError
        The file is missing, has another format, or contains no poses.
    """
    path = Path(path)
    if is_bag(path) or read_head(path, 8) == b"\x89MCAP0\r\n":
        return _from_mcap(path, topic)
    w_first = _W_FIRST.search(read_text(path)) is not None
    found = list(poses_of_rows(path, number_rows(path), w_first=w_first))
    if not found:
        raise InputError(path, "has no poses, expected lines of t tx ty tz qx qy qz qw")
    times = [stamped.t_s for stamped in found if np.isfinite(stamped.t_s)]
    check_numbers(path, SECONDS, **{"time [s]": max(times, default=0.0)})
    return found


def number_rows(path: Path) -> Iterator[tuple[int, list[float]]]:
    """Number of the line and values of each line of a text of numbers; ``#`` starts a comment.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        The file is missing, or contains other words.
    """
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            yield number, [float(word) for word in words]
        except ValueError as error:
            raise InputError(
                path, f"found {line[:60]!r}, expected numbers", field=f"line {number}"
            ) from error


def poses_of_rows(
    path: Path, rows: Iterator[tuple[int, list[float]]], *, w_first: bool = False
) -> Iterator[StampedPose]:
    """Poses of a text of numbers, as :func:`read_poses` describes them.

    Parameters
    ----------
    path
        The file, for messages.
    rows
        Number and values of each line.
    w_first
        Whether the real part of a quaternion is its first number.

    Raises
    ------
    InputError
        A line has another number of values.
    """
    for number, row in rows:
        where = f"line {number}"
        if len(row) == 8:
            yield _tum([*row[:4], *row[5:], row[4]] if w_first else row, where)
        elif len(row) in (12, 16, 17):
            numbers = row[1:] if len(row) == 17 else row
            yield stamped_matrix(np.array(numbers).reshape(-1, 4), where)
        elif len(row) == 4:
            block = [row]
            for _ in range(3):
                more = next(rows, (number, []))[1]
                if len(more) != 4:
                    raise InputError(path, "has an incomplete 4 x 4 matrix", field=where)
                block.append(more)
            yield stamped_matrix(np.array(block), where)
        elif len(row) != 3:
            raise InputError(
                path, f"found {len(row)} numbers, expected 8 (TUM), 4, 12 or 16 (matrix)", field=where
            )


def _tum(row: Sequence[float], where: str) -> StampedPose:
    time_s, position, quaternion = row[0], row[1:4], np.array(row[4:])
    if not np.isfinite(row).all():
        return StampedPose(time_s, None, f"{where} is not finite")
    if not abs(np.linalg.norm(quaternion) - 1.0) < 0.01:
        return StampedPose(
            time_s, None, f"{where} has a quaternion of length {np.linalg.norm(quaternion):.3g}"
        )
    return StampedPose(time_s, Pose.from_quaternion(quaternion, position))


def stamped_matrix(matrix: Float[np.ndarray, "rows 4"], where: str) -> StampedPose:
    """Pose of a matrix with three or four rows; without pose if it is not a rigid transformation.

    Parameters
    ----------
    matrix
        Rotation and translation [m] of the camera, (3, 4) or (4, 4).
    where
        Name of the matrix, for the reason.
    """
    if not np.isfinite(matrix).all():
        return StampedPose(np.nan, None, f"{where} is not finite")
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        return StampedPose(np.nan, None, f"{where} is not a rigid motion: its last row is not 0 0 0 1")
    rotation = matrix[:3, :3]
    left, _, right = np.linalg.svd(rotation)
    nearest = left @ right
    if np.abs(nearest - rotation).max() > _ROUNDING or np.linalg.det(nearest) < 0:
        return StampedPose(np.nan, None, f"{where} is not a rigid motion: its rotation is not orthonormal")
    return StampedPose(np.nan, Pose(nearest, matrix[:3, 3]))


def _from_mcap(path: Path, topic: str | None) -> list[StampedPose]:
    file = open_bag(path)
    found: list[StampedPose] = []
    topics: set[str] = set()
    for message in file.messages({topic} if topic else None):
        if message.datatype not in POSE_TYPES:
            continue
        topics.add(message.topic)
        if len(topics) > 1:
            raise InputError(path, f"has poses on {', '.join(sorted(topics))}", remedy="name one topic")
        found.append(stamped_message(file.decode(message), message.datatype, message.log_time_ns))
    if not found:
        raise InputError(path, f"has no poses on {topic or 'any topic'}, expected {POSE_TYPES[0]}")
    return sorted(found, key=lambda stamped: stamped.t_s)


def stamped_message(message: Any, datatype: str, log_time_ns: int) -> StampedPose:
    """Pose of a stamped pose, transform or odometry message.

    Parameters
    ----------
    message
        Decoded message, of one of :data:`POSE_TYPES`.
    datatype
        ROS 2 name of its type.
    log_time_ns
        Recording time, for messages without a stamp [ns].
    """
    time_s = stamp_s(message, log_time_ns)
    if datatype.endswith("TransformStamped"):
        position, turn = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose if datatype.endswith("/PoseStamped") else message.pose.pose
        position, turn = pose.position, pose.orientation
    row = [time_s, position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w]
    return _tum([float(value) for value in row], f"the message at {time_s:.3f} s")


def interpolate_pose(
    poses: Sequence[StampedPose], t_s: float, *, max_gap_s: float = 0.1
) -> tuple[Pose | None, str]:
    """Pose at a given time, interpolated between the adjacent usable poses, or the reason why there is none.

    Parameters
    ----------
    poses
        In temporal order.
    t_s
        The time, on the clock of the poses [s].
    max_gap_s
        Maximum interval between poses for interpolation; a pose within the rounding of the
        time (1 ms) is used directly.

    Returns
    -------
    pose
        Pose at that time; ``None`` if unavailable.
    problem
        Why there is no pose; otherwise empty.
    """
    times = np.array([stamped.t_s if stamped.pose else np.nan for stamped in poses])
    usable = np.flatnonzero(np.isfinite(times))
    if not len(usable):
        return None, "there is no pose"
    near = usable[np.argmin(np.abs(times[usable] - t_s))]
    if abs(times[near] - t_s) <= 1e-3:
        return poses[near].pose, ""
    after = int(np.searchsorted(times[usable], t_s))
    if after in (0, len(usable)) or times[usable[after]] - times[usable[after - 1]] > max_gap_s:
        return None, f"no pose within {max_gap_s} s of {t_s:.3f} s"
    first, second = poses[usable[after - 1]], poses[usable[after]]
    assert first.pose is not None
    assert second.pose is not None
    return first.pose.interpolated(second.pose, (t_s - first.t_s) / (second.t_s - first.t_s)), ""


def write_poses(path: Path | str, poses: Iterable[tuple[float, Pose]]) -> None:
    """Write poses as TUM text: ``t tx ty tz qx qy qz qw``, camera to world.

    Parameters
    ----------
    path
        File that is created or replaced.
    poses
        Time [s] and camera-to-world pose of each view.
    """
    write_text(path, POSE_HEADER + "".join(pose_line(time_s, pose) for time_s, pose in poses))


def pose_line(time_s: float, pose: Pose | None) -> str:
    """One line of TUM text, with line ending.

    Parameters
    ----------
    time_s
        Time [s].
    pose
        Camera to world; NaN if there is none.
    """
    numbers = [np.nan] * 7 if pose is None else [*pose.translation_m, *pose.quaternion_xyzw]
    return f"{time_s:.6f} " + " ".join(f"{number:.9g}" for number in numbers) + "\n"
