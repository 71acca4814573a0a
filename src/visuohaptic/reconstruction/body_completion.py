"""Completion of a fully transparent upright vessel, of which vision gives the outline only, by touch.

The outlines of depth drop-outs give an upright cone (:mod:`.transparency.outline_fit`) with standard deviations of its axis
and radius, and its radii at single heights (:mod:`.transparency.outline_rings`); the vessel stands on the surface below it. The distance of its wall from that axis is a Gaussian process over
angle and height: the radius profile is the same at all angles, an error of the axis varies as the cosine of the angle, and the
deviation from a circular section is small. Several means of the profile compete: the cone with a large deviation from it, and profiles
drawn from classes of shapes (:mod:`.vessel_shapes`), each at a scale of its own, with smaller deviations. Their
probabilities are the likelihoods of the contacts and of these radii (Rasmussen and Williams 2006, Eq. 2.30), and the wall is the mixture
of the processes conditioned on the contacts (Eq. 2.23): its variance contains that between the shapes. One contact constrains the whole
ring at its height; no artificial points are added. The next touch is a horizontal line to the axis, below the rim and clear of
surrounding surfaces, that maximises the variance of the wall times its radius, for the area that the contact explains, times the
probability of contact. A line may miss a stem that is thinner than the error of the axis. So that such a line is not repeated, axis and profile are sampled from the mixture, and samples that
contradict the missed lines are rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from .completion.surface_completion import MIN_TOUCHES
from .completion.touch import Touch, TouchPlan
from .mesh import SurfaceMesh
from .profile_mixture import ProfileMixture
from .vessel_shapes import OutlineRings, UprightBody

#: Numbers of angles and heights of the surface mesh, and (angles, heights) of the candidate touch points.
_ANGLES, _HEIGHTS, _PLACES = 48, 40, (12, 12)
#: Distance of a touch from rim and foot, of a start from the wall, and of a probe from surrounding surfaces [m].
_END_M, _START_M, _CLEAR_M = 0.012, 0.04, 0.015
#: Places of a line that are compared with other bodies: at most 5 mm apart where it starts 6 cm from the wall.
_LINE = 16
#: Samples of axis and profile: with four fifths of them rejected, a probability of one half has a standard error of 1/40.
_DRAWS = 2000
#: Standard deviation of the lower and upper radius of a cone from those of the vessel, in radii: rms of 16 vessels of open scenes of the
#: ray tracer. The cone is up to a matching window too wide and does not follow a neck.
_CONE = np.array([0.14, 0.17])


@dataclass(slots=True)
class BodyCompletion:
    """A transparent upright body and its touches.

    Examples
    --------
    >>> body = UprightBody(np.zeros(2), np.full(2, 0.004), (0.03, 0.03), 0.003, (0.05, 0.15), 80.0)
    >>> table = SurfaceMesh(np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    >>> completion = BodyCompletion(table, body, 0.0, 0.15)
    >>> plan, before_m = completion.next_touch(), completion.expected_error_m()
    >>> completion.add(Touch(plan.end_m - 0.033 * plan.direction, plan.start_m, plan.end_m))
    >>> completion.expected_error_m() < before_m
    True
    """

    visual: SurfaceMesh  #: the visible surface
    body: UprightBody  #: cone fitted to the outlines
    foot_z_m: float  #: height of the surface on which the body stands [m]
    reach_z_m: (
        float  #: top of the evidence for glass: the rim is between this height and the top of the cone [m]
    )
    visual_sigma_m: float = 0.0005  #: standard deviation of the visible surface [m]
    beside: tuple[UprightBody, ...] = ()  #: bodies of other transparent parts, of which lines keep clear
    touches: list[Touch] = field(default_factory=list)
    _wall_to_m: float = field(init=False)
    _found: tuple[tuple[int, float], ProfileMixture] | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self._wall_to_m = self.body.height_m[1]
        self.reach_z_m = max(self.reach_z_m, self._wall_to_m)

    @property
    def _top_m(self) -> float:
        """Estimated height of the rim: midway between the lower and upper bound [m]."""
        return 0.5 * (self._wall_to_m + self.reach_z_m)

    @classmethod
    def standing(
        cls, visual: SurfaceMesh, body: UprightBody, reach_z_m: float, beside: Sequence[UprightBody] = ()
    ) -> BodyCompletion:
        """Create the completion of a body that stands on the visible surface below it.

        Parameters
        ----------
        visual
            The visible surface.
        body
            Cone fitted to the outlines.
        reach_z_m
            Top of the evidence for glass [m].
        beside
            Bodies of other transparent parts, which stand on the same surface.

        Raises
        ------
        InputError
            No visible surface below the body, or the body leans.
        """
        if any(body.lean_m):
            raise InputError(
                "BodyCompletion",
                f"the vessel leans by {np.degrees(body.lean_rad):.0f} degrees, expected an upright one",
                remedy="stand it up and reconstruct again",
            )
        away_m = np.hypot(*(visual.vertices_m[:, :2] - body.axis_m).T)
        below = visual.vertices_m[
            (away_m < 2 * max(body.radius_m)) & (visual.vertices_m[:, 2] < body.height_m[0]), 2
        ]
        if not len(below):
            raise InputError(
                "BodyCompletion", "no surface was observed below the body, expected the one it stands on"
            )
        return cls(visual, body, float(np.median(below)), reach_z_m, beside=tuple(beside))

    def add(self, touch: Touch) -> None:
        """Add a touch; a line to the axis without contact passed above the rim, or missed a stem below the cone.

        Parameters
        ----------
        touch
            Contact or free line in the frame of the visible surface.
        """
        self.touches.append(touch)
        if touch.contact_m is not None:
            self._wall_to_m = max(self._wall_to_m, float(touch.contact_m[2]))
            self.reach_z_m = max(self.reach_z_m, self._wall_to_m)
        elif touch.end_m is not None and not self._below(touch):
            self.reach_z_m = max(min(self.reach_z_m, float(touch.end_m[2])), self.foot_z_m + 2 * _END_M)
            self._wall_to_m = min(self._wall_to_m, self.reach_z_m)

    def _below(self, touch: Touch) -> bool:
        """Whether a line without contact ends below the cone fitted to the outlines."""
        return touch.contact_m is None and touch.end_m is not None and touch.end_m[2] < self.body.height_m[0]

    def _passed(self) -> Float[np.ndarray, "n 2 3"]:
        """Starts and ends of lines without contact below the cone: the stem there is thinner than the error of the axis [m]."""
        lines_m: list[Any] = [(touch.start_m, touch.end_m) for touch in self.touches if self._below(touch)]
        return np.array(lines_m, dtype=np.float64).reshape(-1, 2, 3)

    def _contacts(self) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"], np.ndarray, np.ndarray]:
        """Directions from the axis, heights, distances from it and their covariance [m] of contacts, missed stems and outlines.

        A missed stem is a radius between zero and the error of the axis, without a direction, as is that of an outline.
        """
        met = [(touch.contact_m, touch.sigma_m) for touch in self.touches if touch.contact_m is not None]
        points = np.array([point for point, _ in met]).reshape(-1, 3)
        stems_m, rings = self._passed()[:, 1, 2], self._rings()
        stem_sigma_m = float(np.hypot(*self.body.axis_sigma_m) / np.sqrt(3))
        none = np.zeros((len(stems_m) + len(rings.z_m), 2))
        offset = np.concatenate([points[:, :2] - self.body.axis_m, none])
        rho_m = np.hypot(*offset.T)
        rho_m[len(met) + len(stems_m) :] = rings.radius_m
        z_m = np.concatenate([points[:, 2], stems_m, rings.z_m])
        single = np.array([*(sigma_m for _, sigma_m in met), *[stem_sigma_m] * len(stems_m), *rings.sigma_m])
        noise_m2 = np.diag(single**2)
        noise_m2[len(z_m) - len(rings.z_m) :, len(z_m) - len(rings.z_m) :] += rings.common_m**2
        return offset / np.maximum(np.hypot(*offset.T), 1e-9)[:, None], z_m, rho_m, noise_m2

    def _rings(self) -> OutlineRings:
        """Radii of the outlines; where there are none, those of the cone, which is wrong by the deviations of profiles."""
        body = self.body
        if len(body.rings.z_m):
            return body.rings
        radius_m = np.array(body.radius_m)
        return OutlineRings(np.array(body.height_m), radius_m, _CONE * radius_m)

    def _mixture(self) -> ProfileMixture:
        """Competing profiles, given the contacts."""
        known = (len(self.touches), self._top_m)
        if self._found is None or self._found[0] != known:
            self._found = known, ProfileMixture(self.body, self.foot_z_m, self._top_m, *self._contacts())
        return self._found[1]

    def _meets(self, theta: Float[np.ndarray, "n"], z_m: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Probability that horizontal lines to the estimated axis hit the wall: the true axis is within its radius of them."""
        passed_m, mixture = self._passed(), self._mixture()
        back = passed_m[:, 0] - passed_m[:, 1]
        heights_m = np.append(z_m, passed_m[:, 1, 2])
        levels, level = np.unique(heights_m, return_inverse=True)
        axis, rng = np.diag(self.body.axis_sigma_m**2), np.random.default_rng(0)
        drawn = []
        for model in mixture.models:
            # Axis offset and profile are jointly Gaussian; a contact observes their sum.
            known = mixture.profile_m2(levels, mixture.z_m, model.spread)
            cross = np.vstack([axis @ mixture.way.T, known])
            prior = np.zeros((len(levels) + 2,) * 2)
            prior[:2, :2], prior[2:, 2:] = axis, mixture.profile_m2(levels, levels, model.spread)
            one = rng.integers(len(model.radii_m), size=round(_DRAWS * model.share))
            mean = model.gains[one] @ cross.T
            mean[:, 2:] += model.at(levels)[one]
            spread = prior - cross @ model.inverse @ cross.T
            drawn.append(
                mean + rng.multivariate_normal(np.zeros(len(prior)), spread, len(one), method="eigh")
            )
        both = np.concatenate(drawn)
        angle = np.append(theta, np.arctan2(back[:, 1], back[:, 0]))
        meets = np.abs(both[:, :2] @ np.stack([-np.sin(angle), np.cos(angle)])) < both[:, 2 + level]
        left = ~meets[:, len(theta) :].any(axis=1)
        return np.asarray(meets[left if left.any() else slice(None), : len(theta)].mean(axis=0))

    def wall(
        self, theta: Float[np.ndarray, "n"], z_m: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Distance of the wall from the axis and its standard deviation [m].

        Parameters
        ----------
        theta, z_m
            Angles (n) around the axis [rad] and heights (n) [m].
        """
        mean_m, sigma_m = self._mixture().wall(np.column_stack([np.cos(theta), np.sin(theta)]), z_m)
        return np.maximum(mean_m, 2e-3), sigma_m

    def _above_rim_m(self, z_m: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Root mean square distance of points of the wall from a rim below them, uniform between its bounds [m]."""
        range_m = max(self.reach_z_m - self._wall_to_m, 1e-9)
        above: Float[np.ndarray, "n"] = np.clip(z_m - self._wall_to_m, 0.0, range_m)
        return np.sqrt(above**3 / (3 * range_m))

    def _places(self, angles: int, heights: int, end_m: float) -> tuple[np.ndarray, np.ndarray]:
        theta = 2 * np.pi * np.arange(angles) / angles
        z_m = np.linspace(self.foot_z_m + end_m, self._top_m - end_m, heights)
        return np.tile(theta, heights), np.repeat(z_m, angles)

    def surface(self) -> SurfaceMesh:
        """Mesh of the estimated wall [m], open at the top."""
        theta, z_m = self._places(_ANGLES, _HEIGHTS, 0.0)
        rho_m, _ = self.wall(theta, z_m)
        vertices = np.column_stack(
            [self.body.axis_m[0] + rho_m * np.cos(theta), self.body.axis_m[1] + rho_m * np.sin(theta), z_m]
        )
        k = np.arange(_ANGLES * (_HEIGHTS - 1))
        right = k // _ANGLES * _ANGLES + (k + 1) % _ANGLES
        faces = np.vstack(
            [np.column_stack([k, right, right + _ANGLES]), np.column_stack([k, right + _ANGLES, k + _ANGLES])]
        )
        return SurfaceMesh(vertices, faces)

    def completed(self) -> SurfaceMesh:
        """The visible surface joined with the estimated wall."""
        part = self.surface()
        colors = None if self.visual.colors is None else np.full((len(part.vertices_m), 3), 200, np.uint8)
        return self.visual.joined(SurfaceMesh(part.vertices_m, part.faces, colors))

    def sigma_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Standard deviation of the completed surface [m]; that of vision at visible points.

        Parameters
        ----------
        points_m
            Points (n, 3) of the completed surface [m].
        """
        offset = points_m[:, :2] - self.body.axis_m
        theta, z_m = np.arctan2(offset[:, 1], offset[:, 0]), points_m[:, 2]
        sigma = np.full(len(points_m), self.visual_sigma_m)
        reach_m = 2 * max(self.body.radius_m)
        near = np.flatnonzero((np.hypot(*offset.T) < reach_m) & (z_m >= self.foot_z_m) & (z_m <= self._top_m))
        if len(near):
            rho_m, wall_m = self.wall(theta[near], z_m[near])
            own = np.abs(np.hypot(*offset[near].T) - rho_m) < 1e-3
            sigma[near[own]] = np.hypot(wall_m, self._above_rim_m(z_m[near]))[own]
        return sigma

    def next_touch(self) -> TouchPlan:
        """Plan the next touch: the horizontal line to the axis with the largest variance over the wall's area times contact probability.

        Raises
        ------
        InputError
            Every line is obstructed by the visible surface.
        """
        theta, z_m = self._places(*_PLACES, _END_M)
        if len(self.touches) >= MIN_TOUCHES and self.reach_z_m - self._wall_to_m > 2 * _END_M:
            # The rim is less certain than the wall: probe at its estimated height.
            z_m = np.full_like(z_m, self._top_m)
        rho_m, sigma_m = self.wall(theta, z_m)
        for best in np.argsort(-rho_m * sigma_m**2 * self._meets(theta, z_m), kind="stable"):
            outward = np.array([np.cos(theta[best]), np.sin(theta[best])])
            target = np.append(self.body.axis_m + rho_m[best] * outward, z_m[best])
            start = np.append(
                self.body.axis_m + (rho_m[best] + 3 * sigma_m[best] + _START_M) * outward, z_m[best]
            )
            if self._free(target, start):
                score = float(sigma_m[best])
                end = np.append(self.body.axis_m, z_m[best])
                return TouchPlan(target, start, end, score, score)
        raise InputError("BodyCompletion.next_touch", "every horizontal line to the axis is obstructed")

    def _free(self, target_m: Float[np.ndarray, "3"], start_m: Float[np.ndarray, "3"]) -> bool:
        """Whether the line from a start to the wall is clear of the visible surface and of other transparent bodies."""
        way = start_m - target_m
        line_m = target_m + np.linspace(0.3, 1.5, _LINE)[:, None] * way
        for body in self.beside:  # below its cone, a body may be as wide as there
            upper_m = np.column_stack([line_m[:, :2], np.maximum(line_m[:, 2], body.height_m[0])])
            if body.contains(upper_m, _CLEAR_M).any():
                return False
        along = np.clip((self.visual.vertices_m - target_m) @ way / (way @ way), 0.3, 1.5)
        gap = np.linalg.norm(self.visual.vertices_m - target_m - along[:, None] * way, axis=1)
        return bool(gap.min(initial=np.inf) > min(_CLEAR_M, 0.8 * (target_m[2] - self.foot_z_m)))

    def expected_error_m(self) -> float:
        """Root mean square standard deviation of the wall, including that of its height [m]."""
        theta, z_m = self._places(*_PLACES, 0.0)
        return float(np.sqrt(np.mean(self.wall(theta, z_m)[1] ** 2 + self._above_rim_m(z_m) ** 2)))

    def done(self, bound_m: float) -> bool:
        """Whether the expected error is below a bound and there are at least three contacts (stop rule).

        Parameters
        ----------
        bound_m
            Accepted root mean square error of the wall [m].
        """
        met = sum(touch.contact_m is not None for touch in self.touches)
        return met >= MIN_TOUCHES and self.expected_error_m() < bound_m
