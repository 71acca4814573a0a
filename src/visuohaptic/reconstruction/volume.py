"""The space of interest as a grid of voxels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..errors import InputError

__all__ = ["SpaceGrid"]

#: More voxels than this are refused: 1 GB of counts.
MAX_VOXELS = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class SpaceGrid:
    """Cubes of edge ``voxel_m`` from a corner of the world on, along its axes."""

    low_m: Float[np.ndarray, "3"]  #: least corner, world [m]
    shape: tuple[int, int, int]  #: voxels along x, y, z
    voxel_m: float = 0.005  #: edge of a voxel [m]

    def __post_init__(self) -> None:
        low = np.asarray(self.low_m, dtype=np.float64)
        if low.shape != (3,) or not np.isfinite(low).all():
            raise InputError("SpaceGrid", f"found {low.tolist()}, expected 3 numbers [m]", field="low_m")
        if not self.voxel_m > 0 or min(self.shape) < 1 or np.prod(np.array(self.shape, float)) > MAX_VOXELS:
            raise InputError(
                "SpaceGrid",
                f"found {self.shape} voxels of {self.voxel_m} m, expected at most {MAX_VOXELS} in all",
                field="shape",
            )
        object.__setattr__(self, "low_m", low)

    @classmethod
    def around(cls, low_m: object, high_m: object, voxel_m: float = 0.005) -> SpaceGrid:
        """The grid that covers a box of the world."""
        low, high = np.asarray(low_m, dtype=np.float64), np.asarray(high_m, dtype=np.float64)
        if low.shape != (3,) or high.shape != (3,) or not (high > low).all():
            raise InputError("SpaceGrid", f"found corners {low_m} and {high_m}, expected low < high")
        nx, ny, nz = (int(n) for n in np.maximum(1, np.ceil((high - low) / voxel_m - 1e-6)))
        return cls(low, (nx, ny, nz), voxel_m)

    @property
    def high_m(self) -> Float[np.ndarray, "3"]:
        """Greatest corner, world [m]."""
        return self.low_m + self.voxel_m * np.array(self.shape)

    def centres_m(self, cells: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Centres of voxels by their indices, world [m]."""
        return self.low_m + self.voxel_m * (np.asarray(cells) + 0.5)
