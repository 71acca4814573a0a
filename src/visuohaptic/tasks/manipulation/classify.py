"""Classify an object and its state by squeezing at the most informative places (Alt 2016, Sec. 6.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

from ...core import InputError, require_members
from ..framework.trace import Ending, Trace
from .hand import Hand, Place
from .squeeze_task import SqueezeCurve, SqueezeOutcome, SqueezeSettings, squeeze


class SqueezeClassifier(Protocol):
    """Interface of a classifier with an exploration plan."""

    def next_place(self) -> Place | None:
        """Next place to squeeze; ``None`` if no place is informative."""

    def update(self, curve: SqueezeCurve) -> None:
        """Update the posterior with a squeeze.

        Parameters
        ----------
        curve
            Force over deformation at a requested place, or at one where the object was squeezed before.
        """

    def belief(self) -> Mapping[str, float]:
        """Posterior probability of every class; the sum is 1."""


class ClassifyOutcome(StrEnum):
    """How it ended."""

    RECOGNISED = "recognised"
    #: no class reached the confidence; the most probable one is reported without a claim
    UNDECIDED = "undecided"
    NOTHING_FELT = "nothing_felt"
    SENSOR_FAILED = "sensor_failed"


@dataclass(frozen=True, slots=True)
class ClassifySettings:
    """Stop criteria."""

    confidence: float = 0.9
    min_squeezes: int = 1  #: minimum number of squeezes before a class is accepted
    squeezes: int = 8  #: maximum number of squeezes
    misses: int = 2  #: number of consecutive places without contact, or a readable sensor, that ends the task
    squeeze: SqueezeSettings = field(default_factory=SqueezeSettings)

    def __post_init__(self) -> None:
        if not (0 < self.confidence <= 1 and 1 <= self.min_squeezes <= self.squeezes and self.misses >= 1):
            raise InputError(
                "ClassifySettings",
                f"found {self}, expected confidence in (0, 1], 1 <= min_squeezes <= squeezes, misses >= 1",
            )


@dataclass(frozen=True, slots=True, eq=False)
class Classification:
    """Result of a classification."""

    ending: Ending
    best: str  #: most probable class, only a claim if ``ending.success``; empty without any squeeze
    belief: Mapping[str, float]
    curves: tuple[SqueezeCurve, ...]
    traces: tuple[Trace, ...]  #: trace of every squeeze


def classify_by_squeezing(
    hand: Hand,
    classifier: SqueezeClassifier,
    settings: ClassifySettings | None = None,
    felt: Sequence[SqueezeCurve] = (),
) -> Classification:
    """Squeeze at the places requested by a classifier until a class reaches the confidence.

    Each squeeze is a :class:`~visuohaptic.tasks.manipulation.squeeze_task.SqueezeTask`.

    Parameters
    ----------
    hand
        Arm, gripper and sensor.
    classifier
        Plans the places and updates the posterior.
    settings
        Stop criteria.
    felt
        Squeezes of the object that it does not know yet, as far as their forces are those of a squeeze here.

    Raises
    ------
    InputError
        The classifier lacks a member of its protocol.
    """
    require_members(classifier, SqueezeClassifier, "classify_by_squeezing", "classifier")
    settings = settings or ClassifySettings()
    curves = list(felt)
    traces: list[Trace] = []
    missed = 0
    for one in felt:
        kept = one.force_N <= settings.squeeze.forces_N[-1]
        values = {name: getattr(one, name)[kept] for name in ("force_N", "deformation_m", "sigma_m")}
        classifier.update(replace(one, **values))

    def result(success: bool, outcome: ClassifyOutcome, why: str) -> Classification:
        belief = dict(classifier.belief())
        best = max(belief, key=lambda name: belief[name]) if belief and curves else ""
        return Classification(Ending(success, outcome.value, why), best, belief, tuple(curves), tuple(traces))

    while True:
        belief = classifier.belief()
        best = max(belief, key=lambda name: belief[name])
        if len(curves) >= settings.min_squeezes and belief[best] >= settings.confidence:
            why = f"{best} with {belief[best]:.2f} after {len(curves)} squeezes"
            return result(True, ClassifyOutcome.RECOGNISED, why)
        if len(traces) >= settings.squeezes or (place := classifier.next_place()) is None:
            break
        done = squeeze(hand, [place], settings.squeeze)
        traces.append(done.trace)
        if not done.ending.success:
            missed += 1
            if missed < settings.misses:
                continue
            if done.ending.outcome == SqueezeOutcome.SOME_MISSED:
                why = f"{missed} places in succession without contact"
                return result(False, ClassifyOutcome.NOTHING_FELT, why)
            return result(False, ClassifyOutcome.SENSOR_FAILED, f"{done.ending.outcome}: {done.ending.why}")
        missed = 0
        curves.extend(done.curves)
        classifier.update(done.curves[0])
    if not curves:
        return result(False, ClassifyOutcome.NOTHING_FELT, "no place could be measured")
    why = f"at best {belief[best]:.2f} after {len(curves)} squeezes"
    return result(False, ClassifyOutcome.UNDECIDED, why)
