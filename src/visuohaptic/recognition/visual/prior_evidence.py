"""Combination of visual evidence: odds of stored objects against an object that is not stored.

With the prior pi_i of object i, the number n of consistent matches of its best image, and the residual r of its
shape to the cloud, the odds against an object that is not stored are

    pi_i / pi_unknown * ((1 + n) / (1 + n_0)) ** a * (r_0 / r) ** b * prod_w P(w | i) / P(w)

over the words w of the scene's context; without consistent matches, exp(-c) replaces the first power: blur and
occlusion remove all matches at once, so that zero matches are a separate case. The second power is at least
exp(-d): ICP occasionally fails on the right object. The exponents a, b, the neutral points n_0, r_0, c and d are
fitted to examples by their log loss, so that probabilities are calibrated. Missing evidence, such as an object without
an image, does not change the odds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True)
class PriorSettings:
    """Computational effort, and weights of the evidence; the latter fitted to labelled examples."""

    features: int = 300  #: maximum number of local features of an image
    words: int = 4096  #: maximum size of the vocabulary
    images_checked: int = 20  #: number of best images by words that are verified geometrically
    shapes_checked: int = 12  #: number of best shapes by descriptor that are registered by ICP
    views_checked: int = 2  #: number of views of each of these
    unknown_prior: float = 0.1  #: prior probability that an object is not stored
    matches_exponent: float = 7.0  #: a
    matches_neutral: float = 4.7  #: n_0; fewer than 6 matches are counted as none
    no_match_penalty: float = 2.2  #: c
    residual_exponent: float = 6.0  #: b
    residual_neutral_m: float = 0.002  #: r_0
    max_residual_penalty: float = 14.0  #: d; the failure rate of ICP is estimated from examples
    max_log_odds: float = 14.0  #: maximum absolute log odds of image or shape alone
    context_weight: float = 2.0  #: number of sightings that the average of all objects is equivalent to


@dataclass(frozen=True, slots=True, eq=False)
class VisualEvidence:
    """Evidence of one observation before weighting; one value for each stored object."""

    log_prior: Float[np.ndarray, "objects"]  #: with the context; without the probability of unknown
    log_matches: Float[np.ndarray, "objects"]  #: log(1 + n); NaN for no evidence
    matches_weight: float  #: 0..1, small if the image has few features
    log_residual: Float[np.ndarray, "objects"]  #: log(r / m); NaN for no evidence
    poses: Mapping[int, Float[np.ndarray, "4 4"]]


def posterior(evidence: VisualEvidence, settings: PriorSettings) -> Float[np.ndarray, "objects_and_unknown"]:
    """Probability of each stored object and, last, of an unknown one.

    Parameters
    ----------
    evidence
        Evidence of one observation, see :meth:`.VisualPrior.evidence`.
    settings
        Weights of the evidence.
    """
    most = settings.max_log_odds
    image = settings.matches_exponent * (evidence.log_matches - np.log1p(settings.matches_neutral))
    image = np.where(evidence.log_matches == 0, -settings.no_match_penalty, image)
    image = np.where(image < 0, evidence.matches_weight * image, image)
    shape = settings.residual_exponent * (np.log(settings.residual_neutral_m) - evidence.log_residual)
    shape = np.maximum(shape, -settings.max_residual_penalty)
    odds = evidence.log_prior + np.log1p(-settings.unknown_prior)
    for part in (image, shape):
        odds = odds + np.clip(np.nan_to_num(part, nan=0.0), -most, most)
    score = np.append(odds, np.log(settings.unknown_prior))
    score = np.exp(score - score.max())
    return np.asarray(score / score.sum())
