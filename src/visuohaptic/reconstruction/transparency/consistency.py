"""A better transparency detector: every ray is confirmed, contradicted, dropped or unknown.

What differs from the published one (:mod:`.transparency`):

- the model is made of views over a wide baseline, where they are there on both sides of the present one;
- a surface is believed when other views see it and do not look past it, no mean is taken;
- a missing depth counts where the surface is known and neither a shadow nor an edge explains it;
- the bad rays of a voxel are tested against chance, so that what is found has a stated rate of false alarms with
  few views and with many (:mod:`.ray_statistics`).
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8, UInt16

from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from ..fusion.volume import SpaceGrid
from .background import ideal_depth, intrinsics, motions
from .ray_statistics import SearchReport, chance_log_odds, edge_fraction, report, search_threshold
from .regions import TransparentRegion, find_regions
from .shadows import explained_dropouts
from .view_selection import signed_baselines, views_at_baselines

__all__ = ["ConsistencyDetector", "ConsistencySettings", "RayImage", "ray_image"]

_log = logging.getLogger(__name__)

_BRICK = 8  #: edge of a brick of voxels, and of a tile of pixels
#: Tangent of the angle of incidence beyond which nothing is read.
_GRAZING_SLOPE = 4.0
_UNKNOWN, _CLEAN, _CONTRADICTED, _DROPPED = range(4)


@dataclass(frozen=True, slots=True)
class ConsistencySettings:
    """Parameters of the detector; the defaults were chosen on seeds 0-15 of ``simulation.glass_scene``."""

    way_m: tuple[float, ...] = (0.12, 0.22, 0.36, 0.55)  #: way to the views of a model, to both sides [m]
    tracking_m: float = 0.003  #: standard deviation of a depth by errors of the poses [m]
    width: float = 2.5  #: sigmas within which depths agree
    margin_m: float = 0.01  #: space before a surface of which its ray says nothing [m]
    edge_px: int = 3  #: margin around edges and shadows in which missing depths mean nothing [px]
    max_wrong: float = 0.3  #: frames with a larger fraction of contradicted rays are left out
    false_alarms: float = 0.01  #: expected voxels of a search that chance alone makes transparent
    #: Margin around expected edges and the unknown in which depths mean nothing; that of the camera's edges by
    #: default [px].
    erosion_px: int | None = None
    #: voxels of a region: fewer than a block of 3 x 3 x 3 is the edge of something else, where rays graze it
    min_voxels: int = 20


@dataclass(frozen=True, slots=True, eq=False)
class RayImage:
    """What other views say about the ray of each pixel."""

    label: UInt8[np.ndarray, "h w"]  #: 0 unknown, 1 clean, 2 contradicted, 3 dropped
    limit_m: Float32[np.ndarray, "h w"]  #: depth up to which the ray speaks [m]
    predicted_m: Float32[np.ndarray, "h w"]  #: depth of the opaque surface, 0 unknown [m]


def ray_image(
    frame: DepthFrame,
    others: Sequence[DepthFrame],
    noise: DepthNoise = SENSOR_NOISE["kinect"],
    settings: ConsistencySettings | None = None,
) -> RayImage:
    """Label every ray of a view by what other views of the same camera say.

    Parameters
    ----------
    frame
        View to label.
    others
        Other views of the same camera.
    noise
        Noise of the camera.
    settings
        Tolerances.
    """
    from ._background_kernels import warp_views
    from ._consistency_kernels import classify

    settings = settings or ConsistencySettings()
    depth_m = ideal_depth(frame)
    depths = np.stack([ideal_depth(other) for other in others])
    poses = [other.T_world_camera for other in others]
    camera = intrinsics(frame.camera)
    warped = np.empty_like(depths)
    warp_views(depths, motions(frame.T_world_camera, poses), *camera, warped)
    there = np.array([(pose.inverse() @ frame.T_world_camera).matrix[:3] for pose in poses], np.float32)
    numbers = np.array(
        [noise.quadratic_per_m, noise.constant_m, noise.offset_m, settings.tracking_m], np.float32
    )
    label = np.empty(depth_m.shape, np.uint8)
    limit_m, predicted_m = np.empty_like(depth_m), np.empty_like(depth_m)
    classify(
        depth_m,
        depths,
        there,
        warped,
        *camera,
        numbers,
        np.float32(settings.width),
        limit_m,
        predicted_m,
        label,
    )
    explained = explained_dropouts(
        predicted_m, frame.camera.focal_px, noise.baseline_m, edge_px=settings.edge_px
    )
    label[(label == _DROPPED) & explained] = _UNKNOWN
    margin_px = settings.erosion_px
    if margin_px is None:
        margin_px = noise.edge_px(frame.camera.focal_px)
    if margin_px > 0:
        min_m = 2 * settings.width * noise.with_tracking(settings.tracking_m).sigma_m(predicted_m)
        unclear = _near_edges(predicted_m, min_m, frame.camera.focal_px, margin_px)
        label[((label == _CONTRADICTED) | (label == _CLEAN)) & unclear] = _UNKNOWN
    return RayImage(label, limit_m, predicted_m)


def _near_edges(
    predicted_m: Float32[np.ndarray, "h w"],
    min_m: Float[np.ndarray, "h w"],
    focal_px: float,
    margin_px: int,
) -> Bool[np.ndarray, "h w"]:
    """Pixels within a margin of a step of the expected surface, or of where it is not known.

    There a camera mixes depths: stereo fattens what is in front by half of its matching window. Beside the unknown an
    edge may be hidden, as a cable on a table has a seam without depths around it. A step is larger than ``min_m``,
    in which depths agree, and steeper than any surface that is seen.
    """
    import cv2

    known = predicted_m > 0
    window = np.ones((3, 3), np.uint8)
    nearest_m = cv2.erode(np.where(known, predicted_m, np.float32(1e3)), window)
    step_m = cv2.dilate(predicted_m, window) - nearest_m
    steep_m = 2 * _GRAZING_SLOPE / focal_px * nearest_m
    # A speck narrower than three pixels hides no edge.
    unknown = cv2.morphologyEx((~known).astype(np.uint8), cv2.MORPH_OPEN, window) > 0
    failing = unknown | (step_m > np.maximum(min_m, steep_m))
    edge = 2 * margin_px + 1
    return cv2.dilate(failing.astype(np.uint8), np.ones((edge, edge), np.uint8)) > 0


@dataclass(slots=True)
class ConsistencyDetector:
    """Counts clean and bad rays in a volume.

    :meth:`add` compares with the views so far; :meth:`run` has the whole
    sequence and compares every view with both sides.
    """

    grid: SpaceGrid
    noise: DepthNoise = SENSOR_NOISE["kinect"]
    settings: ConsistencySettings = field(default_factory=ConsistencySettings)
    contradicted: UInt16[np.ndarray, "x y z"] = field(init=False)  #: rays per voxel
    dropped: UInt16[np.ndarray, "x y z"] = field(init=False)  #: rays per voxel
    used: int = 0  #: views that were compared
    skipped: Counter[str] = field(default_factory=Counter)  #: views that were not, by cause
    _clean: UInt16[np.ndarray, "x y z"] = field(init=False)
    _clean_bricks: UInt16[np.ndarray, "a b c"] = field(init=False)
    _frames: list[DepthFrame] = field(default_factory=list)
    _way_m: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        shape = self.grid.shape
        self.contradicted, self.dropped = np.zeros(shape, np.uint16), np.zeros(shape, np.uint16)
        self._clean = np.zeros(shape, np.uint16)
        self._clean_bricks = np.zeros([-(-n // _BRICK) for n in shape], np.uint16)

    def add(self, frame: DepthFrame) -> RayImage | None:
        """Compare one view with those before it; ``None`` when there are too few.

        Parameters
        ----------
        frame
            Next view.
        """
        self._remember(frame)
        reach = max(self.settings.way_m) + 0.2
        while self._way_m[-1] - self._way_m[0] > 3 * reach:
            del self._frames[0], self._way_m[0]
        return self._compare(len(self._frames) - 1)

    def run(self, frames: Sequence[DepthFrame]) -> None:
        """Compare every view of a sequence with views around it; their order does not matter.

        Parameters
        ----------
        frames
            All views.
        """
        self._frames, self._way_m = [], []
        for frame in frames:
            self._remember(frame)
        for i in range(len(self._frames)):
            self._compare(i)

    def _remember(self, frame: DepthFrame) -> None:
        way = 0.0
        if self._frames:
            before = self._frames[-1].T_world_camera.translation_m
            way = self._way_m[-1] + float(np.linalg.norm(frame.T_world_camera.translation_m - before))
        self._frames.append(frame)
        self._way_m.append(way)

    def _others(self, index: int) -> list[DepthFrame]:
        """Views at the wanted baselines to both sides; where these are missing, the nearest ones."""
        baselines_m = signed_baselines([frame.T_world_camera for frame in self._frames], index)
        return [self._frames[k] for k in views_at_baselines(baselines_m, self.settings.way_m, index=index)]

    def _compare(self, index: int) -> RayImage | None:
        frame, others = self._frames[index], self._others(index)
        if len(others) < 3:
            self.skipped["no model"] += 1
            return None
        rays = ray_image(frame, others, self.noise, self.settings)
        wrong = np.count_nonzero(rays.label == _CONTRADICTED)
        if wrong > self.settings.max_wrong * max(int(np.count_nonzero(rays.label)), 1):
            self.skipped["too wrong"] += 1
            return rays
        self._count(rays, frame)
        self.used += 1
        return rays

    def _count(self, rays: RayImage, frame: DepthFrame) -> None:
        from ._consistency_kernels import count_rays, tile_rays

        tiles = [-(-n // _BRICK) for n in rays.label.shape]
        bad, known, unknown = (np.empty(tiles, np.uint8) for _ in range(3))
        nearest = np.empty(tiles, np.float32)
        tile_rays(rays.label, rays.limit_m, _BRICK, bad, known, unknown, nearest)
        count_rays(
            rays.label,
            rays.limit_m,
            np.float32(self.settings.margin_m),
            _BRICK,
            bad,
            known,
            unknown,
            nearest,
            frame.T_world_camera.inverse().matrix[:3].astype(np.float32),
            *intrinsics(frame.camera),
            self.grid.low_m.astype(np.float32),
            self.grid.voxel_m,
            _BRICK,
            self.contradicted,
            self.dropped,
            self._clean,
            self._clean_bricks,
        )

    def clean(self) -> UInt16[np.ndarray, "x y z"]:
        """Clean rays of every voxel."""
        bricks = self._clean_bricks
        for axis in range(3):
            bricks = np.repeat(bricks, _BRICK, axis=axis)
        nx, ny, nz = self.grid.shape
        return self._clean + bricks[:nx, :ny, :nz]

    def score(self) -> Float[np.ndarray, "x y z"]:
        """Fraction of bad rays of each voxel, 0-1; 0 where no ray says anything."""
        bad, rays = self._counts()
        found: Float[np.ndarray, "x y z"] = bad / np.maximum(rays, 1).astype(np.float32)
        return found

    def _counts(self) -> tuple[Int32[np.ndarray, "x y z"], Int32[np.ndarray, "x y z"]]:
        """Bad rays, and all that say anything, of each voxel."""
        bad = self.contradicted.astype(np.int32) + self.dropped
        return bad, bad + self.clean()

    def chance_rate(self) -> float:
        """Fraction of bad rays in the whole volume, with half a bad one imagined."""
        bad, rays = (float(part.sum()) for part in self._counts())
        return (bad + 0.5) / (rays + 1.0)

    def log_odds(self) -> Float[np.ndarray, "x y z"]:
        """Evidence of each voxel that more than chance is in it [nat]."""
        return chance_log_odds(*self._counts(), self.chance_rate())

    @property
    def threshold(self) -> float:
        """Evidence that founds a region [nat]."""
        return search_threshold(self.contradicted.size, self.settings.false_alarms)

    def _parts(self) -> tuple[Bool[np.ndarray, "x y z"], Bool[np.ndarray, "x y z"]]:
        """Voxels that found a region, and those that may belong to one."""
        bad, rays = self._counts()
        log_odds = self.log_odds()
        strong = log_odds >= self.threshold
        if not strong.any():
            return strong, strong
        fraction = edge_fraction(bad[strong], rays[strong], log_odds[strong])
        # A single ray is no evidence of how far a part reaches.
        weak = (bad >= fraction * rays) & (bad >= 2)
        return strong & weak, weak

    def inside(self) -> Bool[np.ndarray, "x y z"]:
        """Voxels that count as transparent."""
        return self._parts()[1]

    def regions(self) -> tuple[TransparentRegion, ...]:
        """Clusters of transparent voxels with their hulls."""
        strong, weak = self._parts()
        found = find_regions(self.score(), strong, weak, self.grid, min_voxels=1)
        return tuple(region for region in found if region.voxels >= self.settings.min_voxels)

    def report(self) -> SearchReport:
        """What was searched, and why nothing was found where nothing was."""
        return report(
            self._counts(),
            self.log_odds(),
            views=len(self._frames),
            compared=self.used,
            skipped=self.skipped,
            rate=self.chance_rate(),
            threshold=self.threshold,
            regions=len(self.regions()),
        )
