"""Rest phase of a push: how long the object rests and how compliant it is, from platform travel and foam deflection.

Symbols: x travel of the platform, d deflection of the foam, F force. While the object rests,

    x - d = a + c F + s d + noise,

with a the position of the contact, c the compliance of the object (1 / stiffness; 0: rigid), s the scale error of the
deflection relative to the odometry. Once the object slides, x - d grows by the part of the travel that the object follows,
uniform between zero and all of it. With Gaussian priors of a, c and s the evidence that the object rests in the first j frames
is a product of one-step predictions (Bayesian change-point detection). The prior of j is the probability that the static
friction lies between the forces of frame j and of the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .push_record import PushRecord

#: Prior standard deviations: compliance, with stone, cardboard, thin cardboard and cushions equally probable [m/N];
#: scale error, from half a percent for the deflection and a third of a percent for the wheels; position [m].
COMPLIANCES_M_N, SCALE, PLACE_M = (1e-6, 1e-4, 3e-4, 1e-3), 0.006, 1.0
#: Relative excess of static over dynamic friction, mean and standard deviation: dry pairs of materials have
#: ratios of 1.0 (teflon) to 1.6 (wood), and the floor at the start differs from the floor along the path.
STATIC_EXCESS, EXCESS_SIGMA = 0.2, 0.25
#: Minimum probability of a rest phase that is reported.
MIN_PROBABILITY = 0.02
#: A uniform density over a step, blurred by noise, is about one over (the step + this times the noise): exactly its peak without a
#: step or without noise, up to 1.6 times less than the peak between.
UNIFORM = float(np.sqrt(2.0 * np.pi))
#: Minimum number of frames before contact for a noise estimate, and safety factor on it: these frames give the maximum
#: of many noisy points, which scatters less than the mean of a few points that measures the deflection in contact.
QUIET_FRAMES, SAFE_NOISE = 6, 2.0
#: Minimum deflection of a contact, in standard deviations of the noise.
TOUCHED = 5.0
#: Foam is unloading if its deflection is below the maximum by more than this fraction, as for the sensor.
UNLOADED = 0.02
#: Maximum relative force loss of unloading foam against its loading curve (flexible foam returns 60 to 90 % of the energy
#: of a full cycle), and the mean and standard deviation of a uniform distribution up to it.
MAX_LOSS = 0.3
LOSS, LOSS_SIGMA = 0.5 * MAX_LOSS, MAX_LOSS / 12**0.5


@dataclass(frozen=True, slots=True, eq=False)
class FoamCurve:
    """Force over deflection of the foam during loading, measured in the same push."""

    depth_m: Float[np.ndarray, "k"]  #: deflection, non-decreasing [m]
    force_N: Float[np.ndarray, "k"]  #: force, non-decreasing [N]

    @classmethod
    def from_frames(cls, depth_m: Float[np.ndarray, "n"], force_N: Float[np.ndarray, "n"]) -> FoamCurve:
        """Curve through the origin and the frames with the largest deflection so far.

        Parameters
        ----------
        depth_m, force_N
            Deflections [m] and forces [N] in order of time; NaN: not measured.
        """
        from scipy.optimize import isotonic_regression

        deepest = np.fmax.accumulate(np.fmax(depth_m, 0.0))
        read = (depth_m >= (1.0 - UNLOADED) * deepest) & np.isfinite(force_N)
        order = np.argsort(depth_m[read])
        # Isotonic regression: a running maximum of noisy forces would be biased high.
        force = np.maximum(force_N[read][order], 0.0)
        force = isotonic_regression(force).x if len(force) else force
        depth = np.maximum(depth_m[read][order], 0.0)
        return cls(np.concatenate([[0.0], depth]), np.concatenate([[0.0], force]))

    @property
    def slope_N_per_m(self) -> float:
        """Mean stiffness [N/m]."""
        return float(self.force_N[-1]) / max(float(self.depth_m[-1]), 1e-9)

    def force_at(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Force [N]; extrapolated linearly beyond the largest deflection.

        Parameters
        ----------
        depth_m
            Deflections [m].
        """
        before = max(len(self.depth_m) - 3, 0)
        rise = self.force_N[-1] - self.force_N[before]
        slope = rise / max(self.depth_m[-1] - self.depth_m[before], 1e-9)
        inside = np.interp(depth_m, self.depth_m, self.force_N)
        return inside + slope * np.maximum(depth_m - self.depth_m[-1], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """A hypothesis of the rest phase: an object at rest, and the frames in which it rests."""

    probability: float
    first: int  #: first frame of the contact
    last: int  #: last frame at rest
    deepest: int  #: last frame in which the deflection still grows
    model: Float[np.ndarray, "3"]  #: a [m], c [m/N], s
    covariance: Float[np.ndarray, "3 3"]
    noise_m: float  #: noise of travel minus deflection, from frame to frame [m]
    foam: FoamCurve

    def squeeze_m(
        self, depth_m: Float[np.ndarray, "n"], force_N: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Common compression of foam and object [m].

        Parameters
        ----------
        depth_m, force_N
            Deflection of the foam [m] and force [N].
        """
        return (1.0 + self.model[2]) * depth_m + self.model[1] * force_N


def rest_hypotheses(
    record: PushRecord, contact_s: float, motion_s: float, dynamic_N: float = 0.0
) -> tuple[Rest, ...]:
    """Hypotheses of how long a touched object rests, with their probabilities.

    Parameters
    ----------
    record
        The push.
    contact_s, motion_s
        Times of contact and of detected motion [s]; NaN: no such event.
    dynamic_N
        Dynamic friction, for the prior of the breakaway force [N]; 0 if unknown.

    Returns
    -------
    All hypotheses with a probability of 0.02 or more; empty if fewer than three frames have a deflection and a
    force before the deflection stops growing.
    """
    t, d = record.t_s, record.deflection_m
    touch = int(np.searchsorted(t, contact_s))
    noise = _noise_m(record, touch)
    deepest = _end_of_rise(record, motion_s, noise)
    # Only the frames near the contact: a platform that accelerates deviates more from a straight line elsewhere.
    near = slice(max(touch - QUIET_FRAMES, 0), deepest + 1)
    place_noise = float(np.hypot(noise, _travel_noise_m(t[near], record.travel_m[near])))
    rises = (t >= contact_s) & (d > TOUCHED * noise) & np.isfinite(record.force_N)
    frames = np.flatnonzero(rises[: deepest + 1])
    if len(frames) < 3:
        return ()
    design = np.column_stack([np.ones(len(frames)), record.force_N[frames], d[frames]])
    place = float(record.travel_m[frames[0]] - d[frames[0]])
    target = (record.travel_m - d)[frames] - place
    step = np.maximum(np.diff(record.travel_m[frames], prepend=record.travel_m[frames[0]]), 0.0)
    moves = -np.log(step + UNIFORM * place_noise)
    moves[0] = 0.0
    found = [
        _filtered(design, target, place_noise**2 + (prior * record.force_sigma_N[frames]) ** 2, prior)
        for prior in COMPLIANCES_M_N
    ]
    # Rest up to frame j, then a uniform density of the displacement over each step of the travel.
    evidence = np.array([np.cumsum(terms) for _, _, terms in found])
    total = np.logaddexp.reduce(evidence, axis=0) + np.sum(moves) - np.cumsum(moves)
    total += _log_prior(record.force_N[frames], dynamic_N)
    if not np.isfinite(motion_s):
        total[:-1] = -np.inf
    chance = np.exp(total - np.logaddexp.reduce(total))
    foam = FoamCurve.from_frames(d, record.force_N)
    rests = []
    for j in map(int, np.flatnonzero(chance >= MIN_PROBABILITY)):
        # Exclude the last frame at rest: the object may already have moved by hundredths of a millimetre.
        known = max(j - 1, min(j, 2)) if np.isfinite(motion_s) else j
        means, covariances = (np.array([one[i][known] for one in found]) for i in (0, 1))
        model, covariance = _mixed(evidence[:, known], means, covariances)
        model[0] += place
        seen = float(chance[j]), int(frames[0]), int(frames[j]), deepest
        rests.append(Rest(*seen, model, covariance, place_noise, foam))
    return tuple(rests)


def _mixed(
    log_weight: Float[np.ndarray, "k"],
    means: Float[np.ndarray, "k 3"],
    covariances: Float[np.ndarray, "k 3 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Mean and covariance of a Gaussian mixture."""
    weight = np.exp(log_weight - np.logaddexp.reduce(log_weight))
    mean = weight @ means
    apart = means - mean
    return mean, np.einsum("k,kij->ij", weight, covariances + apart[:, :, None] * apart[:, None, :])


def _log_prior(force_N: Float[np.ndarray, "n"], dynamic_N: float) -> Float[np.ndarray, "n"]:
    """Log prior probability that the static friction lies between the force of a frame and that of the next."""
    if dynamic_N <= 0:
        return np.zeros(len(force_N))
    below = ndtr((np.maximum.accumulate(force_N) / dynamic_N - 1.0 - STATIC_EXCESS) / EXCESS_SIGMA)
    return np.log(np.diff(below, append=1.0) + 1e-9)


def _filtered(
    design: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, "n"],
    noise_m2: Float[np.ndarray, "n"],
    compliance_m_N: float,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n"]]:
    """Posterior after each frame, and log predictive density of each frame (recursive least squares)."""
    mean, covariance = np.zeros(3), np.diag(np.square([PLACE_M, compliance_m_N, SCALE]))
    means, covariances, evidence = [], [], []
    for row, value, noise in zip(design, target, noise_m2, strict=True):
        gain = covariance @ row
        variance = float(row @ gain) + noise
        residual = float(value - row @ mean)
        evidence.append(-0.5 * (residual**2 / variance + np.log(2.0 * np.pi * variance)))
        mean = mean + gain * (residual / variance)
        covariance = covariance - np.outer(gain, gain) / variance
        means.append(mean)
        covariances.append(covariance)
    return np.array(means), np.array(covariances), np.array(evidence)


def _end_of_rise(record: PushRecord, motion_s: float, noise_m: float) -> int:
    """Last frame in which the deflection still grows by more than its noise."""
    d = record.deflection_m
    if not np.isfinite(motion_s):
        return int(np.nanargmax(d))
    i = int(np.searchsorted(record.t_s, motion_s))
    i = min(i, len(d) - 1)
    while i + 1 < len(d) and d[i + 1] > d[i] + 2.0 * noise_m:
        i += 1
    return i


def _travel_noise_m(t_s: Float[np.ndarray, "n"], travel_m: Float[np.ndarray, "n"]) -> float:
    """Noise of the odometry [m]: standard deviation from the median distance to the line between neighbours."""
    before, after = np.diff(t_s)[:-1], np.diff(t_s)[1:]
    part = before / (before + after)
    residual = travel_m[1:-1] - (1.0 - part) * travel_m[:-2] - part * travel_m[2:]
    if len(residual) == 0:
        return 0.0
    return float(np.median(np.abs(residual) / np.sqrt(1.0 + part**2 + (1.0 - part) ** 2))) / float(
        ndtri(0.75)
    )


def _noise_m(record: PushRecord, before: int) -> float:
    """Noise of the deflection from frame to frame [m].

    The declared sigma also contains errors common to all frames (zero reference,
    texture at the edge), which cancel in differences over time. With enough frames
    before the contact their scatter is used instead, but at most the declared sigma.
    """
    declared = max(float(np.nanmedian(record.deflection_sigma_m)), 1e-7)
    free = record.deflection_m[:before]
    free = free[np.isfinite(free)]
    if len(free) < QUIET_FRAMES:
        return declared
    return min(declared, max(SAFE_NOISE * float(np.std(np.diff(free))) / np.sqrt(2.0), 1e-6))
