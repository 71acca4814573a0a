"""The thickness of an imported wall: given, measured between its two surfaces, or the usual one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .resample import Wall

__all__ = ["wall_thickness"]

#: Thickness of a wall of which neither mesh nor user say it [m], and its relative standard deviation.
USUAL_WALL_m, USUAL_SPREAD = 0.0005, 0.1


def wall_thickness(
    wall: Wall, thickness_m: float | None, wall_spread: float | None
) -> tuple[Float[np.ndarray, "k 2"], float, list[str]]:
    """Thickness of a wall by height.

    Parameters
    ----------
    wall
        With one surface or two.
    thickness_m
        Given by the user [m], or None.
    wall_spread
        Its relative standard deviation, or None.

    Returns
    -------
    tuple
        Heights and thickness there [m], relative standard deviation, notes.
    """
    if not wall.double:
        given = USUAL_WALL_m if thickness_m is None else thickness_m
        notes = (
            [] if thickness_m else [f"the mesh has one surface: its wall is taken as {1e3 * given:.2g} mm"]
        )
        return np.array([[0.0, given]]), USUAL_SPREAD if wall_spread is None else wall_spread, notes
    usual = float(np.median(wall.thickness_m[:, 1]))
    measured = f"{1e3 * usual:.3g} mm ± {100 * wall.thickness_spread:.2f} %"
    if thickness_m is None:
        spread = wall.thickness_spread if wall_spread is None else wall_spread
        low, high = 1e3 * wall.thickness_m[:, 1].min(), 1e3 * wall.thickness_m[:, 1].max()
        said = f"the wall is as thick as measured: {measured} by the median, {low:.2g} to {high:.2g} mm along the height"
        return wall.thickness_m, spread, [said]
    spread = USUAL_SPREAD if wall_spread is None else wall_spread
    notes = []
    # Two-sided, at 5 %: the standard deviations of both add up.
    if abs(thickness_m - usual) > 1.96 * np.hypot(spread * thickness_m, wall.thickness_spread * usual):
        notes = [
            f"the thickness given, {1e3 * thickness_m:.2g} mm, contradicts the mesh, {measured}; it is used"
        ]
    return np.array([[0.0, thickness_m]]), spread, notes
