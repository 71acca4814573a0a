"""Density of classes that are no Gaussians: a kernel around each of their objects, learned by leaving objects out.

Symbols: n objects of k classes, read at the same d places; m components and s scales of the kernel.

    p(y | class) = mean of K(y - y_i) over its objects i,    K(x) = sum_m pi_m prod_j sum_s w_mjs N(x_j; 0, scale_s^2 + e).

e is the variance of errors beyond those that all readings have. Each object is drawn from the kernels of the others of its class: pi and w maximise this likelihood (expectation maximisation).
Readings that two objects share, or nearly, are found by the small scales, in some components together with others. A reading that
the others predict is replaced by its residual from a linear regression on these, which has a Jacobian of 1, if the likelihood
increases by more than the parameters of the regression are worth (Schwarz 1978).

A class with few objects is described better by a Gaussian with prior (:mod:`.few_curves`), one of many clusters by this density.
Which, is learned: the probability of a class is proportional to p_Gaussian^a p_kernel^b with a, b >= 0 and a + b <= 1 (a logarithmic
opinion pool, Genest and Zidek 1986), averaged by the likelihood of left-out objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import log_expit

#: Candidate scales, in standard deviations of a feature within its classes.
SCALES = 2.0 ** np.arange(1, -7, -1)
#: Components of a kernel, and iterations of expectation maximisation.
COMPONENTS, ITERATIONS = 3, 25
#: Candidate powers of the pool, steps of a tenth; the Gaussians alone are a priori as probable as all others together.
POWERS = np.array([(a, b) for a in range(11) for b in range(11 - a)]) / 10
#: Differences of readings, pairs of objects times places, from which a kernel is learned; the objects of a class are thinned out.
MAX_DIFFERENCES = 500_000
#: Objects that the prior of a regression is equivalent to.
_RIDGE = 3.0

#: Places (o,), values (o,) and variances (o,) of the readings of one object.
Read = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class ExemplarDensity:
    """Kernels around the objects of each class."""

    place: Int[np.ndarray, "d"]  #: features that were read of all objects
    part: Int[np.ndarray, "n"]  #: class of each object
    value: Float[np.ndarray, "n d"]  #: residuals, in standard deviations within the classes
    usual: Float[np.ndarray, "d"]  #: least variance of the errors of the readings, which the scales include
    variance: Float[np.ndarray, "n d"]  #: of their errors beyond the usual ones
    residual: Float[np.ndarray, "d d"]  #: residuals of given values
    component: Float[np.ndarray, "m"]  #: pi
    weight: Float[np.ndarray, "m d s"]  #: w
    powers: tuple[float, float] = (1.0, 0.0)  #: a and b

    def log_density(
        self,
        place: Int[np.ndarray, "o"],
        value: Float[np.ndarray, "o"],
        noise: Float[np.ndarray, "o"] | Float[np.ndarray, "o o"],
    ) -> Float[np.ndarray, "k"] | None:
        """Log density of readings in each class, up to a constant; None unless they are of the same places, each read once.

        Parameters
        ----------
        place, value, noise
            As of :func:`.log_likelihood`.
        """
        order = np.argsort(place)
        if not np.array_equal(place[order], self.place):
            return None
        errors = (np.diagonal(noise) if noise.ndim == 2 else noise)[order]
        beyond = self.residual**2 @ np.maximum(errors - self.usual, 0.0)
        return self._of_each(self.residual @ value[order], beyond, np.ones(len(self.part), bool))

    def left_out(self, turn: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n k"]:
        """Log density of each object in each class, without the objects of the same fold.

        Parameters
        ----------
        turn
            Fold of each object.
        """
        each = zip(self.value, self.variance, turn, strict=True)
        return np.stack([self._of_each(value, noise, turn != fold) for value, noise, fold in each])

    def _of_each(self, value: np.ndarray, noise: np.ndarray, used: Bool[np.ndarray, "n"]) -> np.ndarray:
        kernels = _normals(value - self.value[used], noise + self.variance[used])
        log = np.logaddexp.reduce(_log_kernels(kernels, self.component, self.weight)[0], axis=1)
        part, scale = self.part[used], np.linalg.slogdet(self.residual)[1]
        return np.array([
            scale + np.logaddexp.reduce(log[part == k]) - np.log((part == k).sum())
            for k in range(int(self.part.max()) + 1)
        ])  # fmt: skip


def learn_exemplars(read: Sequence[Read], part: Int[np.ndarray, "n"]) -> ExemplarDensity:
    """Kernels from the readings of objects, all of the same places, each read once.

    Parameters
    ----------
    read
        Places, values and variances of each object.
    part
        Class of each object, from 0; each has at least two.
    """
    place = np.sort(read[0][0])
    order = [np.argsort(one) for one, _, _ in read]
    value = np.stack([one[k] for k, (_, one, _) in zip(order, read, strict=True)])
    variance = np.stack([noise[k] for k, (_, _, noise) in zip(order, read, strict=True)])
    usual = variance.min(axis=0)
    variance = variance - usual
    few = _with_pairs(part, MAX_DIFFERENCES / len(place) / 10)
    residual = _residuals(value[few], variance[few], usual, part[few])
    few = _with_pairs(part, MAX_DIFFERENCES / len(place))
    value, variance = value @ residual.T, variance @ (residual**2).T
    first, second = _pairs(part[few])
    normals = _differences(value[few], variance[few], first, second)
    component, weight, _ = _learned(normals, first, COMPONENTS)
    return ExemplarDensity(place, part, value, usual, variance, residual, component, weight)


def thinned(part: Int[np.ndarray, "n"], most: int) -> Int[np.ndarray, "m"]:
    """Rows of at most this number of objects of each class, evenly among its rows, one class after the other.

    Parameters
    ----------
    part
        Class of each object, from 0.
    most
        Number of objects of a class.
    """
    own = [np.flatnonzero(part == k) for k in range(int(part.max()) + 1)]
    return np.concatenate([one[np.linspace(0, len(one) - 1, min(len(one), most)).astype(int)] for one in own])


def pooled_powers(
    gaussian: Float[np.ndarray, "n k"], kernel: Float[np.ndarray, "n k"], part: Int[np.ndarray, "n"]
) -> tuple[float, float]:
    """Powers of the pool, averaged by the likelihood of the classes of objects that were left out.

    Parameters
    ----------
    gaussian, kernel
        Log likelihoods of each object in each class, learned without it.
    part
        Its class.
    """
    own = np.arange(len(part)), part
    alone = POWERS[:, 0] == 1.0
    # The readings tell whether the classes are Gaussians, and their classes by which powers objects are assigned.
    better = float(np.sum(kernel[own] - gaussian[own]))
    score = np.where(alone, log_expit(-better), log_expit(better) - np.log((~alone).sum()))
    for trial, (a, b) in enumerate(POWERS):
        log = a * gaussian + b * kernel
        score[trial] += (log[own] - np.logaddexp.reduce(log, axis=1)).sum()
    weight = np.exp(score - score.max())
    a, b = weight @ POWERS / weight.sum()
    return float(a), float(b)


def _with_pairs(part: Int[np.ndarray, "n"], pairs: float) -> Int[np.ndarray, "m"]:
    """Objects of each class, evenly, with this number of pairs or fewer."""
    return thinned(part, max(2, int(np.sqrt(pairs / (part.max() + 1)))))


def _pairs(part: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Each object with each other one of its class."""
    same = (part[:, None] == part) & ~np.eye(len(part), dtype=bool)
    first, second = np.nonzero(same)
    return first, second


