"""Weights of visual evidence, estimated from examples (maximum a posteriori with the log loss as likelihood)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from visuohaptic.core import InputError
from visuohaptic.recognition.touch import UNKNOWN
from visuohaptic.recognition.visual import PriorSettings, VisualPrior, posterior

__all__ = ["Example", "calibrate_prior"]


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """An observation and its true object, for calibration."""

    truth: str  #: id, or :data:`UNKNOWN`
    image: UInt8[np.ndarray, "height width *colours"] | None = None
    cloud: Float[np.ndarray, "n 3"] | None = None
    context: tuple[str, ...] = ()


def calibrate_prior(prior: VisualPrior, examples: Sequence[Example]) -> PriorSettings:
    """Weights of evidence with the smallest mean log loss of the examples; assign to ``prior.settings``.

    Parameters
    ----------
    prior
        With the objects of the examples.
    examples
        Looks that were not stored themselves, with unknown objects among them in about the fraction that is
        expected later: it becomes the prior of unknown. Only the worth of evidence that occurs in them is
        changed.
    """
    names = [*prior.entries, UNKNOWN]
    for one in examples:
        if one.truth not in names:
            raise InputError(
                "examples",
                f"found the truth {one.truth!r}, which is not stored",
                remedy=f"call it {UNKNOWN!r}",
            )
    if len(examples) < 10:
        raise InputError("examples", f"found {len(examples)}, expected 10 or more")
    looks = [prior.evidence(one.image, one.cloud, one.context) for one in examples]
    truth = [names.index(one.truth) for one in examples]
    with_image = any(np.isfinite(look.log_matches).any() for look in looks)
    with_shape = any(np.isfinite(look.log_residual).any() for look in looks)
    unknowns = sum(one.truth == UNKNOWN for one in examples)
    old = replace(prior.settings, unknown_prior=(unknowns + 1) / (len(examples) + 2))
    if with_shape:
        # From 14 on nothing is cut off: the gradient is zero and the search would not decrease it.
        old = replace(old, max_residual_penalty=min(old.max_residual_penalty, 3.0))
    names_free = ["matches_exponent", "matches_neutral", "no_match_penalty"] * with_image
    names_free += ["residual_exponent", "residual_neutral_m", "max_residual_penalty"] * with_shape
    if not names_free:
        raise InputError("examples", "found no image and no cloud that says anything")

    def settings(logs: np.ndarray) -> PriorSettings:
        changes: dict[str, Any] = {n: float(np.exp(x)) for n, x in zip(names_free, logs, strict=True)}
        return replace(old, **changes)

    def loss(logs: np.ndarray) -> float:
        now = settings(logs)
        fractions = [posterior(look, now)[i] for look, i in zip(looks, truth, strict=True)]
        # The most probable values, where each is expected within a factor of e of where it starts:
        # a few examples must not lead to extreme weights.
        pull = 0.5 * float(np.sum((logs - start) ** 2)) / len(looks)
        return float(-np.mean(np.log(np.maximum(fractions, 1e-9)))) + pull

    from scipy.optimize import minimize

    start = np.log([getattr(old, name) for name in names_free])
    found = minimize(loss, start, method="Nelder-Mead", options={"maxfev": 400, "xatol": 0.01, "fatol": 1e-5})
    return settings(found.x)
