"""Constraint lines of contour points, term e_c of Alt 2016, Eq. (3.6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class ConstraintLines:
    """One line per contour point k: ``u(t) = origin + t direction`` with t in [start, stop].

    The lines are in the order of the points along the contour. Pixel centres have
    integer coordinates, x to the right (column) and y down (row).

    Raises
    ------
    InputError
        Shapes do not match, a value is not finite, or a direction is not a unit vector.
    """

    origin_px: Float[np.ndarray, "k 2"]  #: point on the reference contour (t = 0) [px]
    direction_px: Float[np.ndarray, "k 2"]  #: unit vector from the reference contour to the front
    start_px: Float[np.ndarray, "k"]  #: nearest search position [px]
    stop_px: Float[np.ndarray, "k"]  #: farthest search position [px]
    half_width_px: Float[np.ndarray, "k"] | float = 8.5  #: half length of the window along the edge [px]
    #: Mean distance of neighbouring origins [px]; twice the half width for a single line.
    spacing_px: float = field(init=False)

    def __post_init__(self) -> None:
        origin = np.ascontiguousarray(self.origin_px, dtype=np.float64)
        direction = np.ascontiguousarray(self.direction_px, dtype=np.float64)
        count = origin.shape[0] if origin.ndim == 2 else 0
        if count == 0 or origin.shape != (count, 2) or direction.shape != (count, 2):
            raise InputError(
                "ConstraintLines",
                f"found origins {origin.shape} and directions {direction.shape}, expected (K, 2) twice",
            )
        set_field = object.__setattr__
        set_field(self, "origin_px", origin)
        set_field(self, "direction_px", direction)
        total = origin.sum() + direction.sum()
        for name in ("start_px", "stop_px", "half_width_px"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.ndim == 0:
                values = np.full(count, float(values))
            if values.shape != (count,):
                raise InputError(
                    "ConstraintLines", f"found shape {values.shape}, expected ({count},)", field=name
                )
            total += values.sum()
            set_field(self, name, np.ascontiguousarray(values))
        if not np.isfinite(total):
            raise InputError(
                "ConstraintLines", "found a value that is not finite", remedy="remove such lines"
            )
        length = np.einsum("ki,ki->k", direction, direction)
        if np.abs(length - 1.0).max() > 1e-6:
            worst = int(np.argmax(np.abs(length - 1.0)))
            raise InputError(
                "ConstraintLines",
                f"found length {length[worst] ** 0.5:.6g} in line {worst}, expected 1",
                field="direction_px",
            )
        if np.any(np.asarray(self.stop_px) < np.asarray(self.start_px)):
            raise InputError("ConstraintLines", "found stop < start", field="stop_px")
        if np.any(np.asarray(self.half_width_px) < 1.5):
            raise InputError("ConstraintLines", "found less than 1.5 px", field="half_width_px")
        steps = origin[1:] - origin[:-1]
        apart = (
            np.sqrt(np.einsum("ki,ki->k", steps, steps))
            if count > 1
            else 2.0 * np.asarray(self.half_width_px)
        )
        set_field(self, "spacing_px", float(apart.mean()))

    def __len__(self) -> int:
        return int(self.origin_px.shape[0])

    def points_px(self, position_px: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k 2"]:
        """Points at the given positions on the lines.

        Parameters
        ----------
        position_px
            Position along each line [px].
        """
        return self.origin_px + np.asarray(position_px, dtype=np.float64)[:, None] * self.direction_px
