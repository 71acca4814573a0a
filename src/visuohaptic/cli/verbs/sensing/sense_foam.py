"""``visuohaptic sense foam``: measure force from images of a foam strip.

reads
  --config   sensor.yaml: camera, foam, pose and shape of the strip (docs: Configure the sensor)
  --source   a video file, a folder of images, recording.mcap[:/topic], or a camera: 0, /dev/video0, rtsp://...,
             realsense:, orbbec:; a camera is read until Ctrl-C
writes
  --out      MCAP recording with geometry_msgs/WrenchStamped, the contact contour and diagnostics; with a
             section finger in sensor.yaml also the finger's pose, geometry_msgs/PoseWithCovarianceStamped
  --csv      t_s, valid, reason, force_N, force_sigma_N, contacts and the error budget, one row per frame
  --parquet  the same, with the profiles along the strip
  --plot     force over time with its uncertainty, events, and why frames are invalid
  --page     with --against: HTML page that compares the force with that of a scale (see `compare`)
  --zero     the zero reference that sensor.yaml names, from frames of the untouched strip

examples
  visuohaptic sense foam --config sensor.yaml --source rest.mp4 --zero
  visuohaptic sense foam --config sensor.yaml --source push.mp4 --out run.mcap --csv run.csv --plot force.png
  visuohaptic sense foam --config sensor.yaml --source push.mp4 --against scale.csv --page scale.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import core, report, sensing
from ....core.files.plain_json import picked
from ....sensing import foam
from ..._sensor_run import (
    SensorRun,
    add_run_arguments,
    check_zero_alone,
    force_outputs,
    opened_frames,
    run_sensor,
    shown_frames,
)
from ._reference import add_reference, checked_reference, reported

#: Modules with kernels of the verb, the last needed first.
KERNELS = (
    "sensing.foam._profile_kernels",
    "sensing.foam.deflection",
    "sensing.foam._chain_kernels",
    "sensing.foam._posterior_kernels",
    "sensing.foam._texture_kernels",
    "tracking.contours",
)


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--config", Path, "sensor.yaml", required=True)
    add("--source", str, "video, images, recording or camera", required=True)
    add_run_arguments(
        add,
        parquet="table with profiles to write",
        zero_frames="zero with the first N frames, then measure; the zero is not stored",
    )
    add_reference(add, "--against")
    add("--zero", bool, "record and store the zero reference, then stop")
    add(
        "--speed",
        float,
        "speed of the platform; needed for the event 'motion' (the object starts to move)",
        metavar="M/S",
    )
    add("--view", bool, "show the measurement live in the browser")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    check_zero_alone(args)
    if args.against is None:
        args.refuse("--page", "found without --against, expected a reference to compare with")
    reference = None if args.against is None else checked_reference(args, args.against)
    sensor = foam.load_foam_sensor(args.config)
    with opened_frames(args, sensor.setup.camera) as source:
        return _zero(args, sensor, source) if args.zero else _measure(args, sensor, source, reference)


def _zero(args: Any, sensor: foam.FoamSensor, source: core.FrameSource) -> dict[str, Any]:
    zero = sensor.zero(args.progress(source, "zeroing"))
    zero.save(sensor.setup.zero_path)
    sigma_m = float(zero.width_sigma_m[~zero.inferred].mean())
    args.report(
        f"zero reference from {zero.frames} frames written to {sensor.setup.zero_path}: "
        f"width {1e3 * zero.width_m.mean():.3f} mm, contrast {abs(zero.contrast):.0f} grey levels, "
        f"noise of a point {1e6 * sigma_m * zero.frames**0.5:.0f} um per frame"
    )
    return {
        "zero": str(sensor.setup.zero_path),
        "frames": zero.frames,
        "width_m": float(zero.width_m.mean()),
        "width_sigma_m": sigma_m,
    }


def _measure(
    args: Any, sensor: foam.FoamSensor, source: core.FrameSource, reference: report.ForceRecord | None
) -> dict[str, Any]:
    finger = sensor if isinstance(sensor, foam.FingerSensor) else None
    reader = _reader(sensor, finger)
    if args.speed is not None:
        reader.odometry = lambda t_s: core.BaseState(t_s, 0.0, 0.0, 0.0, args.speed, 0.0)
    profiles: list[core.ForceProfile] = []
    max_profile: core.ForceProfile | None = None
    positions: list[float] = []

    def note(reading: sensing.SensorReading[core.ForceProfile]) -> None:
        nonlocal max_profile
        profile = reading.measured
        if profile.valid and (max_profile is None or profile.force_N > max_profile.force_N):
            max_profile = profile
        if finger is not None and finger.finger.valid:
            positions.append(finger.finger.position_m)
        if reference is not None:
            profiles.append(profile)

    done = run_sensor(args, reader, shown_frames(args, source, "measuring"), force_outputs(), note)
    result = _summary(args, done, max_profile)
    if reference is not None:
        result["against"] = reported(args, _record(args, profiles), reference)
    if finger is not None:
        result["finger"] = _stroke(args, positions)
    return result


def _record(args: Any, profiles: list[core.ForceProfile]) -> report.ForceRecord:
    """Summary of the measured forces."""
    import numpy as np

    t_s, force_N, sigma_N = np.array([(p.t_s, p.force_N, p.force_sigma_N) for p in profiles]).reshape(-1, 3).T
    return report.ForceRecord(
        Path(args.source).name,
        t_s,
        force_N,
        sigma_N,
        np.array([p.valid for p in profiles], dtype=bool),
        tuple(p.reason.value for p in profiles),
    )


def _summary(args: Any, done: SensorRun, max_profile: core.ForceProfile | None) -> dict[str, Any]:
    args.report(done.text())
    if max_profile is not None:
        args.report(f"maximum force {_force(max_profile)} at {max_profile.t_s:.3f} s")
    return {
        **picked(done, "frames reasons events out"),
        "max_force_N": None if max_profile is None else max_profile.force_N,
        "max_force_sigma_N": None if max_profile is None else max_profile.force_sigma_N,
    }


def _reader(sensor: foam.FoamSensor, finger: foam.FingerSensor | None) -> sensing.FoamReader:
    """The reader of the sensor; with a finger it writes the finger's pose, too."""
    if finger is None:
        return sensing.FoamReader(sensor)
    moving: foam.FingerSensor = finger

    class FingerReader(sensing.FoamReader):
        def read(self, frame: Any, sink: Any = None) -> sensing.SensorReading[core.ForceProfile]:
            reading = super().read(frame, sink)
            if sink is not None and moving.finger.valid:
                _write_finger(sink, moving)
            return reading

    return FingerReader(sensor)


def _write_finger(sink: Any, sensor: foam.FingerSensor) -> None:
    """Pose of frame F on the finger in the fixed frame; unobserved components have no variance."""
    import numpy as np

    finger = sensor.finger
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = finger.sigma_m**2 * np.outer(sensor.axis_foam, sensor.axis_foam)
    pose = core.Pose(np.eye(3), finger.position_m * sensor.axis_foam)
    sink.write_pose(pose, finger.t_s, "/finger/pose", frame="finger_rest", covariance=covariance)


def _stroke(args: Any, positions: list[float]) -> dict[str, Any]:
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


def _force(profile: core.ForceProfile) -> str:
    return f"{profile.force_N:.3f} N +- {profile.force_sigma_N:.3f} N"