def _differences(
    value: np.ndarray, variance: np.ndarray, first: Int[np.ndarray, "p"], second: Int[np.ndarray, "p"]
) -> Float[np.ndarray, "p d s"]:
    """Normal densities of the differences of pairs, by scale."""
    return _normals(value[first] - value[second], variance[first] + variance[second])


def _normals(away: Float[np.ndarray, "p d"], noise: Float[np.ndarray, "p d"]) -> Float[np.ndarray, "p d s"]:
    """Normal densities of differences with these variances of their errors, by scale, up to a constant factor."""
    variance = SCALES**2 + noise[..., None]
    return np.asarray(np.exp(np.maximum(-0.5 * away[..., None] ** 2 / variance, -500.0)) / np.sqrt(variance))


def _log_kernels(
    normals: Float[np.ndarray, "p d s"], component: Float[np.ndarray, "m"], weight: Float[np.ndarray, "m d s"]
) -> tuple[Float[np.ndarray, "p m"], Float[np.ndarray, "m p d"]]:
    """Logarithms of the kernels of each component with its probability, and their factors."""
    factors = np.einsum("pds,mds->mpd", normals, weight)
    return np.log(factors).sum(axis=2).T + np.log(component), factors


def _learned(
    normals: Float[np.ndarray, "p d s"], first: Int[np.ndarray, "p"], components: int
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m d s"], float]:
    """Probabilities of components, weights of scales, and the log likelihood of the objects, up to a constant.

    A component starts at wide, even or narrow scales.
    """
    count, size = normals.shape[1:]
    tilt = np.linspace(-1, 1, components)[:, None, None] if components > 1 else np.zeros((1, 1, 1))
    weight = np.exp(tilt * np.linspace(-1, 1, size)) * np.ones((components, count, size))
    weight /= weight.sum(axis=2, keepdims=True)
    component, likelihood = np.full(components, 1 / components), 0.0
    start = np.flatnonzero(np.diff(first, prepend=-1))
    pairs = np.diff(start, append=len(first))
    for _ in range(ITERATIONS):
        log, factors = _log_kernels(normals, component, weight)
        best = np.maximum.reduceat(log.max(axis=1), start)
        drawn = np.exp(log - np.repeat(best, pairs)[:, None])
        total = np.add.reduceat(drawn.sum(axis=1), start)
        likelihood = float((best + np.log(total)).sum())
        drawn /= np.repeat(total, pairs)[:, None]
        # One object is the weight of the prior of each distribution.
        component = drawn.sum(axis=0) + 1 / components
        component /= component.sum()
        weight = weight * np.einsum("pm,mpd,pds->mds", drawn, 1 / factors, normals, optimize=True) + 1 / size
        weight /= weight.sum(axis=2, keepdims=True)
    return component, weight, likelihood


def _residuals(
    value: Float[np.ndarray, "n d"],
    variance: Float[np.ndarray, "n d"],
    usual: Float[np.ndarray, "d"],
    part: Int[np.ndarray, "n"],
) -> Float[np.ndarray, "d d"]:
    """Residuals of values, in standard deviations within the classes, of each feature if the likelihood increases by it.

    Those that the others predict best are tried first.
    """
    count, size = value.shape
    within = value - np.stack([value[part == k].mean(axis=0) for k in range(int(part.max()) + 1)])[part]
    # A feature that all objects share differs by its errors.
    scatter = within.T @ within / count + np.diag(usual + variance.mean(axis=0) + 1e-12)
    first, second = _pairs(part)
    sigma = np.sqrt(np.diag(scatter))
    out = np.diag(1 / sigma)

    def residual(k: int) -> tuple[float, Float[np.ndarray, "d"]]:
        """Standard deviation of the residual of a feature, and the residual."""
        others = np.delete(out, k, axis=0)
        seen = others @ scatter @ others.T + _RIDGE / count * np.eye(size - 1)
        row = np.eye(size)[k] - np.linalg.solve(seen, others @ scatter[k]) @ others
        return float(np.sqrt(row @ scatter @ row)), row

    normals = _differences(value @ out.T, variance @ (out**2).T, first, second)
    likelihood, worth = _learned(normals, first, 1)[2], 0.5 * (size - 1) * np.log(count)
    for k in sorted(range(size), key=lambda k: residual(k)[0] / sigma[k]):
        left, row = residual(k)
        # The Jacobian of a residual is 1, that of its unit the ratio of the standard deviations.
        narrower = count * np.log(sigma[k] / left)
        if narrower <= worth:
            continue
        trial, row = normals.copy(), row / left
        trial[:, [k]] = _differences(value @ row[:, None], variance @ row[:, None] ** 2, first, second)
        found = _learned(trial, first, 1)[2] + narrower
        if found > likelihood + worth:
            likelihood, normals, out[k] = found, trial, row
    return out
