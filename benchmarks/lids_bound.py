"""How many lids the readings of firm squeezes and the mass can decide: Bayes' rule with the world's own model.

The containers, contents and noise are those of :mod:`.lids_evidence`. This observer knows what no robot knows: the outline, the
gas, the liquid, the noise, the stiffness of the wall by height with a cap and with a free mouth, and that the wall bends
linearly. Unknown are the lid, the filling and its level (with the priors that they are drawn from), the modulus, and how far
the wall at a place is stiffer than its mesh (``uneven``, a standard deviation of the logarithm): 0 is an even wall, 3 one
of which nothing is known, so that only the shape of a curve tells the lid. ``rim``: whether a cap is known to hold the mouth, as
it does here, or may hold it from not at all to fully, all equally probable, as :mod:`visuohaptic.recognition.touch.contents`
assumes of a lid with clearance. A robot that may assume no more of walls and lids claims, at the same rate of errors, about as many
lids as this observer at best: what is missing then is missing in the readings.

    python -m benchmarks.lids_bound --seeds open --count 8     lids claimed after 1 to 6 squeezes, by unevenness
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core.resources import one_blas_thread
from visuohaptic.recognition.touch.contents import (
    FORCES_N,
    HELD,
    HELD_WEIGHTS,
    MAX_DEFORMATION_M,
    ContentsModel,
    SqueezeSamples,
)
from visuohaptic.tasks.manipulation.contents_task import CONFIDENCE, MAX_SQUEEZES, MIN_LEVELS

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from .lids_evidence import (
    CAP_KG,
    FILLINGS,
    KINDS,
    MASS_KG,
    READ_N,
    RIM_N,
    STIFFER,
    Container,
    squeezed,
)
from .table_bottles import DEFORMATION_M, FORCE_N

#: Standard deviations of the logarithm of a wall's stiffness at a place; whether a cap holds the mouth.
UNEVEN, RIM = (0.0, 0.1, 0.2, 0.4, 3.0), ("held", "unknown")
#: Prior of the fillings, and the levels that are compared; the wall's mass is known as well as its stiffness tells it.
PRIOR, LEVELS, WALL_MASS = {"empty": 0.35, "liquid": 0.5, "grain": 0.15}, np.linspace(0.02, 1.0, 50), 0.2
#: Points of a curve of the gas.
POINTS = 300


class Observer:
    """Probability of a cap, from squeezes of a container whose curves are known but for their scale.

    Parameters
    ----------
    one
        The container; its lid, contents and modulus are not looked at.
    mass_kg
        As weighed.
    """

    def __init__(self, one: Container, mass_kg: float) -> None:
        self._one, self._felt = one, list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]()
        # The modulus is a factor, whose own value is not used.
        walls = [one.wall_of(closed) for closed in (False, True)]
        self._log_k = [(at_m, np.log(k) - math.log(one.stiffer)) for at_m, k in walls]
        self._states = [
            (closed, *FILLINGS[name], float(fill))
            for closed in (False, True)
            for name in PRIOR
            for fill in ([0.0] if name == "empty" else LEVELS)
        ]
        names = {value: name for name, value in FILLINGS.items()}
        self._log_prior = np.array([
            math.log(PRIOR[names[state[1:3]]] / (1 if state[2] == 0.0 else len(LEVELS))) - _off(one, state, mass_kg)
            for state in self._states
        ])  # fmt: skip

    def feel(self, curve: SqueezeSamples) -> None:
        """Take a squeeze: for every state its slope, the slope's variance, and the log likelihood of the shape."""
        grid = np.linspace(0.0, MAX_DEFORMATION_M + 1e-3, POINTS)
        d, force = np.maximum(curve.deformation_m, 1e-6), curve.force_N
        slopes, spread, fits = (np.zeros(len(self._states)) for _ in range(3))
        for h, state in enumerate(self._states):
            gas = self._one.contents_N(state, curve.height_m, grid)
            rest = force - np.interp(d, grid, gas)
            k = max(float(d @ rest / (d @ d)), 1.0)
            rise = k + np.interp(d, grid, np.gradient(gas, grid))
            weight = 1.0 / (FORCE_N**2 + (DEFORMATION_M * rise) ** 2)
            variance = 1.0 / float(weight @ d**2)
            k = variance * float(weight @ (d * rest))
            misses = float(weight @ (rest - k * d) ** 2)
            # The integral over a slope that is positive: none fits where the gas alone exceeds the reading.
            slopes[h], spread[h] = k, variance
            fits[h] = 0.5 * float(np.log(weight).sum()) - 0.5 * misses + 0.5 * math.log(variance)
        wall = np.array([float(np.interp(curve.height_m, *walls)) for walls in self._log_k])
        self._felt.append((wall, slopes, spread, fits))

    def closed(self, uneven: float, rim: str) -> float:
        """Probability of a cap.

        Parameters
        ----------
        uneven
            Standard deviation of the logarithm of the wall's stiffness at a place.
        rim
            One of ``RIM``.
        """
        wall, slopes, spread, fits = (np.array(part) for part in zip(*self._felt, strict=True))
        usable = (slopes > 0.0).all(axis=0)
        k = np.where(slopes > 0.0, slopes, 1.0)
        held, weights = (HELD, HELD_WEIGHTS) if rim == "unknown" else (np.ones(1), np.ones(1))
        # Of every place and part of the cap's hold; without a cap nothing is held.
        known = [wall[:, :1] + (wall[:, 1:] - wall[:, :1]) * part for part in (np.zeros(1), held)]
        # p(k) dk of a logarithmic normal k, at its estimate: its width is small against that of the prior.
        scale = math.log(STIFFER[1] / STIFFER[0]) / math.sqrt(12.0)
        scores = self._log_prior + fits.sum(axis=0) - np.log(k).sum(axis=0)
        for h in np.flatnonzero(usable):
            covariance = scale**2 + np.diag(uneven**2 + spread[:, h] / k[:, h] ** 2)
            off = np.log(k[:, h : h + 1]) - known[self._states[h][0]]
            each = (off * np.linalg.solve(covariance, off)).sum(axis=0)
            mean = np.exp(-0.5 * (each - each.min())) @ (weights if off.shape[1] > 1 else np.ones(1))
            scores[h] += math.log(mean) - 0.5 * (each.min() + float(np.linalg.slogdet(covariance)[1]))
        scores[~usable] = -np.inf
        capped = np.array([state[0] for state in self._states])
        return float(np.exp(np.logaddexp.reduce(scores[capped]) - np.logaddexp.reduce(scores)))


