"""Competing profiles of an upright vessel: each a Gaussian process about its own mean, weighted by its likelihood of the contacts.

The means are the cone fitted to the outlines, with a large deviation, and profiles drawn from classes of shapes, with smaller ones and a
scale of their own, which the cone gives roughly (Rasmussen and Williams 2006, Eqs. 2.23 and 2.30).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from .transparency.outline_fit import UprightBody
from .vessel_shapes import vessel_profiles

#: Standard deviation of the profile about the cone, and of the deviation from a circular section, in radii: diameters of bottles are
#: made to 0.5 mm + 1.2 % (ISO 9058), 1 % of a radius of 40 mm if errors are uniform between these limits.
_PROFILE, _NONCIRCULARITY = 0.25, 0.01
#: Correlation length of the profile in heights of the body, and of the deviation from a circular section over the angle [rad].
_OVER_HEIGHT, _OVER_ANGLE_RAD = 0.3, 0.7
#: Prior probabilities of deviations from a profile, in mean radii: about the cone, and about a drawn profile. Those of maximum likelihood
#: of 96 touches on 16 vessels of open scenes of the ray tracer, but at least 5 % for a vessel that is like none of these.
_PRIOR = {_PROFILE: 0.05, 0.06: 0.1, 0.025: 0.4, 0.01: 0.45}
#: Correlation length of the deviation from a drawn profile, in heights of the body.
_RESIDUAL_HEIGHT = 0.15
#: Deviations of the widest, the lowest visible and the mean upper radius of a vessel from those of its cone, in radii: rms of 16 vessels
#: of open scenes of the ray tracer. The outlines are up to a matching window too wide, and the cone does not follow a neck.
_WIDEST, _VISIBLE = 0.11, np.array([0.14, 0.17])
#: Profiles that are this much less likely than the likeliest one are left out.
_NEGLIGIBLE = 1e-5


@dataclass(slots=True, eq=False)
class ProfileModel:
    """Profiles with a common covariance about each of them."""

    about: float  #: standard deviation about a profile, in mean radii
    heights_m: Float[np.ndarray, "heights"]  #: heights of the profiles [m]
    radii_m: Float[np.ndarray, "profiles heights"]  #: radii [m]
    inverse: Float[np.ndarray, "n n"]  #: inverse covariance of the contacts [1/m2]
    weights: Float[np.ndarray, "profiles"] = field(init=False)  #: probability of each profile in the model
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
    sigma_m: Float[np.ndarray, "n"]  #: standard deviations of these distances [m]
    models: tuple[ProfileModel, ...] = field(init=False)  #: by their deviation about a profile
    _widest_m: Float[np.ndarray, "profiles 1"] = field(init=False)

    def __post_init__(self) -> None:
        profiles, at, visible, cone = self._drawn()
        heights_m = np.linspace(self.foot_z_m, self.top_m, profiles.shape[1])
        cone_m = np.interp(self.z_m, self.body.height_m, self.body.radius_m)
        by_cone, _, _ = _over_scales(visible, cone, np.eye(2))
        noise, models, evidence = np.random.default_rng(1).standard_normal(len(profiles)), [], []
        for about, prior in _PRIOR.items():
            covariance = self.covariance_m2((self.way, self.z_m), (self.way, self.z_m), about)
            covariance += np.diag(self.sigma_m**2)
            inverse = np.linalg.inv(covariance)
            if about == _PROFILE:
                gaps = self.rho_m - cone_m
                total, weights = -0.5 * float(gaps @ inverse @ gaps), np.ones(1)
                model = ProfileModel(
                    about, np.array(self.body.height_m), np.array([self.body.radius_m]), inverse
                )
            else:
                precise = np.eye(2 + len(inverse))
                precise[2:, 2:] = inverse
                logs, change, sigma = _over_scales(
                    np.hstack([visible, at]), np.append(cone, self.rho_m), precise
                )
                # The likelihood of the contacts given the cone; a scale of each profile is drawn from its posterior.
                total = float(np.logaddexp.reduce(logs) - np.logaddexp.reduce(by_cone))
                kept = np.flatnonzero(logs > logs.max() + np.log(_NEGLIGIBLE))
                weights = np.exp(logs[kept] - np.logaddexp.reduce(logs[kept]))
                scale = self._widest_m[kept] * (1 + change + sigma * noise)[kept, None]
                model = ProfileModel(about, heights_m, profiles[kept] * scale, inverse)
            model.weights, model.gains = weights, (self.rho_m - model.at(self.z_m)) @ inverse
            evidence.append(total - 0.5 * np.linalg.slogdet(covariance)[1] + np.log(prior))
            models.append(model)
        share = np.exp(np.array(evidence) - np.logaddexp.reduce(evidence))
        for model, part in zip(models, share, strict=True):
            model.share = float(part)
        self.models = tuple(models)

    def _drawn(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The drawn profiles; at the scale of the cone their radii at the contacts [m]; and what the cone shows of them, of itself.

        That are the lowest visible and the mean upper radius, in standard deviations. Sets the scale, the widest radius.
        """
        profiles, (low_m, high_m) = vessel_profiles(), self.body.radius_m
        t = np.linspace(0.0, 1.0, profiles.shape[1])
        ends = (np.array(self.body.height_m) - self.foot_z_m) / (self.top_m - self.foot_z_m)
        seen = np.flatnonzero((t >= min(ends[0], 0.9)) & (t <= ends[1] + 1e-9))
        upper = seen[t[seen] >= 0.5 * ends.sum()]
        self._widest_m = max(low_m, high_m) / profiles[:, seen].max(axis=1, keepdims=True)
        sigma_m = float(np.mean(self.body.radius_m)) * _VISIBLE
        visible = np.column_stack([profiles[:, seen[0]], profiles[:, upper].mean(axis=1)]) * self._widest_m
        cone_m = np.array([low_m, np.interp(t[upper], ends, self.body.radius_m).mean()])
        place = np.clip((self.z_m - self.foot_z_m) / (self.top_m - self.foot_z_m), 0.0, 1.0) * (len(t) - 1)
        low = np.minimum(place.astype(int), len(t) - 2)
        at = (profiles[:, low] + (place - low) * (profiles[:, low + 1] - profiles[:, low])) * self._widest_m
        return profiles, at, visible / sigma_m, cone_m / sigma_m

    def profile_m2(
        self, z_m: Float[np.ndarray, "n"], z2_m: Float[np.ndarray, "m"], about: float
    ) -> Float[np.ndarray, "n m"]:
        """Covariance of the radius between heights [m2].

        Parameters
        ----------
        z_m, z2_m
            Heights (n), (m) [m].
        about
            Standard deviation about a profile, in mean radii.
        """
        free = about == _PROFILE
        common_m, length = (self.body.radius_sigma_m, _OVER_HEIGHT) if free else (0.0, _RESIDUAL_HEIGHT)
        radius_m = float(np.mean(self.body.radius_m))
        return common_m**2 + (about * radius_m) ** 2 * self._near(z_m, z2_m, length)

    def covariance_m2(
        self, here: tuple[np.ndarray, np.ndarray], there: tuple[np.ndarray, np.ndarray], about: float
    ) -> Float[np.ndarray, "n m"]:
        """Covariance of the distance from the axis between places [m2].

        Parameters
        ----------
        here, there
            Directions (n, 2), (m, 2) from the axis, and heights (n), (m) [m].
        about
            Standard deviation about a profile, in mean radii.
        """
        (way, z_m), (way2, z2_m) = here, there
        around = np.exp((way @ way2.T - 1) / _OVER_ANGLE_RAD**2)
        unround = self._unround_m2(about) * self._near(z_m, z2_m, _OVER_HEIGHT) * around
        return np.asarray(
            self.profile_m2(z_m, z2_m, about) + (way * self.body.axis_sigma_m**2) @ way2.T + unround
        )

    def _unround_m2(self, about: float) -> float:
        """Variance of the deviation from a circular section [m2]: a vessel is not made rounder than its profile is smooth."""
        return float((min(about, _NONCIRCULARITY) * np.mean(self.body.radius_m)) ** 2)

    def _near(self, z_m: np.ndarray, z2_m: np.ndarray, length: float) -> np.ndarray:
        """Correlation between heights (Matern 5/2); ``length`` in heights of the body."""
        length_m = length * (self.body.height_m[1] - self.foot_z_m)
        gap = np.sqrt(5) * np.abs(z_m[:, None] - z2_m) / length_m
        return np.asarray((1 + gap + gap**2 / 3) * np.exp(-gap))

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
            cross = self.covariance_m2((way, z_m), (self.way, self.z_m), model.about)
            own = self.profile_m2(levels, levels, model.about).diagonal()[level] + self._unround_m2(
                model.about
            )
            own += axis_m2 - np.einsum("ij,jk,ik->i", cross, model.inverse, cross)
            # The mean of each profile is linear in its radii and in its deviations at the contacts.
            each = np.hstack([model.at(levels), model.gains])
            mean = model.weights @ each
            apart = (each - mean) * np.sqrt(model.weights)[:, None]
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
    precision, pull = _WIDEST**-2 + (weighed * at).sum(axis=1), (weighed * gaps).sum(axis=1)
    square = ((gaps @ precise) * gaps).sum(axis=1)
    logs = -0.5 * (square - pull**2 / precision + np.log(_WIDEST**2 * precision))
    return logs, pull / precision, 1 / np.sqrt(precision)
