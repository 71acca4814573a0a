"""``visuohaptic sense beam``: measure force and moment from images of a bending rod, or from template poses.

reads
  --config   sensor.yaml with kind: beam (beam, templates, frame of the sensor; for images also camera and
             templates_folder)
  --source   a video file, a folder of images, recording.mcap[:/topic], or a camera: 0, rtsp://..., realsense:, orbbec:
  --poses    instead of --source, poses.csv: t_s, name, valid, reason, x_m, y_m, z_m, qx, qy, qz, qw and
             the covariance of each template in the camera frame; the rows of a frame are consecutive
writes
  --out      MCAP recording with geometry_msgs/WrenchStamped and diagnostics; from images also the templates,
             geometry_msgs/PoseWithCovarianceStamped on /template/NAME
  --csv      t_s, valid, reason, fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm and their sigmas, one row per frame
  --parquet  the same
  --plot     forces and moments over time with their uncertainty, and why frames are invalid
  --zero     the zero reference that sensor.yaml names, from frames of the untouched sensor

examples
  visuohaptic sense beam --config sensor.yaml --source rest.mp4 --zero
  visuohaptic sense beam --config sensor.yaml --source push.mp4 --out run.mcap --csv run.csv --plot run.png
"""

from __future__ import annotations

from contextlib import ExitStack
from itertools import islice
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from .... import core, io, report, sensing, tracking
from ....core.files.plain_json import picked
from ..._sensor_run import (
    Outputs,
    SensorRun,
    add_run_arguments,
    check_zero_alone,
    is_live,
    opened_frames,
    run_sensor,
    shown_frames,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np

    from ....sensing.beam import BeamSetup, TrackedReading

#: Number of frames of a live camera for the zero reference.
_LIVE_ZERO = 100
_AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--config", Path, "sensor.yaml", required=True)
    where = add.one_of(required=True)
    where("--source", str, "video, images, recording or camera")
    where("--poses", Path, "CSV file of template poses")
    add("--zero", bool, "record and store the zero reference, then stop")
    add_run_arguments(
        add,
        parquet="table to write",
        zero_frames="zero with the first N frames, then measure (the zero is not stored); with --zero: use N frames",
    )
    add("--view", bool, "show the measurement live in the browser (with --source)")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    check_zero_alone(args)
    with ExitStack() as stack:
        if args.source is not None:
            reader, frames, names = _images(args, stack)
        else:
            reader, frames, names = _poses(args)
        if not args.zero:
            return _measure(args, reader, frames)
        # A live camera has no end.
        limit = args.zero_frames or (_LIVE_ZERO if is_live(str(args.source)) else None)
        assert reader.zero_path is not None  # a file of settings always names one
        return _stored(args, reader.zero(islice(frames, limit)), reader.zero_path, names)


def _images(args: Any, stack: ExitStack) -> tuple[sensing.SensorReader[Any], Iterator[Any], list[str]]:
    """A reader of camera frames, those of ``--source``, and the names of the templates."""
    from ....sensing.beam.tracked import TrackedBeam

    # With a live camera the detector runs in a thread, to avoid delays; with a recording in sequence, for reproducible results.
    beam = TrackedBeam.load(args.config, threaded=is_live(args.source))
    reader = stack.enter_context(sensing.BeamReader(beam, templates=True))
    source = stack.enter_context(opened_frames(args, reader.camera, grey=not args.view))
    return reader, shown_frames(args, source, _doing(args)), list(beam.sensor.setup.xi)


def _poses(args: Any) -> tuple[sensing.SensorReader[Any], Iterator[Any], list[str]]:
    """A reader of template poses, those of ``--poses``, and the names of the templates."""
    args.refuse("--view --start --stop --rate-Hz", "found with --poses, which has no images")
    from ....sensing.beam import BeamSensorConfig, read_template_poses

    setup = BeamSensorConfig.load(args.config)
    frames = args.progress(read_template_poses(args.poses), _doing(args))
    return _pose_reader(setup), iter(_PoseFrame(*frame) for frame in frames), list(setup.xi)


def _doing(args: Any) -> str:
    return "zeroing" if args.zero else "measuring"


class _PoseFrame(NamedTuple):
    """Template poses that were observed at one time."""

    t_s: float
    templates: Sequence[Any]


def _pose_reader(setup: BeamSetup) -> sensing.SensorReader[TrackedReading]:
    """A beam sensor that reads template poses instead of images."""
    from ....sensing.beam import BeamSensor, BeamZero, TrackedReading

    path = setup.zero_path
    stored = BeamZero.load(path, list(setup.xi)) if path is not None and path.is_file() else None
    sensor = BeamSensor(setup, stored)

    class PoseReader(sensing.SensorReader[TrackedReading]):
        kind, camera, zero_path = "beam", None, path

        @property
        def zeroed(self) -> bool:
            return sensor.zero_reference is not None

        def zero(self, frames: Any) -> BeamZero:
            return sensor.zero(frames)

        def read(self, frame: Any, sink: Any = None) -> sensing.SensorReading[TrackedReading]:
            reading = sensor.read(*frame)
            if sink is not None:
                sink.write_wrench(reading.wrench, "beam")
            return sensing.SensorReading(TrackedReading(reading, ()), reading.wrench.reason)

        def blank(self, t_s: float, sink: Any) -> None:
            """Do nothing: a recorded table has no time-outs."""

    return PoseReader("beam")


def _measure(
    args: Any, reader: sensing.SensorReader[TrackedReading], frames: Iterator[Any]
) -> dict[str, Any]:
    import numpy as np

    max_load, noise, exact = np.zeros(6), np.full(6, np.nan), 0

    def note(reading: sensing.SensorReading[TrackedReading]) -> None:
        nonlocal max_load, noise, exact
        found = reading.measured.reading
        exact += found.exact
        if found.wrench.valid:
            load = np.concatenate([found.wrench.force_N, found.wrench.moment_Nm])
            if np.isnan(noise[0]):
                noise = np.sqrt(np.diag(found.noise))
            max_load = np.where(np.abs(load) > np.abs(max_load), load, max_load)

    outputs: Outputs[TrackedReading] = Outputs(
        io.TableWriter,
        rows=lambda found: (found.reading.wrench,),
        page_title="beam sensor",
        chart=lambda found: _chart(found.reading.wrench),
        show=lambda frame, found: {"frame_bgr": _drawn(frame, found.reading.wrench, found.templates)},
    )
    done = run_sensor(args, reader, frames, outputs, note)
    return _summary(args, done, max_load, noise, exact)


def _chart(wrench: core.Wrench) -> dict[str, dict[str, tuple[float, float]]]:
    """Forces [N] and moments [mNm] by their axis, each with its sigma; NaN when the frame is not valid."""
    known = 1.0 if wrench.valid else nan
    sigma = wrench.covariance.diagonal() ** 0.5
    force = zip(known * wrench.force_N, sigma[:3], strict=True)
    moment = zip(1e3 * known * wrench.moment_Nm, 1e3 * sigma[3:], strict=True)
    return {
        "force [N]": dict(zip(("Fx", "Fy", "Fz"), force, strict=True)),
        "moment [mNm]": dict(zip(("Mx", "My", "Mz"), moment, strict=True)),
    }


def _summary(
    args: Any, done: SensorRun, max_load: np.ndarray, noise: np.ndarray, exact: int
) -> dict[str, Any]:
    """Report, and the mapping for ``--json``; ``max_load`` and ``noise`` of six axes [N, Nm]."""
    args.report(done.text(f", {exact} computed with the nonlinear rod model"))
    for name, value, sigma in zip(_AXES, max_load, noise, strict=True):
        args.report(f"{name:6} maximum {value:9.4f}, standard deviation {sigma:.5f}")
    return {
        **picked(done, "frames reasons out"),
        "exact_frames": exact,
        "max": dict(zip(_AXES, max_load.tolist(), strict=True)),
    }


def _drawn(frame: core.Frame, wrench: core.Wrench, templates: Sequence[tracking.TemplatePose]) -> np.ndarray:
    """The image with the templates' outlines and six numbers."""
    from ....tracking.templates.template_tracker import template_outlines

    if wrench.valid:
        sigma = wrench.covariance.diagonal() ** 0.5
        lines = [
            f"F{axis} {force:+.3f} N +- {force_sigma:.3f}   M{axis} {1e3 * moment:+.1f} mNm +- {1e3 * moment_sigma:.1f}"
            for axis, force, moment, force_sigma, moment_sigma in zip(
                "XYZ", wrench.force_N, wrench.moment_Nm, sigma[:3], sigma[3:], strict=True
            )
        ]
    else:
        lines = [f"not valid: {wrench.reason}"]
    return report.annotated_frame(
        frame.image, report.FrameNotes(contacts_px=template_outlines(templates), lines=lines), split=False
    )


def _stored(args: Any, zero: Any, path: Path, names: list[str]) -> dict[str, Any]:
    zero.save(path)
    args.report(f"zero from {zero.frames} frames of {', '.join(zero.rest.names)} written to {path}")
    for name in names:
        if name not in zero.rest.names:
            args.report(f"{name} was not visible in half of the frames: it is not used")
    return {"zero": str(path), "frames": zero.frames, "templates": list(zero.rest.names)}
