"""Transparency detector: evidence of every ray for glass, summed in space, against a stated rate of false alarms.

For a ray with reading r in context c (:mod:`.ray_readings`)

- P(r | c, nothing transparent) is counted in the sequence itself, so that the camera needs no model of its drop-outs;
- P(r | glass) is that of four kinds, from faint to strong, thin to filled (``_KINDS``).

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
from .background import intrinsics
from .outline_fit import OutlineView, fit_body
from .ray_readings import CONTEXTS, FAR, NEAR, RayImage, TrackedNoise, ViewDepth, ray_image
from .regions import TransparentRegion, find_regions
from .search_report import SearchReport, next_eye
from .view_selection import view_graph

__all__ = ["EvidenceDetector", "EvidenceSettings", "ViewEvidence", "reading_tables"]

#: Probabilities of the readings same, farther, nearer, none through glass: thin and clear, strong, faint, filled. Real
#: D435s drop 29-77 % of its pixels.
_KINDS = np.array(
    [[0.30, 0.12, 0.05, 0.53], [0.08, 0.10, 0.04, 0.78], [0.62, 0.08, 0.03, 0.27], [0.15, 0.45, 0.12, 0.28]]
)
#: Rays that the prior of a context weighs: glass and nothing are equally likely to be read so.
_PRIOR_RAYS = 50.0
#: Probability that a view through glass shows nothing of it.
_HIDDEN = 0.1
#: Fraction of windows that look like glass: at least, for what the model does not know, and rounds of its estimate.
_LOOK_ALIKE, _ROUNDS = 0.05, 12
#: Every n-th pixel of a view gives a window for that estimate.
_STRIDE = 5
#: Fraction of the rays beside glass that still pass it.
_BESIDE = 0.85


@dataclass(frozen=True, slots=True)
class EvidenceSettings:
    """Parameters of the detector."""

    false_alarm_rate: float = 0.02  #: expected false parts of a search
    radius_m: float = 0.015  #: of the smallest object that is sought
    neighbours: int = 10  #: views that each one is compared with
    min_angle_rad: float = math.radians(4.0)  #: between compared views: nearer ones see the same glass alike
    independent_rad: float = math.radians(10.0)  #: between independent views
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
    evidence: Float32[np.ndarray, "x y z"] = field(init=False)  #: that glass is here [nat]
    extent: Float32[np.ndarray, "x y z"] = field(init=False)  #: that it is here rather than beside [nat]
    seen: Float32[np.ndarray, "x y z"] = field(init=False)  #: independent views that say anything of a voxel
    look_alike: float = field(init=False, default=_LOOK_ALIKE)  #: fraction of windows that look like glass
    views: int = field(init=False, default=0)  #: views that were given
    skipped: Counter[str] = field(default_factory=Counter)  #: views that were not compared, by cause
    _rays: list[ViewEvidence] = field(default_factory=list)
    _outlines: list[OutlineView] = field(default_factory=list)
    _inside: Bool[np.ndarray, "x y z"] = field(init=False)
    _found: tuple[TransparentRegion, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        shape = self.grid.shape
        self.evidence, self.extent, self.seen = (np.zeros(shape, np.float32) for _ in range(3))
        self._inside = np.zeros(shape, dtype=bool)

    @property
    def used(self) -> int:
        """Views that were compared with others."""
        return len(self._rays)

    def run(self, frames: Sequence[DepthFrame]) -> None:
        """Compare every view with others, sum what its rays say, and take the parts that are found.

        Parameters
        ----------
        frames
            All views of one camera, in any order.
        """
        self.__post_init__()
        self.views, self._rays, self._outlines, self._found = len(frames), [], [], ()
        self.skipped.clear()
        read, weights = self._read(frames)
        if not read:
            return
        tables = reading_tables([rays for _, rays in read])
        ratios = [self.ratios(frame, rays, tables) for frame, rays in read]
        windows = [
            ratio[rays.reading > 0][:: _STRIDE**2] for ratio, (_, rays) in zip(ratios, read, strict=True)
        ]
        self.look_alike = _mixing_fraction(np.concatenate(windows))
        for (frame, rays), weight, ratio in zip(read, weights, ratios, strict=True):
            self._rays.append(ViewEvidence.of_ratios(frame, weight, rays, ratio, self.look_alike))
            readings = [np.take(table, rays.code) for table in tables]
            self._outlines.append(OutlineView.of_view(frame, readings, rays.limit_m, self.noise, weight))
        for view in self._rays:
            view.add(self.grid, self.evidence, self.extent, self.seen)
        self._take()

    def _read(self, frames: Sequence[DepthFrame]) -> tuple[list[tuple[DepthFrame, RayImage]], list[float]]:
        """Readings and weights of all views that have others to compare them with."""
        graph, settings = view_graph(frames), self.settings
        near = [graph.neighbours(i, settings.neighbours, settings.min_angle_rad) for i in range(len(frames))]
        noise = TrackedNoise.measured(frames, near, self.noise)
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
            read.append((frames[i], rays))
            weights.append(float(weight))
        return read, weights

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
            Log-likelihood ratios of readings, see :func:`reading_tables` [nat].
        """
        import cv2

        focal_px = frame.camera.focal_px
        middle_m = 0.5 * (self.grid.low_m + self.grid.high_m)
        away_m = max(float(np.linalg.norm(frame.T_world_camera.translation_m - middle_m)), 0.1)
        matching = self.noise.window_px(focal_px)
        object_px = max(matching, 2 * round(focal_px * self.settings.radius_m / away_m) + 1)
        total = np.zeros(rays.reading.shape, np.float32)
        for table in tables / np.float32(matching**2):
            window = cv2.boxFilter(
                np.take(table, rays.code),
                -1,
                (object_px, object_px),
                normalize=False,
                borderType=cv2.BORDER_CONSTANT,
            )
            total += cv2.exp(np.clip(window, -30.0, 30.0)) / len(tables)
        return total

    def _take(self) -> None:
        """Take parts by falling evidence; what rays say that pass one of them is explained by it."""
        from scipy import ndimage

        labels, _ = ndimage.label(self.extent > 0, np.ones((3, 3, 3)))
        boxes = ndimage.find_objects(labels)
        best = ndimage.maximum(self.evidence, labels, np.arange(1, len(boxes) + 1))
        found: list[TransparentRegion] = []
        # Half of the smallest object that is sought.
        smallest = 2 / 3 * math.pi * (self.settings.radius_m / self.grid.voxel_m) ** 3
        for number in np.argsort(-np.asarray(best), kind="stable"):
            if best[number] < self.threshold:
                break
            box = boxes[number]
            part, evidence = labels[box] == number + 1, self.evidence[box]
            if found:
                evidence, extent = self._unexplained(box)
                part &= extent > 0
                if evidence[part].max(initial=0.0) < self.threshold:
                    continue
            # What others explain may lie across a part: of what is left the piece with the most evidence is one.
            pieces, _ = ndimage.label(part, np.ones((3, 3, 3)))
            peak = np.argmax(np.where(part, evidence, -np.inf))
            part &= pieces == pieces.flat[peak]
            if np.count_nonzero(part) < smallest:
                continue
            points_m = self.grid.centres_m(np.argwhere(part) + [s.start for s in box])
            body = fit_body(self._outlines, points_m.min(axis=0), points_m.max(axis=0))
            # Windows may look like glass by a common cause in all views that has no outline: shine, an edge.
            if body is None or body.evidence < self.threshold:
                continue
            for view in self._rays:
                view.explain(points_m, self.grid.voxel_m)
            inside = np.zeros(self.grid.shape, dtype=bool)
            inside[box] = part
            self._inside |= inside
            regions = find_regions(self.score(), inside, inside, self.grid, min_voxels=1)
            found.extend(replace(region, body=body) for region in regions)
        self._found = tuple(sorted(found, key=lambda region: -region.voxels))

    def _unexplained(
        self, box: tuple[slice, ...]
    ) -> tuple[Float32[np.ndarray, "x y z"], Float32[np.ndarray, "x y z"]]:
        """Evidence in a box of the volume of rays that no part explains."""
        nx, ny, nz = (int(s.stop - s.start) for s in box)
        shape = (nx, ny, nz)
        grid = SpaceGrid(
            self.grid.low_m + self.grid.voxel_m * np.array([s.start for s in box]), shape, self.grid.voxel_m
        )
        evidence, extent, seen = (np.zeros(shape, np.float32) for _ in range(3))
        for view in self._rays:
            view.add(grid, evidence, extent, seen)
        return evidence, extent

    @property
    def threshold(self) -> float:
        """Evidence that founds a part [nat]."""
        places = np.count_nonzero(self.seen) * self.grid.voxel_m**3 / (2 * self.settings.radius_m) ** 3
        return math.log(max(places, 1.0) / self.settings.false_alarm_rate)

    def score(self) -> Float[np.ndarray, "x y z"]:
        """Probability that glass is in a voxel, with one place in the volume expected to hold some."""
        prior = self.threshold + math.log(self.settings.false_alarm_rate)
        return 1 / (1 + np.exp(np.clip(prior - self.evidence, -50.0, 50.0)))

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
        if found.found or not self._rays:
            return found
        frames = [view.frame for view in self._rays]
        eye = next_eye(frames, self.grid, self.seen, self.look_alike, self.threshold)
        return replace(found, next_eye_m=eye)


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvidence:
    """What the rays of one view say."""

    frame: DepthFrame
    weight: float  #: part of an independent view
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which each ray is evidence, 0: of nothing
    found: Float32[np.ndarray, "h w"]  #: that glass is on it [nat]
    reaching: Float32[np.ndarray, "h w"]  #: that it is here rather than beside [nat]

    @classmethod
    def of_ratios(
        cls,
        frame: DepthFrame,
        weight: float,
        rays: RayImage,
        ratio: Float32[np.ndarray, "h w"],
        look_alike: float,
    ) -> ViewEvidence:
        """Evidence of the windows of a view.

        Parameters
        ----------
        frame, rays
            View and its readings.
        weight
            Part of an independent view that it is.
        ratio
            Likelihood ratio of the window around every pixel (h, w).
        look_alike
            Fraction of windows that look like glass anywhere.
        """
        return cls(frame, weight, rays.limit_m, _log_ratio(ratio, look_alike), _log_ratio(ratio, _BESIDE))

    def add(self, grid: SpaceGrid, evidence: np.ndarray, extent: np.ndarray, seen: np.ndarray) -> None:
        """Add to the sums of a volume.

        Parameters
        ----------
        grid
            Volume.
        evidence, extent, seen
            Sums (x, y, z), see :class:`EvidenceDetector`; changed.
        """
        from ._ray_kernels import add_evidence

        motion = self.frame.T_world_camera.inverse().matrix[:3].astype(np.float32)
        images = self.limit_m, self.found, self.reaching, np.float32(self.weight)
        place = grid.low_m.astype(np.float32), grid.voxel_m
        add_evidence(*images, motion, *intrinsics(self.frame.camera), *place, evidence, extent, seen)

    def explain(self, points_m: Float[np.ndarray, "n 3"], voxel_m: float) -> None:
        """Rays through voxels say nothing any more.

        Parameters
        ----------
        points_m
            Centres (n, 3) of voxels in the world [m].
        voxel_m
            Their edge [m].
        """
        import cv2

        camera = self.frame.camera
        local = self.frame.T_world_camera.inverse().apply(points_m)
        local = local[local[:, 2] > 0.05]
        if not len(local):
            return
        fx, fy, cx, cy = intrinsics(camera)
        u = np.rint(fx * local[:, 0] / local[:, 2] + cx).astype(int)
        v = np.rint(fy * local[:, 1] / local[:, 2] + cy).astype(int)
        held = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        passed = np.zeros(self.limit_m.shape, np.uint8)
        passed[v[held], u[held]] = 1
        reach = int(np.ceil(camera.focal_px * voxel_m / float(local[:, 2].min()))) + 1
        self.limit_m[cv2.dilate(passed, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0] = 0.0


def reading_tables(images: Sequence[RayImage]) -> Float32[np.ndarray, "kinds n"]:
    """Log-likelihood ratios by kind of glass and :attr:`RayImage.code`; 0 for the unknown [nat].

    Parameters
    ----------
    images
        Readings of all views, in which the rates without glass are counted.
    """
    counts = sum(np.bincount(rays.code.ravel(), minlength=5 * CONTEXTS) for rays in images)
    rates = np.reshape(counts, (CONTEXTS, 5))[:, 1:] + _PRIOR_RAYS * _KINDS.mean(axis=0)
    rates /= rates.sum(axis=1, keepdims=True)
    tables = np.zeros((len(_KINDS), CONTEXTS, 5), np.float32)
    tables[:, :, 1:] = np.log(_KINDS[:, None] / rates)
    return tables.reshape(len(_KINDS), -1)


def _log_ratio(ratio: Float32[np.ndarray, "h w"], elsewhere: float) -> Float32[np.ndarray, "h w"]:
    """Evidence of windows for glass here, against glass elsewhere on the ray with a probability [nat]."""
    found: Float32[np.ndarray, "h w"] = np.log(
        ((1 - _HIDDEN) * ratio + _HIDDEN) / ((1 - elsewhere) + elsewhere * ratio)
    ).astype(np.float32)
    return found


def _mixing_fraction(ratios: Float32[np.ndarray, "n"]) -> float:
    """Fraction of windows that look like glass, by maximum likelihood."""
    fraction = _LOOK_ALIKE
    for _ in range(_ROUNDS):
        fraction = float(np.mean(fraction * ratios / ((1 - fraction) + fraction * ratios)))
    return max(fraction, _LOOK_ALIKE)
