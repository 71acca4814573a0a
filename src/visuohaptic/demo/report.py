"""The report of the story: one page with every chapter, its reason, its figures and its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..report.html_report import Report
from .judge import Claim
from .story import ChapterOutcome, ChapterResult, Measure, Story

__all__ = ["measure_texts", "write_story"]

_RIGHT = {True: "yes", False: "no", None: ""}

#: Unit of a small value -> the unit that it is shown in, and below which value.
_SMALL = {"m": ("mm", 1e3, 0.1), "N": ("mN", 1e3, 0.1), "kg": ("g", 1e3, 1.0)}


def write_story(story: Story, path: Path | str) -> Path:
    """Write the report as one HTML file that needs nothing else.

    Parameters
    ----------
    story
        The run.
    path
        Of the HTML file.
    """
    whole = len(story.chapters) > 4
    report = Report(
        "A robot looks, touches and remembers" if whole else "Part of the mission",
        about=f"{story.summary()}. Seed {story.mission.seed}, {story.duration_s:.0f} s of computing. "
        "Everything here is simulated; what stands beside a number as the truth is the simulated world's, "
        "which the robot never sees.",
    )
    report.section("The story")
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
        "true": _RIGHT[one.right],
        "time [s]": f"{one.duration_s:.0f}",
    }


def _claim_row(claim: Claim) -> dict[str, Any]:
    said, truth = (
        ", ".join(map(_shown, value)) if isinstance(value, tuple) else _shown(value)
        for value in (claim.value, claim.truth)
    )
    return {
        "claim": f"{claim.kind} of {claim.what}",
        "said": said,
        "probability": f"{claim.forecast:.3f}",
        "truth": truth,
        "right": _RIGHT[claim.right],
    }


def measure_texts(measure: Measure) -> tuple[str, str, str]:
    """Quantity, value and truth in a unit that fits them.

    Parameters
    ----------
    measure
        With its unit in square brackets at the end of its name.
    """
    name, values = measure.what, [measure.ours, measure.truth]
    what, _, unit = name.removesuffix("]").rpartition(" [")
    numbers = [abs(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if unit in _SMALL and numbers and max(numbers) < _SMALL[unit][2]:
        smaller, factor, _ = _SMALL[unit]
        name = f"{what} [{smaller}]"
        values = [factor * v if isinstance(v, (int, float)) else v for v in values]
    return name, _shown(values[0]), _shown(values[1])


def _shown(value: Any) -> str:
    if value is None:
        return "\u2013"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return f"{value:.3g}"
    return str(value)
