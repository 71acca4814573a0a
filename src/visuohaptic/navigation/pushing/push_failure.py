"""Distribution of final poses of pushes, simulated with uncertain friction, load, centre of friction and pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ._push_kernels import GAP, YAW, X, push_object
from .push_model import PushModel

#: A platform that would start inside the object starts this distance earlier (m): up to 4 sigma of position and yaw.
BACK_M = (0.0, 0.04, 0.08, 0.16, 0.32)
#: Maximum depth of the rim in the outline at the start (m).
INSIDE_M = 1e-3
#: Parameters of a sample: contact friction, load, scale of the centre of friction, its x and y, position x and y, yaw.
NUMBERS = 8
#: Standard deviation of the centre of friction from the centroid along either axis, relative to the lever of the bottom:
#: root mean square of six values of real pushes (``benchmarks.nav_push.real_centres``): a centre of mass, two of pressure
#: on flat bottoms.
CENTRE_FRACTION, CENTRE_NUMBERS = 0.05, 6


@dataclass(frozen=True, slots=True)
class PushUncertainty:
    """Uncertain parameters of a simulated push; standard deviations except for the friction.

    The load distribution is uncertain, too: from uniform over a flat bottom to all on feet at its corners, or on a rim.
    """

    #: Half range of the uniformly distributed contact friction. By default from zero to twice
    #: :data:`~visuohaptic.navigation.pushing.push_model.CONTACT_FRICTION`: dry steel on aluminium has about 0.45
    #: (Zhou 2016), plastic that chatters on its feet about 0.1 (``benchmarks.plan_evidence push_ends``).
    contact_friction: float = 0.25
    #: covariance of the centre of friction [m^2]; ``None`` if no push of the object was observed: then the deviation is
    #: :data:`CENTRE_FRACTION` of its lever, whose own uncertainty is sampled as well (Student's t)
    centre_m2: Float[np.ndarray, "2 2"] | None = None
    place_m: float = 0.01  #: of the object relative to the platform, along x and y
    yaw_rad: float = 0.05

    def samples(
        self, model: PushModel, object_m: tuple[float, float, float], rng: np.random.Generator, count: int
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n k 2"], Float[np.ndarray, "n 3"]]:
        """Contact frictions, supports [m] and poses about the nominal ones.

        The samples cover all parameters evenly at once (a Kronecker sequence with a random start).

        Parameters
        ----------
        model
            Nominal model; its contact friction and its supports are varied.
        object_m
            Nominal pose: x, y [m], yaw [rad].
        rng
            Generator for the start of the sequence.
        count
            Number of samples.
        """
        from scipy.special import gammaincinv, ndtri

        # The generalised golden ratio: x^(d + 1) = x + 1.
        ratio = 2.0
        for _ in range(40):
            ratio = (1.0 + ratio) ** (1.0 / (NUMBERS + 1))
        steps = ratio ** -np.arange(1.0, NUMBERS + 1.0)
        even = (rng.random(NUMBERS) + np.outer(np.arange(count), steps)) % 1.0
        even = np.clip(even, 1e-9, 1.0 - 1e-9)
        normal = ndtri(even[:, 3:])
        friction = model.contact_friction + self.contact_friction * (2.0 * even[:, 0] - 1.0)
        spread = 1.0 + (_on_corners(model) - 1.0) * even[:, 1, None, None]
        away = (model.support_m - model.centre_m) * spread
        if self.centre_m2 is None:
            half = 0.5 * CENTRE_NUMBERS
            aside = (
                CENTRE_FRACTION
                * model.lever_m
                * np.sqrt(half / gammaincinv(half, even[:, 2:3]))
                * normal[:, :2]
            )
        else:
            aside = normal[:, :2] @ np.linalg.cholesky(self.centre_m2).T
        support = model.centre_m + away + aside[:, None]
        sigma = np.array([self.place_m, self.place_m, self.yaw_rad])
        poses = np.asarray(object_m, dtype=np.float64) + sigma * normal[:, 2:]
        return np.maximum(0.0, friction), support, poses


def _on_corners(model: PushModel) -> float:
    """Factor of the load's distance from its centre (rms) if all of it is at the corners of the convex hull.

    2 for a triangle, sqrt(3) for a square, sqrt(2) for a disc, which rests on its rim.
    """
    import shapely

    corners = shapely.get_coordinates(shapely.MultiPoint(model.outline_m).convex_hull)
    corners = corners[: max(len(corners) - 1, 1)]
    away_m = np.hypot(*(corners - model.centre_m).T) + model.round_m
    square_m2 = float(model.load @ ((model.support_m - model.centre_m) ** 2).sum(axis=1))
    return max(math.sqrt(float(np.mean(away_m**2)) / max(square_m2, 1e-12)), 1.0)


def sampled_pushes(
    model: PushModel,
    object_m: tuple[float, float, float],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
    rng: np.random.Generator,
    *,
    uncertainty: PushUncertainty | None = None,
    samples: int = 40,
    skip: int = 0,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n k 3"], Bool[np.ndarray, "n"]]:
    """Poses of an object before a push and along it, for samples of the uncertain parameters.

    The push starts earlier on its line where the sampled object overlaps the platform.

    Parameters
    ----------
    model
        Nominal model of the object.
    object_m
        Nominal pose: x, y [m], yaw [rad].
    path_m
        Poses of the platform: x, y [m], heading [rad].
    radius_m
        Radius of the platform [m].
    rng
        Random generator.
    uncertainty
        Uncertainty of friction, load, centre of friction and pose.
    samples
        Number of samples.
    skip
        Number of initial samples that are not simulated, because their poses are known.

    Returns
    -------
    Poses before the push, poses at each platform pose, and whether the object blocks the whole approach:
    then it stays in place.
    """

    uncertainty = uncertainty if uncertainty is not None else PushUncertainty()
    path = np.ascontiguousarray(path_m, dtype=np.float64)
    ahead = path[min(1, len(path) - 1), :2] - path[0, :2]
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    paths = [path] + [np.vstack([path[:1] - np.array([*(back * ahead), 0.0]), path]) for back in BACK_M[1:]]
    drawn = uncertainty.samples(model, object_m, rng, samples)
    friction, supports, before = (values[skip:] for values in drawn)
    along, blocked = before[:, None].repeat(len(path), axis=1), np.ones(samples - skip, dtype=bool)
    trace = np.zeros((len(path) + 1, 8))
    gyration_m = np.maximum(np.sqrt((supports**2).sum(axis=2) @ model.load), 1e-3)
    for k, support in enumerate(supports):
        for line in paths:
            push_object(
                model.outline_m, model.round_m, support, model.load, gyration_m[k], model.tip_m, friction[k],
                radius_m, line, before[k], trace,
            )  # fmt: skip
            if trace[0, GAP] >= -INSIDE_M:
                along[k] = trace[len(line) - len(path) : len(line), X : YAW + 1]
                blocked[k] = False
                break
    return before, along, blocked


def covariance_of_ends(errors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3 3"]:
    """Covariance of the zero-mean normal distribution whose 90 % ellipsoid holds 90 % of the errors.

    Scaled second moments: with sticking and slipping pushes, final poses are not normally distributed.

    Parameters
    ----------
    errors
        Errors of simulated final poses: x, y [m], rotation [rad]; at least a hundred.
    """
    from scipy.special import chdtri

    moments: Float[np.ndarray, "3 3"] = errors.T @ errors / len(errors)
    # Components without any deviation are ignored.
    if not (rank := int(np.linalg.matrix_rank(moments, hermitian=True))):
        return moments
    squares = np.einsum("ni,ij,nj->n", errors, np.linalg.pinv(moments, hermitian=True), errors)
    return moments * (np.quantile(squares, 0.9) / chdtri(rank, 0.1))
