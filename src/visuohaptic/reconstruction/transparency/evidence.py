"""Transparency detector: log-likelihood ratios of rays summed in space, with a specified false-alarm rate.

For a ray with reading r in context c (:mod:`.ray_readings`)

- P(r | c, nothing transparent) is estimated from the sequence itself, so that no drop-out model of the camera is needed.
  The estimate is repeated without the rays through detected parts until no further parts are found, and without those
  through a place that is tested: a vessel seen in a few views raises the rates that it is compared with;
- P(r | glass) is that of four kinds of glass: faint, thin, strong and filled (:func:`.ray_readings.reading_tables`).

Readings of neighbouring pixels are correlated: all readings within a matching window count as one. R is the likelihood
ratio of the readings in a window of the size of the smallest object of interest. The evidence of a view is

    log [((1 - d) R + d) / ((1 - e) + e R)]

with d the probability that a view through glass shows no effect of it, and e the fraction of all windows that look like
glass for any cause (maximum likelihood over the sequence). It is the log ratio of the probability with glass *here* to that
of an arbitrary window, and bounded: no single view is decisive, and views count less if many windows look like glass.

The sum over views is a log-likelihood ratio. The probability that it exceeds log(N / a) at any of N places without glass is
at most a (Markov's inequality, Bonferroni), for any number of views: a is the false-alarm rate that the user specifies.

A wide vessel that few views see has no single place with so much evidence. A place where glass is more probable than not is therefore tested as
a whole: its likelihood ratio in a view is that of all windows inside the outline of a body, with the same bounds. A part has to exceed the
threshold also with the rates of the surface behind it (:func:`.ray_readings.surface_ratios`), and views have to agree on what is behind it
(:func:`.regions.agreed_behind`). Its place follows from its outlines, its extent is the same sum with e = 0.85: this many rays pass
a round glass at 1.03 of its radius. Parts, strongest first, explain their rays. An unknown second eye follows from the shadows of opaque things (:func:`.ray_readings.second_eye_m`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ...io.depth.pixel_model import PixelModel, scores_of
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from ..fusion.volume import SpaceGrid
from ..vessel_shapes import UprightBody
from .body_pairs import fit_part, without_body
from .outline_fit import OutlineView, body_evidence
from .outline_rings import with_rings
from .panes.pane_fit import Pane, find_panes
from .ray_evidence import HIDDEN, LOOK_ALIKE, RayEvidence, ScoreEvidence, look_alike_fraction
from .ray_readings import (
    FAR,
    NEAR,
    RayImage,
    TrackedNoise,
    ViewDepth,
    ray_image,
    reading_tables,
    second_eye_m,
    surface_ratios,
    window_ratios,
)
from .regions import TransparentRegion, agreed_behind, body_voxels, region_of, seen_behind
from .search_report import SearchReport, next_eye
from .view_geometry import ray_stride, thinned, view_graph

#: Stride of the pixels whose windows are used to estimate e [px], and radius of the smallest object of interest [m].
_STRIDE, RADIUS_M = 5, 0.015
#: Numbers of views that each view is compared with, and in which an unknown second eye is sought; maximum fraction of contradicted rays of a view.
_NEIGHBOURS, _EYE_VIEWS, _MAX_WRONG = 10, 8, 0.3
#: Angle between independent views, preferred between compared views; minimum angle between these, as nearer ones see glass alike [rad].
_INDEPENDENT_RAD, MIN_ANGLE_RAD = math.radians(10.0), math.radians(4.0)


@dataclass(slots=True)
class EvidenceDetector:
    """Evidence for transparent parts in a volume, from all views of one sequence in any order."""

    grid: SpaceGrid
    noise: DepthNoise = SENSOR_NOISE["kinect"]
    false_alarm_rate: float = 0.02  #: expected number of false parts of a search
    model: PixelModel | None = None  #: further evidence: scores of a network
    #: for glass here; an upper bound where below 0 [nat]
    evidence: Float32[np.ndarray, "x y z"] = field(init=False)
    #: for glass here rather than beside, likewise [nat]
    extent: Float32[np.ndarray, "x y z"] = field(init=False)
    #: number of independent views with evidence, of each block of voxels
    seen: Float32[np.ndarray, "a b c"] = field(init=False)
    inside: Bool[np.ndarray, "x y z"] = field(init=False)  #: mask of the transparent voxels
    threshold: float = field(init=False)  #: minimum evidence of a part [nat]
    look_alike: float = field(init=False, default=LOOK_ALIKE)  #: fraction of windows that look like glass
    measured: TrackedNoise = field(init=False, default=TrackedNoise())  #: noise of the sequence
    panes: tuple[Pane, ...] = field(init=False, default=())  #: detected flat panes, likeliest first
    views: int = field(init=False, default=0)  #: number of input views
    skipped: Counter[str] = field(
        init=False, default_factory=Counter
    )  #: number of views not compared, by cause
    _images: list[RayImage] = field(init=False, default_factory=list)
    _rays: RayEvidence = field(init=False)
    _tables: Float32[np.ndarray, "kinds n"] = field(init=False)
    _scores: list[Float32[np.ndarray, "h w"]] = field(init=False, default_factory=list)
    _outlines: list[OutlineView] = field(init=False, default_factory=list)
    _found: tuple[TransparentRegion, ...] = field(init=False, default=())
    _strongest: float = field(init=False, default=0.0)  #: largest evidence of a part [nat]
    _stride: int = field(init=False, default=1)
    _matching_px: float = field(init=False, default=1.0)  #: edge of a matching window [px]
    #: edge of the window of the smallest object in each view [px]
    _object_px: list[int] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        if not 0 < self.false_alarm_rate < 1:
            said = f"found {self.false_alarm_rate}, expected between 0 and 1 exclusive"
            raise InputError("EvidenceDetector", said, field="false_alarm_rate")
        shape = self.grid.shape
        self.evidence, self.extent = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self.seen, self.inside = np.zeros((1, 1, 1), np.float32), np.zeros(shape, dtype=bool)
        self.threshold, none = -math.log(self.false_alarm_rate), np.zeros((0, 0, 0), np.float32)
        self._rays = RayEvidence((), none.ravel(), none, none, none)

    def run(self, frames: Sequence[DepthFrame]) -> None:
        """Compare every view with others, sum the evidence of its rays, and extract parts.

        Parameters
        ----------
        frames
            All views of one camera, in any order.
        """
        self.views = len(frames)
        compared, weights = self._read(frames)
        if not compared:
            return
        limit_m = np.stack([rays.limit_m for rays in self._images])
        self._rays = RayEvidence(compared, weights, limit_m, limit_m, limit_m)
        self._sum(limit_m > 0, first=True)
        whole = self.evidence
        while self._take() or self._take_held_out(limit_m):
            # Parts weaker than the accepted ones, as a bowl of which only the rim shows, contaminate the rates less.
            self._sum(limit_m > 0)
            if (strong := self.evidence >= self.threshold).any():
                self._sum((limit_m > 0) & ~self._through(strong))
        told = self._rays, self.grid, self.threshold, self.look_alike, 2 * RADIUS_M
        self.panes = find_panes(self._outline_views(), self._views_beside, *told)
        self.evidence = whole
        if not self._found:
            return
        limit_m[:] = [image.limit_m for image in self._images]
        fitted = self._outline_views(), self.grid.low_m[2], self.threshold, self.false_alarm_rate
        self._found = with_rings(self._found, *fitted)

    def _sum(self, counted: Bool[np.ndarray, "n h w"], *, first: bool = False) -> None:
        """Sum the unexplained evidence; the rates without glass are estimated from the ``counted`` rays."""
        self._outlines, told = [], self._rays
        codes = [rays.code[some] for rays, some in zip(self._images, counted, strict=True)]
        self._tables = reading_tables(codes)
        pairs = zip(self._images, self._object_px, strict=True)
        ratios = np.stack(
            [window_ratios(rays, self._tables, self._matching_px, size) for rays, size in pairs]
        )
        windows = [ratio[limit > 0][:: _STRIDE**2] for ratio, limit in zip(ratios, told.limit_m, strict=True)]
        self.look_alike = look_alike_fraction(np.concatenate(windows))
        self._rays = RayEvidence.of_ratios(told.frames, told.weights, told.limit_m, ratios, self.look_alike)
        self.evidence, self.extent, seen = self._rays.sums(self.grid)
        if first:
            # Rays explained by later parts still count as observations.
            self.seen = seen
            space_m3 = float(np.mean(seen > 0) * np.prod(self.grid.high_m - self.grid.low_m))
            places = space_m3 / (2 * RADIUS_M) ** 3
            self.threshold = math.log(max(places, 1.0) / self.false_alarm_rate)
        if self._scores:
            read = np.stack([image.limit_m > 0 for image in self._images])
            shown = read, self.evidence - self._even, self.grid, 2 * RADIUS_M
            scored = ScoreEvidence.learned(self._scores, self._object_px, self._rays, *shown)
            self._rays = replace(self._rays, scores=scored)
            self.evidence = self.evidence + scored.sums(self.grid)

    def _outline_views(self, added: Sequence[Float32[np.ndarray, "h w"]] = ()) -> list[OutlineView]:
        """Outlines of all views with the current rates, and what is added to the log-likelihood ratios of each view."""
        views = []
        for k, (frame, image) in enumerate(zip(self._rays.frames, self._images, strict=True)):
            ratios = [np.take(table, image.code) + (added[k] if added else 0) for table in self._tables]
            told = (
                image.reading,
                ratios,
                self._rays.limit_m[k],
                self.measured.device,
                float(self._rays.weights[k]),
            )
            views.append(OutlineView.of_view(frame, *told, self._stride))
        return views

    def _read(self, frames: Sequence[DepthFrame]) -> tuple[list[DepthFrame], Float32[np.ndarray, "n"]]:
        """Views that have enough others for a comparison, and their weights; stores their readings."""
        graph, whole = view_graph(frames), frames
        middle_m, focal_px = 0.5 * (self.grid.low_m + self.grid.high_m), frames[0].camera.focal_px
        eyes_m = np.array([frame.T_world_camera.translation_m for frame in frames])
        away_m = np.maximum(np.linalg.norm(eyes_m - middle_m, axis=1), 0.1)
        window_px = self.noise.window_px(focal_px)
        self._stride = ray_stride(focal_px, self.grid.voxel_m, float(np.median(away_m)), window_px)
        frames = [thinned(frame, self._stride) for frame in frames]
        focal_px = frames[0].camera.focal_px
        self._matching_px = self.noise.window_px(focal_px, self._stride)
        near = [graph.neighbours(i, _NEIGHBOURS, _INDEPENDENT_RAD, MIN_ANGLE_RAD) for i in range(len(frames))]
        nearest = [graph.neighbours(i, 1, MIN_ANGLE_RAD) for i in range(len(frames))]
        noise = TrackedNoise.measured(frames, nearest, self.noise)
        views = [ViewDepth.of_frame(frame, noise) for frame in frames]
        compared = [i for i, others in enumerate(near) if len(others) > 1]

        def rays_of(i: int) -> RayImage:
            return ray_image(views[i], [views[k] for k in near[i]], noise)

        if not self.noise.baseline_known:
            some = compared[:: max(1, len(compared) // _EYE_VIEWS)]
            eye_m = second_eye_m([rays_of(i) for i in some], focal_px, self._matching_px)
            noise = replace(noise, device=replace(self.noise, baseline_m=eye_m))
        self.measured = noise
        read, weights = [], graph.weights(_INDEPENDENT_RAD)
        for i in compared:
            rays = rays_of(i)
            wrong = np.count_nonzero(np.isin(rays.reading, (FAR, NEAR)))
            if wrong > _MAX_WRONG * max(int(np.count_nonzero(rays.reading)), 1):
                continue
            read.append(i)
            # At least the matching window.
            radius_px = max(0.5 * (self._matching_px - 1), focal_px * RADIUS_M / away_m[i])
            self._object_px.append(2 * round(radius_px) + 1)
            if self.model:
                scored = replace(whole[i], depth_m=scores_of(self.model, whole[i]))
                self._scores.append(thinned(scored, self._stride).depth_m)
            self._images.append(rays)
        missed = {"no model": len(frames) - len(compared), "too wrong": len(compared) - len(read)}
        self.skipped = Counter({cause: count for cause, count in missed.items() if count})
        return [frames[i] for i in read], weights[read].astype(np.float32)

    def _through(self, voxels: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "n h w"]:
        return self._rays.through(self.grid.centres_m(np.argwhere(voxels)), self.grid.voxel_m)

    def _take_held_out(self, limit_m: Float32[np.ndarray, "n h w"]) -> bool:
        """Extract the first part that exceeds the threshold with the rates of the rays that do not pass it, most probable place first."""
        from scipy import ndimage

        before = self._rays, self._tables, self.evidence, self.extent, self.look_alike, self._outlines
        labels, number = ndimage.label(self.evidence > 0, np.ones((3, 3, 3)))
        peaks = ndimage.maximum_position(self.evidence, labels, range(1, number + 1))
        # A single view is not enough for a part.
        peaks = [peak for peak in peaks if self.evidence[peak] > math.log((1 - HIDDEN) / self.look_alike)]
        for peak in sorted(peaks, key=self.evidence.__getitem__, reverse=True):
            self._sum((limit_m > 0) & ~self._through(labels == labels[peak]))
            if self._take(peak):
                return True
        self._rays, self._tables, self.evidence, self.extent, self.look_alike, self._outlines = before
        return False

    def _take(self, only: tuple[int, ...] | None = None) -> bool:
        """Extract parts, or that at one voxel, in order of falling evidence; each explains the evidence of the rays through it."""
        from scipy import ndimage

        if self.evidence.max() < self._even:
            return False
        before, (labels, _) = len(self._found), ndimage.label(self.extent > 0, np.ones((3, 3, 3)))
        if only:
            labels = (labels == labels[only]).astype(labels.dtype) * (labels[only] > 0)
        boxes = ndimage.find_objects(labels)
        told = self._rays, self._images, self._tables, self._matching_px, self.grid.voxel_m
        held, best = labels > 0, np.full(len(boxes), -np.inf)
        np.maximum.at(best, labels[held] - 1, self.evidence[held])
        while best.max(initial=-np.inf) >= self._even:
            box = boxes[number := int(best.argmax())]
            evidence, extent, _ = self._rays.sums(self.grid.part(box))
            left = (labels[box] == number + 1) & (extent > 0)
            peak = evidence[left].max(initial=-np.inf)
            # The remaining evidence of a part: accepted parts may have reduced it.
            if peak >= best[number] - 1e-3:
                part, bodies = self._part(left, evidence, box)
                # Without their own rates, dark objects look like glass.
                if bodies and (only is None or seen_behind(bodies[0], *told) >= self.threshold):
                    part = self._accept(part, bodies, box)
                labels[box][part] = 0
                peak = evidence[left & ~part].max(initial=-np.inf)
            best[number] = peak
        self._found = tuple(sorted(self._found, key=lambda region: -region.voxels))
        return len(self._found) > before

    def _part(
        self, left: Bool[np.ndarray, "x y z"], evidence: Float32[np.ndarray, "x y z"], box: tuple[slice, ...]
    ) -> tuple[Bool[np.ndarray, "x y z"], list[UprightBody]]:
        """The connected component around the strongest voxel of a part, its strongest body, and a second one beside it."""
        from scipy import ndimage

        labels, _ = ndimage.label(left, np.ones((3, 3, 3)))
        whole: Bool[np.ndarray, "x y z"] = labels == labels.flat[np.where(left, evidence, -np.inf).argmax()]
        told = float(evidence[whole].max())
        for body in (bodies := self._fit(whole, evidence, box)):
            seen = self._rays.scored(body.points_m(self.grid.voxel_m))
            outlined = (
                told
                if told >= self.threshold
                else self._rays.bounded(body_evidence(self._outlines, body), self.look_alike) + seen
            )
            if outlined >= self.threshold and self._beside(body) + seen >= self.threshold:
                self._strongest = max(self._strongest, outlined)
                beside = [other for other in bodies if other is not body and self._second(other, body)]
                return whole, [body, *beside]
        return whole, []

    def _second(self, body: UprightBody, first: UprightBody) -> bool:
        """Whether a body has enough evidence by the readings of the rays that miss the first one."""
        each = body_evidence(without_body(self._outlines, first.shape_m), body)
        return min(self._rays.bounded(each, self.look_alike), self._beside(body, first)) >= self.threshold

    def _beside(self, body: UprightBody, first: UprightBody | None = None) -> float:
        """Evidence for a body, given the readings at the surfaces behind it of rays that pass beside it; of rays that miss a first body [nat]."""
        agreed = agreed_behind(body, self._rays, self._images, self._matching_px, self.grid.voxel_m)
        views = self._views_beside(body.points_m(self.grid.voxel_m))
        views = without_body(views, first.shape_m) if first else views
        return agreed + float(body_evidence(views, body).sum())

    def _views_beside(self, points_m: Float[np.ndarray, "n 3"]) -> list[OutlineView]:
        """Outlines of all views with the rates of the surfaces behind points, of rays that pass beside these."""
        rays = self._rays
        through = rays.through(points_m, self.grid.voxel_m)
        told = through, rays.limit_m > 0, self._tables, 2 * RADIUS_M
        return self._outline_views(surface_ratios(rays.frames, self._images, *told))

    def _fit(
        self, part: Bool[np.ndarray, "x y z"], evidence: Float32[np.ndarray, "x y z"], box: tuple[slice, ...]
    ) -> list[UprightBody]:
        """The likeliest one or two bodies of a part in a box of the volume; none if it has no outline or half the smallest size."""
        if np.count_nonzero(part) < 2 / 3 * math.pi * (RADIUS_M / self.grid.voxel_m) ** 3:
            return []
        points_m = self.grid.centres_m(np.argwhere(part) + [s.start for s in box])
        # Windows may look like glass in all views for a common cause without an outline: an edge.
        self._outlines = self._outlines or self._outline_views()
        return fit_part(self._outlines, points_m, evidence[part], RADIUS_M, self.threshold)

    def _accept(
        self, part: Bool[np.ndarray, "x y z"], bodies: Sequence[UprightBody], box: tuple[slice, ...]
    ) -> Bool[np.ndarray, "x y z"]:
        """Accept the bodies that intersect no accepted one; returns the voxels of the part, without those of another part."""
        from scipy import ndimage

        others = [region.body for region in self._found if region.body is not None]
        bodies = [body for body in bodies if not any(map(body.meets, others))]
        if not bodies:
            return part
        grid, cells = self.grid, np.argwhere(part) + [s.start for s in box]
        points_m = grid.centres_m(cells)
        # Windows are as wide as the smallest object, so a body appears larger by half a window.
        own = np.array([body.contains(points_m, RADIUS_M) for body in bodies])
        own[1:] &= ~own[0]
        for body, inside in zip(bodies, own, strict=True):
            whole_m = np.concatenate([points_m[inside], body.points_m(grid.voxel_m)])
            self._rays.limit_m[self._rays.through(whole_m, grid.voxel_m)] = 0.0
        rest = part.copy()
        rest[part] = ~own.any(axis=0)
        if own.any() and self._rays.sums(grid.part(box))[0][rest].max(initial=0.0) >= self.threshold:
            # Evidence above the threshold from rays that miss the bodies belongs to another part.
            part = part & ~rest
        else:
            self._rays.limit_m[self._rays.through(points_m[~own.any(axis=0)], grid.voxel_m)] = 0.0
            if len(bodies) == 1:  # Drop components that are mostly outside the body.
                piece = ndimage.label(part, np.ones((3, 3, 3)))[0][part]
                own = (2 * np.bincount(piece, weights=own[0])[piece] > np.bincount(piece)[piece])[None]
        for body, inside in zip(bodies, own, strict=True):
            # The voxels may be a fragment of the rim; the body is the whole.
            chosen = np.unique(np.concatenate([cells[inside], body_voxels(body, grid)]), axis=0)
            if len(chosen):
                self.inside[tuple(chosen.T)] = True
                scores = self.score(cells[inside] if inside.any() else chosen)
                self._found += (region_of(chosen, scores, grid, body),)
        return part

    @property
    def _even(self) -> float:
        """Evidence at which glass is as probable as none: the prior expects one place with glass in the volume [nat]."""
        return self.threshold + math.log(self.false_alarm_rate)

    def score(self, cells: Int[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Probability of glass in voxels; the prior expects one place with glass in the volume.

        Parameters
        ----------
        cells
            Indices (n, 3) of the voxels.
        """
        from scipy.special import expit

        return np.asarray(expit(self.evidence[tuple(cells.T)] - self._even), np.float64)

    def regions(self) -> tuple[TransparentRegion, ...]:
        """Detected parts with their convex hulls, largest first."""
        return self._found

    def report(self) -> SearchReport:
        """Summary of the search, with the reason if nothing was found."""
        told = max(float(self.evidence.max(initial=0.0)), self._strongest)
        found = SearchReport.of_search(self, len(self._images), told)
        if found.found or not self._images:
            return found
        eye = next_eye(self._rays.frames, self.grid, self.seen, self.look_alike, self.threshold)
        return replace(found, next_eye_m=eye)
