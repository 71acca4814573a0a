"""Open or closed, and how full: how a round container answers firm squeezes, and what it weighs.

A pinch of a round wall keeps its volume to first order (errata); the ring that it bends into
becomes an ellipse of the same perimeter loses the area pi (3 d^2 - d^3 / r) / 2 over about a diameter. Enclosed air
obeys Boyle's law, so that its force begins with the third power of the deformation, the more of it the less air is
left above a filling; the pressure p of a liquid at the place adds 3 pi r p to the stiffness. Wall and modulus are known to a fraction only, which scales the linear part: it is left
open, as are the zero of the deformation and a small bend of the wall's own curve. What remains decides, and the
weight: an open container feels the same whatever is in it.

A hypothesis is a lid (open, closed), a filling (nothing, liquid, grain) and the fraction of the volume up to which it
stands, in steps of ``FILL_STEP``. With ``L`` the linear part of its force and ``G`` the rest, a measured curve is
Gaussian about ``F = L + G`` with covariance
``diag(sigma^2) + (a L)(a L)^T + (b L d/D)(...)^T + (q G)(q G)^T + (z F')(z F')^T``; the bracketed vectors are what is not
known exactly. The mass is Gaussian about the hypothesis's. Curves and mass are pieces of evidence whose likelihoods
multiply; what fits no hypothesis is unknown, see :mod:`.unknown_state`. Symbols: n levels of a curve, k points of
an outline, h hypotheses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from .haptic_model import UNKNOWN
from .unknown_state import posterior_with_unknown

__all__ = [
    "DEEPEST_M", "EMPTY", "FILLINGS", "FORCES_N", "ContentsModel", "ContentsPosterior", "Filling",
    "SqueezeSamples", "wall_from_stiffness",
]  # fmt: skip

#: Levels of a firm squeeze [N], and the deformation of one side at which it ends [m].
FORCES_N = (1.0, 3.0, 6.0, 10.0, 15.0, 20.0, 26.0, 33.0, 40.0, 47.0, 54.0)
DEEPEST_M = 0.007
#: What is not known: of wall and modulus, as a fraction; of the wall's own bend at the deepest level; of what is
#: enclosed; and where the deformation begins [m].
SCALE, BEND, ENCLOSED, ZERO_M = 0.4, 0.01, 0.12, 1e-4
#: Of a level's mean: force [N] and surface [m].
FORCE_N, SURFACE_M = 0.05, 3e-5
#: What is not known of the wall's mass, as a fraction: its thickness comes from a stiffness that goes with its power of
#: about two (SCALE / 2). A cap is not in the outline [kg].
WALL_MASS, CAP_KG = 0.2, 0.003
#: Pressure of the air [Pa], density of PET [kg/m^3], gravity [m/s^2].
AIR_PA, PET_DENSITY, GRAVITY_M_S2 = 101_325.0, 1380.0, 9.81
#: Of the fractions that are compared.
FILL_STEP = 0.025
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
class Filling:
    """What may be in a container."""

    kg_per_m3: float  #: of the heap, voids included
    sigma: float  #: of that density and of the level, as a fraction
    solid: float  #: fraction of the heap that is not air


#: Random packings fill 0.56 to 0.64 of their space; rice, lentils, sugar and oats weigh 500 to 900 kg/m^3. Of a
#: liquid, 7 % of volume by an outline's millimetre in thirty and as much by density and level.
FILLINGS = {"liquid": Filling(1000.0, 0.1, 1.0), "grain": Filling(750.0, 0.15, 0.6)}
EMPTY = "empty"
#: Prior of a container of which nothing is known but that it is one: empty or not, and bottles are made for liquids.
PRIOR = {EMPTY: 0.4, "liquid": 0.45, "grain": 0.15}


@dataclass(frozen=True, slots=True, eq=False)
class ContentsPosterior:
    """Probability of every hypothesis; those and ``unknown`` sum to 1."""

    closed: Bool[np.ndarray, "h"]  #: nothing can get out, and the rim keeps its shape
    filling: tuple[str, ...]  #: ``EMPTY`` or one of ``FILLINGS``, by hypothesis
    fill: Float[np.ndarray, "h"]  #: fraction of the volume up to which the filling stands
    probability: Float[np.ndarray, "h"]
    unknown: float  #: contents that this model does not know

    def belief(self) -> dict[str, float]:
        """Of ``open``, ``closed`` and ``UNKNOWN``, whatever the filling."""
        closed = float(self.probability[self.closed].sum())
        return {"open": max(1.0 - self.unknown - closed, 0.0), "closed": closed, UNKNOWN: self.unknown}

    def fill_of(self, lid: str | None = None) -> tuple[float, float]:
        """Mean and standard deviation of the fill.

        Parameters
        ----------
        lid
            ``open`` or ``closed``: given that this is so; else of all that is known.
        """
        weight = self.probability if lid is None else self.probability * (self.closed == (lid == "closed"))
        if (total := float(weight.sum())) <= 0.0:
            return math.nan, math.nan
        mean = float(weight @ self.fill) / total
        return mean, math.sqrt(float(weight @ (self.fill - mean) ** 2) / total + FILL_STEP**2 / 12)

    def fillings(self) -> dict[str, float]:
        """Of ``EMPTY`` and every filling, whatever lid and level, among what is known."""
        names = (EMPTY, *FILLINGS)
        parts = [
            sum(p for p, one in zip(self.probability, self.filling, strict=True) if one == n) for n in names
        ]
        total = max(sum(parts), 1e-300)
        return {name: float(part / total) for name, part in zip(names, parts, strict=True)}


@dataclass(frozen=True, slots=True, eq=False)
class SqueezeSamples:
    """One squeeze at a height."""

    height_m: float
    deformation_m: Float[np.ndarray, "n"]  #: of one side
    force_N: Float[np.ndarray, "n"]  #: of one finger


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """Wall and volume of an outline, its stiffness with and without a lid."""

    z_m: Float[np.ndarray, "k"]
    radius_m: Float[np.ndarray, "k"]
    below_m3: Float[np.ndarray, "k"]  #: volume below each height
    wall_kg: float
    stiffness_N_per_m: tuple[
        Float[np.ndarray, "k"], Float[np.ndarray, "k"]
    ]  #: open, closed; at places that give

    def level_m(self, fill: float) -> float:
        """Height up to which a fraction of the volume stands [m]."""
        return float(np.interp(fill * self.below_m3[-1], self.below_m3, self.z_m))

    def force_N(
        self, hypothesis: tuple[bool, str, float], height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Of the wall with the liquid behind it, and of the enclosed air [N]."""
        closed, filling, fill = hypothesis
        stiffness = self.stiffness_N_per_m[closed]
        given = np.isfinite(stiffness)
        k = float(np.interp(height_m, self.z_m[given], stiffness[given]))
        r = float(np.interp(height_m, self.z_m, self.radius_m))
        d = np.maximum(deformation_m, 0.0)
        solid = FILLINGS[filling].solid if filling != EMPTY else 0.0
        if solid == 1.0:
            head_m = max(self.level_m(fill) - height_m, 0.0)
            k += 3.0 * math.pi * r * FILLINGS[filling].kg_per_m3 * GRAVITY_M_S2 * head_m
        if not closed:
            return k * d, np.zeros_like(d)
        air_m3 = max(1.0 - solid * fill, MIN_AIR) * float(self.below_m3[-1])
        lost_m3 = math.pi * (3.0 * d**2 * r - d**3)
        # Stiffer than any wall before the air is gone.
        pressure_Pa = AIR_PA * lost_m3 / np.maximum(air_m3 - lost_m3, 0.1 * air_m3)
        # Two fingers: 2 F dd = p dV.
        return k * d, 0.5 * pressure_Pa * math.pi * (6.0 * d * r - 3.0 * d**2)


