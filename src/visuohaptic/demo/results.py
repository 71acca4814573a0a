"""The result of a chapter: outcome, reason, claims, numbers and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import UInt8

from .judge import Claim

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class ChapterOutcome(StrEnum):
    """Outcome of a chapter."""

    DONE = "done"
    FAILED = "failed"
    SKIPPED = "skipped"  #: a required chapter has not provided its results


@dataclass(frozen=True, slots=True)
class Measure:
    """A number with its true value."""

    what: str  #: with unit
    estimate: float | bool | str | None
    truth: float | bool | str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Illustration:
    """A figure or an annotated frame for the report."""

    content: Figure | UInt8[np.ndarray, "rows columns *colour"]
    caption: str


@dataclass(frozen=True, slots=True, eq=False)
class ChapterResult:
    """Result of a chapter."""

    outcome: ChapterOutcome
    reason: str  #: one sentence with the decisive numbers
    claims: tuple[Claim, ...] = ()
    measures: tuple[Measure, ...] = ()
    pictures: tuple[Illustration, ...] = ()
    name: str = ""
    title: str = ""
    duration_s: float = 0.0  #: computing time

    @property
    def done(self) -> bool:
        """Whether the mission may continue."""
        return self.outcome is ChapterOutcome.DONE

    @property
    def correct(self) -> bool | None:
        """Whether all claims are correct; ``None`` without claims."""
        return all(claim.correct for claim in self.claims) if self.done and self.claims else None


def counted(count: int, one: str, many: str = "") -> str:
    """``1 push``, ``2 pushes``.

    Parameters
    ----------
    count
        Number of items.
    one, many
        Singular, and the plural if it is not formed with s.
    """
    return f"{count} {one if count == 1 else many or one + 's'}"


def done(reason: str, *parts: Any) -> ChapterResult:
    """Result of a successful chapter.

    Parameters
    ----------
    reason
        One sentence with the decisive numbers.
    *parts
        Claims, measures and illustrations in any order.
    """
    return _result(ChapterOutcome.DONE, reason, parts)


def failed(reason: str, *parts: Any) -> ChapterResult:
    """Result of a chapter that failed.

    Parameters
    ----------
    reason
        One sentence with the cause.
    *parts
        Measures and illustrations in any order; a failed chapter has no claims.
    """
    return _result(ChapterOutcome.FAILED, reason, parts)


def _result(outcome: ChapterOutcome, reason: str, parts: Sequence[Any]) -> ChapterResult:
    # A claim with a probability below 0.5 is omitted.
    claims = tuple(part for part in parts if isinstance(part, Claim) and part.forecast >= 0.5)
    measures = tuple(part for part in parts if isinstance(part, Measure))
    pictures = tuple(part for part in parts if isinstance(part, Illustration))
    return ChapterResult(outcome, reason, claims, measures, pictures)
