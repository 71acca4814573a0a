"""Transparency detector: evidence of every ray for glass, summed in space, against a stated rate of false alarms.

For a ray with reading r in context c (:mod:`.ray_readings`)

- P(r | c, nothing transparent) is counted in the sequence itself, so that the camera needs no model of its drop-outs,
  and again without the rays through the parts that were found, until there are no more of them;
- P(r | glass) is that of four kinds, from faint to strong, thin to filled (:func:`.ray_readings.reading_tables`).

Readings of neighbouring pixels are not independent: what a matching window covers counts as one. R is the likelihood
ratio of the readings in a window of the size of the smallest object that is sought. Of a view the evidence is

    log [((1 - d) R + d) / ((1 - e) + e R)]

with d the probability that a view through glass shows nothing of it, and e the fraction of windows anywhere that look
like glass, by whatever cause (maximum likelihood over the sequence). It is the ratio of the probability with glass *here* to
that of any window at all, and is bounded: no single view decides, and where many windows look like glass none counts much.

The sum over views is a log-likelihood ratio. That of N places without glass one exceeds log(N / a) has at most the
probability a (Markov's inequality, Bonferroni), for any number of views: a is the false-alarm rate that the user gives.

Where it stands follows from its outlines (:mod:`.outline_fit`). How far a part reaches is the same sum with e = 0.85: that fraction of the rays still passes a round glass at 1.03 of
its radius, 2/pi asin(1/1.03). Parts are taken by falling evidence, and what rays say that pass an accepted part is explained by it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from ..fusion.volume import SpaceGrid
from .outline_fit import OutlineView, UprightBody, fit_bodies
from .ray_readings import (
    FAR,
    LOOK_ALIKE,
    NEAR,
    RayEvidence,
    RayImage,
    TrackedNoise,
    ViewDepth,
    look_alike_fraction,
    ray_image,
    reading_tables,
)
from .regions import TransparentRegion, region_of
from .search_report import SearchReport, next_eye
from .view_selection import ray_stride, thinned, view_graph

__all__ = ["EvidenceDetector", "EvidenceSettings"]

#: Every n-th pixel of a view gives a window for that estimate.
_STRIDE = 5


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Parameters of the detector."""

    false_alarm_rate: float = 0.02  #: expected false parts of a search
    radius_m: float = 0.015  #: of the smallest object that is sought
    neighbours: int = 10  #: views that each one is compared with
    independent_rad: float = math.radians(10.0)  #: between independent views, compared ones where possible
    min_angle_rad: float = math.radians(4.0)  #: between compared views: nearer ones see the same glass alike
    max_wrong: float = 0.3  #: views with a larger fraction of contradicted rays are left out

    def __post_init__(self) -> None:
        if not 0 < self.false_alarm_rate < 1:
            raise InputError(
                "EvidenceSettings",
                f"found {self.false_alarm_rate}, expected between 0 and 1 exclusive",
                field="false_alarm_rate",
            )


