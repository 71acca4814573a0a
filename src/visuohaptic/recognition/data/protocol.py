"""Protocol of a touch: noise of a closing curve, and duration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from .places import Touch
from .readings import TouchNoise

_MIN_SAMPLES = 6.0  # of a curve, however stiff the object


@dataclass(frozen=True, slots=True)
class TouchProtocol:
    """One touch: close up to a maximum force or deformation, then open (Alt 2016, Sec. 6.4.2)."""

    noise: TouchNoise = field(default_factory=TouchNoise)
    max_force_N: float = 20.0
    max_deformation_m: float = 0.003
    close_m_per_s: float = 0.005
    rate_Hz: float = 30.0
    approach_s: float = 2.0  #: to contact and back
    travel_m_per_s: float = 0.05  #: along the height
    place_m: float = 0.01  #: distance between two adjacent heights of the 16
    turn_s: float = 2.0  #: from one axis to the other

    @property
    def touch_s(self) -> float:
        """Duration of one touch, without the motion to it."""
        return self.approach_s + self.max_deformation_m / self.close_m_per_s

    @property
    def resolution_m_per_N(self) -> float:
        """1.5 times the standard deviation of a compliance from six samples distributed up to the maximum force."""
        return 1.5 * self.noise.deformation_m / (self.max_force_N * math.sqrt(_MIN_SAMPLES / 3))

    def seen_stiffness(
        self, stiffness_N_per_m: Float[np.ndarray, "*k"]
    ) -> tuple[Float[np.ndarray, "*k"], Float[np.ndarray, "*k"]]:
        """Logarithm of stiffness in series with the resolution, and its derivative with respect to the logarithm of stiffness.

        Parameters
        ----------
        stiffness_N_per_m
            Stiffness [N/m], of any shape.
        """
        stiff = 1 + self.resolution_m_per_N * stiffness_N_per_m
        return np.log(stiffness_N_per_m / stiff), 1 / stiff

    def seen_variance(self, stiffness_N_per_m: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
        """Expected variance of the logarithm returned by :meth:`seen_stiffness`; at most 1, above which it is not Gaussian.

        Parameters
        ----------
        stiffness_N_per_m
            Stiffness [N/m], of any shape.
        """
        factor = self.seen_stiffness(stiffness_N_per_m)[1]
        out: np.ndarray = np.minimum(factor * self.relative_sigmas(stiffness_N_per_m), 1.0) ** 2
        return out

    def relative_sigma(self, stiffness_N_per_m: float) -> float:
        """Expected relative standard deviation of the linear coefficient.

        Parameters
        ----------
        stiffness_N_per_m
            Stiffness [N/m].
        """
        return float(self.relative_sigmas(np.array([stiffness_N_per_m]))[0])

    def relative_sigmas(self, stiffness_N_per_m: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
        """Expected relative standard deviations of many linear coefficients.

        Parameters
        ----------
        stiffness_N_per_m
            Stiffness [N/m], of any shape.
        """
        reach = np.minimum(self.max_deformation_m, self.max_force_N / stiffness_N_per_m)
        count = np.maximum(_MIN_SAMPLES, self.rate_Hz * reach / self.close_m_per_s)
        square = count * reach**2 / 3
        spread = (self.noise.force_N / stiffness_N_per_m) ** 2 + self.noise.deformation_m**2
        out: np.ndarray = np.sqrt(spread / square)
        return out


def travel_seconds(protocol: TouchProtocol, start: Touch | None, goal: Touch) -> float:
    """Time from one touch to the next [s]; the motion to the first touch is part of its approach.

    Parameters
    ----------
    protocol
        Speeds and distances.
    start
        Previous touch, or None.
    goal
        Next touch.
    """
    if start is None:
        return 0.0
    way = abs(goal[0] - start[0]) * protocol.place_m / protocol.travel_m_per_s
    return max(way, protocol.turn_s if goal[1] != start[1] else 0.0)
