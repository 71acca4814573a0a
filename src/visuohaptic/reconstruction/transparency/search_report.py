"""Report of a search for transparent parts: coverage, cause of the result, and the most informative next view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from ...core.camera.model import Camera
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.volume import SpaceGrid
from .ray_evidence import HIDDEN
from .view_geometry import ideal_depth, intrinsics, motions

#: Why nothing was found; ``found``: something was found.
Cause = Literal["found", "no views", "no rays", "too few rays", "below threshold", "no outline"]

#: Probability that a view through glass looks like glass at its strongest place: thin walls refract little in the middle.
_SHOWS = 0.75
#: Evidence of a view that does not look like glass: half of the minimum [nat].
_LOSS = -0.5 * math.log(HIDDEN)
#: Number of candidate directions of the next view; stride of the pixels, and number of the views that are used.
_DIRECTIONS, _STRIDE, _VIEWS = 16, 4, 12
#: Number of points along each axis at which a next view is evaluated.
_PLACES = 12


@dataclass(frozen=True, slots=True)
class SearchReport:
    """Coverage and result of a search for transparent parts."""

    cause: Cause
    views: int  #: number of input views
    compared: int  #: number of views compared with others
    rays: float  #: median number of independent views with evidence, over the voxels with any
    #: fraction of the space with evidence from 0, 1-2, 3-5 and more independent views
    seen_by: dict[str, float]
    bad_rate: float  #: fraction of windows that look like glass; NaN without rays
    evidence: float  #: largest evidence of a voxel, or of a found outline: log-likelihood ratio [nat]
    reachable: float  #: evidence of a voxel with the median number of views if all of them looked like glass
    threshold: float  #: minimum evidence of a part
    chance: float  #: detection probability of glass in the best covered part of the space
    skipped: dict[str, int] = field(default_factory=dict)  #: number of views not compared, by cause
    next_eye_m: tuple[float, float, float] | None = (
        None  #: most informative position of a further view, world [m]
    )

    @classmethod
    def of_search(cls, search: Any, compared: int, evidence: float) -> SearchReport:
        """Summarise a search.

        Parameters
        ----------
        search
            The :class:`.EvidenceDetector`, after it has run.
        compared
            Number of views compared with others.
        evidence
            Largest evidence of a voxel, or of an outline [nat].
        """
        seen, rate, threshold = search.seen, search.look_alike, search.threshold
        passed = seen[seen > 0]
        typical = round(float(np.median(passed)), 1) if len(passed) else 0.0
        reachable = typical * -math.log(rate)
        cause: Cause
        if search.regions():
            cause = "found"
        elif not compared:
            cause = "no views"
        elif not len(passed):
            cause = "no rays"
        else:
            cause = "too few rays" if reachable < threshold else "below threshold"
            if evidence >= threshold:
                cause = "no outline"
        levels = np.histogram(seen, [0.0, 1e-9, 2.5, 5.5, np.inf])[0] / seen.size
        seen_by = dict(zip(("0", "1-2", "3-5", "6 or more"), np.round(levels, 3).tolist(), strict=True))
        best = float(np.quantile(passed, 0.9)) if len(passed) else 0.0
        chance = float(chance_of_finding(np.array([best]), rate, threshold)[0])
        known = rate if len(passed) else math.nan
        numbers = known, evidence, reachable, threshold, chance
        return cls(cause, search.views, compared, typical, seen_by, *numbers, dict(search.skipped))

    @property
    def found(self) -> bool:
        """Whether transparent parts were found."""
        return self.cause == "found"

    @property
    def text(self) -> str:
        """Summary for the user, in one sentence."""
        seen = f"{self.compared} of {self.views} views compared"
        if self.skipped:
            seen += " (" + ", ".join(f"{count} {cause}" for cause, count in self.skipped.items()) + ")"
        if self.cause == "no views":
            return f"{seen}: no view could be compared with another"
        if self.cause == "no rays":
            return f"{seen}: none of the compared rays passes the space of interest"
        seen += f", {self.rays:g} independent views per voxel"
        told = {
            "found": f"evidence up to {self.evidence:.1f}, threshold {self.threshold:.1f}",
            "too few rays": f"they give at most {self.reachable:.1f}, threshold {self.threshold:.1f}; add views",
            "no outline": f"evidence up to {self.evidence:.1f}, threshold {self.threshold:.1f}, but no outline of a body",
            "below threshold": f"the strongest voxel has {self.evidence:.1f}, threshold {self.threshold:.1f}",
        }[self.cause]
        if not self.found:
            told += f"; a vessel would be found here with a probability of {self.chance:.1f} at best, a flat pane only in views at more than 60 degrees from its normal"
            if self.next_eye_m is not None:
                told += "; add a view from ({:.2f}, {:.2f}, {:.2f}) m".format(*self.next_eye_m)
        return f"{seen}: {told}"


def chance_of_finding(seen: Float[np.ndarray, "n"], rate: float, threshold: float) -> Float[np.ndarray, "n"]:
    """Detection probability of glass seen by a number of independent views (binomial: enough of them look like glass).

    Parameters
    ----------
    seen
        Numbers of independent views (n).
    rate
        Fraction of all windows that look like glass.
    threshold
        Minimum evidence of a part [nat].
    """
    from scipy.stats import binom

    views = np.round(seen)
    needed = np.ceil((threshold + _LOSS * views) / (max(-math.log(rate), 1e-9) + _LOSS))
    found: Float[np.ndarray, "n"] = binom.sf(needed - 1, views, _SHOWS)
    return found


def next_eye(
    frames: Sequence[DepthFrame],
    grid: SpaceGrid,
    seen: Float[np.ndarray, "a b c"],
    rate: float,
    threshold: float,
) -> tuple[float, float, float]:
    """Camera position of a further view that increases the detection probability of glass most, world [m].

    Candidates are positions around the space at the median height and distance of the views; occlusion is predicted
    from the present views.

    Parameters
    ----------
    frames
        Present views.
    grid
        Space of interest.
    seen
        Number of independent views with evidence for each block of the space (a, b, c).
    rate, threshold
        See :func:`chance_of_finding`.
    """
    from ._view_kernels import warp_views

    middle = 0.5 * (grid.low_m + grid.high_m)
    offset = np.array([frame.T_world_camera.translation_m for frame in frames]) - middle
    radius, height = (float(np.median(part)) for part in (np.hypot(offset[:, 0], offset[:, 1]), offset[:, 2]))
    parts = np.stack(np.meshgrid(*[(np.arange(_PLACES) + 0.5) / _PLACES] * 3, indexing="ij"), -1).reshape(
        -1, 3
    )
    places = grid.low_m + parts * (grid.high_m - grid.low_m)
    now = seen[tuple((parts * seen.shape).astype(int).T)]
    gain = chance_of_finding(now + 1, rate, threshold) - chance_of_finding(now, rate, threshold)
    # A small gain also where one more view is not yet sufficient.
    gain = gain + 1e-3 / (1 + now)
    some = [frames[k] for k in np.linspace(0, len(frames) - 1, min(_VIEWS, len(frames))).astype(int)]
    depths = np.stack([np.ascontiguousarray(ideal_depth(frame)[::_STRIDE, ::_STRIDE]) for frame in some])
    fx, fy, cx, cy = (np.float32(value / _STRIDE) for value in intrinsics(frames[0].camera))
    best, chosen = -1.0, middle
    for angle in 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        eye = middle + np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        # A view near an existing one gains little: scale by its fraction of an independent view.
        sight = (eye - middle) / np.linalg.norm(eye - middle)
        turn = np.arccos(np.clip((offset @ sight) / np.linalg.norm(offset, axis=1), -1, 1)).min()
        pose = Camera.pose_of_view(eye, middle)
        warped = np.empty_like(depths)
        warp_views(depths, motions(pose, [frame.T_world_camera for frame in some]), fx, fy, cx, cy, warped)
        nearest = warped.min(axis=0)
        local = pose.inverse().apply(places)
        u = np.rint(fx * local[:, 0] / local[:, 2] + cx).astype(int)
        v = np.rint(fy * local[:, 1] / local[:, 2] + cy).astype(int)
        held = (u >= 0) & (v >= 0) & (u < nearest.shape[1]) & (v < nearest.shape[0]) & (local[:, 2] > 0.05)
        behind = np.where(held, nearest[np.where(held, v, 0), np.where(held, u, 0)], 0.0)
        value = float(gain[held & np.isfinite(behind) & (local[:, 2] < behind)].sum()) * min(
            turn / np.radians(10), 1.0
        )
        if value > best:
            best, chosen = value, eye
    return (float(chosen[0]), float(chosen[1]), float(chosen[2]))