@dataclass(slots=True)
class EvidenceDetector:
    """Evidence for transparent parts in a volume, of all views of a sequence in any order.

    Examples
    --------
    >>> detector = EvidenceDetector(SpaceGrid.around((-0.1, -0.1, 0.0), (0.1, 0.1, 0.2), 0.02))
    >>> detector.regions()  # nothing seen yet
    ()
    """

    grid: SpaceGrid
    noise: DepthNoise = SENSOR_NOISE["kinect"]
    settings: EvidenceSettings = field(default_factory=EvidenceSettings)
    evidence: Float32[np.ndarray, "x y z"] = field(init=False)  #: that glass is here, below 0 a bound [nat]
    extent: Float32[np.ndarray, "x y z"] = field(init=False)  #: that it is not beside, likewise [nat]
    seen: Float32[np.ndarray, "a b c"] = field(
        init=False
    )  #: independent views that say anything of a block of voxels
    threshold: float = field(init=False)  #: evidence that founds a part [nat]
    look_alike: float = field(init=False, default=LOOK_ALIKE)  #: fraction of windows that look like glass
    views: int = field(init=False, default=0)  #: views that were given
    skipped: Counter[str] = field(default_factory=Counter)  #: views that were not compared, by cause
    _images: list[RayImage] = field(init=False)
    _rays: RayEvidence = field(init=False)
    _tables: Float32[np.ndarray, "kinds n"] = field(init=False)
    _outlines: list[OutlineView] = field(init=False)
    _inside: Bool[np.ndarray, "x y z"] = field(init=False)
    _found: tuple[TransparentRegion, ...] = field(init=False)
    _stride: int = field(init=False, default=1)

    def __post_init__(self) -> None:
        shape = self.grid.shape
        self.evidence, self.extent = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self.seen = np.zeros((1, 1, 1), np.float32)
        self._inside = np.zeros(shape, dtype=bool)
        none = np.zeros((0, 0, 0), np.float32)
        self._rays, self._tables = RayEvidence((), none.ravel(), none, none, none), none.reshape(0, 0)
        self._images, self._outlines, self._found = [], [], ()
        self.threshold = -math.log(self.settings.false_alarm_rate)

    @property
    def used(self) -> int:
        """Views that were compared with others."""
        return len(self._images)

    def run(self, frames: Sequence[DepthFrame]) -> None:
        """Compare every view with others, sum what its rays say, and take the parts that are found.

        Parameters
        ----------
        frames
            All views of one camera, in any order.
        """
        self.__post_init__()
        self.skipped.clear()
        self.views = len(frames)
        frames, weights = self._read(frames)
        if not frames:
            return
        limit_m = np.stack([rays.limit_m for rays in self._images])
        whole, before = self.evidence, -1
        while before < len(self._found):
            first, before = before < 0, len(self._found)
            self._sum(frames, weights, limit_m, limit_m > 0, first=first)
            whole = self.evidence if first else whole
            strong = np.argwhere(self.evidence >= self.threshold)
            if before and len(strong):
                # What is weaker than the parts that were taken, as a bowl of which the rim alone shows, hides less of itself.
                there_m, voxel_m = self.grid.centres_m(strong), self.grid.voxel_m
                passed = np.stack([self._rays.passed(k, there_m, voxel_m) for k in range(len(frames))])
                self._sum(frames, weights, limit_m, (limit_m > 0) & ~passed)
            self._take()
        self.evidence = whole

    def _sum(
        self,
        frames: Sequence[DepthFrame],
        weights: Float32[np.ndarray, "n"],
        limit_m: Float32[np.ndarray, "n h w"],
        counted: Bool[np.ndarray, "n h w"],
        *,
        first: bool = False,
    ) -> None:
        """Sum what rays say that no part explains, by the rates without glass of those that are counted."""
        self._outlines = []
        self._tables = reading_tables(
            [rays.code[some] for rays, some in zip(self._images, counted, strict=True)]
        )
        ratios = np.stack(
            [self.ratios(frame, rays, self._tables) for frame, rays in zip(frames, self._images, strict=True)]
        )
        windows = [ratio[limit > 0][:: _STRIDE**2] for ratio, limit in zip(ratios, limit_m, strict=True)]
        self.look_alike = look_alike_fraction(np.concatenate(windows))
        self._rays = RayEvidence.of_ratios(frames, weights, limit_m, ratios, self.look_alike)
        self.evidence, self.extent, seen = self._rays.sums(self.grid)
        if first:
            # What is explained later was seen.
            self.seen = seen
            space_m3 = float(np.mean(seen > 0) * np.prod(self.grid.high_m - self.grid.low_m))
            places = space_m3 / (2 * self.settings.radius_m) ** 3
            self.threshold = math.log(max(places, 1.0) / self.settings.false_alarm_rate)

    def _outline_views(self) -> list[OutlineView]:
        """Outlines of all views by the present rates, once they are asked for."""
        rays = self._rays
        if not self._outlines:
            views = zip(rays.frames, self._images, rays.limit_m, rays.weights.tolist(), strict=True)
            for frame, image, limit_m, weight in views:
                readings = [np.take(table, image.code) for table in self._tables]
                self._outlines.append(
                    OutlineView.of_view(frame, readings, limit_m, self.noise, weight, self._stride)
                )
        return self._outlines

    def _read(self, frames: Sequence[DepthFrame]) -> tuple[list[DepthFrame], Float32[np.ndarray, "n"]]:
        """Views that have others to compare them with, and their weights; their readings are kept."""
        graph, settings = view_graph(frames), self.settings
        focal_px = frames[0].camera.focal_px
        away_m = float(np.median([self._away_m(frame) for frame in frames]))
        self._stride = ray_stride(focal_px, self.grid.voxel_m, away_m, self.noise.window_px(focal_px))
        frames = [thinned(frame, self._stride) for frame in frames]
        apart_rad = settings.independent_rad, settings.min_angle_rad
        near = [graph.neighbours(i, settings.neighbours, *apart_rad) for i in range(len(frames))]
        nearest = [graph.neighbours(i, 1, settings.min_angle_rad) for i in range(len(frames))]
        noise = TrackedNoise.measured(frames, nearest, self.noise)
        views = [ViewDepth.of_frame(frame, noise) for frame in frames]
        read, weights = [], []
        for i, weight in enumerate(graph.weights(settings.independent_rad)):
            if len(near[i]) < 2:
                self.skipped["no model"] += 1
                continue
            rays = ray_image(views[i], [views[k] for k in near[i]], noise)
            wrong = float(np.count_nonzero((rays.reading == FAR) | (rays.reading == NEAR)))
            if wrong > settings.max_wrong * max(float(np.count_nonzero(rays.reading)), 1.0):
                self.skipped["too wrong"] += 1
                continue
            read.append(frames[i])
            self._images.append(rays)
            weights.append(weight)
        return read, np.array(weights, np.float32)

    def _away_m(self, frame: DepthFrame) -> float:
        """Distance of a camera from the middle of the space [m]."""
        middle_m = 0.5 * (self.grid.low_m + self.grid.high_m)
        return max(float(np.linalg.norm(frame.T_world_camera.translation_m - middle_m)), 0.1)

    def ratios(
        self, frame: DepthFrame, rays: RayImage, tables: Float32[np.ndarray, "kinds n"]
    ) -> Float32[np.ndarray, "h w"]:
        """Likelihood ratio of a window of the size of an object around every pixel (h, w).

        Parameters
        ----------
        frame
            View.
        rays
            Its readings.
        tables
            Log-likelihood ratios of readings, see :func:`~.ray_readings.reading_tables` [nat].
        """
        import cv2

        focal_px = frame.camera.focal_px
        matching = self.noise.window_px(focal_px, self._stride)
        radius_px = focal_px * self.settings.radius_m / self._away_m(frame)
        object_px = 2 * round(max(0.5 * (matching - 1), radius_px)) + 1
        total = np.zeros(rays.reading.shape, np.float32)
        for table in tables / np.float32(matching**2):
            image, size = np.take(table, rays.code), (object_px, object_px)
            window = cv2.boxFilter(image, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
            total += cv2.exp(np.clip(window, -30.0, 30.0)) / len(tables)
        return total

    def _take(self) -> None:
        """Take parts by falling evidence; what rays say that pass one of them is explained by it."""
        from scipy import ndimage

        labels, _ = ndimage.label(self.extent > 0, np.ones((3, 3, 3)))
        boxes = ndimage.find_objects(labels)
        held, best = labels > 0, np.full(len(boxes), -np.inf)
        np.maximum.at(best, labels[held] - 1, self.evidence[held])
        while best.max(initial=-np.inf) >= self.threshold:
            number = int(best.argmax())
            box = boxes[number]
            evidence, extent, _ = self._rays.sums(self._part_grid(box))
            left = (labels[box] == number + 1) & (extent > 0)
            peak = evidence[left].max(initial=-np.inf)
            # A part has the evidence that others leave of it.
            if peak >= best[number] - 1e-3:
                part, body = self._part(left, evidence, box)
                if body is not None:
                    part = self._accept(part, body, box)
                labels[box][part] = 0
                peak = evidence[left & ~part].max(initial=-np.inf)
            best[number] = peak
        self._found = tuple(sorted(self._found, key=lambda region: -region.voxels))

    def _part(
        self, left: Bool[np.ndarray, "x y z"], evidence: Float32[np.ndarray, "x y z"], box: tuple[slice, ...]
    ) -> tuple[Bool[np.ndarray, "x y z"], UprightBody | None]:
        """The piece of a part around its strongest voxel, and its body; of several bodies the strongest."""
        from scipy import ndimage

        labels, _ = ndimage.label(left, np.ones((3, 3, 3)))
        whole: Bool[np.ndarray, "x y z"] = labels == labels.flat[np.where(left, evidence, -np.inf).argmax()]
        together = self._together(self._fit(whole, evidence, box))
        return whole, together[0] if together else None

    def _together(self, bodies: Sequence[UprightBody]) -> list[UprightBody]:
        """Those of the bodies, apart from each other, which tell most of a part together, likeliest first."""
        sets = []
        for first in bodies:
            chosen = [first]
            for body in bodies:
                if not any(body.meets(other) for other in chosen):
                    chosen.append(body)
            sets.append(sorted(chosen, key=lambda body: -body.evidence))
        # Every further body needs what founds a part.
        return max(sets, key=lambda chosen: sum(b.evidence - self.threshold for b in chosen), default=[])

    @property
    def _min_voxels(self) -> float:
        """Half of the voxels of the smallest object that is sought."""
        return 2 / 3 * math.pi * (self.settings.radius_m / self.grid.voxel_m) ** 3

    def _fit(
        self, part: Bool[np.ndarray, "x y z"], evidence: Float32[np.ndarray, "x y z"], box: tuple[slice, ...]
    ) -> list[UprightBody]:
        """Bodies of a part in a box of the volume, if it is large enough and has an outline."""
        if np.count_nonzero(part) < self._min_voxels:
            return []
        points_m = self.grid.centres_m(np.argwhere(part) + [s.start for s in box])
        # Windows may look like glass by a common cause in all views that has no outline: shine, an edge.
        bodies = fit_bodies(self._outline_views(), points_m, evidence[part])
        # What is thinner than the smallest object is a piece of a rim, whose middle is elsewhere.
        thick = (body for body in bodies if sum(body.radius_m) >= 2 * self.settings.radius_m)
        return [body for body in thick if body.evidence >= self.threshold]

    def _accept(
        self, part: Bool[np.ndarray, "x y z"], body: UprightBody, box: tuple[slice, ...]
    ) -> Bool[np.ndarray, "x y z"]:
        """Take a part in a box of the volume, unless it is where another one is; what of it the body explains, or is nothing else."""
        from scipy import ndimage

        if any(region.body is not None and body.meets(region.body) for region in self._found):
            return part
        grid = self.grid
        cells = np.argwhere(part) + [s.start for s in box]
        points_m, body_m = grid.centres_m(cells), body.points_m(grid.voxel_m)
        # Windows, as wide as the smallest object, show a body larger by half of them.
        own = body.contains(points_m, self.settings.radius_m)
        self._explain(np.concatenate([points_m[own], body_m]))
        rest = part.copy()
        rest[part] = ~own
        if own.any() and self._rays.sums(self._part_grid(box))[0][rest].max(initial=0.0) >= self.threshold:
            # What founds a part by rays that pass the body by is another one.
            part, cells, own = part & ~rest, cells[own], own[own]
        else:
            self._explain(points_m[~own])
        # A piece beyond it hangs in the air.
        piece = ndimage.label(part, np.ones((3, 3, 3)))[0][part]
        cells = cells[2 * np.bincount(piece, weights=own)[piece] > np.bincount(piece)[piece]]
        if len(cells) < self._min_voxels:
            cells = np.floor((body_m - grid.low_m) / grid.voxel_m).astype(int)
            cells = cells[((cells >= 0) & (cells < grid.shape)).all(axis=1)]
        if len(cells):
            chosen = tuple(cells.T)
            self._inside[chosen] = True
            self._found += (region_of(cells, self._probability(self.evidence[chosen]), grid, body),)
        return part

    def _explain(self, points_m: Float[np.ndarray, "n 3"]) -> None:
        """Leave out what rays say that pass some points."""
        for k, limit_m in enumerate(self._rays.limit_m):
            limit_m[self._rays.passed(k, points_m, self.grid.voxel_m)] = 0.0

    def _part_grid(self, box: tuple[slice, ...]) -> SpaceGrid:
        """The voxels of a box of the volume."""
        nx, ny, nz = (int(s.stop - s.start) for s in box)
        low_m = self.grid.low_m + self.grid.voxel_m * np.array([s.start for s in box])
        return SpaceGrid(low_m, (nx, ny, nz), self.grid.voxel_m)

    def score(self) -> Float[np.ndarray, "x y z"]:
        """Probability that glass is in a voxel, with one place in the volume expected to hold some."""
        return self._probability(self.evidence)

    def _probability(self, evidence: Float32[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        prior = self.threshold + math.log(self.settings.false_alarm_rate)
        found: Float[np.ndarray, "*n"] = 1 / (1 + np.exp(np.clip(prior - evidence, -50.0, 50.0)))
        return found

    def inside(self) -> Bool[np.ndarray, "x y z"]:
        """Voxels that count as transparent."""
        return self._inside

    def regions(self) -> tuple[TransparentRegion, ...]:
        """Parts that were found, largest first, with their hulls."""
        return self._found

    def report(self) -> SearchReport:
        """What was searched, and why nothing was found where nothing was."""
        found = SearchReport.of_search(
            self.evidence,
            self.seen,
            views=self.views,
            compared=self.used,
            skipped=self.skipped,
            rate=self.look_alike,
            threshold=self.threshold,
            regions=len(self._found),
        )
        if found.found or not self._images:
            return found
        eye = next_eye(self._rays.frames, self.grid, self.seen, self.look_alike, self.threshold)
        return replace(found, next_eye_m=eye)
