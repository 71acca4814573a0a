"""``visuohaptic classify run``: what an object is, from touches, and what to touch next."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..errors import InputError

__all__ = ["EPILOG", "HELP", "add_arguments", "run"]

HELP = "Say what an object is from measured curves, and what to touch next."
EPILOG = """\
reads   a tree of classify train with its .npz, and a CSV file of curves with the columns
          height (1..16), side (x+, x-, y+, y-), force_N, deformation_m [, width_m]
        or, with --ask, lines on stdin after each question: stiffness of both sides [N/m]
        and perhaps the width [m], as: 5200 5150 0.071
writes  the probabilities of the classes to stdout

example: visuohaptic classify run tree.json curves.csv --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("tree", type=Path, help="tree.json of classify train")
    parser.add_argument("curves", type=Path, nargs="?", help="CSV file of measured curves")
    parser.add_argument("--ask", action="store_true", help="ask for one touch after the other")
    parser.add_argument("--confidence", type=float, default=0.99, help="wanted probability (0.99)")
    parser.add_argument("--most", type=int, default=10, help="touches with --ask")
    parser.add_argument("--no-width", action="store_true", help="do not use widths as evidence")
    parser.add_argument("--force-noise", type=float, default=0.1, help="of one sample [N]")
    parser.add_argument("--deformation-noise", type=float, default=1e-4, help="of one sample [m]")
    parser.add_argument(
        "--prior", action="append", default=[], metavar="CLASS=SHARE", help="of vision; may be repeated"
    )
    parser.add_argument("--state", type=Path, help="state.json of this object: say its state, too")


def run(args: Any) -> dict[str, Any]:
    """Classify; the mapping is what ``--json`` prints."""
    from ..recognition import believe, next_touch, read_curves, stiffness_grid, touch_gains
    from ..recognition.classifier_file import load_classifier
    from ..recognition.readings import SensorNoise

    if bool(args.curves) == args.ask:
        raise InputError("classify run", "expected either a file of curves or --ask")
    if not 0 < args.confidence <= 1:
        raise InputError("--confidence", f"found {args.confidence}, expected 0 to 1")
    if not (0 < args.force_noise < 1e3 and 0 <= args.deformation_noise < 0.1):
        raise InputError(
            "--force-noise", "expected more than 0 N, and a deformation noise of less than 0.1 m"
        )
    found = load_classifier(args.tree)
    prior = dict(_prior(text) for text in args.prior) or None
    model = found.model(use_width=not args.no_width, prior=prior)
    if args.ask:
        readings = _asked(args, model)
    else:
        readings = read_curves(args.curves, SensorNoise(args.force_noise, args.deformation_noise))
    belief = believe(model, readings)
    wanted, node = next_touch(found.tree, stiffness_grid(readings))
    gains = touch_gains(model, readings)
    best = max(gains, key=lambda one: gains[one][0] / gains[one][1]) if gains else None
    sure = belief.confidence >= args.confidence
    result: dict[str, Any] = {
        "answer": belief.answer,
        "confidence": belief.confidence,
        "sure": sure,
        "probabilities": belief.as_mapping(),
        "touches": [f"{reading.axis}{reading.height}" for reading in readings],
        "next_touch": None
        if best is None or sure
        else {"touch": f"{best[1]}{best[0]}", "information_nat": gains[best][0], "seconds": gains[best][1]},
        "tree": {
            "answer": found.tree.classes[int(found.tree.answer[node])] if wanted is None else None,
            "next_touch": None if wanted is None else f"{wanted[1]}{wanted[0]}",
        },
        "state": None,
    }
    if args.state:
        from ..recognition.state import load_state_model, state_probability

        states = load_state_model(args.state)
        result["state"] = state_probability(states, readings)
    return result


def _asked(args: Any, model: Any) -> tuple[Any, ...]:
    from ..recognition.bayes import explore
    from ..recognition.readings import CurveFit, TouchReading

    def touch(height: int, axis: str) -> TouchReading:
        sys.stderr.write(f"touch {axis}{height}: stiffness of {axis}+ and {axis}- [N/m], width [m]? ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        words = line.split()
        try:
            numbers = [float(word) for word in words]
        except ValueError as error:
            raise InputError("stdin", f"found {line.strip()!r}, expected numbers") from error
        if len(numbers) not in (2, 3) or not all(0 < value < 1e12 for value in numbers):
            raise InputError(
                "stdin", f"found {line.strip()!r}, expected two stiffnesses, and perhaps a width"
            )
        sides = [
            CurveFit(value, value, float("nan"), model.protocol.relative_sigma(value), float("nan"))
            for value in numbers[:2]
        ]
        width = numbers[2] if len(numbers) > 2 else float("nan")
        return TouchReading(height, axis, (sides[0], sides[1]), width)

    return explore(
        model, touch, confidence=args.confidence, most_touches=args.most, least_touches=min(2, args.most)
    ).readings


def _prior(text: str) -> tuple[str, float]:
    name, _, share = text.rpartition("=")
    try:
        return name, float(share)
    except ValueError as error:
        raise InputError("--prior", f"found {text!r}, expected CLASS=SHARE") from error
