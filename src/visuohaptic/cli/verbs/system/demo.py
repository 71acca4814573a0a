"""``visuohaptic demo``: the end-to-end demo on a simulated robot, or one part of it.

parts
  foam      push one obstacle with the foam sensor and store its haptic tag
  beam      zero the beam sensor and measure known loads
  navigate  map the office, find the door blocked, push an obstacle aside, reach the goal
  glass     detect the transparent part of a bottle and complete it with the probe
  bottle    squeeze a bottle: class and contents; plan the grasp and lift it
  Without a part, all of it runs, from the laser map to the lifted bottle.
reads
  --world   seed of a random house with its own obstacles and containers; the robot knows nothing of it
  --memory  database (a folder, or postgresql://...): a later visit uses the map, tags and containers of earlier ones
  --bring   requested containers, of two or three on the table: every or a, then transparent, opaque, open, closed,
            filled, empty, then a class (bottle, smoothie, cup, ...) or container
  --apart   processes of their own for depth camera, probe and hand: only images, poses and commands cross
  --map     any map_server YAML file: push three obstacles in it (foam part only)
writes, into --out
  report.html   one self-contained page with every chapter
  touch/        sensor files, run.mcap (ROS 2 messages) and run.csv of the pushes
  beam/         files of the beam sensor
  With --map: report.html, run.mcap, run.csv, sensor.yaml, foam.yaml, zero.yaml.

examples
  visuohaptic demo --quick
  visuohaptic demo
  visuohaptic demo bottle --seed 3
  visuohaptic demo foam --map office.yaml --out results/office --view
  visuohaptic demo --world 4 --memory results/memory
  visuohaptic demo --world 4 --bring "every transparent bottle"
  visuohaptic demo --world 4 --visit 1 --memory results/memory --seed 9
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from .... import demo, viewer
from ....core.errors import InputError

#: Parts of the demo; the same names as ``experiments.mission.PARTS``, without its imports.
PARTS = ("foam", "beam", "navigate", "glass", "bottle")

#: Packages with kernels of the chapters after the first five, in the order in which these need them: the first chapters
#: need few, and leave time for those of the others.
LATER_CHAPTERS = ("simulation.tabletop", "reconstruction", "deformation.shells")


def needs(args: argparse.Namespace) -> set[str]:
    """Optional modules that the verb imports: none for the recorded mission.

    Parameters
    ----------
    args
        As parsed.
    """
    if args.quick:
        return set()
    remembers = {"pyarrow", "sqlalchemy"} if args.memory else set()
    return {"av", "matplotlib", "mcap_ros2", "mujoco", "robust_laplacian", "skimage"} | remembers


def kernels(args: argparse.Namespace) -> tuple[str, ...]:
    """Packages whose kernels are compiled while the demo runs; none for one part, a map or the recorded mission.

    Parameters
    ----------
    args
        As parsed.
    """
    return () if args.quick or args.part or args.map else LATER_CHAPTERS


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("part", str, "run only this part", nargs="?", choices=PARTS)
    add("--quick", bool, "replay a recorded mission; takes seconds and needs no extra")
    add("--map", Path, "push three obstacles in this map", metavar="YAML")
    add("--out", Path("results/demo"), "folder to write to (results/demo)")
    add("--seed", 2, "seed of everything random (2)")
    add("--world", 0, "seed of a random house; 0: the office (0)", low=0)
    add("--visit", 0, "number of the visit to this world, between which objects are moved (0)", low=0)
    add("--memory", str, "database that stores results between visits", metavar="FOLDER|URL")
    add("--bring", "", "containers to bring, such as 'every transparent bottle'", metavar="REQUEST")
    add("--apart", bool, "run the worlds at the table in processes of their own")
    add("--view", bool, "show the pushes live in the browser")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    from contextlib import ExitStack

    from .view import wait

    chosen = min(args.given & {"--world", "--visit", "--memory", "--apart"}, default="")
    if args.quick and (other := chosen or args.part or args.map):
        raise InputError("--quick", f"found with {other}", remedy="it replays the whole recorded mission")
    if args.quick or args.part or args.map:
        args.refuse("--bring", "found with --quick, --map or a part", "it needs the whole mission")
    if args.part not in (None, "foam"):
        args.refuse("--map", f"found with {args.part}", "maps are for the foam part")
    if chosen:
        args.refuse("--map", f"found with {chosen}", "a map is a world of its own, without a mission")
    with ExitStack() as stack:
        page = None
        if args.view:
            page = stack.enter_context(viewer.LivePage())
            args.report(f"live page: {page.url}")
            page.show()
        work = _replay if args.quick else _tell
        result = work(args, page)
        if page is not None:
            args.report(f"the page stays at {page.url}; end with Ctrl-C")
            wait(args)
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
    """The demo in the built-in office and table, or with three obstacles in the user's map."""
    if page is not None and args.map is None:
        grid = demo.Mission(args.seed, args.out, world=args.world).house.grid
        page.set_map(grid.cells, grid.resolution_m, grid.origin)
    if args.map is not None:
        story = demo.touch_in_map(args.out, args.map, seed=args.seed, on_message=args.report, page=page)
    else:
        story = demo.run_mission(
            args.out, part=args.part, seed=args.seed, on_message=args.report, page=page,
            visit=demo.Visit(args.world, args.visit, args.memory, args.apart, args.bring),
        )  # fmt: skip
    report = demo.write_story(story, args.out / "report.html")
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
                "claim_is_true": one.correct,
                "claims": [claim.as_row() for claim in one.claims],
                "measures": [
                    {"what": m.what, "estimate": m.estimate, "truth": m.truth} for m in one.measures
                ],
                "duration_s": one.duration_s,
            }
            for one in story.chapters
        ],
        "duration_s": story.duration_s,
    }
