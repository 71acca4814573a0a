"""Pipeline from depth views to the visual surface and the transparent regions in which it is missing."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..io.depth.depth_sequence import DepthFrame, DepthSequence
from ..io.depth.pixel_model import PixelModel
from ..io.meshes.ply import PlyMesh, write_ply
from .body_completion import BodyCompletion
from .completion import Completion, CompletionSettings, HoleRegion
from .fusion import SENSOR_NOISE, DepthNoise, SpaceGrid, TsdfVolume, sensor_noise, space_of_interest
from .mesh import SurfaceMesh
from .transparency import EvidenceDetector, SearchReport, TrackedNoise, view_graph
from .transparency.evidence import MIN_ANGLE_RAD
from .transparency.panes import Pane
from .transparency.pose_refinement import common_sigma_m, refine_poses
from .transparency.regions import TransparentRegion, mask_refracted_rays, outer_voxels, save_regions

#: Half width of the band of signed distances: standard deviations of a depth, and at least this many voxels; see :func:`_band_m`.
_BAND_SIGMAS, _MIN_BAND_VOXELS = 3.0, 2.0

#: Views from which the noise of an unknown camera is measured, and rounds; readings are rounded to 1 mm (uniform distribution).
_MEASURED_VIEWS, _MEASURED_ROUNDS, _MIN_SIGMA_M = 48, 4, 0.001 / 12**0.5

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """The visual surface of a depth sequence and its transparent parts, where the surface is missing or wrong."""

    surface: SurfaceMesh  #: visual surface, world [m]
    regions: tuple[TransparentRegion, ...]  #: transparent parts, largest first
    points_m: Float[np.ndarray, "n 3"]  #: outer voxels of transparent parts, and points of panes, world [m]
    scores: Float[np.ndarray, "n"]  #: score of each of these points
    grid: SpaceGrid  #: space of interest that was searched for transparent parts
    search: SearchReport  #: number of compared views, evidence, and the reason if nothing was found
    panes: tuple[Pane, ...] = ()  #: flat panes, likeliest first, whose surface is known without touches

    def completion(self, part: int = 0, settings: CompletionSettings | None = None) -> Completion:
        """Completion of the surface in a transparent part, ready for touches (Alt 2016, Sec. 5.3 and 5.4).

        Parameters
        ----------
        part
            Index into :attr:`regions`; the largest by default.
        settings
            Settings of the completion.

        Raises
        ------
        InputError
            The index is out of range, or there is no surface around the part.
        """
        region = self._region(part)
        return Completion(self.surface, HoleRegion.of_points(region.hull_m), settings)

    def body_completion(self, part: int = 0) -> BodyCompletion:
        """Completion of a fully transparent vessel from its outlines; it stands on the surface below it.

        Parameters
        ----------
        part
            Index into :attr:`regions`; the largest by default.

        Raises
        ------
        InputError
            The index is out of range, the part has no outline, or nothing below it is visible.
        """
        region = self._region(part)
        if region.body is None:
            raise InputError("body_completion", "the part has no outline")
        beside = [other.body for other in self.regions if other is not region and other.body is not None]
        return BodyCompletion.standing(self.surface, region.body, float(region.hull_m[:, 2].max()), beside)

    def _region(self, part: int) -> TransparentRegion:
        if not 0 <= part < len(self.regions):
            raise InputError(
                "completion",
                f"found part {part}, expected one of {len(self.regions)} transparent parts",
                remedy=self.search.text if not self.regions else "",
            )
        return self.regions[part]

    def save(self, folder: Path | str) -> None:
        """Write ``surface.ply``, ``transparency.ply`` (points with ``score``) and ``regions.json``.

        Parameters
        ----------
        folder
            Folder to write; created where it does not exist.

        Raises
        ------
        InputError
            The folder cannot be created or written.
        """
        folder = Path(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, f"cannot create the folder ({error.strerror})") from error
        self.surface.save(folder / "surface.ply")
        no_faces = np.zeros((0, 3), dtype=np.int64)
        write_ply(folder / "transparency.ply", PlyMesh(self.points_m, no_faces, None, {"score": self.scores}))
        save_regions(
            folder / "regions.json",
            self.regions,
            low=self.grid.low_m.tolist(),
            high=self.grid.high_m.tolist(),
            voxel_m=self.grid.voxel_m,
            views=self.search.compared,
            search=asdict(self.search),
            panes=[
                {
                    "corners": np.round(pane.corners_m, 5).tolist(),
                    "sigma": round(pane.sigma_m, 5),
                    "evidence": round(pane.evidence, 2),
                }
                for pane in self.panes
            ],
            reason=self.search.text,
        )


def reconstruct(
    sequence: Path | str | DepthSequence | Sequence[DepthFrame],
    *,
    grid: SpaceGrid | None = None,
    noise: DepthNoise | None = None,
    refine: bool = True,
    sparse: bool = False,
    false_alarm_rate: float = 0.02,
    model: PixelModel | None = None,
) -> Reconstruction:
    """Fuse the surface and detect transparent parts from the same views.

    Parameters
    ----------
    sequence
        Sequence folder, see :class:`~visuohaptic.io.depth.depth_sequence.DepthSequence`, or the views of one
        camera, in any order.
    grid
        Space of interest; a cube of 1 m with voxels of 5 mm around what the camera looks at by default.
    noise
        Noise of the camera; by default that of the sensor named in the sequence; see :func:`sequence_noise`.
    refine
        Whether poses are first refined jointly.
    sparse
        Whether the surface is fused wherever it is observed, for scenes larger than the space of interest;
        otherwise in the space of interest only.
    false_alarm_rate
        Expected number of false transparent parts of a search, between 0 and 1.
    model
        A network of your own that scores every pixel of a view, as a further source of evidence, see
        :func:`~visuohaptic.io.depth.load_pixel_model`.

    Raises
    ------
    InputError
        There are no usable frames, they do not fit into the memory, or nothing is visible in the space of interest.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.core.camera import Camera, Pose
    >>> from visuohaptic.io.depth import DepthFrame
    >>> camera = Camera.simple(64, 48, 60.0)
    >>> frames = []
    >>> for x_m in np.linspace(-0.2, 0.2, 6):  # a wall at 0.8 m
    ...     pose = Pose(np.eye(3), np.array([x_m, 0.0, 0.0]))
    ...     frames.append(DepthFrame(0.0, np.full((48, 64), 0.8, np.float32), None, pose, camera))
    >>> found = reconstruct(frames, grid=SpaceGrid.around([-0.2, -0.2, 0.6], [0.2, 0.2, 1.0], 0.01))
    >>> bool(np.abs(found.surface.vertices_m[:, 2] - 0.8).max() < 0.001)
    True
    >>> found.regions  # nothing transparent
    ()
    """
    if isinstance(sequence, str | Path):
        sequence = DepthSequence(sequence)
    if noise is None:
        noise = sequence_noise(sequence)
    frames: Sequence[DepthFrame] = sequence.load() if isinstance(sequence, DepthSequence) else list(sequence)
    grid = grid or space_of_interest(frames)
    reported = frames
    if refine:
        frames = refine_poses(frames, noise)
    detector = EvidenceDetector(grid, noise, false_alarm_rate, model)
    detector.run(frames)
    regions = detector.regions()
    if refine and len(frames) > 1:
        regions = tuple(_placed(region, reported, frames) for region in regions)
    # Without images there is no color to average; the default black would look like a measurement.
    color = any(frame.color is not None for frame in frames)
    band_m = _band_m(grid, frames, detector.measured)
    low_m, high_m = (None, None) if sparse else (grid.low_m, grid.high_m)
    surface = TsdfVolume(grid.voxel_m, low_m=low_m, high_m=high_m, truncation_m=band_m, color=color)
    surface.integrate_all([mask_refracted_rays(frame, regions) for frame in frames])
    cells = outer_voxels(detector.inside)
    points_m, scores = grid.centres_m(cells), detector.score(cells)
    kept = np.zeros(len(points_m), dtype=bool)
    for region in regions:
        kept |= region.contains(points_m)
    from scipy.special import expit

    points_m, scores = points_m[kept], scores[kept]
    panes = tuple(_placed_pane(pane, reported, frames) for pane in detector.panes)
    for pane in panes:
        sheet_m = pane.points_m(grid.voxel_m)
        # As of voxels: the prior expects one place with glass in the volume.
        chance = expit(pane.evidence - detector.threshold - math.log(false_alarm_rate))
        points_m = np.vstack([points_m, sheet_m])
        scores = np.append(scores, np.full(len(sheet_m), chance))
    return Reconstruction(
        surface.mesh(min_weight=0.0), regions, points_m, scores, grid, detector.report(), panes
    )


def _band_m(grid: SpaceGrid, frames: Sequence[DepthFrame], noise: TrackedNoise) -> float:
    """Half width of the band of signed distances: 3 sigma of a depth, at least 2 voxels [m].

    A wider band reaches through thin objects and moves their far side outwards: a plate of 10 mm becomes 2 x 1.4 mm thicker
    with a band of 12.5 mm, 2 x 3.9 mm with 20 mm. In a narrower one, second surfaces appear: a reading that errs by more than
    the band, 1 of 740 at 3 sigma, shows free space where other views have no readings. Two voxels contain both ends
    of an edge of the grid that crosses the surface, up to an incidence of 60 degrees. Sigma is measured by the agreement of
    neighbouring views, with the errors of the poses: the median within each pair of views, and the mean square of the pairs. It is
    that of the camera for single views.
    """
    middle_m = 0.5 * (grid.low_m + grid.high_m)
    away_m = np.median([np.linalg.norm(frame.T_world_camera.translation_m - middle_m) for frame in frames])
    known = np.isfinite(noise.depth_sigma_m)
    sigma_m = noise.depth_sigma_m if known else float(noise.sigma_m(away_m))
    return max(_BAND_SIGMAS * sigma_m, _MIN_BAND_VOXELS * grid.voxel_m)


def _placed(
    region: TransparentRegion, reported: Sequence[DepthFrame], frames: Sequence[DepthFrame]
) -> TransparentRegion:
    """The region with the common pose error of all views added to the standard deviation of its axis."""
    if (body := region.body) is None:
        return region
    common_m = common_sigma_m(reported, frames, region.centroid_m)[:2]
    ends_m = None if body.ends_sigma_m is None else np.hypot(body.ends_sigma_m, common_m)
    axis_m = np.hypot(body.axis_sigma_m, common_m)
    return replace(region, body=replace(body, axis_sigma_m=axis_m, ends_sigma_m=ends_m))


def _placed_pane(pane: Pane, reported: Sequence[DepthFrame], frames: Sequence[DepthFrame]) -> Pane:
    """The pane with the common pose error of all views along its normal."""
    first, *ends = pane.corners_m[[0, 1, 3]]
    normal = np.cross(ends[0] - first, ends[1] - first)
    common_m = normal / np.linalg.norm(normal) * common_sigma_m(reported, frames, pane.corners_m.mean(axis=0))
    return replace(pane, sigma_m=float(np.hypot(pane.sigma_m, np.linalg.norm(common_m))))


def sequence_noise(sequence: DepthSequence | Sequence[DepthFrame]) -> DepthNoise:
    """Noise of the sensor named in a sequence; measured from its views if the sensor is unknown.

    Parameters
    ----------
    sequence
        Sequence folder, or views without a sensor name, whose noise is that of a Kinect.
    """
    if isinstance(sequence, DepthSequence):
        try:
            return sensor_noise(sequence.sensor)
        except InputError:
            return measured_noise(list(islice(sequence, _MEASURED_VIEWS)), sequence.sensor)
    return SENSOR_NOISE["kinect"]


def measured_noise(frames: Sequence[DepthFrame], name: str = "") -> DepthNoise:
    """Noise of an unknown camera, by the agreement of neighbouring views: proportional to the squared depth.

    The agreement contains the errors of the poses and of rounding to pixels on slopes, so that the noise is an upper bound. The matching window is the largest
    of the known cameras; the baseline is inferred with the evidence (:func:`.ray_readings.second_eye_m`). Views that show no common surface have the noise of a Kinect.

    Parameters
    ----------
    frames
        Views of one camera.
    name
        Name of the camera, for the log.
    """
    graph = view_graph(frames)
    near = [graph.neighbours(k, 1, MIN_ANGLE_RAD) for k in range(len(frames))]
    kinect = SENSOR_NOISE["kinect"]
    edge_rad = max(known.edge_rad for known in SENSOR_NOISE.values())
    device = replace(kinect, edge_rad=edge_rad, baseline_m=0.0, baseline_known=False, source="measured")
    middle_m = float(np.nanmedian([np.nanmedian(frame.depth_m) for frame in frames]))
    # Pairs of readings count within 5 deviations: a noisier camera is measured again with what was found.
    for _ in range(_MEASURED_ROUNDS):
        sigma_m = TrackedNoise.measured(frames, near, device).depth_sigma_m
        if not np.isfinite(sigma_m):
            _log.warning(
                "the noise of the sensor %r cannot be measured: that of a Kinect is used (--sensor)", name
            )
            return kinect
        device = replace(device, quadratic_per_m=max(sigma_m, _MIN_SIGMA_M) / middle_m**2)
    _log.info("noise of the sensor %r, measured: %.2g mm at %.2g m", name, 1e3 * sigma_m, middle_m)
    return device
