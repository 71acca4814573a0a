"""Posterior of states and of "none of them", from the fit of each state to every piece of evidence.

Evidence consists of pieces i of n_i numbers, such as one squeeze or one weight. State s predicts a piece with a
Gaussian whose chi-square is q_si. For the piece that s predicts worst, the unknown state has a broad density: it is
everywhere that of s where a test with the stated false-alarm rate just rejects it,

    log p(y | like s, but unknown) = log p(y | s) + (q_si - Q_i) / 2,

with Q_i the quantile of chi-square with n_i degrees of freedom at 1 - alpha / m for m pieces (Bonferroni).
A state at the limit of its test is therefore as probable as the unknown state, and the probability of one far beyond it
vanishes, however much worse the other states are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

#: Probability that a known state is rejected.
FALSE_ALARM = 1e-3


def posterior_with_unknown(
    log_likelihood: Float[np.ndarray, "s"],
    chi2: Float[np.ndarray, "s m"],
    freedom: Int[np.ndarray, "m"],
    *,
    false_alarm: float = FALSE_ALARM,
) -> tuple[Float[np.ndarray, "s"], float]:
    """Probabilities of the states and of "none of them"; they sum to 1.

    Parameters
    ----------
    log_likelihood
        Of all evidence, by state.
    chi2
        Of every piece, by state.
    freedom
        Degrees of freedom (number of values) of every piece.
    false_alarm
        alpha, for all pieces together.
    """
    from scipy.stats import chi2 as chi2_distribution

    limit = chi2_distribution.isf(false_alarm / len(freedom), freedom)
    worst = 0.5 * (chi2 - limit).max(axis=1)
    parts = np.concatenate([log_likelihood, log_likelihood + worst])
    fraction = np.exp(parts - parts.max())
    fraction /= fraction.sum()
    known = len(log_likelihood)
    return fraction[:known], float(fraction[known:].sum())
