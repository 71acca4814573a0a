"""``visuohaptic sense beam``: from pictures, or from template poses, to six axes of force and moment."""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....core.errors import InputError
from ..._frames import add_part, opened_frames

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np

    from ....core.camera.frame import Frame
    from ....core.measurement import Wrench
    from ....io.sinks.mcap_out import MeasurementWriter
    from ....sensing.beam.sensor import BeamReading
    from ....sensing.beam.tracked import TrackedBeam
    from ....tracking.templates.template_tracker import TemplatePose
    from ....viewer.page import LivePage

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "read force and moment, six axes, from templates on a bending rod"

EPILOG = """\
reads
  --config   sensor.yaml with kind: beam (beam, templates, frame of the sensor; camera and
             templates_folder to read from pictures)
  --source   a video file, a folder of images, recording.mcap[:/topic], or a live camera (camera:0)
  --poses    instead of --source, poses.csv: t_s, name, valid, reason, x_m, y_m, z_m, qx, qy, qz, qw and
             the covariance of each template in the camera, rows of a frame together
writes
  --out      run.mcap with geometry_msgs/WrenchStamped and diagnostics; from pictures also the templates,
             geometry_msgs/PoseWithCovarianceStamped on /template/NAME
  --csv      t_s, valid, reason, fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm and their sigmas, a row a frame
  --parquet  the same
  --zero     the resting poses that sensor.yaml names, from frames of a sensor that nothing touches

examples
  visuohaptic sense beam --config sensor.yaml --source rest.mp4 --zero
  visuohaptic sense beam --config sensor.yaml --source push.mp4 --out run.mcap --csv run.csv
"""

#: Frames of a live camera that make a zero.
_LIVE_ZERO = 100
_AXES = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--config", required=True, type=Path, help="sensor.yaml")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--source", help="where the frames come from")
    where.add_argument("--poses", type=Path, help="poses of the templates, CSV")
    parser.add_argument("--out", type=Path, help="MCAP recording to write")
    parser.add_argument("--csv", type=Path, help="table to write")
    parser.add_argument("--parquet", type=Path, help="table to write")
    parser.add_argument("--zero", action="store_true", help="take and store the zero, then stop")
    parser.add_argument(
        "--zero-frames",
        type=int,
        default=0,
        metavar="N",
        help="zero on the first N frames, then measure (nothing is stored); with --zero: from N frames",
    )
    add_part(parser)
    parser.add_argument(
        "--view", action="store_true", help="show it live on a page of this machine (with --source)"
    )


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    if args.zero_frames < 0:
        raise InputError("--zero-frames", f"found {args.zero_frames}, expected 0 or more")
    if args.source is not None:
        return _from_pictures(args)
    if args.view or args.start or args.stop != float("inf") or args.rate_Hz is not None:
        raise InputError(
            "--poses", "has no pictures", remedy="--view, --start, --stop and --rate-Hz belong to --source"
        )
    return _from_poses(args)


def _from_poses(args: Any) -> dict[str, Any]:
    from ....sensing.beam.config import BeamSensorConfig
    from ....sensing.beam.records import read_template_poses
    from ....sensing.beam.sensor import BeamSensor
    from ....sensing.beam.zero import BeamZero

    setup = BeamSensorConfig.load(args.config)
    sensor = BeamSensor(setup)
    assert setup.zero_path is not None
    frames = read_template_poses(args.poses)
    if args.zero:
        return _stored(args, sensor.zero(args.progress(frames, "zeroing")), setup.zero_path)
    if args.zero_frames:
        sensor.zero(islice(frames, args.zero_frames))
    elif setup.zero_path.is_file():
        sensor = BeamSensor(setup, BeamZero.load(setup.zero_path, list(setup.xi)))
    else:
        raise _no_zero(setup.zero_path)
    with _Writers(args) as writers:
        for t_s, templates in args.progress(frames, "measuring"):
            writers.write(sensor.read(t_s, templates))
        return writers.summary()


def _from_pictures(args: Any) -> dict[str, Any]:
    from ....sensing.beam.tracked import TrackedBeam

    with ExitStack() as stack:
        # A live camera must not wait for the detector; a recording must give the same result each time.
        live = args.source.startswith(("camera:", "uvc:"))
        beam = stack.enter_context(TrackedBeam.load(args.config, threaded=live))
        source = stack.enter_context(opened_frames(args, beam.camera, grey=not args.view))
        frames: Iterator[Frame] = iter(args.progress(source, "zeroing" if args.zero else "measuring"))
        zero_path = beam.sensor.setup.zero_path
        assert zero_path is not None
        if args.zero:
            # A live camera never ends by itself.
            limit = args.zero_frames or (_LIVE_ZERO if live else None)
            return _stored(args, beam.zero(islice(frames, limit)), zero_path)
        if args.zero_frames:
            beam.zero(islice(frames, args.zero_frames))
        elif beam.sensor.zero_reference is None:
            raise _no_zero(zero_path)
        return _measure(args, beam, frames, stack)


