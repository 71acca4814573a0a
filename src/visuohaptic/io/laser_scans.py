"""Laser scans with odometry: from MCAP, and from and to CSV.

CSV: one line per scan with the columns ``t_s, x_m, y_m, yaw_rad, angle_min_rad,
angle_step_rad, range_min_m, range_max_m``, followed by the ranges ``r0, r1, ...``
[m]; ``inf`` means no return within range, an empty field no measurement.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import InputError, Pose, compose_2d
from ..core.files import CsvRow, read_csv, write_csv
from ..core.laser_scan import MAX_BEAMS, LaserScan
from ..core.ranges import SECONDS, check_numbers
from .ros.ros_messages import stamp_s
from .ros.sqlite_bag import is_bag, open_bag

#: A scan, and the scanner's pose (x, y, yaw) from odometry [m, rad].
OdometryScan = tuple[LaserScan, tuple[float, float, float]]

_COLUMNS = ("t_s", "x_m", "y_m", "yaw_rad", "angle_min_rad", "angle_step_rad", "range_min_m", "range_max_m")
_SCAN, _ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
#: A scanner whose axis is tilted further does not measure a horizontal plane: cosine of 5 degrees.
_UPRIGHT = math.cos(math.radians(5.0))
_log = logging.getLogger(__name__)
#: Maximum time between a scan and the nearest odometry message [s]; between two messages, their usual interval if that is longer.
_SLACK_S = 0.25


def read_scans(
    path: Path | str, *, scan_topic: str | None = None, odometry_topic: str | None = None
) -> list[OdometryScan]:
    """Read scans with their odometry, sorted by time.

    From an MCAP file, the ``sensor_msgs/LaserScan`` and ``nav_msgs/Odometry``
    messages are used, with odometry interpolated at the scans' timestamps.
    The scanner's pose on the robot is that of ``/tf_static``, also upside down; without it the scanner
    is assumed at the origin of the odometry's body frame, with a warning.

    Parameters
    ----------
    path
        CSV or MCAP file.
    scan_topic, odometry_topic
        Topics of an MCAP file; may be omitted if there is only one of their type.

    Raises
    ------
    InputError
        Messages or columns are missing, or a value is invalid, with its location; or the scanner is not
        horizontal.
    """
    path = Path(path)
    if path.suffix == ".mcap" or is_bag(path):
        found = _from_mcap(path, scan_topic, odometry_topic)
    elif path.suffix == ".csv":
        found = _from_csv(path)
    else:
        raise InputError(path, f"found {path.suffix!r}, expected .mcap, .db3 or .csv")
    scans = [scan for scan, _ in found]
    far = np.concatenate([scan.ranges_m[np.isfinite(scan.ranges_m)] for scan in scans] or [np.zeros(0)])
    if far.size and not any(scan.hits.any() for scan in scans):
        # All of them would be free space up to the scanner's limit.
        raise InputError(
            path,
            f"its ranges of {far.min():.4g} to {far.max():.4g} m are all outside of the scanner's limits, "
            f"{scans[0].range_min_m:g} to {scans[0].range_max_m:g} m",
            remedy="give them in metres",
        )
    return found


def write_scans(path: Path | str, scans: Iterable[OdometryScan]) -> None:
    """Write scans to a CSV file, atomically.

    Parameters
    ----------
    path
        File that is created or replaced.
    scans
        Scans to write.
    """
    rows = []
    for scan, (x, y, yaw) in scans:
        head = (scan.t_s, x, y, yaw, scan.angle_min_rad, scan.angle_step_rad, scan.range_min_m)
        ranges = ["" if math.isnan(r) else repr(float(r)) for r in scan.ranges_m]
        rows.append([*(repr(float(v)) for v in (*head, scan.range_max_m)), *ranges])
    beams = max((len(row) - len(_COLUMNS) for row in rows), default=0)
    columns = [*_COLUMNS, *(f"r{number}" for number in range(beams))]
    write_csv(path, columns, (row + [""] * (len(columns) - len(row)) for row in rows))


def _from_csv(path: Path) -> list[OdometryScan]:
    names, rows = read_csv(path, (*_COLUMNS, "r0"))
    beams = [name for name in names if name not in _COLUMNS]
    if beams != [f"r{k}" for k in range(len(beams))]:
        raise InputError(path, "expected the ranges as columns r0, r1, ... in this order", field="header")
    if len(beams) > MAX_BEAMS:
        raise InputError(path, f"found {len(beams)} beams, expected at most {MAX_BEAMS}", field="header")
    return sorted((_csv_row(row, beams) for row in rows), key=lambda pair: pair[0].t_s)


def _csv_row(row: CsvRow, beams: Sequence[str]) -> OdometryScan:
    t_s, x, y, yaw, first, step, low, high = (row.number(name) for name in _COLUMNS)
    try:
        ranges = np.array([float(row[name] or "nan") for name in beams])
    except ValueError as error:
        raise row.problem(f"has a range that is not a number ({error})") from error
    if (ranges < 0).any():
        raise row.problem("found a distance below 0")
    check_numbers(f"{row.path}: line {row.line}", SECONDS, t_s=t_s)
    try:
        return LaserScan(t_s, ranges, first, step, low, high), (x, y, yaw)
    except InputError as error:
        raise row.problem(error.problem) from error


def _from_mcap(path: Path, scan_topic: str | None, odometry_topic: str | None) -> list[OdometryScan]:
    file = open_bag(path)
    scans: list[LaserScan] = []
    times: list[float] = []
    poses: list[tuple[float, float, float]] = []
    topics: dict[str, set[str]] = {_SCAN: set(), _ODOMETRY: set()}
    requested = {_SCAN: scan_topic, _ODOMETRY: odometry_topic}
    mounted: dict[str, tuple[str, Pose]] = {}
    scanner = body = ""
    for message in file.messages():
        if message.datatype == _TRANSFORMS and message.topic.endswith("tf_static"):
            mounted |= _transforms(file.decode(message), f"{path}:{message.topic}")
        if message.datatype not in topics or requested[message.datatype] not in (None, message.topic):
            continue
        topics[message.datatype].add(message.topic)
        if len(topics[message.datatype]) > 1:
            named = ", ".join(sorted(topics[message.datatype]))
            raise InputError(path, f"has {message.datatype} on {named}", remedy="name one topic")
        decoded = file.decode(message)
        if message.datatype == _SCAN:
            scans.append(_scan(decoded, stamp_s(decoded, message.log_time_ns), f"{path}:{message.topic}"))
            scanner = decoded.header.frame_id.strip("/")
        else:
            times.append(stamp_s(decoded, message.log_time_ns))
            poses.append(_planar(decoded.pose.pose, f"{path}:{message.topic}"))
            body = decoded.child_frame_id.strip("/")
    for kind, found in ((_SCAN, scans), (_ODOMETRY, poses)):
        if not found:
            where = f" on {requested[kind]}" if requested[kind] else ""
            raise InputError(path, f"has no {kind}{where}")
    joined = _joined(path, scans, np.array(times), np.array(poses))
    (root, T_root_scanner), (body_root, T_root_body) = (_to_root(name, mounted) for name in (scanner, body))
    if root == body_root:
        return _from_scanner(path, joined, T_root_body.inverse() @ T_root_scanner)
    _log.warning(
        "%s: where %r is on %r is not recorded (/tf_static): the scanner is taken as its origin",
        path, scanner, body,
    )  # fmt: skip
    return joined


def _transforms(message: Any, where: str) -> dict[str, tuple[str, Pose]]:
    """Parent and pose in it, by frame."""
    found = {}
    for one in message.transforms:
        q, t = one.transform.rotation, one.transform.translation
        try:
            pose = Pose.from_quaternion([q.x, q.y, q.z, q.w], [t.x, t.y, t.z])
        except InputError as error:
            raise InputError(where, f"{one.child_frame_id}: {error.problem}") from error
        found[one.child_frame_id.strip("/")] = (one.header.frame_id.strip("/"), pose)
    return found


def _to_root(frame: str, mounted: dict[str, tuple[str, Pose]]) -> tuple[str, Pose]:
    """The frame without a parent, and the pose of the given one in it."""
    pose = Pose.identity()
    for _ in range(len(mounted)):  # a circle ends, too
        if frame not in mounted:
            break
        frame, own = mounted[frame]
        pose = own @ pose
    return frame, pose


def _from_scanner(path: Path, scans: list[OdometryScan], T_body_scanner: Pose) -> list[OdometryScan]:
    """Poses of the scanner instead of the body; upside down, its beams turn the other way."""
    rotation, place = T_body_scanner.rotation, T_body_scanner.translation_m
    if abs(rotation[2, 2]) < _UPRIGHT:
        tilt = math.degrees(math.acos(abs(rotation[2, 2])))
        raise InputError(path, f"its scanner is tilted by {tilt:.0f} degrees, expected a horizontal one")
    mounted = (float(place[0]), float(place[1]), math.atan2(rotation[1, 0], rotation[0, 0]))
    side = math.copysign(1.0, rotation[2, 2])
    return [
        (
            replace(scan, angle_min_rad=side * scan.angle_min_rad, angle_step_rad=side * scan.angle_step_rad),
            compose_2d(pose, mounted),
        )
        for scan, pose in scans
    ]


def _scan(message: Any, t_s: float, where: str) -> LaserScan:
    ranges = np.array(message.ranges, dtype=np.float64)
    if not 1 <= len(ranges) <= MAX_BEAMS:
        raise InputError(where, f"found {len(ranges)} beams, expected 1 to {MAX_BEAMS}", field="ranges")
    # By ROS convention, a range outside the scanner's limits is not a measurement; beyond them there is free space.
    with np.errstate(invalid="ignore"):
        ranges[ranges < message.range_min] = np.nan
    try:
        return LaserScan(
            t_s,
            ranges,
            float(message.angle_min),
            float(message.angle_increment),
            float(message.range_min),
            float(message.range_max),
        )
    except InputError as error:
        raise InputError(where, error.problem) from error


def _planar(pose: Any, where: str) -> tuple[float, float, float]:
    q = pose.orientation
    try:
        rotation = Pose.from_quaternion([q.x, q.y, q.z, q.w], np.zeros(3)).rotation
    except InputError as error:
        raise InputError(where, error.problem, field="pose") from error
    found = (float(pose.position.x), float(pose.position.y), math.atan2(rotation[1, 0], rotation[0, 0]))
    if not np.isfinite(found).all():
        raise InputError(where, f"found {found}, expected finite x, y and yaw", field="pose")
    return found


def _joined(
    path: Path, scans: list[LaserScan], times_s: Float[np.ndarray, "m"], poses: Float[np.ndarray, "m 3"]
) -> list[OdometryScan]:
    order = np.argsort(times_s, kind="stable")
    times_s, poses = times_s[order], poses[order]
    yaw = np.unwrap(poses[:, 2])
    # Where messages are lost, the robot may have driven and turned in any way between two of them.
    slack_s = max(_SLACK_S, float(np.median(np.diff(times_s)))) if len(times_s) > 1 else _SLACK_S
    scans = sorted(scans, key=lambda scan: scan.t_s)
    at_s = np.array([scan.t_s for scan in scans])
    after = np.searchsorted(times_s, at_s)
    offset_s = np.minimum(
        np.abs(at_s - times_s[after.clip(1) - 1]), np.abs(at_s - times_s[after.clip(max=len(times_s) - 1)])
    )
    outside_s = np.maximum(times_s[0] - at_s, at_s - times_s[-1])
    track = np.column_stack([np.interp(at_s, times_s, v) for v in (poses[:, 0], poses[:, 1], yaw)])
    known = (offset_s <= slack_s) & (outside_s <= _SLACK_S)
    pairs = [
        (scans[k], (x, y, angle))
        for k, (x, y, angle) in zip(np.flatnonzero(known), track[known].tolist(), strict=True)
    ]
    if 0 < len(pairs) < len(scans):
        _log.warning(
            "%s: %d of %d scans have no odometry and are left out", path, len(scans) - len(pairs), len(scans)
        )
    if not pairs:
        raise InputError(
            path,
            f"has scans from {scans[0].t_s:.2f} s and odometry from {times_s[0]:.2f} to {times_s[-1]:.2f} s, "
            "expected them at the same time",
        )
    return pairs
