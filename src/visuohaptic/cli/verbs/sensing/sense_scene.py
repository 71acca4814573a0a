"""``visuohaptic sense scene``: what else the foam's camera sees."""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....core.errors import InputError
from ..._frames import add_part, opened_frames

if TYPE_CHECKING:
    from ....core.robots import FrameSource
    from ....sensing.foam.sensor import FoamSensor
    from ....sensing.scene.scene_file import SceneSetup

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "track obstacles ahead, the floor that passes and the object that is pushed"

EPILOG = """\
reads
  --config    scene.yaml: camera, its pose, height above the floor (docs: Scene); with a field sensor the
              foam's force is read, too, and the object that it touches is tracked
  --source    a video file, a folder of images, recording.mcap[:/topic], or a live camera (camera:0)
  --odometry  t_s, speed_m_s, turn_rate_rad_s of the platform, CSV; fused with what the floor tells
writes
  --out       run.mcap with the platform's pose and covariance (geometry_msgs/PoseWithCovarianceStamped),
              diagnostics with all numbers, falls and slips, and with --mask the obstacle mask; with a
              sensor its geometry_msgs/WrenchStamped, too
  --csv       t_s, valid, reason, x_m, y_m, heading_rad and their sigmas, object turn, tilt and shift,
              proximity_m, events; a row a frame

examples
  visuohaptic sense scene --config scene.yaml --source drive.mp4 --csv scene.csv
  visuohaptic sense scene --config scene.yaml --source push.mp4 --odometry wheels.csv --out run.mcap
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--config", required=True, type=Path, help="scene.yaml")
    parser.add_argument("--source", required=True, help="where the frames come from")
    parser.add_argument("--odometry", type=Path, metavar="CSV", help="speed and turn rate of the platform")
    parser.add_argument("--out", type=Path, help="MCAP recording to write")
    parser.add_argument("--csv", type=Path, help="table to write")
    parser.add_argument("--mask", action="store_true", help="write the obstacle mask to --out, too")
    parser.add_argument(
        "--zero-frames",
        type=int,
        default=0,
        metavar="N",
        help="zero the foam sensor on the first N frames, then measure (nothing is stored)",
    )
    add_part(parser)
    parser.add_argument("--seed", type=int, default=0, help="of the consensus search (0)")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....sensing.scene.scene_file import SceneConfig

    if args.zero_frames < 0:
        raise InputError("--zero-frames", f"found {args.zero_frames}, expected 0 or more")
    setup = SceneConfig.load(args.config)
    with opened_frames(args, setup.camera) as source:
        return _track(args, setup, source)


def _sensor(args: Any, setup: SceneSetup) -> FoamSensor | None:
    """The foam sensor that the configuration names, with its zero reference if it has one."""
    if setup.sensor is None:
        if args.zero_frames:
            raise InputError(
                "--zero-frames", f"found {args.zero_frames}, but {args.config} names no sensor to zero"
            )
        return None
    from ....sensing.foam.sensor import FoamSensor
    from ....sensing.foam.strip.zero import ZeroReference

    zero = None
    if setup.sensor.zero_path.exists():
        zero = ZeroReference.load(setup.sensor.zero_path, len(setup.sensor.geometry.s_m))
    elif not args.zero_frames:
        raise InputError(
            setup.sensor.zero_path,
            "there is no zero reference",
            remedy="take one first (visuohaptic sense foam ... --zero) or give --zero-frames N",
        )
    return FoamSensor(setup.sensor, zero)


def _track(args: Any, setup: SceneSetup, source: FrameSource) -> dict[str, Any]:
    import numpy as np

    from ....io.sinks.mcap_out import MeasurementWriter
    from ....sensing.scene.scene_file import read_odometry
    from ....sensing.scene.scene_record import SceneTable, write_scene

    odometry = read_odometry(args.odometry) if args.odometry else None
    sensor = _sensor(args, setup)
    tracker = setup.tracker(np.random.default_rng(args.seed))
    frames = iter(args.progress(source, "tracking"))
    if sensor is not None and args.zero_frames:
        sensor.zero(frame for _, frame in zip(range(args.zero_frames), frames, strict=False))
    reasons: Counter[str] = Counter()
    found: list[dict[str, Any]] = []
    nearest, tracked, tilt = float("inf"), 0, 0.0
    reading = None
    with ExitStack() as stack:
        recording = stack.enter_context(MeasurementWriter(args.out)) if args.out else None
        table = stack.enter_context(SceneTable(args.csv)) if args.csv else None
        for frame in frames:
            profile = sensor.read(frame) if sensor is not None else None
            state = odometry.at(frame.t_s) if odometry is not None else None
            if recording is not None and reading is None:
                recording.write_camera(setup.camera, frame.t_s)
            reading = tracker.update(frame, profile, state)
            reasons[reading.motion.reason.value] += 1
            if reading.obstacle.valid:
                nearest = min(nearest, reading.proximity_m)
            if reading.object_motion.valid:
                tracked += 1
                tilt = max(tilt, reading.object_motion.tilt_rad)
            if recording is not None:
                write_scene(recording, reading, mask=args.mask)
                if profile is not None:
                    recording.write_force(profile)
            if table is not None:
                table.write(reading)
            for event in reading.events:
                args.report(f"{event.t_s:10.3f} s  {event.kind.value}")
                found.append({"t_s": event.t_s, "event": event.kind.value})
                if recording is not None:
                    recording.write_event(event, "scene")
    if reading is None:
        raise InputError(args.source, "no frames are left to track", remedy="check --start, --stop")
    count, (x, y, heading) = sum(reasons.values()), reading.pose
    sigma = np.sqrt(np.diag(reading.pose_covariance))
    args.report(
        f"{count} frames, motion of {reasons.get('ok', 0)} valid"
        + "".join(f", {number} {reason}" for reason, number in reasons.items() if reason != "ok")
    )
    args.report(
        f"drove to x {x:.4f} m +- {sigma[0]:.4f} m, y {y:.4f} m +- {sigma[1]:.4f} m, "
        f"heading {np.degrees(heading):.2f} deg +- {np.degrees(sigma[2]):.2f} deg"
    )
    args.report(f"nearest obstacle {1e3 * nearest:.0f} mm ahead" if np.isfinite(nearest) else "nothing ahead")
    if sensor is not None:
        args.report(f"object tracked in {tracked} frames, largest tilt {np.degrees(tilt):.1f} deg")
    return {
        "frames": count,
        "reasons": dict(reasons),
        "pose": {"x_m": float(x), "y_m": float(y), "heading_rad": float(heading)},
        "pose_sigma": {"x_m": float(sigma[0]), "y_m": float(sigma[1]), "heading_rad": float(sigma[2])},
        "nearest_m": nearest if np.isfinite(nearest) else None,
        "object_frames": tracked,
        "events": found,
        "out": [str(path) for path in (args.out, args.csv) if path],
    }
