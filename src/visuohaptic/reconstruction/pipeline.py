"""From depth views to a surface and the transparent regions that it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..io.depth.depth_sequence import DepthFrame
from ..io.meshes.ply import PlyMesh, write_ply
from .fusion.depth_fusion import TsdfVolume
from .fusion.depth_noise import SENSOR_NOISE, SensorNoise
from .fusion.volume import SpaceGrid, space_of_interest
from .mesh import SurfaceMesh
from .transparency.consistency import ConsistencyDetector
from .transparency.detector import TransparencyDetector
from .transparency.pose_refinement import refine_poses
from .transparency.ray_statistics import SearchReport
from .transparency.refracted_rays import without_seen_through
from .transparency.regions import TransparentRegion, outer_points, save_regions

__all__ = ["METHODS", "Reconstruction", "reconstruct"]

Method = Literal["consistency", "published"]
METHODS: tuple[Method, ...] = ("consistency", "published")


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """What a sequence showed, and where it cannot be trusted."""

    surface: SurfaceMesh  #: visual surface in the space of interest, world [m]
    regions: tuple[TransparentRegion, ...]  #: transparent parts, largest first
    points_m: Float[np.ndarray, "n 3"]  #: outer voxels of the transparent parts, world [m]
    scores: Float[np.ndarray, "n"]  #: score of each of these points
    grid: SpaceGrid
    search: SearchReport  #: what was compared, and why nothing was found where nothing was

    def save(self, folder: Path | str) -> None:
        """Write ``surface.ply``, ``transparency.ply`` (points with ``score``) and ``regions.json``."""
        folder = Path(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, f"cannot be made ({error.strerror})") from error
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
            reason=self.search.text,
        )


def reconstruct(
    frames: Sequence[DepthFrame],
    *,
    grid: SpaceGrid | None = None,
    noise: SensorNoise = SENSOR_NOISE["kinect"],
    method: Method = "consistency",
    refine: bool = True,
) -> Reconstruction:
    """Fuse the surface and find what is transparent, from the same views.

    Parameters
    ----------
    frames
        Views of one camera; in order for ``published``.
    grid
        Space of interest; a cube of 1 m around what the camera looks at by default.
    noise
        Of the camera.
    method
        ``consistency``, or ``published`` (Alt 2016, 5.2).
    refine
        Whether poses are first fitted to each other; without it ``published`` is as printed.

    Raises
    ------
    InputError
        No frames, an unknown method, or nothing was seen in the space of interest.

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
    if method not in METHODS:
        raise InputError(
            "reconstruct", f"found {method!r}, expected one of {', '.join(METHODS)}", field="method"
        )
    grid = grid or space_of_interest(frames)
    if refine:
        frames = refine_poses(frames, noise)
    detector: TransparencyDetector | ConsistencyDetector
    if method == "consistency":
        detector = ConsistencyDetector(grid, noise)
        detector.run(frames)
    else:
        detector = TransparencyDetector(grid, noise)
        for frame in frames:
            detector.add(frame)
    regions = detector.regions()
    # Without pictures there is no colour to average: black would look like one.
    color = any(frame.color is not None for frame in frames)
    surface = TsdfVolume.around(grid.low_m, grid.high_m, grid.voxel_m, color=color)
    for frame in frames:
        surface.integrate(without_seen_through(frame, regions))
    inside, score = detector.inside(), detector.score()
    points_m, scores = outer_points(inside, score, grid)
    kept = np.zeros(len(points_m), dtype=bool)
    for region in regions:
        kept |= region.contains(points_m)
    return Reconstruction(surface.mesh(), regions, points_m[kept], scores[kept], grid, detector.report())
