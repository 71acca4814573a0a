"""The report of the story: one page with every chapter, its reason, its figures and its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..report.html_report import Report
from .story import ChapterOutcome, ChapterResult, Story

__all__ = ["write_story"]

_RIGHT = {True: "true", False: "not true", None: ""}


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
        if one.measures:
            report.table(
                [{"what": m.what, "ours": _shown(m.ours), "truth": _shown(m.truth)} for m in one.measures]
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
        "ended": one.outcome.value,
        "why": one.reason,
        "claim": _RIGHT[one.right],
        "s": f"{one.duration_s:.0f}",
    }


def _shown(value: Any) -> str:
    if value is None:
        return "\u2013"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (int, float)):
        return f"{value:.3g}"
    return str(value)
