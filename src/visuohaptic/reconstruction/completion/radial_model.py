"""Probabilistic model of the hidden wall: a Gaussian process of its radius around the height axis.

In cylinder coordinates (rho, theta, z)

    log rho = p(z) + e0(theta) + w(z) (e1(theta) - e0(theta)) + g(theta, z)

with the profile ``p``, the cross-sections ``e0`` and ``e1`` of the bands below and above the hole (:mod:`.symmetry`), the weight ``w`` of
the upper cross-section, which is 0 and 1 in the bands and unknown between them, and the residual ``g`` of the cross-sections. ``p`` and ``g`` have Matern covariances over the height; ``w``
is a Brownian bridge around a straight line. Walls are smooth except for kinks, so
``p`` has order 3/2 or 5/2. Order, correlation length and deviation are not fixed:
several processes are averaged with weights proportional to their likelihood, and
where they disagree the variance grows. So are an exact visible surface and fused
ones, which curl at their rims, all around: within the last cell, or within the half
band of two cells over which distances are averaged.

The spatial spline and this process have different errors: the spline overshoots
between rings, the process represents only walls around an axis. With the mean m
and the variance v of the process, the expected squared error of an estimate r of
the wall f is

    E (r - f)^2 = (r - m)^2 + v

where the first term ranks the places and the second is the remaining uncertainty.
``v`` is scaled by the leave-one-out residuals of the contacts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ...core.resources import one_blas_thread
from .outline import ANGLES, VisibleWall
from .symmetry import ShapePrior, polar
from .uncertainty import matern

#: Grids of correlation lengths (in sizes of the region) and of deviations of p, for both orders.
_LENGTHS, _DEVIATIONS = (0.15, 0.3, 0.6), (0.01, 0.02, 0.05, 0.1, 0.2)
#: Minimum likelihood of a process relative to the likeliest, and maximum number of processes that are averaged.
MIN_LIKELIHOOD_RATIO, _MAX_PROFILES = 0.03, 6
#: Errors at rims, in those of a surface that is anywhere within its last cell: none, these, and those of the half band of a fusion.
_RIMS = (0.0, 1.0, 2.0)
#: Standard deviation of the unknown mean of log rho, and of a bin of the visible band.
_MEAN, _BAND = 0.3, 0.003
#: Correlation of g: length in sizes of the region, and over the angle [rad].
_OVER_HEIGHT, _OVER_ANGLE_RAD = 0.3, 0.35
#: Places on a ring, the contact among them.
_RING = 12
#: Prior scale of the variance (actual over predicted variance on 48 bottles), and its weight in contacts.
_SCALE, _SCALE_WEIGHT = 0.2, 8.0
#: Squared standardised residuals are clipped at this value, so that one contact with another object does not dominate.
_MAX_SQUARED_RESIDUAL = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class RadialProfile:
    """One process of p, conditioned on the known heights of the model."""

    fraction: float  #: posterior probability among the processes of a model
    order: int  #: twice the order of the Matern covariance, 3 or 5
    length: float  #: correlation length, in sizes of the region
    deviation: float  #: prior standard deviation of p
    lower: Float[np.ndarray, "q q"]  #: Cholesky factor of the correlation of the known heights
    mean: Float[np.ndarray, "q"]  #: posterior mean of p at the known heights
    root: Float[np.ndarray, "q q"]  #: square root of the posterior covariance of p, root root^T
    scale: float = 1.0  #: scale of the variance


@dataclass(frozen=True, slots=True, eq=False)
class RadialModel:
    """The processes conditioned on the bands and the contacts.

    With the vector y of known values of log rho minus the cross-section, y = B p + e, where B selects the height of each place
    and e has the covariance L L^T of all terms other than p.
    """

    prior: ShapePrior
    size_m: float  #: size of the region [m]
    theta: Float[np.ndarray, "k"]  #: angles of the known places [rad]
    row: Int[np.ndarray, "k"]  #: index of the height of each in ``z_m``
    z_m: Float[np.ndarray, "q"]  #: known heights [m]
    middle: float  #: mean of log rho minus its cross-section
    lower: Float[np.ndarray, "k k"]  #: L
    whitened: Float[np.ndarray, "k"]  #: L^-1 y
    picked: Float[np.ndarray, "k q"]  #: L^-1 B
    profiles: tuple[RadialProfile, ...]  #: likeliest first
    likelihood: float  #: log-likelihood of the known values, averaged over all processes
    rim: Float[np.ndarray, "k r"]  #: L^-1 B R with R of the visible wall

    @one_blas_thread()
    def expected(
        self, points_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Mean and standard deviation of the distance of the wall from the axis [m].

        Parameters
        ----------
        points_m
            Points (n, 3) whose angles and heights are used [m].
        """
        theta, z_m = polar(points_m, self.prior.axis_m)[0], points_m[:, 2]
        at = _upper_fraction(self.prior, z_m)
        own = _MEAN**2 + self.prior.residual**2 + at * (1 - at) * _difference(self.prior, theta) ** 2
        mean_m, square_m2 = np.zeros(len(z_m)), np.zeros(len(z_m))
        for profile, logs, variance in self._predicted(
            theta, z_m, own, np.zeros(1), lambda m: (m**2).sum(axis=0)
        ):
            rho_m = np.exp(np.clip(logs, -20.0, 20.0))
            mean_m += profile.fraction * rho_m
            square_m2 += profile.fraction * rho_m**2 * (1 + np.maximum(variance, 0.0))
        return mean_m, np.sqrt(np.maximum(square_m2 - mean_m**2, 0.0))

    @one_blas_thread()
    def ring_errors(self, outline_m: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k k"]:
        """Expected products of the errors of the log radii of an outline; a radius is the mean of its ring.

        Parameters
        ----------
        outline_m
            Estimated radius and height of each ring (k, 2) [m].
        """
        count, angles = len(outline_m), np.linspace(-np.pi, np.pi, ANGLES, endpoint=False)
        theta, z_m = np.tile(angles, count), np.repeat(outline_m[:, 1], ANGLES)
        here, gap = (theta, z_m, np.arange(len(z_m))), (z_m[:, None] - z_m) / self.size_m
        own = _residual_covariance(self.prior, self.size_m, here, here)
        errors = np.zeros((count, count))
        for profile, logs, covariance in self._predicted(theta, z_m, own, gap, lambda m: m.T @ m):
            off = logs.reshape(count, ANGLES).mean(axis=1) - np.log(outline_m[:, 0])
            rings = covariance.reshape(count, ANGLES, count, ANGLES).mean(axis=(1, 3))
            errors += profile.fraction * (rings + np.outer(off, off))
        return errors

    def _predicted(
        self,
        theta: Float[np.ndarray, "n"],
        z_m: Float[np.ndarray, "n"],
        own: np.ndarray,
        gap: np.ndarray,
        product: Callable[[np.ndarray], np.ndarray],
    ) -> Iterator[tuple[RadialProfile, Float[np.ndarray, "n"], np.ndarray]]:
        """Mean of log rho at some places, and its variance or covariance, by each process.

        ``product`` of a matrix M is the diagonal of M^T M (variances) or all of it (covariances); ``own`` is the prior variance
        or covariance of all terms except the profile; ``gap`` the distances of the places, 0 with variances.
        """
        known = (self.theta, self.z_m, self.row)
        here = theta, z_m, np.arange(len(z_m))
        cross = _solved(self.lower, _residual_covariance(self.prior, self.size_m, here, known).T)
        logs = self.middle + self.prior.section(theta, z_m) + self.whitened @ cross
        leading = cross.T @ self.picked
        for profile in self.profiles:
            shape = (profile.length, profile.order)
            near = _solved(profile.lower, matern((z_m[:, None] - self.z_m) / self.size_m, *shape).T)
            # Contribution of p, without the part that the other terms already explain at the known places.
            weight = _solved(profile.lower, near, transposed=True).T - leading
            along = (weight @ profile.root).T
            between = profile.deviation**2 * (matern(gap, *shape) - product(near))
            # Errors at rims are not those of the process that the contacts scale.
            at_rims = product(self.rim.T @ cross + (self.rim.T @ self.picked @ profile.root) @ along)
            whole = own - product(cross) + between + product(along)
            yield profile, logs + weight @ profile.mean, at_rims + profile.scale * (whole - at_rims)


@dataclass(frozen=True, slots=True, eq=False)
class RadialMixture:
    """Models of the same wall with different errors of its visible part."""

    models: tuple[RadialModel, ...]
    fractions: tuple[float, ...]  #: posterior probability of each
    #: error at rims of each, relative to that of a surface that is anywhere within its last cell
    rims: tuple[float, ...]

    def deviation_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Root mean square radial error of estimated points [m]; an upper bound of the distance from the wall.

        Parameters
        ----------
        points_m
            Points (n, 3) of the estimated surface [m].
        """
        expected_m, sigma_m = self.expected(points_m)
        return np.hypot(polar(points_m, self.models[0].prior.axis_m)[1] - expected_m, sigma_m)

    def expected(
        self, points_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """As :meth:`RadialModel.expected`.

        Parameters
        ----------
        points_m
            Points (n, 3) whose angles and heights are used [m].
        """
        each = np.array([model.expected(points_m) for model in self.models])
        mean_m, square_m2 = np.tensordot(self.fractions, [each[:, 0], (each**2).sum(axis=1)], axes=(0, 1))
        return mean_m, np.sqrt(np.maximum(square_m2 - mean_m**2, 0.0))

    def rings(
        self, contacts_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n k 3"], Float[np.ndarray, "n k"]]:
        """Points of the wall at the heights of contacts, at other angles, and their standard deviations [m].

        Parameters
        ----------
        contacts_m
            Contacts (n, 3) [m].
        """
        axis_m, turn = self.models[0].prior.axis_m, 2 * np.pi * np.arange(1, _RING) / _RING
        angle = polar(contacts_m, axis_m)[0][:, None] + turn
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points_m = np.dstack([axis_m + way, np.broadcast_to(contacts_m[:, 2:], angle.shape)])
        rho_m, sigma_m = (part.reshape(angle.shape) for part in self.expected(points_m.reshape(-1, 3)))
        points_m[..., :2] = axis_m + rho_m[..., None] * way
        return points_m, sigma_m

    def ring_errors(self, outline_m: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k k"]:
        """As :meth:`RadialModel.ring_errors`.

        Parameters
        ----------
        outline_m
            Estimated radius and height of each ring (k, 2) [m].
        """
        each = [model.ring_errors(outline_m) for model in self.models]
        return np.tensordot(self.fractions, each, axes=1)


def fit_radial_mixture(
    prior: ShapePrior,
    seen: VisibleWall,
    contacts: Sequence[tuple[Float[np.ndarray, "3"], float]],
    size_m: float,
) -> RadialMixture:
    """Models with different errors at rims (a fused surface curls there) with their posterior probabilities.

    Parameters
    ----------
    prior
        Axis and cross-sections of the bands.
    seen, contacts
        Bins of the visible wall; contacts (3) with their standard deviations [m].
    size_m
        Size of the region [m].
    """
    walls = [replace(seen, rim=times * seen.rim) for times in _RIMS]
    models = [fit_radial_model(prior, wall, contacts, size_m) for wall in walls]
    best = max(model.likelihood for model in models)
    ratio = np.exp([model.likelihood - best for model in models])
    kept = np.flatnonzero(ratio > MIN_LIKELIHOOD_RATIO)
    rims = tuple(_RIMS[k] for k in kept)
    return RadialMixture(tuple(models[k] for k in kept), tuple(ratio[kept] / ratio[kept].sum()), rims)


@one_blas_thread()
def fit_radial_model(
    prior: ShapePrior,
    seen: VisibleWall,
    contacts: Sequence[tuple[Float[np.ndarray, "3"], float]],
    size_m: float,
) -> RadialModel:
    """Average of the most likely processes; the variance of each is scaled by leave-one-out residuals of the contacts.

    Parameters
    ----------
    prior
        Axis and cross-sections of the bands.
    seen, contacts
        Bins of the visible wall; contacts (3) with their standard deviations [m].
    size_m
        Size of the region [m].
    """
    theta, row, z_m, logs = seen.theta, seen.row, seen.z_m, seen.logs
    noise = np.full(len(logs), _BAND**2)
    if contacts:
        touched = np.array([contact for contact, _ in contacts])
        angle, rho_m = polar(touched, prior.axis_m)
        row = np.append(row, len(z_m) + np.arange(len(touched)))
        theta, z_m = np.append(theta, angle), np.append(z_m, touched[:, 2])
        logs = np.append(logs, np.log(rho_m) - prior.section(angle, touched[:, 2]))
        noise = np.append(noise, (np.array([sigma for _, sigma in contacts]) / rho_m) ** 2)
    middle = float(logs.mean())
    known = (theta, z_m, row)
    covariance = _residual_covariance(prior, size_m, known, known) + np.diag(noise + 1e-10)
    at_rims = np.zeros((len(logs), len(seen.rim)))
    at_rims[: len(seen.row)] = seen.rim[seen.row]
    lower = np.linalg.cholesky(covariance + at_rims @ at_rims.T)
    pick = (row[:, None] == np.arange(len(z_m))).astype(float)
    # The last columns are for the leave-one-out residuals of the contacts.
    count = len(contacts)
    ones = np.eye(len(logs))[:, len(logs) - count :]
    whole = _solved(lower, np.column_stack([logs - middle, pick, ones]))
    whitened, picked, each = whole[:, 0], whole[:, 1 : 1 + len(z_m)], whole[:, 1 + len(z_m) :]
    found = []
    for order in (3, 5):
        for length in _LENGTHS:
            shape = matern((z_m[:, None] - z_m) / size_m, length, order)
            found.extend(_given(shape, picked, whitened, order, length))
    found.sort(key=lambda one: -one[0])
    best = found[0][0]
    kept = [one for one in found[:_MAX_PROFILES] if one[0] >= best + np.log(MIN_LIKELIHOOD_RATIO)]
    total = sum(np.exp(one[0] - best) for one in kept)
    profiles = []
    for above, make in kept:
        profile = make()
        squares = _squared_residuals(profile, picked, whitened, each).sum()
        scale = float((_SCALE_WEIGHT * _SCALE + squares) / (_SCALE_WEIGHT + count))
        fraction = float(np.exp(above - best) / total)
        profiles.append(replace(profile, fraction=fraction, scale=scale))
    relative = np.mean(np.exp([one[0] - best for one in found]))
    likelihood = best + float(np.log(relative) - 0.5 * whitened @ whitened - np.log(np.diag(lower)).sum())
    values = theta, row, z_m, middle, lower, whitened, picked, tuple(profiles)
    return RadialModel(prior, size_m, *values, likelihood, _solved(lower, at_rims))


def _given(
    shape: Float[np.ndarray, "q q"],
    picked: Float[np.ndarray, "k q"],
    whitened: Float[np.ndarray, "k"],
    order: int,
    length: float,
) -> list[tuple[float, Callable[[], RadialProfile]]]:
    """Log-likelihood for each deviation of p, with a function that creates the conditioned process.

    With S the correlation of p and C = B^T (L L^T)^-1 B, all deviations share the eigenvectors of S^1/2 C S^1/2.
    """
    lower = np.linalg.cholesky(shape + 1e-8 * np.eye(len(shape)))
    across = picked @ lower
    values, vectors = np.linalg.eigh(across.T @ across)
    along = vectors.T @ (across.T @ whitened)
    turned = lower @ vectors
    found: list[tuple[float, Callable[[], RadialProfile]]] = []
    for deviation in _DEVIATIONS:
        gain = 1 + deviation**2 * np.maximum(values, 0.0)
        likelihood = 0.5 * float(((deviation * along) ** 2 / gain).sum() - np.log(gain).sum())

        def make(deviation: float = deviation, gain: np.ndarray = gain) -> RadialProfile:
            root = deviation * turned / np.sqrt(gain)
            return RadialProfile(
                1.0, order, length, deviation, lower, root @ (deviation * along / np.sqrt(gain)), root
            )

        found.append((likelihood, make))
    return found


def _squared_residuals(
    profile: RadialProfile,
    picked: Float[np.ndarray, "k q"],
    whitened: Float[np.ndarray, "k"],
    each: Float[np.ndarray, "k n"],
) -> Float[np.ndarray, "n"]:
    """Squared standardised leave-one-out residual of each contact, clipped.

    y_i - mean_without_i = (K^-1 y)_i / (K^-1)_ii, with variance 1 / (K^-1)_ii.
    """
    through = picked.T @ each
    inverse = (each**2).sum(axis=0) - ((profile.root.T @ through) ** 2).sum(axis=0)
    off = each.T @ (whitened - picked @ profile.mean)
    return np.asarray(np.minimum(off**2 / np.maximum(inverse, 1e-12), _MAX_SQUARED_RESIDUAL))


def _solved(lower: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, int(transposed), lower=True, check_finite=False))


_Places = tuple[np.ndarray, np.ndarray, np.ndarray]  # angles [rad], heights [m], index of the height of each


def _residual_covariance(prior: ShapePrior, size_m: float, here: _Places, there: _Places) -> np.ndarray:
    """Covariance of log rho between places from all terms except the profile."""
    (theta, z_m, row), (theta2, z2_m, row2) = here, there
    turned = np.cos(theta)[:, None] * np.cos(theta2) + np.sin(theta)[:, None] * np.sin(theta2)
    near = prior.residual**2 * matern((z_m[:, None] - z2_m) / size_m, _OVER_HEIGHT)
    found = np.exp((turned - 1) / _OVER_ANGLE_RAD**2) * near[row[:, None], row2]
    found += _MEAN**2
    if len(prior.heights_m) > 1:
        at, at2 = _upper_fraction(prior, z_m)[:, None], _upper_fraction(prior, z2_m)
        bridge = np.minimum(at, at2) * (1 - np.maximum(at, at2))
        found += bridge[row[:, None], row2] * np.outer(_difference(prior, theta), _difference(prior, theta2))
    return found


def _upper_fraction(prior: ShapePrior, z_m: np.ndarray) -> np.ndarray:
    """Expected weight of the upper cross-section."""
    low, high = prior.heights_m[0], prior.heights_m[-1]
    return np.asarray(np.clip((z_m - low) / max(high - low, 1e-9), 0.0, 1.0))


def _difference(prior: ShapePrior, theta: np.ndarray) -> np.ndarray:
    """Upper minus lower cross-section."""
    low, high = (prior.section(theta, np.full(len(theta), prior.heights_m[k])) for k in (0, -1))
    return high - low
