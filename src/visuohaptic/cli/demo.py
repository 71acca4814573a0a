"""``visuohaptic demo``: the first story."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "drive a simulated platform at three obstacles and read force and shape from its camera"

EPILOG = """\
reads
  --map     any map_server YAML; without it the project's own small office
writes, into --out
  report.html   one page with all figures, needs nothing else
  picture.jpg   what the camera saw at the largest force, annotated
  run.mcap      ROS 2 messages: wrench, contact contour, diagnostics, map, camera
  run.csv       t_s, valid, reason, force_N, force_sigma_N, contacts, error budget
  sensor.yaml, camera.yaml, foam.yaml, zero.yaml, strain_stress.csv: the sensor

examples
  visuohaptic demo
  visuohaptic demo --map office.yaml --out results/office --view
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--map", type=Path, metavar="YAML", help="drive in this map")
    parser.add_argument("--out", type=Path, default=Path("results/demo"), help="folder (results/demo)")
    parser.add_argument("--seed", type=int, default=1, help="of everything random (1)")
    parser.add_argument("--view", action="store_true", help="show it live on a page of this machine")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from contextlib import ExitStack

    from ..experiments.demo import run_demo
    from ..experiments.demo_report import error_figures, write_report
    from ..experiments.tables import primitive_text, tag_text
    from ..sensing import tag_to_dict

    with ExitStack() as stack:
        page = None
        if args.view:
            from ..viewer import LivePage

            page = stack.enter_context(LivePage())
            args.report(f"live page: {page.url}")
            page.show()
        result = run_demo(args.out, map_path=args.map, seed=args.seed, say=args.report, page=page)
        args.report("")
        args.report("haptic tags")
        for one in result.objects:
            shape = one.exploration.fit.best if one.exploration.fit is not None else None
            args.report(f"  {one.name}: {tag_text(one.tag)}")
            args.report(f"      shape: {primitive_text(shape) or 'none fits'}")
            truth = one.path.obstacle
            if truth.movable:
                args.report(
                    f"      truth: static friction {truth.static_friction_N:.2f} N, "
                    f"dynamic friction {truth.dynamic_friction_N:.2f} N"
                )
            else:
                args.report("      truth: fixed")
        report = write_report(result, args.out / "report.html")
        _save_picture(result, args.out / "picture.jpg")
        args.report("")
        args.report(f"report: {report}")
        args.report(f"recording: {args.out / 'run.mcap'}, table: {args.out / 'run.csv'}")
        if page is not None:
            args.report(f"the page stays at {page.url}; end with Ctrl-C")
            _wait()
    return {
        "report": str(report),
        "objects": [
            {
                "name": one.name,
                "outcome": one.exploration.outcome.value,
                "haptic_tag": tag_to_dict(one.tag),
                "errors": error_figures(one),
            }
            for one in result.objects
        ],
        "duration_s": result.duration_s,
    }


def _save_picture(result: Any, path: Path) -> None:
    """The first push as one picture, without the split into image and gradient."""
    import cv2

    from ..experiments.demo_report import annotated_push
    from ..files import atomic_path

    picture = annotated_push(result, result.objects[0], split=False)
    if picture is None:
        return
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])
    if done:
        with atomic_path(path) as temporary:
            temporary.write_bytes(data.tobytes())


def _wait() -> None:
    import contextlib
    import threading

    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
