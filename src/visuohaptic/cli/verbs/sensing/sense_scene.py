"""``visuohaptic sense scene``: obstacles, ego-motion and the pushed object from the foam sensor's camera.

reads
  --config    scene.yaml: camera, its pose and height above the floor (docs: Scene); with a field sensor, the
              foam's force is measured too, and the object in contact is tracked
  --source    a video file, a folder of images, recording.mcap[:/topic], or a camera: 0, rtsp://..., realsense:, orbbec:
  --odometry  CSV with t_s, speed_m_s, turn_rate_rad_s of the platform; fused with the motion of the floor
writes
  --out       MCAP recording with the platform's pose and covariance (geometry_msgs/PoseWithCovarianceStamped),
              diagnostics, toppling and slip events, with --mask the obstacle mask, and with a sensor
              its geometry_msgs/WrenchStamped
  --csv       t_s, valid, reason, x_m, y_m, heading_rad and their sigmas, rotation, tilt and translation of the object,
              proximity_m, events; one row per frame
  --plot      platform pose, nearest obstacle and object motion over time, with their uncertainty

examples
  visuohaptic sense scene --config scene.yaml --source drive.mp4 --csv scene.csv --plot scene.png
  visuohaptic sense scene --config scene.yaml --source push.mp4 --odometry wheels.csv --out run.mcap
"""

from __future__ import annotations

from math import degrees, isfinite, nan
from pathlib import Path
from typing import Any

from .... import core, sensing
from ....core.errors import InputError
from ....sensing import scene
from ..._sensor_run import Outputs, SensorRun, add_run_arguments, opened_frames, run_sensor, shown_frames


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--config", Path, "scene.yaml", required=True)
    add("--source", str, "video, images, recording or camera", required=True)
    add("--odometry", Path, "speed and turn rate of the platform", metavar="CSV")
    add_run_arguments(
        add, zero_frames="zero the foam sensor with the first N frames, then measure; the zero is not stored"
    )
    add("--mask", bool, "also write the obstacle mask to --out")
    add("--seed", 0, "seed of RANSAC (0)")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    import numpy as np

    count = args.zero_frames
    setup = scene.SceneConfig.load(args.config)
    if count and setup.sensor is None:
        raise InputError("--zero-frames", f"found {count}, but {args.config} names no sensor to zero")
    rng = np.random.default_rng(args.seed)
    reader = sensing.SceneReader(scene.SceneSensor(setup, rng=rng), foam_name="foam", mask=args.mask)
    if args.odometry:
        reader.odometry = scene.read_odometry(args.odometry).at
    with opened_frames(args, setup.camera) as source:
        return _track(args, reader, source)


def _track(args: Any, reader: sensing.SceneReader, source: core.FrameSource) -> dict[str, Any]:
    nearest_m, tracked, tilt_rad = float("inf"), 0, 0.0
    last: sensing.SceneReading | None = None

    def note(found: sensing.SensorReading[sensing.SceneReading]) -> None:
        nonlocal nearest_m, tracked, tilt_rad, last
        last = reading = found.measured
        if reading.obstacle.valid:
            nearest_m = min(nearest_m, reading.proximity_m)
        if reading.object_motion.valid:
            tracked += 1
            tilt_rad = max(tilt_rad, reading.object_motion.tilt_rad)

    outputs: Outputs[sensing.SceneReading] = Outputs(
        scene.SceneTable,
        rows=lambda reading: (reading,),
        page_title="scene",
        chart=lambda reading: _chart(reading, reader.foam is not None),
    )
    done = run_sensor(args, reader, shown_frames(args, source, "tracking"), outputs, note)
    assert last is not None  # the run has frames
    result = _summary(args, done, last, nearest_m)
    if reader.foam is not None:
        args.report(f"object tracked in {tracked} frames, maximum tilt {degrees(tilt_rad):.1f} deg")
    return {**result, "object_frames": tracked, "events": done.events, "out": done.out}


def _chart(reading: sensing.SceneReading, touches: bool) -> dict[str, dict[str, tuple[float, float]]]:
    """Drive, obstacle and, with a sensor that touches, object: value and sigma; NaN where unknown."""
    x, y, heading = reading.pose if reading.valid else (nan, nan, nan)
    variance = reading.pose_covariance.diagonal()
    obstacle, moved = reading.obstacle, reading.object_motion
    seen = obstacle.valid and isfinite(obstacle.proximity_m)
    near = (1e2 * obstacle.proximity_m, 1e2 * obstacle.proximity_sigma_m) if seen else (nan, nan)
    panels = {
        "position [cm]": {"x": (1e2 * x, 1e2 * variance[0] ** 0.5), "y": (1e2 * y, 1e2 * variance[1] ** 0.5)},
        "heading [deg]": {"heading": (degrees(heading), degrees(variance[2] ** 0.5))},
        "obstacle ahead [cm]": {"nearest": near},
    }
    if touches:
        turn = degrees(moved.turn_sigma_rad) if moved.valid else nan
        panels["object [deg]"] = {
            "turn": (degrees(reading.object_angle_rad), turn),
            "tilt": (degrees(moved.tilt_rad) if moved.valid else nan, nan),
        }
    return panels


def _summary(args: Any, done: SensorRun, last: sensing.SceneReading, nearest_m: float) -> dict[str, Any]:
    """Report the drive, and its part of the mapping."""
    import numpy as np

    (x, y, heading), sigma = last.pose, np.sqrt(np.diag(last.pose_covariance))
    args.report(done.text().replace(" frames, ", " frames, motion of ", 1))
    args.report(
        f"drove to x {x:.4f} m +- {sigma[0]:.4f} m, y {y:.4f} m +- {sigma[1]:.4f} m, "
        f"heading {degrees(heading):.2f} deg +- {degrees(sigma[2]):.2f} deg"
    )
    seen = np.isfinite(nearest_m)
    args.report(f"nearest obstacle {1e3 * nearest_m:.0f} mm ahead" if seen else "no obstacle ahead")
    return {
        "frames": done.frames,
        "reasons": dict(done.reasons),
        "pose": {"x_m": float(x), "y_m": float(y), "heading_rad": float(heading)},
        "pose_sigma": {"x_m": float(sigma[0]), "y_m": float(sigma[1]), "heading_rad": float(sigma[2])},
        "nearest_m": nearest_m if seen else None,
    }