def _off(one: Container, state: tuple[bool, float, float, float], mass_kg: float) -> float:
    """Negative log likelihood of a mass."""
    closed, kg_per_m3, _, fill = state
    expected = one.wall_kg + closed * CAP_KG + kg_per_m3 * fill * one.below_m3[-1]
    variance = MASS_KG**2 + (WALL_MASS * one.wall_kg) ** 2
    return float(0.5 * (mass_kg - expected) ** 2 / variance)


@one_blas_thread()
def answer(kind: str, seed: int) -> dict[str, Any]:
    """Probability of the true lid after every squeeze, by unevenness.

    Parameters
    ----------
    kind
        One of ``KINDS``.
    seed
        Of truth and errors.
    """
    one, rng = Container(kind, seed), np.random.default_rng([seed, 62])
    observer = Observer(one, one.mass_kg + MASS_KG * float(rng.standard_normal()))
    model = ContentsModel(one.outline_m, one.wall_m)
    heights, found = model.heights_m(), {f"{rim} {uneven}": list[float]() for rim in RIM for uneven in UNEVEN}
    for z in heights[:MAX_SQUEEZES]:
        limit_N = RIM_N if z > 0.7 * one.outline_m[-1, 1] else READ_N + 1.0
        curve = squeezed(one, z, FORCES_N, limit_N, rng)
        if len(curve.force_N) >= MIN_LEVELS:
            observer.feel(curve)
        for key, before in found.items():
            rim, uneven = key.split()
            if len(curve.force_N) >= MIN_LEVELS:
                capped = observer.closed(float(uneven), rim)
                before.append(capped if one.closed else 1.0 - capped)
            else:
                before.append(before[-1] if before else 0.5)
    return {"truth": "closed" if one.closed else "open", "right": found}


def run(seeds: Sequence[int] = range(0, 4, 2), report: Path | None = None) -> list[dict[str, Any]]:
    """Rows of the table; two containers of each kind by default.

    Parameters
    ----------
    seeds
        Of containers and errors.
    report
        Keeps the answers; a stopped campaign continues there.
    """
    kept = Journal(report, {"campaign": "lids_bound"})
    keys = {f"{kind} {seed}": (kind, seed) for kind in KINDS for seed in seeds}
    for key, (kind, seed) in keys.items():
        if key not in kept:
            kept.put(key, answer(kind, seed))
    rows = []
    for case in (f"{rim} {uneven}" for rim in RIM for uneven in UNEVEN):
        right = np.array([kept.rows[key]["right"][case] for key in keys])
        # A claim ends the squeezes.
        ended = np.maximum.accumulate(np.maximum(right, 1.0 - right) >= CONFIDENCE, axis=1)
        first = np.argmax(ended, axis=1)
        wrong = ended[:, -1] & (right[np.arange(len(right)), first] < 0.5)
        rows.append({
            "case": case, "claimed": [float(part) for part in ended.mean(axis=0)],
            "wrong": int(wrong.sum()), "count": len(right), "likely": float((right[:, -1] > 0.5).mean()),
        })  # fmt: skip
    return rows


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 8, "containers of each class, and of none", resumes=True)
    args = parser.parse_args()
    for row in run(seeds_of(args.seeds, args.count, args.first), args.report):
        parts = "  ".join(f"{100 * part:3.0f}" for part in row["claimed"])
        print(
            f"rim {row['case'].replace(' ', ', wall uneven by ')}: claimed after 1 to {MAX_SQUEEZES} squeezes [%] {parts}; "
            f"{row['wrong']} wrong, {100 * row['likely']:.0f} % more probable than not, of {row['count']}"
        )


if __name__ == "__main__":
    main()
