"""Is more than chance in a voxel: a test of its bad rays against the rate of bad rays in the whole volume.

With b bad ones of the n rays that say anything about a voxel, and q the fraction of bad rays everywhere, Chernoff's bound
P(B >= b) <= exp(-n D), D = s ln(s / q) + (1 - s) ln((1 - s) / (1 - q)), s = b / n > q, holds for any n. The log-odds
n D against chance must reach ln(V / alpha) for V voxels searched, by which the expected number of false voxels is at
most alpha (Bonferroni). Few views cannot reach more than n ln(1 / q), so that it is known when they are too few.

How far a part reaches is another question: beside glass a part of the rays passes it. With p the fraction of bad rays
where it was found, a voxel belongs to it when p is likelier than p / 2, the rate where every second ray misses it.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

__all__ = ["Cause", "SearchReport", "chance_log_odds", "edge_fraction", "search_threshold"]

#: Why nothing was found; ``found``: something was.
Cause = Literal["found", "no views", "no rays", "no bad rays", "too few rays", "below threshold", "too small"]

#: Bad rays through glass: real D435s drop 29-77 % of its pixels, a Beta distribution of 53 % that weighs as many rays
#: as its standard deviation of 16 % says, 0.53 x 0.47 / 0.16^2 - 1.
_GLASS_RATE, _GLASS_RAYS = 0.53, 8.7


@dataclass(frozen=True, slots=True)
class SearchReport:
    """What a search for transparent parts was able to see, and why it found what it found."""

    cause: Cause
    views: int  #: given
    compared: int  #: views of which rays were compared with others
    rays: int  #: median number of rays that say anything of a voxel, of the voxels that any ray passes
    bad_rate: float  #: fraction of bad rays in the volume, NaN without rays
    evidence: float  #: largest evidence of a voxel; log-odds [nat], of ``published`` the summed score
    reachable: float  #: evidence of a voxel of the median number of rays were all of them bad
    threshold: float  #: evidence that a voxel needs
    skipped: dict[str, int] = field(default_factory=dict)  #: views that were not compared, by cause

    @property
    def found(self) -> bool:
        """Whether there are transparent parts."""
        return self.cause == "found"

    @property
    def text(self) -> str:
        """One sentence for a user."""
        seen = f"{self.compared} of {self.views} views compared"
        if self.skipped:
            seen += " (" + ", ".join(f"{count} {cause}" for cause, count in self.skipped.items()) + ")"
        if self.cause == "no views":
            return f"{seen}: no view had others to compare it with"
        seen += f", {self.rays} rays per voxel"
        needed = f"threshold {self.threshold:.1f}"
        return {
            "found": f"{seen}, evidence up to {self.evidence:.1f}, {needed}",
            "no rays": f"{seen}: none of the compared rays passes the space of interest",
            "no bad rays": f"{seen}: no ray was contradicted or dropped out without another reason",
            "too few rays": f"{seen}: they give at most {self.reachable:.1f} where every ray is bad, {needed}; "
            "add views",
            "below threshold": f"{seen}: the strongest voxel has {self.evidence:.1f}, {needed}",
            "too small": f"{seen}: evidence up to {self.evidence:.1f}, {needed}, in fewer voxels than a part has",
        }[self.cause]


def search_threshold(voxels: int, false_alarms: float) -> float:
    """Log-odds [nat] that fewer than ``false_alarms`` of ``voxels`` exceed by chance.

    Parameters
    ----------
    voxels
        Number of voxels that are searched.
    false_alarms
        Expected number of false voxels of a search.
    """
    return math.log(max(voxels, 1) / false_alarms)


def chance_log_odds(
    bad: Shaped[np.ndarray, "*n"], rays: Shaped[np.ndarray, "*n"], rate: float
) -> Float[np.ndarray, "*n"]:
    """n D of Chernoff's bound [nat]; 0 where the fraction of bad rays is not above the rate.

    Parameters
    ----------
    bad, rays
        Bad rays, and all that say anything.
    rate
        Fraction of bad rays by chance, 0-1 exclusive.
    """
    n = np.maximum(rays, 1).astype(np.float32)
    fraction = np.minimum(bad / n, np.float32(1))
    with np.errstate(divide="ignore", invalid="ignore"):
        above = np.where(fraction > 0, fraction * np.log(fraction / rate), 0)
        below = np.where(fraction < 1, (1 - fraction) * np.log((1 - fraction) / (1 - rate)), 0)
    found: Float[np.ndarray, "*n"] = np.where(fraction > rate, n * (above + below), 0).astype(np.float32)
    return found


def edge_fraction(
    bad: Shaped[np.ndarray, "n"], rays: Shaped[np.ndarray, "n"], log_odds: Float[np.ndarray, "n"]
) -> float:
    """Fraction of bad rays at which a voxel is as likely inside the glass as halfway out of it.

    The rate p inside is that of the voxels with at least half of the largest evidence, drawn to what real cameras do
    by a Beta prior of ``_GLASS_RAYS`` rays: few rays that were chosen for being bad say little of p.

    Parameters
    ----------
    bad, rays, log_odds
        Of the voxels with evidence, at least one.
    """
    core = log_odds >= 0.5 * log_odds.max()
    n = float(np.median(rays[core]))
    fraction = float(bad[core].sum() / rays[core].sum())
    inside = (fraction * n + _GLASS_RATE * _GLASS_RAYS) / (n + _GLASS_RAYS)
    clean = math.log((1 - inside / 2) / (1 - inside))
    return clean / (clean + math.log(2))


def report(
    counts: tuple[Shaped[np.ndarray, "*n"], Shaped[np.ndarray, "*n"]],
    evidence: Float[np.ndarray, "*n"],
    *,
    views: int,
    compared: int,
    skipped: Counter[str],
    rate: float,
    threshold: float,
    regions: int,
) -> SearchReport:
    """Say what was searched and why ``regions`` parts were found; ``counts`` are bad rays and all rays of voxels."""
    bad, rays = counts
    passed = rays[rays > 0]
    typical = int(np.median(passed)) if len(passed) else 0
    best = float(evidence.max(initial=0.0))
    reachable = typical * -math.log(rate)
    cause: Cause
    if regions:
        cause = "found"
    elif not compared:
        cause = "no views"
    elif not len(passed):
        cause = "no rays"
    elif not bad.any():
        cause = "no bad rays"
    elif best >= threshold:
        cause = "too small"
    else:
        cause = "too few rays" if reachable < threshold else "below threshold"
    seen = rate if len(passed) else math.nan
    return SearchReport(cause, views, compared, typical, seen, best, reachable, threshold, dict(skipped))
