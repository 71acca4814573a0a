"""Where to draw what was tracked."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from .template_tracker import TemplatePose

__all__ = ["template_outlines"]


def template_outlines(poses: Iterable[TemplatePose]) -> list[Float[np.ndarray, "6 2"]]:
    """Closed outline in pixels of every template that is seen, with a tick at its first corner.

    Parameters
    ----------
    poses
        Poses of one frame; those that are not valid are left out.
    """
    found = []
    for pose in poses:
        if pose.valid and pose.alignment is not None:
            corners = pose.alignment.corners
            # The tick shows which way is up.
            tick = corners[0] + 0.25 * (corners.mean(axis=0) - corners[0])
            found.append(np.vstack([corners, corners[:1], tick]))
    return found
