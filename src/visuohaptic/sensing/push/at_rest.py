"""How long a touched object rests, and how much it yields: from the platform's travel and the foam's deflection.

Symbols: x travel of the platform, d deflection of the foam, F force. While the object rests,

    x - d = a + c F + s d + noise,

a place of the contact, c compliance of the object (1 / stiffness; 0: rigid), s error of the deflection's scale against
the odometry. Once it slides, x - d grows by as much of the travel as the object follows, anything between nothing and
all of it. With Gaussian priors of a, c and s the evidence that the first j frames are those of an object at rest is a
product of one-step predictions (Bayesian change point), and the prior of j is that of the static friction, which lies
between the forces of frame j and of the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .push_record import PushRecord

__all__ = ["FoamCurve", "Rest", "rest_before_motion"]

#: Priors, as deviations: of the compliance, for which stone, cardboard, thin cardboard and cushions are equally
#: probable [m/N]; of the deflection's scale (half a percent) against that of the wheels (a third); of the place [m].
COMPLIANCES_M_N, SCALE, PLACE_M = (1e-6, 1e-4, 3e-4, 1e-3), 0.006, 1.0
#: By how much static friction exceeds the dynamic one, as a part of it, and the deviation: dry pairs of materials have
#: 1.0 (teflon) to 1.6 (wood), and the floor at the start differs from the floor along the path.
STATIC_EXCESS, EXCESS_SIGMA = 0.2, 0.25
#: What is less probable is left out.
RARE = 0.02
#: An even density over a step, blurred by noise, is at most one by the step and this many deviations: a Gaussian's peak.
UNIFORM = float(np.sqrt(2.0 * np.pi))
#: Frames before the contact that give the noise, and the factor that it is taken larger by: the largest of many
#: noisy points, which the deflection in a contact is a mean of, scatter less than each of them.
QUIET_FRAMES, SAFE_NOISE = 6, 2.0
#: Deflections from this many deviations of the noise on are those of a contact.
TOUCHED = 5.0
#: Below its largest deflection by more than this part foam is unloading, for the sensor as well.
UNLOADED = 0.02
#: Unloading foam carries less than its loading curve says, by anything up to 30 %: mean and deviation. (Flexible foam
#: gives back 60 to 90 % of the energy of a whole loop.)
LOSS, LOSS_SIGMA = 0.15, 0.3 / 12**0.5


@dataclass(frozen=True, slots=True, eq=False)
class FoamCurve:
    """Force by deflection while the foam is compressed, measured in the same push."""

    depth_m: Float[np.ndarray, "k"]  #: never falling [m]
    force_N: Float[np.ndarray, "k"]  #: never falling [N]

    @classmethod
    def from_frames(cls, depth_m: Float[np.ndarray, "n"], force_N: Float[np.ndarray, "n"]) -> FoamCurve:
        """Curve through the origin and the frames in which the deflection is the largest so far.

        Parameters
        ----------
        depth_m, force_N
            Deflections [m] and forces [N] in order of time; NaN: not read.
        """
        from scipy.optimize import isotonic_regression

        deepest = np.fmax.accumulate(np.fmax(depth_m, 0.0))
        read = (depth_m >= (1.0 - UNLOADED) * deepest) & np.isfinite(force_N)
        order = np.argsort(depth_m[read])
        # Isotonic: the largest so far of noisy forces would be too high.
        force = np.maximum(force_N[read][order], 0.0)
        force = isotonic_regression(force).x if len(force) else force
        depth = np.maximum(depth_m[read][order], 0.0)
        return cls(np.concatenate([[0.0], depth]), np.concatenate([[0.0], force]))

    @property
    def slope_N_per_m(self) -> float:
        """Mean stiffness."""
        return float(self.force_N[-1]) / max(float(self.depth_m[-1]), 1e-9)

    def force_at(self, depth_m: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Force [N]; goes on straight beyond the largest deflection.

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
    """An object at rest, and the frames that show it."""

    probability: float
    first: int  #: first frame of the contact
    last: int  #: last frame at rest
    deepest: int  #: frame of the largest deflection before the object slides evenly
    model: Float[np.ndarray, "3"]  #: a [m], c [m/N], s
    covariance: Float[np.ndarray, "3 3"]
    noise_m: float  #: of travel less deflection, from frame to frame
    foam: FoamCurve

    def squeeze_m(
        self, depth_m: Float[np.ndarray, "n"], force_N: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """By how much foam and object are compressed together [m].

        Parameters
        ----------
        depth_m, force_N
            Deflection of the foam [m] and force [N].
        """
        return (1.0 + self.model[2]) * depth_m + self.model[1] * force_N


def rest_before_motion(
    record: PushRecord, contact_s: float, motion_s: float, dynamic_N: float = 0.0
) -> tuple[Rest, ...]:
    """How long an object that is touched may have rested.

    Parameters
    ----------
    record
        The push.
    contact_s, motion_s
        When it is touched and when it is seen to give way; NaN: it never does [s].
    dynamic_N
        Dynamic friction, which says at what forces it may break away [N]; 0 when it is not known.

    Returns
    -------
    What is possible with a probability of 0.02 or more; nothing for fewer than three frames with a deflection and a
    force before the deflection stops growing.
    """
    t, d = record.t_s, record.deflection_m
    touch = int(np.searchsorted(t, contact_s))
    noise = _noise_m(record, touch)
    deepest = _end_of_rise(record, motion_s, noise)
    # Faster parts of the way, where a platform that starts and stops leaves its line by more, are not asked.
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
    # Frames up to j at rest, those after it anywhere along the travel.
    evidence = np.array([np.cumsum(terms) for _, _, terms in found])
    total = np.logaddexp.reduce(evidence, axis=0) + np.sum(moves) - np.cumsum(moves)
    total += _log_prior(record.force_N[frames], dynamic_N)
    if not np.isfinite(motion_s):
        total[:-1] = -np.inf
    chance = np.exp(total - np.logaddexp.reduce(total))
    foam = FoamCurve.from_frames(d, record.force_N)
    rests = []
    for j in map(int, np.flatnonzero(chance >= RARE)):
        # The last frame that looks like rest may hold the first hundredths of a millimetre.
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
    """Mean and covariance of a mixture."""
    weight = np.exp(log_weight - np.logaddexp.reduce(log_weight))
    mean = weight @ means
    apart = means - mean
    return mean, np.einsum("k,kij->ij", weight, covariances + apart[:, :, None] * apart[:, None, :])


def _log_prior(force_N: Float[np.ndarray, "n"], dynamic_N: float) -> Float[np.ndarray, "n"]:
    """Probability that the static friction lies between the force of a frame and that of the next."""
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
    """Posterior after each frame, and log density of each frame given those before (recursive least squares)."""
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
    """Noise of the odometry [m]: the median distance from the line between the neighbours, as a standard deviation."""
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

    The declared sigma holds what stays the same in every frame, too (zero reference,
    texture at the edge), and that falls out of differences in time: with enough frames
    before the contact their scatter is used instead, never more than declared.
    """
    declared = max(float(np.nanmedian(record.deflection_sigma_m)), 1e-7)
    free = record.deflection_m[:before]
    free = free[np.isfinite(free)]
    if len(free) < QUIET_FRAMES:
        return declared
    return min(declared, max(SAFE_NOISE * float(np.std(np.diff(free))) / np.sqrt(2.0), 1e-6))
