"""Competing profiles of an upright vessel: each a Gaussian process about its own mean, weighted by its likelihood of contacts and outlines.

The means are the cone fitted to the outlines, with a large deviation, and profiles drawn from classes of shapes, with smaller ones and a
scale of their own (Rasmussen and Williams 2006, Eqs. 2.23 and 2.30). Their parameters are sampled from
rough to smooth profiles by sequential Monte Carlo (Del Moral, Doucet and Jasra 2006), with the scale integrated in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .completion.uncertainty import matern
from .vessel_shapes import UprightBody, drawn_vessels, vessel_profiles

#: Correlation length of the profile in heights of the body, and of the deviation from a circular section over the angle [rad].
_OVER_HEIGHT, _OVER_ANGLE_RAD = 0.3, 0.7
#: Correlation length of the deviation from a drawn profile, in heights of the body.
_RESIDUAL_HEIGHT = 0.15
#: Numbers of profiles that are drawn first and kept; steps of their parameters, in standard deviations among them.
_DRAWS, _PARTICLES, _STEPS = 8000, 800, (1.0, 0.5, 0.25, 0.1) * 3


class Spread(NamedTuple):
    """Standard deviations of a vessel about a profile, in mean radii, and their prior probability."""

    profile: float  #: of the radius over the height
    unround: float  #: of the deviation from a circular section
    prior: float  #: probability


#: About the cone, first, and about drawn profiles, from rough to smooth. Prior probabilities are those of maximum likelihood of 96 touches
#: on 16 vessels of open scenes of the ray tracer, but at least 5 % for a vessel that is like none of these. Diameters of bottles are made to
#: 0.5 mm + 1.2 % (ISO 9058), 1 % of a radius of 40 mm if errors are uniform between these limits; a vessel that was turned in its mould
#: is round, however, and each is as probable for one with a smooth profile.
_SPREADS = (
    Spread(0.25, 0.01, 0.05),
    Spread(0.06, 0.01, 0.15),
    Spread(0.01, 0.01, 0.4),
    Spread(0.01, 0.0, 0.4),
)


@dataclass(slots=True, eq=False)
class ProfileModel:
    """Profiles with a common covariance about each of them."""

    spread: Spread  #: deviations about a profile
    heights_m: Float[np.ndarray, "heights"]  #: heights of the profiles [m]
    radii_m: Float[np.ndarray, "profiles heights"]  #: radii [m]
    inverse: Float[np.ndarray, "n n"]  #: inverse covariance of the contacts [1/m2]
    gains: Float[np.ndarray, "profiles n"] = field(init=False)  #: weighted deviations of the contacts [1/m]
    share: float = 0.0  #: probability of the model

    def at(self, z_m: Float[np.ndarray, "m"]) -> Float[np.ndarray, "profiles m"]:
        """Radii of the profiles at heights [m].

        Parameters
        ----------
        z_m
            Heights (m) [m].
        """
        place = np.interp(z_m, self.heights_m, np.arange(len(self.heights_m)))
        low = np.minimum(place.astype(int), len(self.heights_m) - 2)
        return self.radii_m[:, low] + (place - low) * (self.radii_m[:, low + 1] - self.radii_m[:, low])


@dataclass(slots=True, eq=False)
class ProfileMixture:
    """The profiles of a vessel that compete, given its contacts."""

    body: UprightBody  #: cone fitted to the outlines
    foot_z_m: float  #: height of the foot [m]
    top_m: float  #: height of the rim [m]
    way: Float[np.ndarray, "n 2"]  #: direction of each contact from the axis; zero if it is unknown
    z_m: Float[np.ndarray, "n"]  #: heights of the contacts [m]
    rho_m: Float[np.ndarray, "n"]  #: their distances from the axis [m]
    noise_m2: Float[np.ndarray, "n n"]  #: covariance of the errors of these distances [m2]
    models: tuple[ProfileModel, ...] = field(init=False)  #: by their deviation about a profile

    def __post_init__(self) -> None:
        rng, cone = np.random.default_rng(1), np.array(self.body.height_m)
        free = ProfileModel(_SPREADS[0], cone, np.array([self.body.radius_m]), self._inverse(_SPREADS[0]))
        gaps = self.rho_m - free.at(self.z_m)[0]
        models, evidence = [free], [-0.5 * float(gaps @ free.inverse @ gaps)]
        kind, parameters, profiles = drawn_vessels(_DRAWS)
        logs, total = np.zeros(len(profiles)), 0.0
        heights_m = np.linspace(self.foot_z_m, self.top_m, profiles.shape[1])
        for spread in _SPREADS[1:]:
            inverse = self._inverse(spread)
            gain = self._likelihoods(profiles, inverse)[0] - logs
            weights = np.exp(gain - np.logaddexp.reduce(gain))
            total += float(np.logaddexp.reduce(gain)) - np.log(len(gain))
            places = (np.arange(_PARTICLES) + rng.random()) / _PARTICLES
            chosen = np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)
            kind, parameters = kind[chosen], parameters[chosen]
            profiles, logs, scale = self._moved(kind, parameters, inverse, rng)
            models.append(ProfileModel(spread, heights_m, profiles * scale, inverse))
            evidence.append(total)
        for n, model in enumerate(models):
            model.gains = (self.rho_m - model.at(self.z_m)) @ model.inverse
            evidence[n] += 0.5 * np.linalg.slogdet(model.inverse)[1] + np.log(model.spread.prior)
        share = np.exp(np.array(evidence) - np.logaddexp.reduce(evidence))
        for model, part in zip(models, share, strict=True):
            model.share = float(part)
        self.models = tuple(models)

    def _inverse(self, spread: Spread) -> np.ndarray:
        """Inverse covariance of the contacts about a profile [1/m2]."""
        covariance = self.covariance_m2((self.way, self.z_m), (self.way, self.z_m), spread)
        return np.linalg.inv(covariance + self.noise_m2)

    def _moved(
        self, kind: np.ndarray, parameters: np.ndarray, inverse: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Metropolis steps of the parameters, in place; profiles, log-likelihoods, and a scale drawn for each profile [m]."""
        spread = np.array(
            [parameters[kind == k].std(axis=0) if (kind == k).any() else np.zeros(6) for k in range(4)]
        )
        profiles = vessel_profiles(kind, parameters)
        logs, change, sigma, widest_m = self._likelihoods(profiles, inverse)
        for step in _STEPS:
            trial = parameters + step * spread[kind] * rng.standard_normal(parameters.shape)
            trial = 1 - np.abs(1 - np.abs(trial) % 2)  # reflected at 0 and 1
            shapes = vessel_profiles(kind, trial)
            found = self._likelihoods(shapes, inverse)
            better = np.log(rng.random(len(logs))) < found[0] - logs
            parameters[better], profiles[better] = trial[better], shapes[better]
            for old, new in zip((logs, change, sigma, widest_m), found, strict=True):
                old[better] = new[better]
        return profiles, logs, (widest_m * (1 + change + sigma * rng.standard_normal(len(logs))))[:, None]

    def _likelihoods(
        self, profiles: np.ndarray, inverse: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Log-likelihoods over all scales; mean and deviation of the scale, relative to that of the cone [m]."""
        t, height_m = np.linspace(0.0, 1.0, profiles.shape[1]), self.top_m - self.foot_z_m
        ends = (np.array(self.body.height_m) - self.foot_z_m) / height_m
        seen = (t >= min(ends[0], 0.9)) & (t <= ends[1] + 1e-9)
        widest_m = max(self.body.radius_m) / profiles[:, seen].max(axis=1)
        place = np.clip((self.z_m - self.foot_z_m) / height_m, 0.0, 1.0) * (len(t) - 1)
        low = np.minimum(place.astype(int), len(t) - 2)
        at = profiles[:, low] + (place - low) * (profiles[:, low + 1] - profiles[:, low])
        return *_over_scales(at * widest_m[:, None], self.rho_m, inverse), widest_m

    def profile_m2(
        self, z_m: Float[np.ndarray, "n"], z2_m: Float[np.ndarray, "m"], spread: Spread
    ) -> Float[np.ndarray, "n m"]:
        """Covariance of the radius between heights [m2].

        Parameters
        ----------
        z_m, z2_m
            Heights (n), (m) [m].
        spread
            Standard deviations about a profile.
        """
        free = spread is _SPREADS[0]
        common_m, length = (self.body.radius_sigma_m, _OVER_HEIGHT) if free else (0.0, _RESIDUAL_HEIGHT)
        radius_m = float(np.mean(self.body.radius_m))
        return common_m**2 + (spread.profile * radius_m) ** 2 * self._near(z_m, z2_m, length)

    def covariance_m2(
        self, here: tuple[np.ndarray, np.ndarray], there: tuple[np.ndarray, np.ndarray], spread: Spread
    ) -> Float[np.ndarray, "n m"]:
        """Covariance of the distance from the axis between places [m2].

        Parameters
        ----------
        here, there
            Directions (n, 2), (m, 2) from the axis, and heights (n), (m) [m].
        spread
            Standard deviations about a profile.
        """
        (way, z_m), (way2, z2_m) = here, there
        around = np.exp((way @ way2.T - 1) / _OVER_ANGLE_RAD**2)
        unround = self._unround_m2(spread) * self._near(z_m, z2_m, _OVER_HEIGHT) * around
        return np.asarray(
            self.profile_m2(z_m, z2_m, spread) + (way * self.body.axis_sigma_m**2) @ way2.T + unround
        )

    def _unround_m2(self, spread: Spread) -> float:
        """Variance of the deviation from a circular section [m2]."""
        return float((spread.unround * np.mean(self.body.radius_m)) ** 2)

    def _near(self, z_m: np.ndarray, z2_m: np.ndarray, length: float) -> np.ndarray:
        """Correlation between heights (Matern 5/2); ``length`` in heights of the body."""
        height_m = self.body.height_m[1] - self.foot_z_m
        return matern((z_m[:, None] - z2_m) / height_m, length, 5)

    def wall(
        self, way: Float[np.ndarray, "n 2"], z_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Distance of the wall from the axis and its standard deviation [m].

        Parameters
        ----------
        way, z_m
            Directions (n, 2) from the axis, and heights (n) [m].
        """
        levels, level = np.unique(z_m, return_inverse=True)
        mean_m, square_m2 = np.zeros(len(z_m)), np.zeros(len(z_m))
        axis_m2 = way**2 @ self.body.axis_sigma_m**2
        for model in self.models:
            cross = self.covariance_m2((way, z_m), (self.way, self.z_m), model.spread)
            own = self.profile_m2(levels, levels, model.spread).diagonal()[level] + self._unround_m2(
                model.spread
            )
            own += axis_m2 - np.einsum("ij,jk,ik->i", cross, model.inverse, cross)
            # The mean of each profile is linear in its radii and in its deviations at the contacts.
            each = np.hstack([model.at(levels), model.gains])
            mean = each.mean(axis=0)
            apart = (each - mean) / np.sqrt(len(each))
            rows = np.hstack([np.eye(len(levels))[level], cross])
            between = np.einsum("ij,jk,ik->i", rows, apart.T @ apart, rows)
            mean_m += model.share * (rows @ mean)
            square_m2 += model.share * (own + between + (rows @ mean) ** 2)
        return mean_m, np.sqrt(np.maximum(square_m2 - mean_m**2, 0.0))


def _over_scales(
    at: np.ndarray, data: np.ndarray, precise: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log-likelihood of data over all scales of each profile (rows of ``at``); mean and deviation of the change of the scale."""
    gaps, weighed = data - at, at @ precise
    precision, pull = _SPREADS[0].profile ** -2 + (weighed * at).sum(axis=1), (weighed * gaps).sum(axis=1)
    square = ((gaps @ precise) * gaps).sum(axis=1)
    logs = -0.5 * (square - pull**2 / precision + np.log(_SPREADS[0].profile ** 2 * precision))
    return logs, pull / precision, 1 / np.sqrt(precision)