class ContentsModel:
    """What each lid and filling would feel like and weigh, for a measured outline and wall.

    Parameters
    ----------
    outline_m
        (radius, height) from the bottom up [m].
    wall_m
        Thickness of the wall [m]; the material is PET.
    prior
        Probability of ``EMPTY`` and of some or all ``FILLINGS``; the levels of a filling are alike.

    Raises
    ------
    InputError
        The prior names another filling, or does not sum to 1.

    Examples
    --------
    >>> import numpy as np
    >>> model = ContentsModel(np.array([[0.03, 0.0], [0.03, 0.2]]), 4e-4)
    >>> posterior = model.posterior([], mass_kg=(0.3, 0.003))  # weighed, not squeezed
    >>> round(posterior.belief()["closed"], 2)
    0.5
    """

    def __init__(
        self, outline_m: Float[np.ndarray, "k 2"], wall_m: float, prior: Mapping[str, float] = PRIOR
    ) -> None:
        if not set(prior) <= {EMPTY, *FILLINGS} or not math.isclose(sum(prior.values()), 1.0):
            raise InputError(
                "ContentsModel",
                f"found {dict(prior)}, expected fractions of {EMPTY}, {', '.join(FILLINGS)} that sum to 1",
                field="prior",
            )
        self.height_m = float(outline_m[-1, 1])
        self._body = _body(outline_m, wall_m)
        fills = np.arange(FILL_STEP, 1.0 + 0.5 * FILL_STEP, FILL_STEP)
        levels = [(name, float(fill)) for name in prior for fill in ((0.0,) if name == EMPTY else fills)]
        self._hypotheses = [(closed, name, fill) for closed in (False, True) for name, fill in levels]
        parts = [prior[name] / (1 if name == EMPTY else len(fills)) for _, name, _ in self._hypotheses]
        self._log_prior = np.log(0.5 * np.array(parts))

    def mass_kg(self, fill: float, filling: str = "liquid") -> tuple[float, float]:
        """Mass of container and contents, and its standard deviation [kg].

        Parameters
        ----------
        fill
            Fraction of the volume up to which it is filled.
        filling
            ``EMPTY`` or one of ``FILLINGS``.
        """
        heap, sigma = 0.0, 0.0
        if filling != EMPTY:
            heap = FILLINGS[filling].kg_per_m3 * fill * float(self._body.below_m3[-1])
            sigma = FILLINGS[filling].sigma * heap
        return self._body.wall_kg + heap, math.hypot(WALL_MASS * self._body.wall_kg, sigma, CAP_KG)

    def force_N(
        self,
        height_m: float,
        deformation_m: Float[np.ndarray, "n"],
        *,
        closed: bool,
        fill: float = 0.0,
        filling: str = "liquid",
    ) -> Float[np.ndarray, "n"]:
        """Expected force of one finger [N].

        Parameters
        ----------
        height_m
            Above the bottom [m].
        deformation_m
            Of one side [m].
        closed
            Nothing can get out.
        fill
            Fraction of the volume up to which it is filled.
        filling
            ``EMPTY`` or one of ``FILLINGS``.
        """
        wall, air = self._body.force_N((closed, filling, fill), height_m, deformation_m)
        return wall + air

    def heights_m(self) -> list[float]:
        """Heights where a lid makes most difference to the firmest squeeze, best first and apart from each other [m]."""
        levels = [k for k in range(ENDS, HEIGHTS - ENDS + 1) if (k - 0.5) / HEIGHTS < LID]
        heights = {k: (k - 0.5) / HEIGHTS * self.height_m for k in levels}
        gain = {k: self._distance(z) for k, z in heights.items()}
        found: list[int] = []
        for k in sorted(levels, key=lambda level: -gain[level]):
            if all(abs(k - other) >= APART for other in found):
                found.append(k)
        return [heights[k] for k in found]

    def _distance(self, height_m: float) -> float:
        """Squared Mahalanobis distance of the curves of an open and a closed empty one, as deep as the open allows."""
        d = np.linspace(0.0, DEEPEST_M, 200)[1:]
        reached = d[self.force_N(height_m, d, closed=False, filling=EMPTY) <= FORCES_N[-1]]
        if len(reached) < 4:
            return 0.0
        at = np.linspace(0.0, reached[-1], len(FORCES_N) + 1)[1:]
        one, _ = self._curve((False, EMPTY, 0.0), height_m, at)
        other, covariance = self._curve((True, EMPTY, 0.0), height_m, at)
        gap = one - other
        return float(gap @ np.linalg.solve(covariance, gap))

    def _curve(
        self, hypothesis: tuple[bool, str, float], height_m: float, deformation_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n n"]]:
        """Expected forces of a hypothesis, and their covariance."""
        d = np.maximum(deformation_m, 1e-6)
        linear, enclosed = self._body.force_N(hypothesis, height_m, d)
        slope = (linear + 3.0 * enclosed) / d
        deepest = float(d.max())
        unknown = np.stack([SCALE * linear, BEND * linear * d / deepest, ENCLOSED * enclosed, ZERO_M * slope])
        noise = np.diag(FORCE_N**2 + (SURFACE_M * slope) ** 2)
        return linear + enclosed, noise + unknown.T @ unknown

    def posterior(
        self, squeezes: Sequence[SqueezeSamples], mass_kg: tuple[float, float] | None = None
    ) -> ContentsPosterior:
        """Probability of every lid, filling and level, and that it is none of them.

        Parameters
        ----------
        squeezes
            Curves of large deformation, at any heights.
        mass_kg
            As felt on lifting, and its standard deviation [kg]; ``None``: not lifted.
        """
        squeezes = [one for one in squeezes if len(one.force_N)]
        count, many = len(squeezes) + (mass_kg is not None), len(self._hypotheses)
        # Without evidence: open, closed and unknown alike.
        probability, unknown = np.exp(self._log_prior) * 2.0 / 3.0, 1.0 / 3.0
        if count:
            chi2, log_det = np.zeros((many, count)), np.zeros(many)
            for h, hypothesis in enumerate(self._hypotheses):
                for i, one in enumerate(squeezes):
                    mean, covariance = self._curve(hypothesis, one.height_m, one.deformation_m)
                    residual = one.force_N - mean
                    chi2[h, i] = residual @ np.linalg.solve(covariance, residual)
                    log_det[h] += np.linalg.slogdet(covariance)[1]
                if mass_kg is not None:
                    expected, sigma = self.mass_kg(hypothesis[2], hypothesis[1])
                    variance = sigma**2 + mass_kg[1] ** 2
                    chi2[h, -1] = (mass_kg[0] - expected) ** 2 / variance
                    log_det[h] += math.log(variance)
            freedom = np.array([len(one.force_N) for one in squeezes] + [1] * (mass_kg is not None))
            log_joint = self._log_prior - 0.5 * (chi2.sum(axis=1) + log_det)
            whole, best = np.logaddexp.reduce(log_joint), int(np.argmax(log_joint))
            # All hypotheses are one model, and the test is whether its best one passes.
            known, unknown = posterior_with_unknown(whole[None], chi2[best][None], freedom)
            probability = known[0] * np.exp(log_joint - whole)
        closed, filling, fill = zip(*self._hypotheses, strict=True)
        return ContentsPosterior(np.array(closed), filling, np.array(fill), probability, unknown)


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
        body = _body(outline_m, wall)
        # Gently pressed, enclosed air is not felt; whether a lid holds the rim makes little difference below it.
        ratios = [
            k / expected
            for z, k in felt
            if (expected := body.force_N((True, EMPTY, 0.0), z, np.ones(1))[0].item()) > 0
        ]
        if not ratios:
            raise InputError("wall_from_stiffness", "found no squeeze with a stiffness")
        wall *= float(np.exp(np.mean(np.log(ratios)))) ** (1 / WALL_POWER)
    return wall


def _body(outline_m: Float[np.ndarray, "k 2"], wall_m: float) -> _Body:
    from ...deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness

    z = np.linspace(outline_m[0, 1], outline_m[-1, 1], 81)
    r = np.interp(z, outline_m[:, 1], outline_m[:, 0])
    thickness = np.where(z > NECK * z[-1], max(NECK_M, wall_m), wall_m)
    open_, closed = (
        np.asarray(pinch_stiffness(RevolutionShell(r, z, thickness, rim_held=held), "PET"))
        for held in (False, True)
    )
    slices = 0.5 * math.pi * (r[1:] ** 2 + r[:-1] ** 2) * np.diff(z)
    area = math.pi * (r[1:] + r[:-1]) * np.hypot(np.diff(r), np.diff(z))
    wall_kg = PET_DENSITY * float(np.sum(area * 0.5 * (thickness[1:] + thickness[:-1])))
    return _Body(z, r, np.concatenate([[0.0], np.cumsum(slices)]), wall_kg, (open_, closed))
