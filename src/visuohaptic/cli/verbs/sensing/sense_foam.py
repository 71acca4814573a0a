"""``visuohaptic sense foam``: from frames to force."""

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
    from ....io.sinks.mcap_out import MeasurementWriter
    from ....io.sinks.tables import TableWriter
    from ....sensing.foam.finger import FingerSensor
    from ....sensing.foam.sensor import FoamSensor
    from ....viewer.page import LivePage

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "read force and shape of a foam strip from camera frames"

EPILOG = """\
reads
  --config   sensor.yaml: camera, foam, pose and shape of the strip (docs: Build a foam sensor)
  --source   a video file, a folder of images, recording.mcap[:/topic], or a live camera (camera:0)
writes
  --out      run.mcap with geometry_msgs/WrenchStamped, the contact contour and diagnostics; with a
             section finger in sensor.yaml also the finger's pose, geometry_msgs/PoseWithCovarianceStamped
  --csv      t_s, valid, reason, force_N, force_sigma_N, contacts and the error budget, a row a frame
  --parquet  the same, with the profiles along the strip
  --zero     the zero reference that sensor.yaml names, from frames of a strip that nothing touches

examples
  visuohaptic sense foam --config sensor.yaml --source rest.mp4 --zero
  visuohaptic sense foam --config sensor.yaml --source push.mp4 --out run.mcap --csv run.csv
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--config", required=True, type=Path, help="sensor.yaml")
    parser.add_argument("--source", required=True, help="where the frames come from")
    parser.add_argument("--out", type=Path, help="MCAP recording to write")
    parser.add_argument("--csv", type=Path, help="table to write")
    parser.add_argument("--parquet", type=Path, help="table with profiles to write")
    parser.add_argument("--zero", action="store_true", help="take and store the zero reference, then stop")
    parser.add_argument(
        "--zero-frames",
        type=int,
        default=0,
        metavar="N",
        help="zero on the first N frames of the source, then measure (nothing is stored)",
    )
    add_part(parser)
    parser.add_argument(
        "--speed",
        type=float,
        metavar="M/S",
        help="how fast the platform drives; the event 'motion' (the object gives way) needs it",
    )
    parser.add_argument("--view", action="store_true", help="show it live on a page of this machine")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....sensing.foam.finger import load_foam_sensor

    if args.zero_frames < 0:
        raise InputError("--zero-frames", f"found {args.zero_frames}, expected 0 or more")
    sensor = load_foam_sensor(args.config)
    with opened_frames(args, sensor.setup.camera) as source:
        if args.zero:
            return _zero(args, sensor, source)
        return _measure(args, sensor, source)


def _zero(args: Any, sensor: FoamSensor, source: FrameSource) -> dict[str, Any]:
    zero = sensor.zero(args.progress(source, "zeroing"))
    zero.save(sensor.setup.zero_path)
    args.report(
        f"zero reference from {zero.frames} frames written to {sensor.setup.zero_path}: "
        f"width {1e3 * zero.width_m.mean():.3f} mm, "
        f"noise of a point {1e6 * float(zero.width_sigma_m.mean()) * zero.frames**0.5:.0f} um per frame"
    )
    return {
        "zero": str(sensor.setup.zero_path),
        "frames": zero.frames,
        "width_m": float(zero.width_m.mean()),
        "width_sigma_m": float(zero.width_sigma_m.mean()),
    }


def _measure(args: Any, sensor: FoamSensor, source: FrameSource) -> dict[str, Any]:
    from ....core.measurement import EventKind
    from ....io.sinks.mcap_out import MeasurementWriter
    from ....io.sinks.tables import TableWriter
    from ....sensing.foam.finger import FingerSensor
    from ....sensing.push.events import ContactEvents

    frames = iter(args.progress(source, "measuring"))
    if args.zero_frames:
        sensor.zero((frame for _, frame in zip(range(args.zero_frames), frames, strict=False)))
    elif sensor.zero_reference is None:
        raise InputError(
            sensor.setup.zero_path,
            "there is no zero reference",
            remedy="take one first (visuohaptic sense foam ... --zero) or give --zero-frames N",
        )
    events = ContactEvents()
    reasons: Counter[str] = Counter()
    found: list[dict[str, Any]] = []
    best: tuple[float, float, float] | None = None
    finger = sensor if isinstance(sensor, FingerSensor) else None
    positions: list[float] = []
    with ExitStack() as stack:
        recording = stack.enter_context(MeasurementWriter(args.out)) if args.out else None
        writers: list[TableWriter] = [
            stack.enter_context(TableWriter(path)) for path in (args.csv, args.parquet) if path
        ]
        page: LivePage | None = None
        if args.view:
            from ....viewer.page import LivePage

            page = stack.enter_context(LivePage())
            args.report(f"live page: {page.url}")
            page.show()
        described = False
        for frame in frames:
            profile = sensor.read(frame)
            reasons[profile.reason.value] += 1
            if recording is not None:
                if not described:
                    recording.write_camera(sensor.setup.camera, frame.t_s)
                    described = True
                recording.write_force(profile)
                if finger is not None and finger.finger.valid:
                    _write_finger(recording, finger)
            if finger is not None and finger.finger.valid:
                positions.append(finger.finger.position_m)
            for writer in writers:
                writer.write(profile)
            for event in events.update(profile, speed_m_s=args.speed):
                # A front that stands still says nothing of the object unless the platform goes on.
                if event.kind is EventKind.MOTION and args.speed is None:
                    continue
                args.report(f"{event.t_s:10.3f} s  {event.kind.value:8}  {_force(profile)}")
                found.append({"t_s": event.t_s, "event": event.kind.value})
                if recording is not None:
                    recording.write_event(event)
            if profile.valid and (best is None or profile.force_N > best[1]):
                best = (profile.t_s, profile.force_N, profile.force_sigma_N)
            if page is not None:
                page.update(frame.t_s, frame_bgr=frame.image, profile=profile)
    count = sum(reasons.values())
    if not count:
        raise InputError(args.source, "no frames are left to measure", remedy="check --start, --stop")
    args.report(
        f"{count} frames, {reasons.get('ok', 0)} valid"
        + "".join(f", {number} {reason}" for reason, number in reasons.items() if reason != "ok")
    )
    if best is not None:
        args.report(f"largest force {best[1]:.3f} N +- {best[2]:.3f} N at {best[0]:.3f} s")
    result = {
        "frames": count,
        "reasons": dict(reasons),
        "events": found,
        "max_force_N": best[1] if best else None,
        "largest_force_sigma_N": best[2] if best else None,
        "out": [str(path) for path in (args.out, args.csv, args.parquet) if path],
    }
    if finger is not None:
        result["finger"] = _travel(args, positions)
    return result


def _write_finger(recording: MeasurementWriter, sensor: FingerSensor) -> None:
    """Pose of frame F on the finger in the fixed frame; what is not observed has no variance."""
    import numpy as np

    from ....core.camera.pose import Pose

    finger = sensor.finger
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = finger.sigma_m**2 * np.outer(sensor.axis_foam, sensor.axis_foam)
    pose = Pose(np.eye(3), finger.position_m * sensor.axis_foam)
    recording.write_pose(pose, finger.t_s, "/finger/pose", frame="finger_rest", covariance=covariance)


def _travel(args: Any, positions: list[float]) -> dict[str, Any]:
    if not positions:
        args.report("the finger was not seen")
        return {"frames": 0}
    first, last = positions[0], positions[-1]
    args.report(f"finger from {1e3 * first:.2f} mm to {1e3 * last:.2f} mm, seen in {len(positions)} frames")
    return {
        "frames": len(positions),
        "first_m": first,
        "last_m": last,
        "min_m": min(positions),
        "max_m": max(positions),
    }


def _force(profile: Any) -> str:
    return f"{profile.force_N:.3f} N +- {profile.force_sigma_N:.3f} N"
