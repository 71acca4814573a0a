"""Completion of an object by touch: extrapolate the visible surface, plan the next touch, refit.

Alt 2016, Sec. 5.3.1 and 5.4. The spline of the visible band is factored once; touches are added by a Schur complement
update. In the dissertation the surface of one object diverged at the 19th touch, because contacts were interpolated:
two contacts a millimetre apart whose position errors differ by a millimetre impose a slope of one *along* the
surface, and |x|^3 propagates that slope over the whole hole. Here contacts are smoothed by their variance relative to
the scale of the spline, touches at one place are averaged, and a touch adds one centre on the surface only, without
off-surface points along an unmeasured normal.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ...core import InputError, Pose
from ..mesh import SurfaceMesh
from ..surfaces import BiharmonicMesh, RbfSurface
from .discrete_symmetry import DiscreteSymmetry
from .hole import support_band
from .hole_region import HoleRegion
from .hole_surface import HoleSpace
from .open_shell import OpenShell
from .outline import VisibleWall, wall_seen
from .radial_model import MIN_LIKELIHOOD_RATIO, RadialMixture, fit_radial_mixture
from .rbf_centres import (
    Centres,
    band_sigma_m,
    constrain_axis,
    constrain_core,
    constrain_free,
    constrain_to_hull,
    free_points,
    with_off_surface,
)
from .symmetry import ShapePrior, fit_prior, height_axis
from .touch import CompletionSettings, Touch, TouchPlan, reachable, starts
from .uncertainty import SurfaceUncertainty, between, calibration, spline_sigma_m
from .visibility import remove_back_sides

#: Points of a ring with a smaller standard deviation, relative to its radius, are supports for planning.
_TRUSTED = 0.06
#: Points of a ring with a larger standard deviation, relative to its radius, are not used.
_USELESS = 0.2
#: Distance of the off-surface points, in sizes of the region.
_OFF_SURFACE = 0.05
#: Nodes along the longest edge of the region, for the surface and for the mesh on which touches are planned.
_GRID, _PLAN_GRID = 64, 34
#: Minimum number of contacts before an exploration is complete.
MIN_TOUCHES = 3


class Completion:
    """A visible surface, the region where it is missing, and its touches.

    Parameters
    ----------
    visual
        The visible surface, triangles counter-clockwise from outside, z up.
    region
        Region where the surface is missing.
    settings
        Noise of the visible surface, priors and the floor.
    T_visual_haptic
        Maps touches to the frame of the visible surface.

    Raises
    ------
    InputError
        The region is too far from the surface.

    Examples
    --------
    >>> from visuohaptic.simulation.tabletop import random_bottle
    >>> bottle = random_bottle(np.random.default_rng(4), "round")
    >>> low_m, high_m = 0.3 * bottle.height_m, 0.7 * bottle.height_m
    >>> visible = SurfaceMesh(*bottle.mesh(0.0, low_m)).joined(SurfaceMesh(*bottle.mesh(high_m, bottle.height_m)))
    >>> hidden_m, _ = bottle.mesh(low_m, high_m, caps=False)
    >>> completion = Completion(visible, HoleRegion.of_points(hidden_m))
    >>> before_m, plan = completion.expected_error_m(), completion.next_touch()
    >>> completion.add(Touch(bottle.probe(plan.start_m, plan.direction, 1.0), plan.start_m, plan.end_m))
    >>> completion.expected_error_m() < before_m
    True
    """

    def __init__(
        self,
        visual: SurfaceMesh,
        region: HoleRegion,
        settings: CompletionSettings | None = None,
        *,
        T_visual_haptic: Pose | None = None,
    ) -> None:
        self.settings = settings or CompletionSettings()
        self._both_sides = visual
        self.visual = remove_back_sides(visual, region)
        self.region = region
        self._pose = T_visual_haptic
        self.band = support_band(self.visual, region)
        self.touches: list[Touch] = []  #: in the frame of the visible surface
        self._d_m = _OFF_SURFACE * region.size_m
        middle_z = float(region.hull_m[:, 2].min() + region.hull_m[:, 2].max()) / 2
        oriented = self.band.points_m, self.band.normals
        self.prior: ShapePrior | None = fit_prior(*oriented, middle_z) if self.settings.use_priors else None
        #: x and y of the height axis [m].
        self.axis_m: Float[np.ndarray, "2"] = self.prior.axis_m if self.prior else height_axis(*oriented)
        self._centers = with_off_surface(*oriented, self._d_m)
        first = RbfSurface(*self._centers[:2], 1e-8)
        #: Variance of the thin-plate process in units of the extent; the smoothing is noise variance over this.
        self._scale, self._extent_m = max(first.process_scale, 1e-12), first.extent_m
        #: Averaged contacts and their standard deviations.
        self._contacts: list[tuple[np.ndarray, float]] = []
        self._free: list[np.ndarray] = []  #: points that probes passed without contact
        self._squares: list[float] = []  #: squared standardised residuals of the touches
        self._radial: RadialMixture | None = None
        self._ring_points = np.zeros((0, 0, 3)), np.zeros((0, 0))  #: of each contact, and their deviations
        self._seen: VisibleWall | None = None
        self._bound()
        self._fit = self._visible
        self._space = HoleSpace(region, self.band)
        if self._symmetric:
            self._refit(None)
        self._reset()

    def _bound(self) -> None:
        """Fit the band; keep the surface in the hull of all known points, above the floor."""
        near = self.visual.vertices_m[self.region.within(self.visual.vertices_m, self.region.size_m), 2]
        floor_m = max(self.settings.floor_m, min(near.min(), self.region.hull_m[:, 2].min()))
        self._outer = self.region.with_surface(self._supports(), self.band.gap_m, floor_m)
        centers, values, own = self._centers
        self._band_sigma_m = band_sigma_m(self.band, self.radial, self.visual_sigma_m)
        fit = RbfSurface(centers, values, self._rho(self._band_sigma_m[own], self._extent_m))
        within = constrain_to_hull(fit, self._outer, self.band, 0.5 * self._d_m, self._rho)
        walls_m = np.vstack([self.band.walls_m, self._met_m])
        self._visible = constrain_core(within, self.region.clipped(self.axis_m, walls_m), self._rho)
        self._symmetry = DiscreteSymmetry(self.band, self.region, self._outer)
        self._symmetric = self.settings.use_priors and self._symmetry.possible

    def _reset(self) -> None:
        self._plan: Any = None
        self._uncertainty: SurfaceUncertainty | None = None

    def _rho(self, sigma_m: Float[np.ndarray, "n"], extent_m: float) -> Float[np.ndarray, "n"]:
        return (np.asarray(sigma_m) / extent_m) ** 2 / self._scale

    @property
    def visual_sigma_m(self) -> float:
        """Standard deviation of the visible surface [m]."""
        return self.settings.visual_sigma_m

    @property
    def implicit(self) -> RbfSurface:
        """The fitted signed distance, positive outside."""
        return self._fit

    def add(self, touch: Touch) -> None:
        """Add a touch: its contact is on the surface, its line up to the contact is outside.

        Parameters
        ----------
        touch
            Contact or free line, in the haptic frame (see ``T_visual_haptic``).
        """
        touch = touch.moved(self._pose) if self._pose is not None else touch
        self.touches.append(touch)
        fresh, refit = Centres(), False
        if (contact := touch.contact_m) is not None:
            expected_m = float(self._fit.kriging_sigma_m(contact[None])[0])
            square_m2 = float(self._fit(contact[None])[0]) ** 2
            self._squares.append(square_m2 / (expected_m**2 + touch.sigma_m**2))
            self._radial = None
            refit = self._join(contact, touch.sigma_m)
            sigma_m = band_sigma_m(self.band, self.radial, self.visual_sigma_m)
            same = np.allclose(sigma_m, self._band_sigma_m, rtol=0.5 * MIN_LIKELIHOOD_RATIO, atol=0.0)
            if not (same and self._outer.within(contact[None], touch.sigma_m)[0]):
                self._bound()  # the contact changes the errors at rims, or shows that the region was too small
                refit = True
            if not refit:
                fresh.put(contact, 0.0, touch.sigma_m)
                self._rings(-1, fresh)
        self._free.extend(free_points(touch, self._d_m))
        # Symmetries are inferred again from all contacts.
        self._refit(None if refit or self._symmetric else fresh)
        self._reset()

    def _join(self, contact: Float[np.ndarray, "3"], sigma_m: float) -> bool:
        """Average touches at one place; returns whether an earlier contact was changed."""
        near_m = max(3.0 * sigma_m, 0.01 * self.region.size_m)
        for number, (old, old_sigma) in enumerate(self._contacts):
            if np.linalg.norm(old - contact) < near_m:
                a, b = 1 / old_sigma**2, 1 / sigma_m**2
                self._contacts[number] = ((a * old + b * contact) / (a + b), float((a + b) ** -0.5))
                return True
        self._contacts.append((contact, sigma_m))
        return False

    def _rings(self, number: int, into: Centres) -> None:
        """Append the rest of a touched ring, predicted by the process of the wall's radius."""
        if self.prior is None or self.radial is None:
            return
        contact, sigma_m = self._contacts[number]
        radius = float(np.linalg.norm(contact[:2] - self.axis_m))
        points, spread = (part[number] for part in self._ring_points)
        spread = spread * len(self._contacts) ** 0.5  # each ring is predicted from all contacts
        held = np.full(len(points), self.prior.p_sweep)
        if self.prior.p_mirror > 0.5 > self.prior.p_sweep:
            # The cross-section changes between the bands, but the mirror symmetry still holds.
            mirrored, off_m = self.prior.mirrored(contact)
            points, spread = np.vstack([mirrored, points]), np.append(np.hypot(off_m, sigma_m), spread)
            held = np.append(self.prior.p_mirror, held)
        # Expected log-likelihood of an observation that holds with probability p: its variance is divided by p.
        spread = spread / np.sqrt(np.maximum(held, np.finfo(float).tiny))
        # Measured points nearby replace the prediction.
        gaps = np.linalg.norm(points[:, None] - self._supports(), axis=2).min(axis=1)
        used = (gaps >= 0.04 * self.region.size_m) & (spread < _USELESS * radius)
        for k in np.flatnonzero(used):
            into.put(points[k], 0.0, float(spread[k]))

    def _refit(self, fresh: Centres | None) -> None:
        """Add the new centres, or refit all if ``None``; then add centres in free space that the surface covers."""
        base = self._fit
        if fresh is None:
            base, fresh = self._visible, Centres()
            for number, (contact, sigma) in enumerate(self._contacts):
                fresh.put(contact, 0.0, sigma)
                self._rings(number, fresh)
            if self._symmetric:
                self._symmetry.put(self._contacts, fresh)
        if fresh.points:
            rho = self._rho(np.array(fresh.sigmas), base.extent_m)
            base = base.added(np.array(fresh.points), np.array(fresh.values), rho)
        self._fit = base
        if self.prior is not None and self._contacts:
            self._fit = constrain_axis(self._fit, self.axis_m, self._met_m, self._d_m, self._rho)
        if self._free:
            self._fit = constrain_free(self._fit, np.array(self._free), 0.25 * self._d_m, self._rho)

    def _supports(self) -> Float[np.ndarray, "s 3"]:
        return np.vstack([self.band.points_m, self._met_m])

    @property
    def _met_m(self) -> Float[np.ndarray, "n 3"]:
        return np.array([contact for contact, _ in self._contacts]).reshape(-1, 3)

    def surface(self) -> SurfaceMesh:
        """The estimated surface in the grown region [m]; it overlaps the visible one in the band."""
        return self._space.surface(self._fit, _GRID, self._supports())

    def completed(self) -> SurfaceMesh:
        """The visible surface joined with the estimated one where the visible surface is missing."""
        found = self.surface()
        missing = self.band.away(found.vertices_m[found.faces].mean(axis=1))
        if not missing.any():
            return self.visual
        part, visible = found.submesh(np.flatnonzero(missing)), self.visual
        if self.shell is not None:
            part, visible = part.joined(self._inner()[0]), self.shell.visible
        colors = None if visible.colors is None else np.full((len(part.vertices_m), 3), 200, np.uint8)
        return visible.joined(SurfaceMesh(part.vertices_m, part.faces, colors))

    @cached_property
    def shell(self) -> OpenShell | None:
        """Wall of an open container of which both sides are seen; ``None`` if a solid is more probable."""
        return OpenShell.seen(self._both_sides, self.band, self._outer, self.region, self.visual_sigma_m)

    def _inner(self) -> tuple[SurfaceMesh, Float[np.ndarray, "v"]]:
        """Hidden inner side of the shell, and its standard deviation from the outer side [m]."""
        assert self.shell is not None
        return self.shell.inner(self.surface(), self.region, self.band.gap_m)

    def _planned(
        self,
    ) -> tuple[SurfaceMesh, BiharmonicMesh, Float[np.ndarray, "v"], Bool[np.ndarray, "v"]]:
        """The planning mesh with its distances, the score of every vertex, and whether it is in the missing part."""
        if self._plan is None:
            mesh = self._space.surface(self._fit, _PLAN_GRID, self._supports())
            distances = BiharmonicMesh(mesh.vertices_m, mesh.faces)
            heights, z_m = self._outer.hull_m[:, 2], mesh.vertices_m[:, 2]
            missing = self.band.away(mesh.vertices_m) & (z_m >= heights.min()) & (z_m <= heights.max())
            self._plan = mesh, distances, distances.score(self._support_vertices(mesh)), missing
        return self._plan

    def _deviation_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Standard deviation of points of the estimated surface [m]."""
        if self.radial is not None:
            return self.radial.deviation_m(points_m)
        return spline_sigma_m(self._fit, points_m) * calibration(self._squares)

    @property
    def radial(self) -> RadialMixture | None:
        """Process of the hidden wall's radius; ``None`` if no cross-section is visible all around."""
        if self._radial is None and self.prior is not None:
            self._seen = self._seen or wall_seen(self.prior, self.band)
            self._radial = fit_radial_mixture(self.prior, self._seen, self._contacts, self.region.size_m)
            self._ring_points = self._radial.rings(self._met_m)
        return self._radial

    def uncertainty(self) -> SurfaceUncertainty:
        """Standard deviation of every vertex of the planning mesh."""
        if self._uncertainty is None:
            mesh, _, _, missing = self._planned()
            self._uncertainty = SurfaceUncertainty(mesh, self._deviation_m(mesh.vertices_m), missing)
        return self._uncertainty

    def sigma_m(self, points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Standard deviation of the completed surface [m]; that of vision at visible points.

        Parameters
        ----------
        points_m
            Points (n, 3) of the completed surface [m].
        """
        sigma = np.full(len(points_m), self.settings.visual_sigma_m)
        missing = self.band.away(points_m) & (self.region.distance_m(points_m) < self.band.gap_m)
        if missing.any():
            found = self.uncertainty()
            places_m, known_m = found.mesh.vertices_m, found.sigma_m
            if self.shell is not None:
                inner, off_m = self._inner()
                known_m = np.append(known_m, np.hypot(between(places_m, known_m, inner.vertices_m), off_m))
                places_m = np.vstack([places_m, inner.vertices_m])
            sigma[missing] = between(places_m, known_m, points_m[missing])
        return sigma

    def _support_vertices(self, mesh: SurfaceMesh) -> Int[np.ndarray, "s"]:
        from scipy.spatial import cKDTree

        points, rings = [*self._supports()], Centres()
        for number in range(len(self._contacts)):
            self._rings(number, rings)
        away_m = np.linalg.norm(np.reshape(rings.points, (-1, 3))[:, :2] - self.axis_m, axis=1)
        points += [rings.points[k] for k in np.flatnonzero(rings.sigmas < _TRUSTED * away_m)]
        gaps, near = cKDTree(mesh.vertices_m).query(np.array(points))
        close = gaps < 0.06 * self.region.size_m
        return near[close] if close.any() else near

    def next_touch(self) -> TouchPlan:
        """Plan the line to the least supported reachable point of the missing part.

        Raises
        ------
        InputError
            No point of the missing part can be reached by a horizontal line.
        """
        return self.next_touches([])[0]

    def next_touches(self, reaches_m: list[tuple[float, float]]) -> list[TouchPlan]:
        """Plan lines for several fingers greedily.

        Each target is a support for the selection of the next.

        Parameters
        ----------
        reaches_m
            Of each further finger: minimum and maximum distance of its start
            from the start of the first [m]. Fingers without a reachable target are omitted.
        """
        mesh, distances, score, missing = self._planned()
        size_m = self.region.size_m
        ok = missing & reachable(mesh, self.axis_m, self.touches, size_m=size_m, clear_m=self._d_m)
        begins = starts(mesh.vertices_m, self.axis_m, self._supports(), self._d_m)
        ok[ok] = self.band.in_front(mesh.vertices_m[ok], begins[ok], 2 * self._d_m)
        gap_m, plans = np.zeros(len(score)), list[TouchPlan]()
        for low_m, high_m in [(0.0, np.inf), *reaches_m]:
            chosen = np.where(ok & (gap_m >= low_m) & (gap_m <= high_m), score, -1.0)
            if chosen.max() >= 0:
                best = int(chosen.argmax())
                target_m = mesh.vertices_m[best]
                sigma_m = float(self._deviation_m(target_m[None])[0])
                end_m = np.append(self.axis_m, target_m[2])
                plans.append(TouchPlan(target_m, begins[best], end_m, float(score[best]), sigma_m))
                if reaches_m:
                    gap_m = np.linalg.norm(begins - plans[0].start_m, axis=1)
                    known = distances.distance(np.arange(len(score)), np.array([best]))
                    score = np.minimum(score, known[:, 0])
            elif not plans:
                raise InputError("Completion.next_touch", "no point of the missing part can be reached")
        return plans

    def expected_error_m(self) -> float:
        """Root mean square standard deviation of the missing part [m]."""
        found = self.uncertainty()
        chosen = found.sigma_m[found.missing]
        return float(np.sqrt(np.mean(chosen**2))) if len(chosen) else 0.0

    def done(self, bound_m: float) -> bool:
        """Whether the expected error is below a bound (stop rule).

        Always false with fewer than ``MIN_TOUCHES`` contacts: the uncertainty predicted from
        vision alone has not been validated yet.

        Parameters
        ----------
        bound_m
            Accepted root mean square error of the missing part [m].
        """
        return len(self._contacts) >= MIN_TOUCHES and self.expected_error_m() < bound_m
