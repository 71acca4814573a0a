"""Evaluation of a run: every claim of the robot is compared with ground truth, by the rules of this file.

A claim is a value with its declared certainty: a probability, or a standard deviation. A rule defines the
tolerance of a value from its use, not from the declared certainty. With both, every
claim is the forecast of an event: "this is correct, with probability p". For a Gaussian error of deviation s and a
tolerance t that is ``erf(t / (s sqrt 2))`` for a number, and ``1 - exp(-t^2 / (2 s^2))`` for a position in the plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

#: A wrong claim with a higher probability is a confident error.
CONFIDENT_PROBABILITY = 0.98


@dataclass(frozen=True, slots=True)
class ClaimTolerance:
    """Tolerance of a value; without both fields it has to be equal."""

    tolerance: float = 0.0  #: in the unit of the value
    fraction: float = 0.0  #: relative to the true value; the larger tolerance counts

    def allowed(self, truth: Any) -> float:
        """Tolerance for a true value, in its unit.

        Parameters
        ----------
        truth
            Value in the simulated world.
        """
        size = abs(truth) if isinstance(truth, (int, float)) else 0.0
        return max(self.tolerance, self.fraction * size)


RULES: dict[str, ClaimTolerance] = {
    # A platform of 34 cm is led through doors of 90 cm, and reaches a table from a distance of 15 cm.
    "place": ClaimTolerance(tolerance=0.10),
    # A hand that closes on an object moves it to its centre from 2 cm off.
    "foot": ClaimTolerance(tolerance=0.02),
    # A push is planned with a margin of 10 % of its force; the foam's noise is at least 0.1 N.
    "friction": ClaimTolerance(tolerance=0.1, fraction=0.10),
    "fixed": ClaimTolerance(),
    "withstood": ClaimTolerance(),
    # Fingers open a centimetre wider than an outline: half of it on either side.
    "shape": ClaimTolerance(tolerance=0.005),
    "height": ClaimTolerance(tolerance=0.008),
    "transparent": ClaimTolerance(),
    "class": ClaimTolerance(),
    "lid": ClaimTolerance(),
    "fill": ClaimTolerance(tolerance=0.15),
    # A grip has a safety factor of two for the mass.
    "mass": ClaimTolerance(tolerance=0.005, fraction=0.10),
    # A touch is detected from 0.4 N on.
    "force": ClaimTolerance(tolerance=0.1),
    "grip": ClaimTolerance(),
    "requested": ClaimTolerance(),
}


@dataclass(frozen=True, slots=True)
class Claim:
    """A claim of the robot with its declared certainty, and the true value."""

    kind: str  #: a name of ``RULES``
    what: str  #: the object
    value: float | str | bool | tuple[float, float]
    truth: float | str | bool | tuple[float, float]  #: filled in from the simulated world
    sigma: float = math.nan  #: declared standard deviation of a number, or of each coordinate of a position
    probability: float = math.nan  #: declared probability; with neither, the claim has probability 1

    @property
    def correct(self) -> bool:
        """Whether it is correct by the rule of its kind."""
        allowed = RULES[self.kind].allowed(self.truth)
        if isinstance(self.value, (str, bool)):
            return self.value == self.truth
        return self.error <= allowed

    @property
    def error(self) -> float:
        """Error of a number or position, in its unit; 0 or 1 for a name."""
        if isinstance(self.value, tuple) and isinstance(self.truth, tuple):
            return math.dist(self.value, self.truth)
        if isinstance(self.value, (int, float)) and isinstance(self.truth, (int, float)):
            return abs(float(self.value) - float(self.truth))
        return float(self.value != self.truth)

    @property
    def forecast(self) -> float:
        """Declared probability that the claim is correct."""
        if math.isfinite(self.probability):
            return self.probability
        if not (math.isfinite(self.sigma) and self.sigma > 0):
            return 1.0
        ratio = RULES[self.kind].allowed(self.value) / self.sigma
        if isinstance(self.value, tuple):
            return 1.0 - math.exp(-0.5 * ratio**2)
        return math.erf(ratio / math.sqrt(2.0))

    @property
    def confidently_wrong(self) -> bool:
        """Wrong, and claimed with a probability above ``CONFIDENT_PROBABILITY``."""
        return not self.correct and self.forecast > CONFIDENT_PROBABILITY

    def as_row(self) -> list[Any]:
        """Kind, object, value, truth, forecast and correctness, for JSON."""
        return [self.kind, self.what, self.value, self.truth, round(self.forecast, 6), self.correct]


class RunOutcome(StrEnum):
    """Result of a run."""

    COMPLETE = "complete"  #: all chapters completed, all claims correct
    HONEST_FAILURE = "honest failure"  #: reports a failure, and all its claims are correct
    WRONG = "wrong"  #: a claim is wrong

    @classmethod
    def of(cls, claims: Iterable[Claim], complete: bool) -> RunOutcome:
        """Result from the claims, and from completeness.

        Parameters
        ----------
        claims
            Claims of all completed chapters.
        complete
            Whether no chapter failed.
        """
        if not all(claim.correct for claim in claims):
            return cls.WRONG
        return cls.COMPLETE if complete else cls.HONEST_FAILURE
