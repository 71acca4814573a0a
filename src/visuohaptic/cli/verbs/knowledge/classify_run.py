"""``visuohaptic classify run``: classify an object from touches, and plan the next touch.

reads   a classifier of `classify train`, and a CSV file of curves with the columns
          height (1..16), side (x+, x-, y+, y-), force_N, deformation_m [, width_m, object_height_m]
        or a folder of published compressions, with the print to classify as --object;
        or, with --ask, one line on stdin per question: stiffness of both sides [N/m]
        and optionally the width [m], for example: 5200 5150 0.071
writes  the class probabilities to stdout; with --view, a page that shows the tree and the planned touches
        as they arrive, until Ctrl-C; with --steps, the steps through the tree for `visuohaptic view`

example: visuohaptic classify run tree.json curves.csv --json
         visuohaptic classify run tree.json --ask --view
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .... import recognition, viewer
from ....core import files
from ....core.errors import InputError


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("tree", Path, ".json of classify train")
    add("curves", Path, "CSV file of measured curves, or folder of compressions", nargs="?")
    add("--object", str, "print of a folder of compressions", metavar="NAME")
    add("--ask", bool, "ask for one touch after the other")
    add("--confidence", 0.99, "probability at which to stop (0.99)", low=0, high=1, above=True)
    add("--max-touches", 10, "maximum number of touches with --ask (10)")
    add("--no-width", bool, "do not use widths as evidence")
    add("--force-noise", 0.1, "standard deviation of one force sample [N]", low=0, high=1e3, above=True)
    add("--deformation-noise", 1e-4, "standard deviation of one deformation sample [m]", low=0, high=0.1)
    add("--prior", list, "probability of a class from vision; may be repeated", metavar="CLASS=PROBABILITY")
    add("--state", Path, "state.json of this object: also estimate its state")
    add("--view", bool, "show the touches in the browser")
    add("--port", 8080, "port of --view on 127.0.0.1", low=0, high=65535)
    add("--seconds", float, "close the page after this time [s] (default: at Ctrl-C)", low=0)
    add("--steps", Path, "JSON file for the steps of the tree")


def run(args: Any) -> dict[str, Any]:
    """Classify; returns the mapping that ``--json`` prints."""
    if bool(args.curves) == args.ask:
        raise InputError("classify run", "expected either a file of curves or --ask")
    if args.object is not None and not (args.curves and args.curves.is_dir()):
        raise InputError(
            "--object", f"found {args.object!r} without a folder, expected a folder of compressions"
        )
    found = recognition.load_classifier(args.tree)
    prior = dict(_prior(text) for text in args.prior) or None
    readings: Any = ()
    if not args.ask:
        readings = _readings(args)
    # Without widths in the file the model omits this feature, and its confidence threshold differs, too.
    wide = args.ask or any(math.isfinite(reading.width_m) for reading in readings)
    model = found.model(use_width=wide and not args.no_width, prior=prior)
    if args.steps and args.steps.suffix != ".json":
        raise InputError("--steps", f"found {args.steps.name!r}, expected a name with .json")
    with _page(args, found.tree, model) as follow:
        if args.ask:
            readings = _interactive(args, model, follow)
        else:
            for count in range(1, len(readings) + 1):
                # Replay the touches one at a time.
                follow(readings[:count], None if count == len(readings) else _place_of(readings[count]))
        result = _result(args, found, model, readings)
        if args.steps:
            steps, answer = recognition.tree_steps(
                found.required_tree(), recognition.stiffness_grid(readings)
            )
            walked = {"steps": [list(step) for step in steps], "result": answer}
            files.write_text(args.steps, json.dumps(walked, indent=1) + "\n")
        if args.view:
            args.report(f"{result['answer']}: {result['confidence']:.3f}")
        if result["contradiction"]:
            args.report(result["contradiction"])
    return result


def _readings(args: Any) -> Any:
    """Touches of the file, or of one print of a folder of compressions."""
    if not args.curves.is_dir():
        noise = recognition.TouchNoise(args.force_noise, args.deformation_noise)
        return recognition.read_curves(args.curves, noise)
    known = {one.name: one for one in recognition.read_compressions(args.curves)}
    if args.object not in known:
        raise InputError(
            "--object", f"found {args.object!r}, expected one of the {len(known)} prints of {args.curves}"
        )
    return known[args.object].readings()


def _result(args: Any, found: Any, model: Any, readings: Any) -> dict[str, Any]:
    from ....recognition.touch.steps import contradicted_assumption

    belief = recognition.update_belief(model, readings)
    tree = found.tree
    requested, node = (
        (None, 0) if tree is None else recognition.next_touch(tree, recognition.stiffness_grid(readings))
    )
    gains = recognition.touch_gains(model, readings)
    best = max(gains, key=lambda one: gains[one][0] / gains[one][1]) if gains else None
    sure = belief.confidence >= args.confidence
    result: dict[str, Any] = {
        "answer": belief.answer,
        "confidence": belief.confidence,
        "confident": sure,
        "probabilities": belief.as_mapping(),
        "contradiction": contradicted_assumption(model, readings),
        "touches": [f"{reading.axis}{reading.height}" for reading in readings],
        "next_touch": None
        if best is None or sure
        else {"touch": f"{best[1]}{best[0]}", "information_nat": gains[best][0], "seconds": gains[best][1]},
        "tree": {
            "answer": tree.classes[int(tree.answer[node])]
            if tree is not None and requested is None
            else None,
            "next_touch": None if requested is None else f"{requested[1]}{requested[0]}",
        },
        "state": None,
    }
    if args.state:
        from ....recognition.touch.state import load_state_model, state_probability

        states = load_state_model(args.state)
        result["state"] = state_probability(states, readings)
    return result


@contextmanager
def _page(args: Any, tree: Any, model: Any) -> Iterator[Any]:
    """Listener of each touch; with --view a page that shows them, and stays open after the last one."""
    if not args.view:
        yield lambda readings, requested: None
        return
    from ..system.view import wait

    pages = [viewer.StepsView("planner")]
    tellers = [recognition.planner_follower(model, pages[0])]
    if tree is not None:
        pages.insert(0, viewer.StepsView("tree"))
        tell_tree = recognition.tree_follower(tree, pages[0])
        tellers.append(lambda readings, requested: tell_tree(recognition.stiffness_grid(readings)))

    def follow(readings: Any, requested: Any) -> None:
        for tell in tellers:
            tell(readings, requested)

    with viewer.BrowsePage(pages, args.port) as page:
        args.report(f"{page.url} shows the touches; Ctrl-C ends it")
        page.show()
        yield follow
        wait(args)


def _place_of(reading: Any) -> tuple[int, str]:
    return reading.height, reading.axis


def _interactive(args: Any, model: Any, follow: Any) -> tuple[Any, ...]:
    def touch(height: int, axis: str) -> recognition.TouchReading:
        sys.stderr.write(
            f"touch {axis}{height}: stiffness of {axis}+ and {axis}- [N/m], width, height of the object [m]? "
        )
        sys.stderr.flush()
        line = sys.stdin.readline()
        words = line.split()
        try:
            numbers = [float(word) for word in words]
        except ValueError as error:
            raise InputError("stdin", f"found {line.strip()!r}, expected numbers") from error
        if not 2 <= len(numbers) <= 4 or not all(0 < value < 1e12 for value in numbers):
            raise InputError(
                "stdin",
                f"found {line.strip()!r}, expected two stiffnesses, optionally followed by width and height",
            )
        sides = [
            recognition.CurveCoefficients(
                value, value, float("nan"), model.protocol.relative_sigma(value), float("nan")
            )
            for value in numbers[:2]
        ]
        return recognition.TouchReading(height, axis, (sides[0], sides[1]), *numbers[2:])

    return recognition.explore(
        model,
        touch,
        confidence=args.confidence,
        max_touches=args.max_touches,
        min_touches=min(2, args.max_touches),
        follow=follow,
    ).readings


def _prior(text: str) -> tuple[str, float]:
    name, _, fraction = text.rpartition("=")
    try:
        value = float(fraction)
    except ValueError as error:
        raise InputError("--prior", f"found {text!r}, expected CLASS=PROBABILITY") from error
    if not 0 <= value <= 1:
        raise InputError("--prior", f"found a probability of {fraction}, expected 0 to 1", field=name)
    return name, value
