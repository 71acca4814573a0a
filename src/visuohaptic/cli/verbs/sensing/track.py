"""``visuohaptic track``: estimate the poses of templates in images.

reads
  --templates  folder of images with a dpi value, and tags.yaml (tags: {name: {id: 7, size_m: 0.04}})
  --source     a video file, a folder of images, recording.mcap[:/topic], or a camera: 0, rtsp://..., realsense:, orbbec:
  --camera     camera.yaml, a ROS camera_info file
writes
  --out        MCAP recording with geometry_msgs/PoseWithCovarianceStamped on /template/NAME
  --csv        t_s, name, valid, reason, position [m], quaternion, standard deviations, correlation
  --plot       position of each template over time with its uncertainty

example: visuohaptic track --templates templates/ --source run.mp4 --camera camera.yaml --out poses.mcap
"""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .... import core, report, tracking
from ....core import files
from ....sensing import readers
from ..._sensor_run import Outputs, add_run_arguments, is_live, opened_frames, run_sensor, shown_frames

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--templates", Path, "folder of templates", required=True)
    add("--source", str, "video, images, recording or camera", required=True)
    add("--camera", Path, "camera.yaml", required=True)
    add_run_arguments(add)
    add("--view", bool, "show the measurement live in the browser")


def run(args: Any) -> dict[str, Any]:
    """Track through the source; returns the mapping that ``--json`` prints."""
    camera = core.Camera.load(args.camera)
    templates = tracking.load_templates(args.templates)
    seen: Counter[str] = Counter()
    outputs: Outputs[tuple[tracking.TemplatePose, ...]] = Outputs(
        _Table,
        rows=lambda poses: poses,
        page_title="templates",
        show=lambda frame, poses: {"frame_bgr": _drawn(frame, poses)},
        chart=_chart,
    )
    with ExitStack() as stack:
        source = stack.enter_context(opened_frames(args, camera, grey=not args.view))
        # With a live camera the detector runs in a thread, to avoid delays; with a recording in sequence, for reproducible results.
        tracker = stack.enter_context(
            tracking.TemplateTracker(templates, camera, threaded=is_live(args.source))
        )
        frames = shown_frames(args, source, "tracking")
        done = run_sensor(
            args,
            readers.TemplateReader(tracker),
            frames,
            outputs,
            lambda reading: seen.update(pose.name for pose in reading.measured if pose.valid),
        )
    for template in templates:
        args.report(f"{template.name:<24}seen in {seen[template.name]} of {done.frames} frames")
    for path in done.out:
        args.report(f"written to {path}")
    return {
        "frames": done.frames,
        "seen": {template.name: seen[template.name] for template in templates},
        "out": str(args.out) if args.out else None,
        "csv": str(args.csv) if args.csv else None,
    }


def _drawn(frame: core.Frame, poses: Sequence[tracking.TemplatePose]) -> np.ndarray:
    """The image with the outlines and positions of the templates."""
    from ....tracking.templates.template_tracker import template_outlines

    lines = []
    for pose in poses:
        if pose.T_camera_template is None:
            lines.append(f"{pose.name}: {pose.reason}")
        else:
            x, y, z = 1e3 * pose.T_camera_template.translation_m
            depth_sigma = 1e3 * pose.covariance[2, 2] ** 0.5
            lines.append(f"{pose.name}: {x:.2f} {y:.2f} {z:.2f} mm, depth +- {depth_sigma:.3f}")
    return report.annotated_frame(
        frame.image, report.FrameNotes(contacts_px=template_outlines(poses), lines=lines), split=False
    )


def _chart(poses: Sequence[tracking.TemplatePose]) -> dict[str, dict[str, tuple[float, float]]]:
    """Position of each template in the camera frame [cm]; NaN if not detected."""
    found: dict[str, dict[str, tuple[float, float]]] = {"x [cm]": {}, "y [cm]": {}, "distance z [cm]": {}}
    for pose in poses:
        place = pose.T_camera_template
        values = [nan] * 3 if place is None else (1e2 * place.translation_m).tolist()
        sigmas = 1e2 * pose.covariance.diagonal() ** 0.5
        for panel, value, sigma in zip(found.values(), values, sigmas, strict=False):
            panel[pose.name] = (value, float(sigma))
    return found


class _Table(files.GrowingCsv):
    """Table with one row per template and frame."""

    COLUMNS = (
        *("t_s", "name", "valid", "reason", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
        *("x_sigma_m", "y_sigma_m", "z_sigma_m", "rx_sigma_rad", "ry_sigma_rad", "rz_sigma_rad"),
        *("ambiguous", "ncc"),
    )

    def __init__(self, path: Path) -> None:
        super().__init__(path, self.COLUMNS)

    def write(self, pose: tracking.TemplatePose) -> None:
        """One row; empty where there is no number."""
        numbers: list[Any] = [""] * 13
        if pose.T_camera_template is not None:
            sigma = pose.covariance.diagonal() ** 0.5
            values = [*pose.T_camera_template.translation_m, *pose.T_camera_template.quaternion_xyzw, *sigma]
            numbers = [f"{value:.9g}" for value in values]
        ncc = f"{pose.alignment.ncc:.4f}" if pose.alignment is not None else ""
        head = [f"{pose.t_s:.6f}", pose.name, int(pose.valid), str(pose.reason)]
        self.add([*head, *numbers, int(pose.ambiguous), ncc])
