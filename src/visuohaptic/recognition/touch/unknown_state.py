"""Posterior of states and of "none of them", from how well each explains every piece of evidence.

Evidence comes in pieces i of n_i numbers, as one squeeze or one weight. State s explains a piece with a
Gaussian whose chi-square is q_si. What is unknown has, in the piece that s explains worst, a broad density: as high everywhere as that of s is where a test with the stated false-alarm rate
just rejects it,

    log p(y | like s, but unknown) = log p(y | s) + (q_si - Q_i) / 2,

with Q_i the quantile of chi-square with n_i degrees of freedom at 1 - alpha / m for m pieces (Bonferroni).
So a state at the limit of its test is as probable as the unknown, and one far beyond it has no probability
left, however much worse the other states are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

__all__ = ["FALSE_ALARM", "posterior_with_unknown"]

#: Probability that what the model does know is rejected.
FALSE_ALARM = 1e-3


def posterior_with_unknown(
    log_likelihood: Float[np.ndarray, "s"],
    chi2: Float[np.ndarray, "s m"],
    freedom: Int[np.ndarray, "m"],
    *,
    false_alarm: float = FALSE_ALARM,
) -> tuple[Float[np.ndarray, "s"], float]:
    """Probabilities of the states, and that it is none of them; together 1.

    Parameters
    ----------
    log_likelihood
        Of all evidence, by state.
    chi2
        Of every piece, by state.
    freedom
        Numbers in every piece.
    false_alarm
        alpha, over all pieces together.
    """
    from scipy.stats import chi2 as chi2_distribution

    limit = chi2_distribution.isf(false_alarm / len(freedom), freedom)
    worst = 0.5 * (chi2 - limit).max(axis=1)
    parts = np.concatenate([log_likelihood, log_likelihood + worst])
    fraction = np.exp(parts - parts.max())
    fraction /= fraction.sum()
    known = len(log_likelihood)
    return fraction[:known], float(fraction[known:].sum())
