"""Open, closed or full: how a round container answers firm squeezes, and what it weighs, beside what each state would.

A pinch of a round wall keeps its volume to first order (errata); the ring that it bends into
w = d cos(2 t) loses the area (3 pi / 2) d^2 over about a diameter. Enclosed air answers with the third power of
the deformation, the more so the less air is left above a filling. Wall and modulus are known to a fraction
only, which scales the linear part: it is left open, as are the zero of the deformation and a small
bend of the wall's own curve. What remains decides, and the weight: an open container feels the same
whatever is in it.

With ``F_s(d)`` of a state, its linear part ``L`` and the rest ``G``, a measured curve is Gaussian about
``F_s`` with covariance ``diag(sigma^2) + (a L)(a L)^T + (b L d/D)(...)^T + (q G)(q G)^T + (z F_s')(z F_s')^T``;
the bracketed vectors are what is not known exactly. The mass is Gaussian about the state's. Curves and mass
are pieces of evidence whose likelihoods multiply; what fits no state is unknown, see
:mod:`.unknown_state`. Symbols: n levels of a curve, k points of an outline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.ranges import check_ranges, within
from .haptic_model import UNKNOWN
from .unknown_state import posterior_with_unknown

__all__ = ["DEEPEST_M", "FORCES_N", "ContentsModel", "ContentsState", "SqueezeSamples", "wall_from_stiffness"]

#: Levels of a firm squeeze [N], and the deformation of one side at which it ends [m].
FORCES_N = (1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 26.0, 33.0, 40.0, 47.0, 54.0)
DEEPEST_M = 0.007
#: What is not known: of wall and modulus, as a fraction; of the wall's own bend at the deepest level; of what is
#: enclosed; and where the deformation begins [m].
SCALE, BEND, ENCLOSED, ZERO_M = 0.4, 0.01, 0.12, 1e-4
#: Of a level's mean: force [N] and surface [m].
FORCE_N, SURFACE_M = 0.05, 3e-5
#: What is not known of a mass, as a fraction: of the wall's, whose thickness comes from a stiffness that goes with
#: its power of about two (SCALE / 2); of a liquid's, 7 % of volume by an outline's millimetre in thirty and as much
#: by density and level. A cap is not in the outline [kg].
WALL_MASS, LIQUID_MASS, CAP_KG = 0.2, 0.1, 0.003
#: Pressure of the air [Pa], density of water and of PET [kg/m^3].
AIR_PA, WATER, PET_DENSITY = 101_325.0, 1000.0, 1380.0
#: Levels of height, those between two places, and those at the ends, where the height matters most.
HEIGHTS, APART, ENDS = 16, 2, 4
#: Heights above this fraction of the object's are near the lid, whose hold is not known.
LID = 0.7
#: Thickness of the neck with its thread [m], and the fraction of the height where it begins.
NECK_M, NECK = 0.0012, 0.9
#: Liquids and their container deform a little: never less than this fraction of air.
MIN_AIR = 0.01
#: The wall is found by as many rounds; a stiffness goes with its power so.
WALL_ROUNDS, WALL_POWER = 5, 2.3


@dataclass(frozen=True, slots=True)
class ContentsState:
    """A hypothesis."""

    closed: bool  #: nothing can get out, and the rim keeps its shape
    fill: float = field(default=0.0, metadata=within(0, 1))  #: fraction of the volume that is liquid

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeSamples:
    """One squeeze at a height."""

    height_m: float
    deformation_m: Float[np.ndarray, "n"]  #: of one side
    force_N: Float[np.ndarray, "n"]  #: of one finger


@dataclass(frozen=True, slots=True, eq=False)
class _Response:
    """What one state feels like: F = k d + g d^3 at every height."""

    height_m: Float[np.ndarray, "k"]
    stiffness_N_per_m: Float[np.ndarray, "k"]
    cubic_N_per_m3: Float[np.ndarray, "k"]
    wall_kg: float
    liquid_kg: float

    def at(self, height_m: float) -> tuple[float, float]:
        return (
            float(np.interp(height_m, self.height_m, self.stiffness_N_per_m)),
            float(np.interp(height_m, self.height_m, self.cubic_N_per_m3)),
        )


class ContentsModel:
    """What each state would feel like and weigh, for a measured outline and wall.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    wall_m
        Thickness of the wall [m]; the material is PET.
    states
        Name -> hypothesis.
    """

    def __init__(
        self, outline_m: Float[np.ndarray, "k 2"], wall_m: float, states: Mapping[str, ContentsState]
    ) -> None:
        if not states or UNKNOWN in states:
            raise InputError("ContentsModel", f"found states {list(states)}, expected names but {UNKNOWN!r}")
        self.height_m = float(outline_m[-1, 1])
        self.states = dict(states)
        self._responses = {name: _response(outline_m, wall_m, state) for name, state in states.items()}

    def mass_kg(self, state: str) -> tuple[float, float]:
        """Mass of container and contents in a state, and its standard deviation [kg].

        Parameters
        ----------
        state
            Name of the hypothesis.
        """
        response = self._responses[state]
        sigma = math.hypot(WALL_MASS * response.wall_kg, LIQUID_MASS * response.liquid_kg)
        return response.wall_kg + response.liquid_kg, math.hypot(sigma, CAP_KG)

    def force_N(
        self, state: str, height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Expected force of one finger [N].

        Parameters
        ----------
        state
            Name of the hypothesis.
        height_m
            Above the bottom [m].
        deformation_m
            Of one side [m].
        """
        k, g = self._responses[state].at(height_m)
        d = np.maximum(deformation_m, 0.0)
        return k * d + g * d**3

    def heights_m(self, first: str = "open", second: str = "closed") -> list[float]:
        """Heights where two states differ most for the firmest squeeze, best first and apart from each other [m].

        Parameters
        ----------
        first, second
            Names of the hypotheses.
        """
        levels = [k for k in range(ENDS, HEIGHTS - ENDS + 1) if (k - 0.5) / HEIGHTS < LID]
        heights = {k: (k - 0.5) / HEIGHTS * self.height_m for k in levels}
        gain = {k: self._distance(first, second, z) for k, z in heights.items()}
        found: list[int] = []
        for k in sorted(levels, key=lambda level: -gain[level]):
            if all(abs(k - other) >= APART for other in found):
                found.append(k)
        return [heights[k] for k in found]

    def _distance(self, first: str, second: str, height_m: float) -> float:
        """Squared Mahalanobis distance of two states' curves, as deep as the first one allows."""
        d = np.linspace(0.0, DEEPEST_M, 200)[1:]
        reached = d[self.force_N(first, height_m, d) <= FORCES_N[-1]]
        if len(reached) < 4:
            return 0.0
        at = np.linspace(0.0, reached[-1], len(FORCES_N) + 1)[1:]
        one, _ = self._curve(first, height_m, at)
        other, covariance = self._curve(second, height_m, at)
        gap = one - other
        return float(gap @ np.linalg.solve(covariance, gap))

    def _curve(
        self, state: str, height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n"]]:
        """Expected forces of a state, and their covariance."""
        k, g = self._responses[state].at(height_m)
        d = np.maximum(deformation_m, 0.0)
        linear, enclosed, slope = k * d, g * d**3, k + 3.0 * g * d**2
        deepest = max(float(d.max()), 1e-6)
        unknown = np.stack([SCALE * linear, BEND * linear * d / deepest, ENCLOSED * enclosed, ZERO_M * slope])
        noise = np.diag(FORCE_N**2 + (SURFACE_M * slope) ** 2)
        return linear + enclosed, noise + unknown.T @ unknown

    def probabilities(
        self, squeezes: Sequence[SqueezeSamples], mass_kg: tuple[float, float] | None = None
    ) -> dict[str, float]:
        """Of every state, and of ``UNKNOWN``: contents that this model does not know; they sum to 1.

        Parameters
        ----------
        squeezes
            Curves of large deformation, at any heights.
        mass_kg
            As felt on lifting, and its standard deviation [kg]; ``None``: not lifted.
        """
        squeezes = [one for one in squeezes if len(one.force_N)]
        names = list(self.states)
        count = len(squeezes) + (mass_kg is not None)
        if not count:
            return dict.fromkeys([*names, UNKNOWN], 1.0 / (len(names) + 1))
        chi2, log_det = np.zeros((len(names), count)), np.zeros(len(names))
        for s, name in enumerate(names):
            for i, one in enumerate(squeezes):
                mean, covariance = self._curve(name, one.height_m, one.deformation_m)
                residual = one.force_N - mean
                chi2[s, i] = residual @ np.linalg.solve(covariance, residual)
                log_det[s] += np.linalg.slogdet(covariance)[1]
            if mass_kg is not None:
                expected, sigma = self.mass_kg(name)
                variance = sigma**2 + mass_kg[1] ** 2
                chi2[s, -1] = (mass_kg[0] - expected) ** 2 / variance
                log_det[s] += math.log(variance)
        freedom = np.array([len(one.force_N) for one in squeezes] + [1] * (mass_kg is not None))
        known, unknown = posterior_with_unknown(-0.5 * (chi2.sum(axis=1) + log_det), chi2, freedom)
        return {**dict(zip(names, known.tolist(), strict=True)), UNKNOWN: unknown}


def wall_from_stiffness(
    outline_m: Float[np.ndarray, "k 2"], stiffness_N_per_m: Sequence[tuple[float, float]], start_m: float
) -> float:
    """Thickness [m] with which a measured outline is as stiff as it was felt; the modulus is that of PET.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    stiffness_N_per_m
        (height [m], stiffness [N/m]) of gentle squeezes; what is not finite and positive is left out.
    start_m
        First guess [m].

    Raises
    ------
    InputError
        No squeeze has a stiffness.
    """
    felt = [(z, k) for z, k in stiffness_N_per_m if math.isfinite(k) and k > 0]
    wall = start_m
    for _ in range(WALL_ROUNDS):
        response = _response(outline_m, wall, ContentsState(closed=True))
        ratios = [k / expected for z, k in felt if (expected := response.at(z)[0]) > 0]
        if not ratios:
            raise InputError("wall_from_stiffness", "found no squeeze with a stiffness")
        wall *= float(np.exp(np.mean(np.log(ratios)))) ** (1 / WALL_POWER)
    return wall


def _response(outline_m: Float[np.ndarray, "k 2"], wall_m: float, state: ContentsState) -> _Response:
    from ...deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness

    z = np.linspace(outline_m[0, 1], outline_m[-1, 1], 81)
    r = np.interp(z, outline_m[:, 1], outline_m[:, 0])
    thickness = np.where(z > NECK * z[-1], max(NECK_M, wall_m), wall_m)
    stiffness = np.asarray(pinch_stiffness(RevolutionShell(r, z, thickness, rim_held=state.closed), "PET"))
    free = np.isfinite(stiffness)
    volume = float(np.sum(0.5 * math.pi * (r[1:] ** 2 + r[:-1] ** 2) * np.diff(z)))
    area = math.pi * (r[1:] + r[:-1]) * np.hypot(np.diff(r), np.diff(z))
    wall_kg = PET_DENSITY * float(np.sum(area * 0.5 * (thickness[1:] + thickness[:-1])))
    air = max(1.0 - state.fill, MIN_AIR) * volume
    cubic = AIR_PA * (1.5 * math.pi * 2.0 * r) ** 2 / air if state.closed else np.zeros_like(r)
    return _Response(z[free], stiffness[free], cubic[free], wall_kg, WATER * state.fill * volume)
