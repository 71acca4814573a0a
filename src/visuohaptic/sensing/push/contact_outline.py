"""Model of a foam contour with a simple outline pressed into it, and its fit to a measured contour.

The deformed front of the foam extends beyond the object: lateral tension creates
smooth flanks that are not in contact with it (Alt 2016, Sec. 3.2 and
the remark on fits "at the boundaries of the deformation region", 3.6.2). A
fit that takes flank points for contact points gets the wrong shape. Here the
flanks are part of the model, so that the ends of the contact are estimated.

Symbols: u along the strip, v towards the base, delta = v - rest(u) >= 0 the
deflection. The flank satisfies T delta'' = c delta^n (a Pasternak foundation with
a power law), whose first integral is a slope S(delta) = S_0 (delta/scale)^((n+1)/2)
and whose solution is closed-form. An object is in contact as long as it recedes
less steeply than S.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ._primitive_kernels import BENT, ROUND, STRAIGHT, profile_and_jacobian
from .outline_hypotheses import Hypothesis, Impression

#: Drops over which a tip is marginalised, in standard deviations of the prior, and iterations of the descent at each.
_DROPS, _DROP_STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0), 12
#: Relative error of the flank law where the flanks end, because foam bulges there, in units of the largest deflection.
_BULGE = 0.15


@dataclass(frozen=True, slots=True)
class FlankPrior:
    """Prior of the flanks of the foam."""

    length_m: float = 0.007  #: ratio of deflection to slope at the start of the flank [m]
    log_length_sigma: float = 0.5  #: standard deviation of its logarithm
    exponent: float = 0.9  #: n of the power law: 0 plateau, 1 linear
    exponent_sigma: float = 0.4
    #: relative drop of the foam at a tip: 0.35 for a sharp edge, 0.5 for a radius of 3 mm; mean and
    #: standard deviation of the uniform distribution between both
    drop: float = 0.425
    drop_sigma: float = 0.043
    #: position error of a tip [m]: in a continuum foam the fit is short by half of the edge radius, uniform up to 2 mm
    edge_sigma_m: float = 0.0003
    asymmetry_sigma: float = 0.08  #: standard deviation of the log ratio of left to right flank
    error: float = 0.02  #: relative error of the power law of a flank, by deflection
    contact_error: float = 0.001  #: relative distance of the touching foam from the object, by deflection
    min_segment_m: float = 0.01  #: a shorter face counts as a tip [m]
    min_radius_m: float = 0.012  #: a round object with a smaller radius counts as a tip [m]
    max_radius_m: float = 0.6  #: a round object with a larger radius counts as flat [m]
    parsimony: float = 2.0  #: cost of a free parameter in addition to log K


@dataclass(frozen=True, slots=True, eq=False)
class OutlineFit:
    """A hypothesis fitted to an impression."""

    hypothesis: Hypothesis
    theta: Float[np.ndarray, "p"]  #: shape and flank parameters, as in the kernels
    covariance: Float[np.ndarray, "p p"]  #: zero rows for parameters that were not free
    model_m: Float[np.ndarray, "K"]  #: deflection of the model [m]
    touched: Bool[np.ndarray, "K"]  #: points in contact with the object
    ends_m: tuple[float, float]  #: ends of the contact along u [m]
    #: Bayesian information criterion: -2 log likelihood, including the flank prior, + free parameters x (log K + parsimony)
    criterion: float
    chi2: float  #: weighted squared residuals of the touched points

    @property
    def widening(self) -> float:
        """Factor on the covariance: residuals above the declared noise (a rough object) widen it, smaller ones never narrow it."""
        return max(1.0, self.chi2 / max(int(self.touched.sum()) - len(self.hypothesis.free), 1))


class _Problem:
    """Residuals of one hypothesis: contour, flank prior and weak bounds on the shape."""

    def __init__(self, impression: Impression, hypothesis: Hypothesis, prior: FlankPrior) -> None:
        self.impression, self.hypothesis, self.prior = impression, hypothesis, prior
        self.shape_count = {STRAIGHT: 5, ROUND: 3, BENT: 4}[hypothesis.family]
        self.count = self.shape_count + 3
        #: Whether a straight outline has a tip, at which the foam drops.
        self.tipped = hypothesis.family == STRAIGHT and len(hypothesis.free) > 2
        drop = (4,) if self.tipped else ()
        self.free = np.array([*hypothesis.free, *drop, *range(self.shape_count, self.count)])
        steps = np.full(self.count, 1e-6)
        steps[self.shape_count :] = 1e-4
        if hypothesis.family == STRAIGHT:
            steps[1], steps[4] = 1e-5, 1e-4
        elif hypothesis.family == ROUND:
            steps[2] = 1e-4
        else:
            steps[2:4] = 1e-5
        fixed = np.setdiff1d(np.arange(self.count), self.free)
        steps[fixed] = 0.0
        self.steps = steps
        self.log_slope = float(np.log(impression.scale_m / prior.length_m))
        k = len(impression.u_m)
        self.delta = np.zeros(k)
        self.touched = np.zeros(k, dtype=bool)
        self.jacobian = np.zeros((k, self.count))
        self.ends = np.zeros(2)
        self.low = float(impression.u_m[0] - impression.spacing_m)
        self.high = float(impression.u_m[-1] + impression.spacing_m)

    def start(self, shape: np.ndarray) -> np.ndarray:
        drop = (self.prior.drop,) if self.hypothesis.family == STRAIGHT else ()
        return np.array([*shape, *drop, self.log_slope, self.log_slope, self.prior.exponent])

    def project(self, theta: np.ndarray) -> np.ndarray:
        """Clip the parameters to the domain of the kernel."""
        theta = theta.copy()
        theta[-1] = np.clip(theta[-1], -0.6, 2.0)
        theta[-3:-1] = np.clip(theta[-3:-1], self.log_slope - 4, self.log_slope + 4)
        if self.hypothesis.family == ROUND:
            theta[2] = np.clip(theta[2], np.log(0.003), np.log(2.0))
        elif self.hypothesis.family == BENT:
            theta[0] = np.clip(theta[0], self.low, self.high)
            theta[2:4] = np.clip(theta[2:4], -0.6, 60.0)
        if self.tipped:
            theta[4] = np.clip(theta[4], 0.0, 0.8)
        if self.hypothesis.family != STRAIGHT:
            return theta
        if 2 in self.hypothesis.free and 3 in self.hypothesis.free:
            theta[2] = np.clip(theta[2], self.low, self.high)
            theta[3] = max(min(theta[3], self.high), theta[2] + self.prior.min_segment_m)
        elif 2 in self.hypothesis.free:
            theta[2] = np.clip(theta[2], self.low, self.high)
        elif 3 in self.hypothesis.free:
            theta[3] = np.clip(theta[3], self.low, self.high)
        return theta

    def soft(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prior residuals and their Jacobian."""
        p, rows, values = self.prior, [], []

        def add(weights: dict[int, float], value: float) -> None:
            row = np.zeros(self.count)
            for index, weight in weights.items():
                row[index] = weight
            rows.append(row)
            values.append(value)

        left, right, n = self.count - 3, self.count - 2, self.count - 1
        w = 1.0 / p.log_length_sigma
        mean = 0.5 * (theta[left] + theta[right])
        add({left: 0.5 * w, right: 0.5 * w}, w * (mean - self.log_slope))
        # A free end of the strip lifts the flank next to it.
        w = 1.0 / (0.3 if any(self.impression.cut) else p.asymmetry_sigma)
        add({left: w, right: -w}, w * (theta[left] - theta[right]))
        w = 1.0 / p.exponent_sigma
        add({n: w}, w * (theta[n] - p.exponent))
        if self.tipped:
            w = 1.0 / p.drop_sigma
            add({4: w}, w * (theta[4] - p.drop))
        if self.hypothesis.name == "corner":
            for index in (2, 3):  # edges of real corners: steeper than 10 degrees, weakly about 45
                add({index: 0.3}, 0.3 * (theta[index] - 1.0))
        if self.hypothesis.family == ROUND:
            low, high = np.log(p.min_radius_m), np.log(p.max_radius_m)
            outside = max(theta[2] - high, 0.0) + min(theta[2] - low, 0.0)
            add({2: 10.0 if outside else 0.0}, 10.0 * outside)
        return np.array(values), np.array(rows)

    def evaluate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Residuals, Jacobian (free columns) and deviance."""
        data = self.impression
        profile_and_jacobian(
            self.hypothesis.family, theta, self.steps, data.rest, data.scale_m,
            self.low, self.high, data.u_m, self.delta, self.touched, self.jacobian, self.ends,
        )  # fmt: skip
        # The error of the flank law scales with the data, not the model, so that a wrong model does not gain tolerance.
        pressed = np.maximum(data.delta_m, 0.0)
        flank = self.prior.error * (pressed + _BULGE * data.scale_m)
        sigma = np.hypot(data.sigma_m, np.where(self.touched, self.prior.contact_error * pressed, flank))
        residual = (self.delta - data.delta_m) / sigma
        jacobian = self.jacobian / sigma[:, None]
        value, rows = self.soft(theta)
        deviance = float(residual @ residual + 2 * np.log(sigma).sum() + value @ value)
        return np.concatenate([residual, value]), np.vstack([jacobian, rows])[:, self.free], deviance

    def covariance(self, jacobian: np.ndarray) -> np.ndarray:
        """Covariance of all parameters from the curvature; zero rows for parameters that are not free."""
        normal = jacobian.T @ jacobian
        # A direction that the data do not determine (an untouched face) gets a large, finite variance.
        small = np.linalg.pinv(normal + 1e-12 * np.trace(normal) * np.eye(len(normal)), hermitian=True)
        covariance = np.zeros((self.count, self.count))
        covariance[np.ix_(self.free, self.free)] = small
        return covariance


def _descend(problem: _Problem, theta: np.ndarray, iterations: int) -> tuple[np.ndarray, float]:
    theta = problem.project(theta)
    residual, jacobian, deviance = problem.evaluate(theta)
    damping = 1e-2
    for _ in range(iterations):
        normal = jacobian.T @ jacobian
        damped = normal + damping * np.diag(np.diag(normal) + 1e-9 * np.trace(normal) + 1e-12)
        step = np.zeros(problem.count)
        step[problem.free] = np.linalg.solve(damped, -jacobian.T @ residual)
        moved = problem.project(theta + step)
        trial = problem.evaluate(moved)
        if trial[2] < deviance:
            gain = deviance - trial[2]
            theta, (residual, jacobian, deviance) = moved, trial
            damping = max(damping / 5, 1e-9)
            if gain < 1e-4:
                break
        else:
            damping *= 6
            if damping > 1e8:
                break
    return theta, deviance


def fit_outline(
    impression: Impression, hypothesis: Hypothesis, prior: FlankPrior, *, iterations: int = 40
) -> OutlineFit:
    """Fit one hypothesis by Levenberg-Marquardt from each of its starts; returns the best result.

    Parameters
    ----------
    impression
        The measured contour.
    hypothesis
        Family of the outline, its free parameters and starts.
    prior
        Prior of the flanks of the foam.
    iterations
        Maximum number of iterations for each start.
    """
    problem = _Problem(impression, hypothesis, prior)
    found = [_descend(problem, problem.start(shape), iterations) for shape in hypothesis.starts]
    theta, _ = min(found, key=lambda item: item[1])
    residual, jacobian, deviance = problem.evaluate(theta)
    k = len(impression.u_m)
    touched = problem.touched.copy()
    fit = OutlineFit(
        hypothesis=hypothesis,
        theta=theta,
        covariance=problem.covariance(jacobian),
        model_m=problem.delta.copy(),
        touched=touched,
        ends_m=(float(problem.ends[0]), float(problem.ends[1])),
        criterion=deviance + len(hypothesis.free) * (float(np.log(k)) + prior.parsimony),
        chi2=float(residual[:k][touched] @ residual[:k][touched]),
    )
    return replace(fit, covariance=fit.widening * fit.covariance)


def integrate_drop(fit: OutlineFit, impression: Impression, prior: FlankPrior) -> OutlineFit:
    """Mean and covariance of an outline, marginalised over the drop at its tips; a fit without tips is returned unchanged.

    Along an exponential flank a tip farther out is equivalent to a larger drop, so the likelihood of a tip is
    flat except for steps where the tip passes a point of the strip: its maximum is not unique, and its curvature is
    meaningless. Therefore all other parameters are fitted for each of several fixed drops, and the results are averaged with
    their posterior weights.

    Parameters
    ----------
    fit
        Maximum of the likelihood.
    impression
        The measured contour.
    prior
        Prior of the flanks of the foam.
    """
    problem = _Problem(impression, fit.hypothesis, prior)
    if not problem.tipped:
        return fit
    problem.free = np.setdiff1d(problem.free, [4])
    tips = [(index, sign) for index, sign in ((2, -1.0), (3, 1.0)) if index in fit.hypothesis.free]
    found: list[tuple[np.ndarray, float]] = []
    for drop in prior.drop + prior.drop_sigma * np.array(_DROPS):
        held = fit.theta.copy()
        held[4] = drop
        moved = held.copy()
        length = impression.scale_m * np.exp(-np.mean(held[-3:-1]))
        for index, sign in tips:  # keeps the flank in place
            moved[index] += sign * length * np.log((1.0 - fit.theta[4]) / (1.0 - drop))
        starts = [held, moved]
        found.append(min((_descend(problem, start, _DROP_STEPS) for start in starts), key=lambda end: end[1]))
    thetas, deviances = np.array([theta for theta, _ in found]), np.array([deviance for _, deviance in found])
    weight = np.exp(-0.5 * (deviances - deviances.min()))
    weight /= weight.sum()
    mean = weight @ thetas
    covariance = fit.widening * problem.covariance(problem.evaluate(thetas[weight.argmax()])[1])
    covariance += (thetas - mean).T @ (weight[:, None] * (thetas - mean))
    for index, _ in tips:
        covariance[index, index] += prior.edge_sigma_m**2
    return replace(fit, theta=mean, covariance=covariance)
