"""The space of interest as a grid of voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import InputError, finite_array
from ...io.depth.depth_sequence import DepthFrame

#: Maximum number of voxels: 1 GB of counts.
MAX_VOXELS = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SpaceGrid:
    """Axis-aligned cubic voxels of edge ``voxel_m`` that start at a corner in the world."""

    low_m: Float[np.ndarray, "3"]  #: lowest corner, world [m]
    shape: tuple[int, int, int]  #: voxels along x, y, z
    voxel_m: float = 0.005  #: edge of a voxel [m]

    def __post_init__(self) -> None:
        object.__setattr__(self, "low_m", finite_array("SpaceGrid", self.low_m, 3, field="low_m"))
        if not self.voxel_m > 0 or min(self.shape) < 1 or np.prod(np.array(self.shape, float)) > MAX_VOXELS:
            raise InputError(
                "SpaceGrid",
                f"found {self.shape} voxels of {self.voxel_m} m, expected at most {MAX_VOXELS} in all",
                field="shape",
            )

    @classmethod
    def around(cls, low_m: object, high_m: object, voxel_m: float = 0.005) -> SpaceGrid:
        """Create the grid that covers a box of the world.

        Parameters
        ----------
        low_m, high_m
            Lowest and highest corner of the box, world [m].
        voxel_m
            Edge of a voxel [m].

        Raises
        ------
        InputError
            The corners are not three numbers each with low < high, or the grid has too many voxels.
        """
        low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
        if low.shape != (3,) or high.shape != (3,) or not (high > low).all():
            raise InputError("SpaceGrid", f"found corners {low_m} and {high_m}, expected low < high")
        nx, ny, nz = (int(n) for n in np.maximum(1, np.ceil((high - low) / voxel_m - 1e-6)))
        return cls(low, (nx, ny, nz), voxel_m)

    @property
    def high_m(self) -> Float[np.ndarray, "3"]:
        """Highest corner, world [m]."""
        return self.low_m + self.voxel_m * np.array(self.shape)

    @property
    def all_centres_m(self) -> Float[np.ndarray, "n 3"]:
        """Centres of all voxels, world [m]; the last axis varies fastest."""
        return self.centres_m(np.moveaxis(np.indices(self.shape), 0, -1).reshape(-1, 3))

    def centres_m(self, cells: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Centres of voxels, world [m].

        Parameters
        ----------
        cells
            Indices (n, 3) of voxels.
        """
        return self.low_m + self.voxel_m * (np.asarray(cells) + 0.5)

    def part(self, box: tuple[slice, ...]) -> SpaceGrid:
        """Grid of the voxels in a box.

        Parameters
        ----------
        box
            Ranges of the indices along x, y, z.
        """
        nx, ny, nz = (int(along.stop - along.start) for along in box)
        low_m = self.low_m + self.voxel_m * np.array([along.start for along in box])
        return SpaceGrid(low_m, (nx, ny, nz), self.voxel_m)


def space_of_interest(
    frames: Sequence[DepthFrame], *, edge_m: float = 1.0, voxel_m: float = 0.005
) -> SpaceGrid:
    """A cube around the target of the camera.

    Its centre is the point nearest to all optical axes if these intersect in front
    of the camera, else the median of the points at the centres of the images.

    Parameters
    ----------
    frames
        Views of one camera.
    edge_m
        Edge of the cube [m].
    voxel_m
        Edge of a voxel [m].

    Raises
    ------
    InputError
        There are no frames, or none has a depth.
    """
    if not frames:
        raise InputError("space_of_interest", "found no frames, expected at least one")
    eyes = np.array([frame.T_world_camera.translation_m for frame in frames])
    axes = np.array([frame.T_world_camera.rotation[:, 2] for frame in frames])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.mean(axis=0)
    middle_m = np.full(3, np.nan)
    if np.linalg.eigvalsh(normal)[0] > 0.05:  # the axes differ by about 25 degrees or more
        middle_m = np.linalg.solve(normal, (across @ eyes[:, :, None]).mean(axis=0)[:, 0])
        if np.median(((middle_m - eyes) * axes).sum(axis=1)) < 0.2:
            middle_m[:] = np.nan
    if np.isnan(middle_m).any():
        points = []
        for frame in frames[:: max(1, len(frames) // 10)]:
            height, width = frame.depth_m.shape
            rows, columns = np.mgrid[height // 4 : 3 * height // 4 : 8, width // 4 : 3 * width // 4 : 8]
            depth_m = frame.depth_m[rows, columns]
            seen = np.isfinite(depth_m)
            pixels = np.column_stack([columns[seen], rows[seen]]).astype(float)
            points.append(frame.T_world_camera.apply(frame.camera.rays(pixels) * depth_m[seen, None]))
        cloud = np.concatenate(points)
        if not len(cloud):
            raise InputError("space_of_interest", "the middle of the images has no depth")
        middle_m = np.median(cloud, axis=0)
    return SpaceGrid.around(middle_m - edge_m / 2, middle_m + edge_m / 2, voxel_m)
