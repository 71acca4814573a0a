"""Open, closed or full: how a bottle answers a firm squeeze beside what each state would answer.

A pinch of a round wall keeps its volume to first order (errata), so the state shows in the part of the
force that grows faster than the deformation. Wall and modulus are known to a share only, which scales the
linear part: it is left open, as are the zero of the deformation and a small bend of the wall's own curve.
What remains decides: nothing when the bottle is open, the air's answer when it is closed, and the answer of
the little air above a filling.

With ``F_s(d)`` of a state, its linear part ``L`` and the rest ``G``, a measured curve is Gaussian about
``F_s`` with covariance ``diag(sigma^2) + (a L)(a L)^T + (b L d/D)(...)^T + (q G)(q G)^T + (z F_s')(z F_s')^T``;
the bracketed vectors are what is not known exactly. Of several places the likelihoods multiply.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ...simulation.deformable import DeformableContainer
from ...tasks.hand import Place
from ...tasks.squeeze import SqueezeCurve
from .bottle import HEIGHTS, STATES, contained

__all__ = ["DEEPEST_M", "FORCES_N", "ContentsModel"]

#: Levels of a firm squeeze [N], and the deformation of one side at which it ends [m].
FORCES_N = (1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 26.0, 33.0, 40.0, 47.0, 54.0)
DEEPEST_M = 0.007
#: What is not known: of wall and modulus, as a share; of the wall's own bend at the deepest level; of what is
#: enclosed; and where the deformation begins [m].
SCALE, BEND, ENCLOSED, ZERO_M = 0.4, 0.01, 0.12, 1e-4
#: Of a level's mean: force [N] and surface [m].
FORCE_N, SURFACE_M = 0.05, 3e-5
#: Chi-square per level above which a state is not believed, whatever the others say.
MISFIT = 4.0
#: Levels of height between two places, and those at the ends, where the height matters most.
APART, ENDS = 2, 4
#: Heights above this share of the object's are near the lid, whose hold is not known.
LID = 0.7


class ContentsModel:
    """What each state would feel like, for a measured outline and wall."""

    def __init__(self, outline_m: Float[np.ndarray, "k 2"], wall_m: float) -> None:
        self.height_m = float(outline_m[-1, 1])
        self.things: dict[str, DeformableContainer] = {
            state: contained(outline_m, wall_m, state) for state in STATES
        }

    def places(self) -> list[Place]:
        """Where open and closed differ most for the firmest squeeze, best first and apart from each other.

        After them the same again from the side: wall and noise are others there.
        """
        levels = [k for k in range(ENDS, HEIGHTS - ENDS + 1) if (k - 0.5) / HEIGHTS < LID]
        heights = {k: (k - 0.5) / HEIGHTS * self.height_m for k in levels}
        told = {k: self._told(z) for k, z in heights.items()}
        found: list[int] = []
        for k in sorted(levels, key=lambda level: -told[level]):
            if all(abs(k - other) >= APART for other in found):
                found.append(k)
        return [Place(heights[k], angle) for angle in (0.0, 0.5 * math.pi) for k in found]

    def _told(self, height_m: float) -> float:
        """Mahalanobis distance between the curves of open and closed, by the squeeze that open would allow."""
        d = np.linspace(0.0, DEEPEST_M, 200)[1:]
        force = np.array([self.things["open"].force_at(height_m, x) for x in d])
        at = d[force <= FORCES_N[-1]]
        if len(at) < 4:
            return 0.0
        at = np.linspace(0.0, at[-1], len(FORCES_N) + 1)[1:]
        gap, covariance = np.zeros(len(at)), np.eye(len(at))
        for state, sign in (("open", 1.0), ("closed", -1.0)):
            mean, covariance = self._curve(state, height_m, at)
            gap += sign * mean
        return float(gap @ np.linalg.solve(covariance, gap))

    def _curve(
        self, state: str, height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n"]]:
        """Expected forces of a state, and their covariance."""
        thing, step = self.things[state], 2e-5
        d = np.maximum(deformation_m, 0.0)
        mean = np.array([thing.force_at(height_m, float(x)) for x in d])
        slope = (np.array([thing.force_at(height_m, float(x) + step) for x in d]) - mean) / step
        linear = thing.force_at(height_m, 2e-4) / 2e-4 * d
        deepest = max(float(d.max()), 1e-6)
        unknown = np.stack(
            [SCALE * linear, BEND * linear * d / deepest, ENCLOSED * (mean - linear), ZERO_M * slope]
        )
        noise = np.diag(FORCE_N**2 + (SURFACE_M * slope) ** 2)
        return mean, noise + unknown.T @ unknown

    def probabilities(self, curves: Sequence[SqueezeCurve]) -> Mapping[str, float]:
        """Of every state; empty when none of them would feel like that."""
        score = dict.fromkeys(STATES, 0.0)
        misfit = dict.fromkeys(STATES, 0.0)
        count = 0
        for curve in curves:
            count += len(curve.force_N)
            for state in STATES:
                mean, covariance = self._curve(state, curve.place.height_m, curve.deformation_m)
                off = curve.force_N - mean
                chi2 = float(off @ np.linalg.solve(covariance, off))
                misfit[state] += chi2
                score[state] -= 0.5 * (chi2 + float(np.linalg.slogdet(covariance)[1]))
        believed = [state for state in STATES if misfit[state] <= MISFIT * max(count, 1)]
        if not believed or not count:
            return {}
        best = max(score[state] for state in believed)
        share = {state: math.exp(min(score[state] - best, 0.0)) for state in believed}
        total = sum(share.values())
        return {state: share.get(state, 0.0) / total for state in STATES}
