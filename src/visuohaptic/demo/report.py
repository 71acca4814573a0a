"""The report of the demo: one page with every chapter, its reason, its figures and its numbers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ..report.html_report import Report
from .judge import Claim
from .story import ChapterOutcome, ChapterResult, Measure, Story

_YES_NO = {True: "yes", False: "no", None: ""}

#: What a claim of each kind states of its object; unit, factor from SI units, and decimals of a number.
_CLAIMS = {
    "place": ("position", "m", 1.0, 2),
    "foot": ("position of its foot", "mm", 1e3, 1),
    "friction": ("static friction", "N", 1.0, 2),
    "fixed": ("is fixed", "", 1.0, 0),
    "withstood": ("withstood the lower bound of its tag", "", 1.0, 0),
    "shape": ("rms error of its outline", "mm", 1e3, 1),
    "height": ("height", "mm", 1e3, 0),
    "fill": ("fill", "%", 1e2, 0),
    "mass": ("mass", "g", 1e3, 1),
    "force": ("rms error of a force", "mN", 1e3, 0),
    "grip": ("is held by the grasp", "", 1.0, 0),
}

#: Unit of a small value -> display unit, and the limit up to which it is used; for errors it always is.
_SMALL = {"m": ("mm", 1e3, 0.1), "N": ("mN", 1e3, 0.1), "kg": ("g", 1e3, 1.0)}


def write_story(story: Story, path: Path | str) -> Path:
    """Write the report as one self-contained HTML file.

    Parameters
    ----------
    story
        The run.
    path
        Path of the HTML file.
    """
    whole, summary = len(story.chapters) > 4, story.summary()
    report = Report(
        "A robot looks, touches and remembers" if whole else "Part of the mission",
        about=f"{summary[0].upper()}{summary[1:]}. Seed {story.mission.seed}, {story.duration_s:.0f} s of computing. "
        'Everything here is simulated. The column "truth" is the state of the simulated world, '
        "which the robot never sees.",
    )
    report.section("Overview")
    report.table([_row(number, one) for number, one in enumerate(story.chapters, 1)])
    if story.mission.fault is not None:
        report.text(f"A fault was switched on: {story.mission.fault.value.replace('_', ' ')}.")
    for number, one in enumerate(story.chapters, 1):
        if one.outcome is ChapterOutcome.SKIPPED:
            continue
        report.section(f"{number}. {one.title}")
        verb = "Done" if one.done else "Failed"
        report.text(f"{verb}: {one.reason}.")
        if one.claims:
            report.table([_claim_row(claim) for claim in one.claims])
        if one.measures:
            report.table(
                [
                    dict(zip(("quantity", "measured", "truth"), measure_texts(m), strict=True))
                    for m in one.measures
                ]
            )
        for picture in one.pictures:
            if isinstance(picture.content, np.ndarray):
                report.image(picture.content, picture.caption)
            else:
                report.figure(picture.content, picture.caption)
    return report.write(path)


def _row(number: int, one: ChapterResult) -> dict[str, Any]:
    return {
        "chapter": f"{number}. {one.title}",
        "outcome": one.outcome.value,
        "reason": one.reason,
        "correct": _YES_NO[one.correct],
        "time [s]": f"{one.duration_s:.0f}",
    }


def _claim_row(claim: Claim) -> dict[str, Any]:
    what, unit, factor, decimals = _CLAIMS.get(claim.kind, (claim.kind, "", 1.0, 0))

    def shown(value: Any) -> str:
        numbers = value if isinstance(value, tuple) else (value,)
        if not unit or isinstance(value, (str, bool)):
            return ", ".join(map(_shown, numbers))
        # Adding 0 turns a rounded -0 into 0.
        return ", ".join(f"{round(factor * number, decimals) + 0.0:.{decimals}f}" for number in numbers)

    sigma = f" \u00b1 {shown(claim.sigma)}" if math.isfinite(claim.sigma) else ""
    return {
        "claim": f"{claim.what}: {what}" + (f" [{unit}]" if unit else ""),
        "reported": shown(claim.value) + sigma,
        "probability": f"{claim.forecast:.3f}",
        "truth": shown(claim.truth),
        "correct": _YES_NO[claim.correct],
    }


def measure_texts(measure: Measure) -> tuple[str, str, str]:
    """Quantity, value and ground truth in a suitable unit.

    Parameters
    ----------
    measure
        Measure with its unit in square brackets at the end of its name.
    """
    name, values = measure.what, [measure.estimate, measure.truth]
    what, _, unit = name.removesuffix("]").rpartition(" [")
    numbers = [abs(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    smaller, factor, limit = _SMALL.get(unit, ("", 1.0, 0.0))
    if numbers and smaller and ("error" in what or max(numbers) <= limit):
        name = f"{what} [{smaller}]"
        values = [factor * v if isinstance(v, (int, float)) else v for v in values]
    return name, _shown(values[0]), _shown(values[1])


def _shown(value: Any) -> str:
    if value is None:
        return "\u2013"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return "\u221e" if value == math.inf else f"{value:.3g}"
    return str(value)
