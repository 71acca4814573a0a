"""``visuohaptic view``: show objects, maps, plans, surfaces and classifications in the browser.

reads   stiffness maps (.npz), containers (.yaml, .stl, .obj, .glb, .dae, or the name of a built-in
        class), surfaces (.ply; coloured by any scalar of their vertices, such as sigma_m), maps of
        map_server (.yaml), plans (.json, drawn on the map given before them), steps of a classification
        (.json with "steps": [[question, answer], ...] and "result")
writes  nothing; the page is served on 127.0.0.1 until Ctrl-C

example: visuohaptic view cup-rim map.yaml plan.json completed.ply
"""

from __future__ import annotations

import time
from typing import Any

from .... import grasping, viewer

#: Optional modules that the verb imports.
NEEDS = ("trimesh", "viser")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("files", str, "files or classes to show", nargs="+", metavar="FILE")
    add("--port", 8080, "port on 127.0.0.1; the next free one if it is in use", low=0, high=65535)
    add("--force", 10.0, "initial force of a finger (10)", metavar="N")
    add("--state", "open", "state of containers", choices=("open", "closed"))
    add("--fill", 0.0, "fill level in containers, 0..1")
    add("--seconds", float, "stop after this time", low=0)


def run(args: Any) -> dict[str, Any]:
    """Serve until interrupted; returns the mapping that ``--json`` prints."""
    task = grasping.GraspTask(force_N=args.force, closed=args.state == "closed", fill=args.fill)
    views = viewer.open_views(args.files, task)
    with viewer.BrowsePage(views, args.port) as page:
        url, names = page.url, page.names
        args.report(f"{url} shows {', '.join(names)}; Ctrl-C ends it")
        page.show()
        wait(args)
    return {"url": url, "views": list(names)}


def wait(args: Any) -> None:
    """Until ``--seconds`` have passed, where the verb has it, or Ctrl-C.

    Parameters
    ----------
    args
        With ``seconds`` [s], ``None``, or without.
    """
    try:
        seconds = getattr(args, "seconds", None)
        end_s = float("inf") if seconds is None else time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.5))
    except KeyboardInterrupt:
        args.report("stopped")
