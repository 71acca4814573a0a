"""The whole story in one run: look, touch, remember, plan, push, arrive, complete, squeeze, recognise, grasp."""

from .chapters import CHAPTERS, PARTS, run_mission
from .report import write_story
from .story import Chapter, ChapterResult, Measure, Mission, Outcome, Story, tell

__all__ = [
    "CHAPTERS",
    "PARTS",
    "Chapter",
    "ChapterResult",
    "Measure",
    "Mission",
    "Outcome",
    "Story",
    "run_mission",
    "tell",
    "write_story",
]
