"""``visuohaptic demo``: the whole story in one command, or one part of it.

parts
  foam      touch one obstacle with the camera-read foam and tag it
  beam      zero the beam sensor and read known loads
  navigate  map the office, find the door blocked, push something aside, arrive
  glass     find what is transparent, and complete it with the probe
  bottle    squeeze: class and contents; plan the grasp and lift
  without one: all of it, from the first round with the laser to the lifted bottle
reads
  --world   a seed: a house, what blocks its doorway and what is on its table are drawn; the robot is told nothing
  --memory  database (a folder, or postgresql://...): a later visit uses map, tags and containers of the earlier ones
  --map     any map_server YAML: touch three obstacles in it (the foam part only)
writes, into --out
  report.html   one page with every chapter, needs nothing else
  touch/        sensor files, run.mcap (ROS 2 messages) and run.csv of the pushes
  beam/         files of the beam sensor
with --map, into --out: report.html, picture.jpg, run.mcap, run.csv, sensor.yaml, foam.yaml, zero.yaml

examples
  visuohaptic demo --quick
  visuohaptic demo
  visuohaptic demo bottle --seed 3
  visuohaptic demo foam --map office.yaml --out results/office --view
  visuohaptic demo --world 4 --memory results/memory
  visuohaptic demo --world 4 --visit 1 --memory results/memory --seed 9
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ....core.errors import InputError

__all__ = ["add_arguments", "needs", "run"]

#: Parts of the story; the same names as ``experiments.mission.PARTS``, without its imports.
PARTS = ("foam", "beam", "navigate", "glass", "bottle")


def needs(args: argparse.Namespace) -> set[str]:
    """Modules beyond the core on its way: none for the recorded mission.

    Parameters
    ----------
    args
        As parsed.
    """
    if args.quick:
        return set()
    remembers = {"pyarrow", "sqlalchemy"} if args.memory else set()
    return {"av", "matplotlib", "mcap_ros2", "mujoco", "robust_laplacian", "skimage"} | remembers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("part", nargs="?", choices=PARTS, help="run this part alone")
    parser.add_argument(
        "--quick", action="store_true", help="replay a recorded mission: seconds, needs no extra"
    )
    parser.add_argument("--map", type=Path, metavar="YAML", help="touch three obstacles in this map")
    parser.add_argument("--out", type=Path, default=Path("results/demo"), help="folder (results/demo)")
    parser.add_argument("--seed", type=int, default=2, help="of everything random (2)")
    parser.add_argument("--world", type=int, default=0, help="seed of a drawn house; 0: the office (0)")
    parser.add_argument("--visit", type=int, default=0, help="day in this world; people move things (0)")
    parser.add_argument(
        "--memory", metavar="FOLDER|URL", help="database of what is remembered between visits"
    )
    parser.add_argument("--view", action="store_true", help="show it live on a page of this machine")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from contextlib import ExitStack

    if args.quick and (args.part or args.map):
        raise InputError(
            "--quick", f"found with {args.part or args.map}", remedy="it replays the whole mission"
        )
    if args.map is not None and args.part not in (None, "foam"):
        raise InputError("--map", f"found with {args.part}", remedy="maps are for the foam part")
    for name, value in (("--seed", args.seed), ("--world", args.world), ("--visit", args.visit)):
        if value < 0:
            raise InputError(name, f"found {value}, expected 0 or more")
    with ExitStack() as stack:
        page = None
        if args.view:
            from ....viewer.page import LivePage

            page = stack.enter_context(LivePage())
            args.report(f"live page: {page.url}")
            page.show()
        work = _replay if args.quick else _touch_in_map if args.map is not None else _tell
        result = work(args, page)
        if page is not None:
            args.report(f"the page stays at {page.url}; end with Ctrl-C")
            _wait()
    return result


def _replay(args: Any, page: Any) -> dict[str, Any]:
    """The recorded mission."""
    from ....demo.recorded import replay

    args.report("a recorded mission; visuohaptic demo computes one, with your --seed")
    report = replay(args.out, on_message=args.report, page=page)
    args.report("")
    args.report(f"report: {report}")
    _open(report)
    return {"report": str(report), "recorded": True}


def _open(report: Path) -> None:
    """Show the report in a browser where there is a screen for one."""
    import sys
    import webbrowser

    from ....viewer.server import has_screen

    if sys.stdout.isatty() and has_screen():
        webbrowser.open(report.resolve().as_uri())


def _tell(args: Any, page: Any) -> dict[str, Any]:
    """The story on our own office and table."""
    from ....demo.chapters import Visit, run_mission
    from ....demo.report import write_story

    if page is not None:
        from ....demo.story import Mission

        grid = Mission(args.seed, args.out, world=args.world).house.grid
        page.set_map(grid.cells, grid.resolution_m, grid.origin)
    story = run_mission(
        args.out, part=args.part, seed=args.seed, on_message=args.report, page=page,
        visit=Visit(args.world, args.visit, args.memory),
    )  # fmt: skip
    report = write_story(story, args.out / "report.html")
    args.report("")
    args.report(f"{story.summary()} ({story.duration_s:.0f} s)")
    args.report(f"report: {report}")
    if not story.complete:
        args.exit_code = 1
    return {
        "report": str(report),
        "complete": story.complete,
        "chapters": [
            {
                "name": one.name,
                "outcome": one.outcome.value,
                "reason": one.reason,
                "claim_is_true": one.right,
                "claims": [claim.as_row() for claim in one.claims],
                "measures": [{"what": m.what, "ours": m.ours, "truth": m.truth} for m in one.measures],
                "duration_s": one.duration_s,
            }
            for one in story.chapters
        ],
        "duration_s": story.duration_s,
    }


def _touch_in_map(args: Any, page: Any) -> dict[str, Any]:
    """Three obstacles in a map of the user's."""
    from ....core.codec import to_dict
    from ....demo.push_demo import run_demo
    from ....demo.push_demo_report import error_figures, write_report
    from ....report.run_tables import primitive_text, tag_text

    result = run_demo(args.out, map_path=args.map, seed=args.seed, on_message=args.report, page=page)
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
    return {
        "report": str(report),
        "objects": [
            {
                "name": one.name,
                "outcome": one.exploration.outcome.value,
                "haptic_tag": to_dict(one.tag),
                "errors": error_figures(one),
            }
            for one in result.objects
        ],
        "duration_s": result.duration_s,
    }


def _save_picture(result: Any, path: Path) -> None:
    """The first push as one picture, without the split into image and gradient."""
    import cv2

    from ....core.files import atomic_path
    from ....demo.push_demo_report import annotated_push

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
