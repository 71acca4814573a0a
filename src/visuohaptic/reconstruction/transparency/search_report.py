"""What a search for transparent parts was able to see, why it found what it found, and which view would tell most more."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Shaped

from ...core.camera.model import Camera
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.volume import SpaceGrid
from .background import ideal_depth, intrinsics, motions
from .ray_readings import HIDDEN

__all__ = ["Cause", "SearchReport", "chance_of_finding", "next_eye"]

#: Why nothing was found; ``found``: something was.
Cause = Literal["found", "no views", "no rays", "too few rays", "below threshold", "no outline"]

#: Probability that a view through glass looks like glass at its strongest place: thin walls bend little in the middle.
_SHOWS = 0.75
#: Evidence that a view loses which does not look like it: half of what it can lose at most [nat].
_LOSS = -0.5 * math.log(HIDDEN)
#: Directions around the space that are tried for the next view, and the part of the pixels and views that is used.
_DIRECTIONS, _STRIDE, _VIEWS = 16, 4, 12
#: Places at which a next view is valued, along each axis.
_PLACES = 12


@dataclass(frozen=True, slots=True)
class SearchReport:
    """What a search for transparent parts was able to see, and why it found what it found."""

    cause: Cause
    views: int  #: given
    compared: int  #: views of which rays were compared with others
    rays: float  #: median number of independent views of the voxels that any ray says something of
    seen_by: dict[
        str, float
    ]  #: fraction of the space that 0, 1-2, 3-5 and more independent views say something of
    bad_rate: float  #: fraction of windows of the images that look like glass, NaN without rays
    evidence: (
        float  #: largest evidence of a voxel; log-likelihood ratio [nat], of ``published`` the summed score
    )
    reachable: float  #: evidence of a voxel with the median number of views did all of them look like glass
    threshold: float  #: evidence that a part needs
    chance: float  #: probability that glass in the part of the space that is seen best would be found
    skipped: dict[str, int] = field(default_factory=dict)  #: views that were not compared, by cause
    next_eye_m: tuple[float, float, float] | None = None  #: where a further view would help most, world [m]

    @classmethod
    def of_search(
        cls,
        evidence: Float[np.ndarray, "x y z"],
        seen: Shaped[np.ndarray, "a b c"],
        *,
        views: int,
        compared: int,
        skipped: Counter[str],
        rate: float,
        threshold: float,
        regions: int,
    ) -> SearchReport:
        """Say what was searched, and why as many parts were found.

        Parameters
        ----------
        evidence
            Of every voxel (x, y, z).
        seen
            Independent views that say anything of a voxel, or of a block of voxels (a, b, c).
        views, compared, skipped
            Numbers of views.
        rate
            Fraction of windows that look like glass.
        threshold
            Evidence that a part needs.
        regions
            Number of parts that were found.
        """
        passed = seen[seen > 0]
        typical = round(float(np.median(passed)), 1) if len(passed) else 0.0
        reachable = typical * -math.log(rate)
        cause: Cause
        if regions:
            cause = "found"
        elif not compared:
            cause = "no views"
        elif not len(passed):
            cause = "no rays"
        else:
            cause = "too few rays" if reachable < threshold else "below threshold"
            if evidence.max(initial=0.0) >= threshold:
                cause = "no outline"
        levels = np.histogram(seen, [0.0, 1e-9, 2.5, 5.5, np.inf])[0] / seen.size
        seen_by = dict(zip(("0", "1-2", "3-5", "6 or more"), np.round(levels, 3).tolist(), strict=True))
        best = float(np.quantile(passed, 0.9)) if len(passed) else 0.0
        chance = float(chance_of_finding(np.array([best]), rate, threshold)[0])
        known = rate if len(passed) else math.nan
        numbers = known, float(evidence.max(initial=0.0)), reachable, threshold, chance
        return cls(cause, views, compared, typical, seen_by, *numbers, dict(skipped))

    @property
    def found(self) -> bool:
        """Whether there are transparent parts."""
        return self.cause == "found"

    @property
    def text(self) -> str:
        """One sentence for a user."""
        seen = f"{self.compared} of {self.views} views compared"
        if self.skipped:
            seen += " (" + ", ".join(f"{count} {cause}" for cause, count in self.skipped.items()) + ")"
        if self.cause == "no views":
            return f"{seen}: no view had others to compare it with"
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
            told += f"; glass would be found here with a probability of {self.chance:.1f} at best"
            if self.next_eye_m is not None:
                told += "; add a view from ({:.2f}, {:.2f}, {:.2f}) m".format(*self.next_eye_m)
        return f"{seen}: {told}"


def chance_of_finding(seen: Float[np.ndarray, "n"], rate: float, threshold: float) -> Float[np.ndarray, "n"]:
    """Probability that as many views find glass: enough of them look like it, each by itself, against those that do not.

    Parameters
    ----------
    seen
        Numbers of independent views (n).
    rate
        Fraction of windows that look like glass anywhere.
    threshold
        Evidence that a part needs [nat].
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
    """Where a further view of the space would raise the probability of finding glass most, world [m].

    Tried are places around the space at the median height and distance of the views; what would hide the space from
    there is what the present views have seen.

    Parameters
    ----------
    frames
        Present views.
    grid
        Space of interest.
    seen
        Independent views that say anything of each block of the space (a, b, c).
    rate, threshold
        See :func:`chance_of_finding`.
    """
    from ._background_kernels import warp_views

    middle = 0.5 * (grid.low_m + grid.high_m)
    offset = np.array([frame.T_world_camera.translation_m for frame in frames]) - middle
    radius, height = (float(np.median(part)) for part in (np.hypot(offset[:, 0], offset[:, 1]), offset[:, 2]))
    parts = np.stack(np.meshgrid(*[(np.arange(_PLACES) + 0.5) / _PLACES] * 3, indexing="ij"), -1).reshape(
        -1, 3
    )
    places = grid.low_m + parts * (grid.high_m - grid.low_m)
    now = seen[tuple((parts * seen.shape).astype(int).T)]
    gain = chance_of_finding(now + 1, rate, threshold) - chance_of_finding(now, rate, threshold)
    # Where one view more is not enough either, it is a step.
    gain = gain + 1e-3 / (1 + now)
    some = [frames[k] for k in np.linspace(0, len(frames) - 1, min(_VIEWS, len(frames))).astype(int)]
    depths = np.stack([np.ascontiguousarray(ideal_depth(frame)[::_STRIDE, ::_STRIDE]) for frame in some])
    fx, fy, cx, cy = (np.float32(value / _STRIDE) for value in intrinsics(frames[0].camera))
    best, chosen = -1.0, middle
    for angle in 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        eye = middle + np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        # A view from where one was tells little: the part of an independent view that it is.
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