def _measure(args: Any, beam: TrackedBeam, frames: Iterator[Frame], stack: ExitStack) -> dict[str, Any]:
    writers = stack.enter_context(_Writers(args, frame=beam.camera.name))
    page: LivePage | None = None
    if args.view:
        from ....viewer.page import LivePage

        page = stack.enter_context(LivePage(title="beam sensor"))
        args.report(f"live page: {page.url}")
        page.show()
    for frame in frames:
        found = beam.read(frame)
        writers.write(found.reading, found.templates)
        if page is not None:
            page.update(frame.t_s, frame_bgr=_drawn(frame, found.reading.wrench, found.templates))
    if writers.recording is not None:
        writers.recording.write_camera(beam.camera, writers.last_t_s)
    return writers.summary()


def _drawn(frame: Frame, wrench: Wrench, templates: Sequence[TemplatePose]) -> np.ndarray:
    """The picture with the templates' outlines and six numbers."""
    from ....report.annotation import FrameNotes, annotated_frame
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
    return annotated_frame(
        frame.image, FrameNotes(contacts_px=template_outlines(templates), lines=lines), split=False
    )


def _stored(args: Any, zero: Any, path: Path) -> dict[str, Any]:
    zero.save(path)
    args.report(f"zero from {zero.frames} frames of {', '.join(zero.rest.names)} written to {path}")
    return {"zero": str(path), "frames": zero.frames, "templates": list(zero.rest.names)}


def _no_zero(path: Path) -> InputError:
    return InputError(
        path,
        "there is no zero reference",
        remedy="take one first (visuohaptic sense beam ... --zero) or give --zero-frames N",
    )


class _Writers:
    """All that is written of a run, and what there is to say at its end."""

    def __init__(self, args: Any, frame: str = "camera") -> None:
        self._args, self._frame = args, frame
        self._stack = ExitStack()
        self.recording: MeasurementWriter | None = None
        self.last_t_s = 0.0

    def __enter__(self) -> _Writers:
        import numpy as np

        from ....io.sinks.mcap_out import MeasurementWriter
        from ....io.sinks.tables import TableWriter

        args = self._args
        self._reasons: Counter[str] = Counter()
        self._largest, self._sigma, self._exact = np.zeros(6), np.full(6, np.nan), 0
        if args.out:
            self.recording = self._stack.enter_context(MeasurementWriter(args.out))
        self._tables = [
            self._stack.enter_context(TableWriter(path)) for path in (args.csv, args.parquet) if path
        ]
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def write(self, reading: BeamReading, templates: Sequence[TemplatePose] = ()) -> None:
        """One frame."""
        import numpy as np

        wrench = reading.wrench
        self.last_t_s = wrench.t_s
        self._reasons[wrench.reason.value] += 1
        self._exact += reading.exact
        if self.recording is not None:
            self.recording.write_wrench(wrench)
            for pose in templates:
                if pose.T_camera_template is not None:
                    self.recording.write_pose(
                        pose.T_camera_template,
                        pose.t_s,
                        f"/template/{pose.name}",
                        frame=self._frame,
                        covariance=pose.covariance,
                    )
        for table in self._tables:
            table.write(wrench)
        if wrench.valid:
            now = np.concatenate([wrench.force_N, wrench.moment_Nm])
            if np.isnan(self._sigma[0]):
                self._sigma = np.sqrt(np.diag(reading.noise))
            self._largest = np.where(np.abs(now) > np.abs(self._largest), now, self._largest)

    def summary(self) -> dict[str, Any]:
        """Report, and the mapping for ``--json``."""
        args, reasons = self._args, self._reasons
        count = sum(reasons.values())
        if not count:
            raise InputError(
                args.source or args.poses,
                "no frames are left to measure",
                remedy="check --zero-frames, --start, --stop",
            )
        args.report(
            f"{count} frames, {reasons.get('ok', 0)} valid, {self._exact} read by the exact rod"
            + "".join(f", {number} {reason}" for reason, number in reasons.items() if reason != "ok")
        )
        for name, value, noise in zip(_AXES, self._largest, self._sigma, strict=True):
            args.report(f"{name:6} largest {value:9.4f}, noise of a frame {noise:.5f}")
        return {
            "frames": count,
            "reasons": dict(reasons),
            "exact_frames": self._exact,
            "largest": dict(zip(_AXES, self._largest.tolist(), strict=True)),
            "out": [str(path) for path in (args.out, args.csv, args.parquet) if path],
        }
