"""What of a run is true: every claim of the robot beside the truth of the simulated world, by the rules of this file.

A claim is a value with what the robot says of its certainty: a probability, or a standard deviation. A rule says how
far off a value may be and still be right, by what the value is used for, never by what was declared. With both, every
claim is the forecast of an event: "this is right, with probability p". For a Gaussian error of deviation s and a
tolerance t that is ``erf(t / (s sqrt 2))`` for a number, and ``1 - exp(-t^2 / (2 s^2))`` for a place in the plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

__all__ = ["RULES", "SURE", "Claim", "RunOutcome"]

#: A wrong claim of at least this probability is a wrong one beyond excuse.
SURE = 0.98


@dataclass(frozen=True, slots=True)
class Rule:
    """How far off a value may be; nothing of both: it has to be the same."""

    tolerance: float = 0.0  #: in the unit of the value
    fraction: float = 0.0  #: of the truth; the larger of both counts

    def allowed(self, truth: Any) -> float:
        """Of a truth, in its unit.

        Parameters
        ----------
        truth
            Of the simulated world.
        """
        size = abs(truth) if isinstance(truth, (int, float)) else 0.0
        return max(self.tolerance, self.fraction * size)


RULES: dict[str, Rule] = {
    # A platform of 34 cm is led through doors of 90 cm, and serves a table from 15 cm off.
    "place": Rule(tolerance=0.10),
    # A hand that closes on an object brings it to its middle from 2 cm off.
    "foot": Rule(tolerance=0.02),
    # A push is planned with a margin of 10 % of its force; the foam's noise is 0.1 N at least.
    "friction": Rule(tolerance=0.1, fraction=0.10),
    "fixed": Rule(),
    "withstood": Rule(),
    # Fingers open a centimetre wider than an outline: half of it on either side.
    "shape": Rule(tolerance=0.005),
    "height": Rule(tolerance=0.008),
    "class": Rule(),
    "lid": Rule(),
    "fill": Rule(tolerance=0.15),
    # A grip has a margin of two for the mass.
    "mass": Rule(tolerance=0.005, fraction=0.10),
    # A touch is felt from 0.4 N on.
    "force": Rule(tolerance=0.1),
    "grip": Rule(),
    "changed": Rule(),
}


@dataclass(frozen=True, slots=True)
class Claim:
    """What the robot says, how sure it says to be, and what is true."""

    kind: str  #: a name of ``RULES``
    what: str  #: the object
    value: float | str | bool | tuple[float, float]
    truth: float | str | bool | tuple[float, float]  #: filled in by the simulated world alone
    sigma: float = math.nan  #: declared standard deviation of a number, or of either coordinate of a place
    probability: float = math.nan  #: declared; with neither of both it is said without reserve

    @property
    def right(self) -> bool:
        """By the rule of its kind."""
        allowed = RULES[self.kind].allowed(self.truth)
        if isinstance(self.value, (str, bool)):
            return self.value == self.truth
        return self.error <= allowed

    @property
    def error(self) -> float:
        """Of a number or place, in its unit; 0 or 1 of a name."""
        if isinstance(self.value, tuple) and isinstance(self.truth, tuple):
            return math.dist(self.value, self.truth)
        if isinstance(self.value, (int, float)) and isinstance(self.truth, (int, float)):
            return abs(float(self.value) - float(self.truth))
        return float(self.value != self.truth)

    @property
    def forecast(self) -> float:
        """Probability by which the robot says that it is right."""
        if math.isfinite(self.probability):
            return self.probability
        if not (math.isfinite(self.sigma) and self.sigma > 0):
            return 1.0
        ratio = RULES[self.kind].allowed(self.value) / self.sigma
        if isinstance(self.value, tuple):
            return 1.0 - math.exp(-0.5 * ratio**2)
        return math.erf(ratio / math.sqrt(2.0))

    @property
    def wrong_and_sure(self) -> bool:
        """Not right, and said with more than ``SURE``."""
        return not self.right and self.forecast > SURE

    def as_row(self) -> list[Any]:
        """Kind, object, value, truth, forecast and whether it is right, as JSON has them."""
        return [self.kind, self.what, self.value, self.truth, round(self.forecast, 6), self.right]


class RunOutcome(StrEnum):
    """What became of a run."""

    COMPLETE = "complete"  #: all chapters done, all claims right
    HONEST_FAILURE = "honest failure"  #: it says where it failed, and all that it claims is right
    WRONG = "wrong"  #: something that it claims is not so

    @classmethod
    def of(cls, claims: Iterable[Claim], complete: bool) -> RunOutcome:
        """By its claims, and whether all was done.

        Parameters
        ----------
        claims
            Of all chapters that are done.
        complete
            Whether no chapter failed.
        """
        if not all(claim.right for claim in claims):
            return cls.WRONG
        return cls.COMPLETE if complete else cls.HONEST_FAILURE
