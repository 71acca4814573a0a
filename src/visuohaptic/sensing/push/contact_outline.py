"""What a foam contour looks like when a simple outline is pressed into it, and the fit of that image.

The foam's front does not end where the object ends: lateral tension lets it
run out in smooth flanks that do not lie on the object (Alt 2016, Sec. 3.2 and
the remark on fits "at the boundaries of the deformation region", 3.6.2). A
fit that takes flank points for object points gets the wrong shape. Here the
flanks are part of the model, so that the data decide where the contact ends.

Symbols: u along the strip, v towards the base, delta = v - rest(u) >= 0 the
deflection; the flank obeys T delta'' = c delta^n (a Pasternak foundation with
a power law), whose first integral is a slope S(delta) = S_0 (delta/scale)^((n+1)/2)
and whose solution is closed. An object touches as long as it falls away less
steeply than S.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ._primitive_kernels import BENT, ROUND, STRAIGHT, profile_and_jacobian
from .outline_hypotheses import Hypothesis, Impression

__all__ = ["FlankPrior", "OutlineFit", "fit_outline", "integrate_drop"]


#: Drops over which a tip is integrated, in standard deviations of the prior, and steps of the descent at each.
_DROPS, _DROP_STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0), 12
#: Foam bulges beyond its flanks: their law departs by its error of this part of the depth where they end.
_BULGE = 0.15


@dataclass(frozen=True, slots=True)
class FlankPrior:
    """What is known of the foam's flanks before a contact is seen."""

    length_m: float = 0.007  #: deflection by slope where the flank begins
    log_length_sigma: float = 0.5  #: standard deviation of its logarithm
    exponent: float = 0.9  #: n of the power law: 0 plateau, 1 linear
    exponent_sigma: float = 0.4
    #: by how much the foam drops at a tip, by the deflection: 0.35 sharp, 0.5 at a radius of 3 mm; the mean and the
    #: standard deviation of what is uniform between both
    drop: float = 0.425
    drop_sigma: float = 0.043
    #: of a tip, by its edge: in a continuum foam the fit ends further in by half of the radius; uniform up to 2 mm
    edge_sigma_m: float = 0.0003
    asymmetry_sigma: float = 0.08  #: left against right, of the logarithm
    error: float = 0.02  #: how far a real flank departs from the power law, by deflection
    contact_error: float = 0.001  #: how far the touched foam departs from the object, by deflection
    min_segment_m: float = 0.01  #: a face shorter than this counts as a tip
    min_radius_m: float = 0.012  #: a round object smaller than this counts as a tip
    max_radius_m: float = 0.6  #: a round object larger than this counts as flat
    parsimony: float = 2.0  #: added to log K: what a further parameter has to earn


@dataclass(frozen=True, slots=True, eq=False)
class OutlineFit:
    """A hypothesis fitted to an impression."""

    hypothesis: Hypothesis
    theta: Float[np.ndarray, "p"]  #: shape and flank parameters, as in the kernels
    covariance: Float[np.ndarray, "p p"]  #: zero rows for parameters that were not free
    model_m: Float[np.ndarray, "K"]  #: deflection of the model
    touched: Bool[np.ndarray, "K"]  #: points on the object
    ends_m: tuple[float, float]  #: where the contact begins and ends (u)
    deviance: float  #: -2 log likelihood, with the flank prior
    criterion: float  #: deviance + free parameters x log K: Bayesian information criterion
    chi2: float  #: weighted squared residuals of the touched points

    @property
    def widening(self) -> float:
        """Residuals larger than declared (a rough object) widen the covariance; smaller ones never narrow it."""
        return max(1.0, self.chi2 / max(int(self.touched.sum()) - len(self.hypothesis.free), 1))


class _Problem:
    """Residuals of one hypothesis: contour, flank prior and weak bounds on the shape."""

    def __init__(self, impression: Impression, hypothesis: Hypothesis, prior: FlankPrior) -> None:
        self.impression, self.hypothesis, self.prior = impression, hypothesis, prior
        self.shape_count = {STRAIGHT: 5, ROUND: 3, BENT: 4}[hypothesis.family]
        self.count = self.shape_count + 3
        #: A straight outline with a tip, beside which the foam drops.
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
        """Keep the parameters where the kernel is defined."""
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
        # A free end lifts the flank next to it.
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
        # The error of the flank law is taken from the data, so that no model earns slack by being wrong.
        pressed = np.maximum(data.delta_m, 0.0)
        flank = self.prior.error * (pressed + _BULGE * data.scale_m)
        sigma = np.hypot(data.sigma_m, np.where(self.touched, self.prior.contact_error * pressed, flank))
        residual = (self.delta - data.delta_m) / sigma
        jacobian = self.jacobian / sigma[:, None]
        value, rows = self.soft(theta)
        deviance = float(residual @ residual + 2 * np.log(sigma).sum() + value @ value)
        return np.concatenate([residual, value]), np.vstack([jacobian, rows])[:, self.free], deviance

    def covariance(self, jacobian: np.ndarray) -> np.ndarray:
        """Of all parameters, by the curvature; zero rows for those that are not free."""
        normal = jacobian.T @ jacobian
        # A direction that the data leave open (a face that is not touched) gets a large, finite variance.
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
    """Fit one hypothesis by Levenberg-Marquardt from each of its starts; the best end wins.

    Parameters
    ----------
    impression
        The measured contour.
    hypothesis
        Family of the outline, its free parameters and starts.
    prior
        What is known of the foam's flanks.
    iterations
        At most, for each start.
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
        deviance=deviance,
        criterion=deviance + len(hypothesis.free) * (float(np.log(k)) + prior.parsimony),
        chi2=float(residual[:k][touched] @ residual[:k][touched]),
    )
    return replace(fit, covariance=fit.widening * fit.covariance)


def integrate_drop(fit: OutlineFit, impression: Impression, prior: FlankPrior) -> OutlineFit:
    """Mean and covariance of an outline over the drop beside its tips; without a tip the fit itself.

    Along an exponential flank a tip farther out and a larger drop look the same, so that the likelihood of a tip is
    flat, but for steps where it passes a point of the strip: its maximum is one of several, and its curvature says
    nothing. So the drop is held at each of some values, all else follows, and the posterior weights what is found.

    Parameters
    ----------
    fit
        Maximum of the likelihood.
    impression
        The measured contour.
    prior
        What is known of the foam's flanks.
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
        for index, sign in tips:  # so that the flank stays where it is
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
