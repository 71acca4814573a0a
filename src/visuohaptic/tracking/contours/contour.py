"""Contour tracking along constraint lines, Alt 2016, Sec. 3.3.1 and Eq. (3.6).

Per frame: the global optimum of the energy over all points (dynamic programming),
then a maximum-likelihood fit of a blurred step to the raw pixels of each point.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ...core import NON_NEGATIVE, POSITIVE, InputError, Ranged, at_least, finite_array, within
from ...core.measurement import SIGMA_PER_MAD
from . import _fit_kernels as columns
from ._classify_kernels import classify_points
from ._refine_kernels import SHARED, refine, start_on_edge
from ._search_kernels import search
from .lines import ConstraintLines

#: Number of points on each side over which the levels beside the edge are fitted jointly ...
SHARED_POINTS = SHARED
#: ... and the resulting correlation between the noise of two of them: the fraction by which
#: unknown levels increase the variance of a point (5 % above the bound with known levels).
SHARED_NOISE = 0.05


class PointReason(IntEnum):
    """Why a point is invalid."""

    OK = 0  #: valid
    LOST = 1  #: no edge with sufficient contrast, or the fit diverged from the detected edge
    OCCLUDED = 2  #: pixels in front do not belong to the stripe
    OUT_OF_RANGE = 3  #: outside the search range, or its pixels are outside the image
    WRONG_POLARITY = 4  #: bright and dark are reversed
    POOR_FIT = 5  #: the pixels do not match a blurred step
    JUMP = 6  #: far from both neighbours


@dataclass(frozen=True, slots=True)
class ContourSettings(Ranged):
    """Appearance and motion model of the contour.

    The three weights multiply the terms of Eq. (3.6), each scaled to a range of about
    [-1, 1]: the edge strength by its limit, the second difference by the point
    spacing (a kink of 45 degrees costs ``weight_smooth``), the jump term by the mean
    contrast of the contour (crossing one full edge costs ``weight_jump``).
    """

    weight_edge: float = field(default=1.0, metadata=POSITIVE)  #: w_e
    weight_smooth: float = field(default=1.0, metadata=NON_NEGATIVE)  #: w_s
    weight_jump: float = field(default=1.0, metadata=NON_NEGATIVE)  #: w_j
    polarity: int = field(default=0, metadata=within(-1, 1))  #: +1 brighter at larger t, -1 darker, 0 either
    #: Initial blur of the optics (Gaussian sigma), without the pixel [px].
    blur_px: float = field(default=1.0, metadata=POSITIVE)
    min_contrast: float = field(default=8.0, metadata=POSITIVE)  #: minimum usable step [grey levels]
    #: Width of the pixels on each side from which the grey levels are estimated; smaller for a thin stripe [px].
    plateau_px: float = field(default=8.0, metadata=at_least(2.0))
    #: Standard deviation of one pixel [grey levels]; None: estimated per frame.
    noise_grey: float | None = field(default=None, metadata=POSITIVE)
    #: search on either side of the prediction while tracking
    window_px: int = field(default=15, metadata=POSITIVE)
    #: frames between searches of the whole range
    full_search_every: int = field(default=60, metadata=POSITIVE)
    #: largest mean squared residual, in noise variances
    max_chi2: float = field(default=4.0, metadata=POSITIVE)
    #: distance from both neighbours, in point spacings
    max_jump: float = field(default=1.75, metadata=POSITIVE)


@dataclass(frozen=True, slots=True, eq=False)
class Contour:
    """One contour in one frame; values are meaningless where ``valid`` is False."""

    lines: ConstraintLines  #: constraint lines of the points
    position_px: Float[np.ndarray, "k"]  #: t of every point [px]
    sigma_px: Float[np.ndarray, "k"]  #: standard deviation [px]: noise, and possible shift by texture
    noise_px: Float[np.ndarray, "k"]  #: the component that changes from frame to frame [px]
    valid: Bool[np.ndarray, "k"]
    reason: UInt8[np.ndarray, "k"]  #: ``PointReason`` of every point
    contrast: Float[np.ndarray, "k"]  #: grey level behind minus that in front of the edge, signed
    level: Float[np.ndarray, "k"]  #: grey level behind the edge
    blur_px: Float[np.ndarray, "k"]  #: blur of the optics, pixel size removed [px]
    slope: Float[np.ndarray, "k"]  #: dt/ds, s along the direction (-d_y, d_x) [px/px]
    chi2: Float[np.ndarray, "k"]  #: mean squared residual in noise variances
    searched_all: bool  #: whether the whole range was searched in this frame

    @property
    def points_px(self) -> Float[np.ndarray, "k 2"]:
        """The points in the image (x, y) [px]."""
        return self.lines.points_px(self.position_px)


class ContourTracker:
    """Tracks one contour from frame to frame.

    The state is used for the next frame: positions, blur and noise, the mean
    edge strength of the previous frame (the limit of e_e) and the number of valid points.

    Parameters
    ----------
    settings
        Appearance and motion model of the contour; defaults if omitted.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.full((60, 120), 40, np.uint8)
    >>> image[31:] = 160  # the edge between row 30 and row 31 is at 30.5
    >>> x = np.arange(20.0, 101.0, 16.0)
    >>> lines = ConstraintLines(
    ...     np.stack([x, np.full(6, 20.0)], 1), np.tile([0.0, 1.0], (6, 1)), np.zeros(6), np.full(6, 20.0)
    ... )
    >>> ContourTracker().track(image, lines).position_px.round(2)
    array([10.5, 10.5, 10.5, 10.5, 10.5, 10.5])
    """

    def __init__(self, settings: ContourSettings | None = None) -> None:
        self.settings = settings or ContourSettings()
        self.reset()

    def reset(self) -> None:
        """Discard the state; the whole range is searched in the next frame."""
        self._position: Float[np.ndarray, "k"] | None = None
        self._blur: Float[np.ndarray, "k"] | None = None
        self._noise_var = 0.0
        self._cap = 0.0
        self._contrast = 0.0
        self._age = 0

    def track(
        self,
        grey: UInt8[np.ndarray, "rows columns"],
        lines: ConstraintLines,
        *,
        predicted_px: Float[np.ndarray, "k"] | None = None,
        free_ends: int = 0,
    ) -> Contour:
        """Find the contour in one frame.

        Parameters
        ----------
        grey
            The frame.
        lines
            One line per point; the number of points may change only after ``reset``.
        predicted_px
            Expected positions; by default, those of the previous frame.
        free_ends
            Largest number of points at either end that the contour may not reach.

        Raises
        ------
        InputError
            The frame is not 8-bit grey, or an array does not match the lines.
        """
        if grey.dtype != np.uint8 or grey.ndim != 2 or min(grey.shape) < 16:
            raise InputError(
                "ContourTracker.track",
                f"found {grey.dtype} {grey.shape}, expected uint8 (rows, columns) of 16 px or more",
                field="grey",
            )
        grey = np.ascontiguousarray(grey)
        count = len(lines)
        guess = self._position
        if predicted_px is not None:
            guess = finite_array("ContourTracker.track", predicted_px, count, field="predicted_px")
        if guess is not None and guess.shape != (count,):
            raise InputError(
                "ContourTracker.track",
                f"found {count} lines after {guess.shape[0]} in the previous frame",
                field="lines",
                remedy="call reset() first",
            )
        due = guess is None or self._age >= self.settings.full_search_every
        contour = self._attempt(grey, lines, None if due else guess, free_ends)
        if guess is None:  # once more with the contrast, blur and noise that the first frame has shown
            contour = replace(self._attempt(grey, lines, self._position, free_ends), searched_all=True)
        # Some points have no edge: the contour, or its occluder, may have left the search window.
        if not due and contour.valid.mean() < _FEW_VALID:
            due = True
            contour = self._attempt(grey, lines, None, free_ends)
        self._age = 0 if due else self._age + 1
        return contour

    def near(
        self,
        grey: UInt8[np.ndarray, "rows columns"],
        lines: ConstraintLines,
        expected_px: Float[np.ndarray, "k"],
    ) -> Contour:
        """Find a contour in one frame within ``window_px`` of a place, without the state of frames before.

        Parameters
        ----------
        grey, lines
            As in :meth:`track`.
        expected_px
            Expected positions [px].
        """
        self.reset()
        return self._attempt(np.ascontiguousarray(grey), lines, expected_px, 0)

    def _attempt(
        self,
        grey: UInt8[np.ndarray, "rows columns"],
        lines: ConstraintLines,
        guess: Float[np.ndarray, "k"] | None,
        free_ends: int,
    ) -> Contour:
        """Search around ``guess`` (or the whole range), fit, classify; update the state."""
        noise = self.settings.noise_grey or float(np.sqrt(self._noise_var)) or _first_noise(grey, lines)
        found, strength = self._found(grey, lines, guess, noise, free_ends)
        state, noise_var = self._fitted(grey, lines, found)
        contour = self._classified(lines, state, found, noise_var, searched_all=guess is None)
        poor = (contour.reason == PointReason.LOST) | (contour.reason == PointReason.POOR_FIT)
        if self._blur is not None:
            # Softer than in the last frame by far more than the noise of its blur.
            poor |= state[:, columns.BLUR] > (1.0 + 3.0 * _SAME_BLUR) * self._blur
        doubtful = _long_runs(poor)
        if self._blur is not None and doubtful.any():
            again, noise_var = self._fitted(grey, lines, found, doubtful)
            better = doubtful & (again[:, columns.NEXT_STEP] != 0.0)
            better &= self._classified(lines, again, found, noise_var, searched_all=False).valid
            state[better] = again[better]
            contour = self._classified(lines, state, found, noise_var, searched_all=guess is None)
        self._noise_var = noise_var
        self._position = np.where(contour.valid, contour.position_px, found)
        if contour.valid.any():
            self._blur = state[:, columns.BLUR].copy()
            self._cap = max(float(strength[contour.valid].mean()), 1e-3)
            self._contrast = float(np.abs(contour.contrast[contour.valid]).mean())
        return contour

    def _found(
        self,
        grey: UInt8[np.ndarray, "rows columns"],
        lines: ConstraintLines,
        guess: Float[np.ndarray, "k"] | None,
        noise: float,
        free_ends: int,
    ) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Positions with minimum energy, Eq. (3.6), moved to the edge, and their edge strength."""
        chosen = self.settings
        start, stop = np.asarray(lines.start_px), np.asarray(lines.stop_px)
        cap = self._cap
        strength = found = np.zeros(len(lines)) if guess is None else guess
        # First the whole range if necessary, then around the guess at half the density.
        for wide in (True, False) if guess is None else (False,):
            if wide:
                span = float((stop - start).max())
                stride, turns = max(1, int(np.ceil(span / 64.0))), 1
                first, positions = np.floor(start), int(span / stride) + 2
            else:
                stride, turns, positions = 2, 0, chosen.window_px + 1
                first = np.rint(np.minimum(np.maximum(found, start), stop)) - chosen.window_px
            found, strength, _, cap = search(
                grey, lines.origin_px, lines.direction_px, start, stop, first, positions, stride,
                chosen.polarity, cap, self._contrast, 0.4 * noise, chosen.weight_edge, chosen.weight_jump,
                chosen.weight_smooth / lines.spacing_px**2, free_ends, turns,
            )  # fmt: skip
        start_on_edge(
            grey, lines.origin_px, lines.direction_px, found, strength, start, stop, chosen.polarity,
            cap, 0.4 * noise, lines.spacing_px,
        )  # fmt: skip
        return found, strength

    def _fitted(
        self,
        grey: UInt8[np.ndarray, "rows columns"],
        lines: ConstraintLines,
        found: Float[np.ndarray, "k"],
        doubtful: Bool[np.ndarray, "k"] | None = None,
    ) -> tuple[Float[np.ndarray, "k states"], float]:
        """Maximum-likelihood fit of a blurred step at each point, and the variance of one pixel [grey levels^2].

        Doubtful points may have a second edge close beyond the first, that of a body in front of the contour.
        """
        if doubtful is None:
            doubtful = np.zeros(len(found), dtype=bool)
        chosen, last = self.settings, self._blur
        given = chosen.noise_grey**2 if chosen.noise_grey else 0.0
        best: tuple[float, Float[np.ndarray, "k states"], float] | None = None
        cold = (np.hypot(blur, PIXEL_PX) for blur in (chosen.blur_px, *_BLURS_PX))
        for start in cold if last is None else chain((last,), cold):
            state = np.zeros((len(lines), columns.STATES))
            state[:, columns.T], state[:, columns.BLUR] = found, start
            noise_var = refine(
                grey, lines.origin_px, lines.direction_px, np.asarray(lines.half_width_px), state, doubtful, given,
                *((2, 0.3) if start is last else (5, 1.0)), chosen.min_contrast, chosen.plateau_px,
            )  # fmt: skip
            misfit = quick_median(state[:, columns.CHI2])
            if best is None or misfit < best[0]:
                best = misfit, state, noise_var
            height = quick_median(np.abs(state[:, columns.HIGH] - state[:, columns.LOW]))
            # Changed focus or motion: the update of the blur would be slow, and poor fits would never converge.
            if misfit < 2.0 * noise_var + (_POOR * height) ** 2 and (
                start is not last
                or abs(quick_median(state[:, columns.BLUR]) / quick_median(last) - 1.0) < _SAME_BLUR
            ):
                break
        assert best is not None
        _, state, noise_var = best
        if not given and self._noise_var > 0.0:
            # React at once to a dark or changed frame: never below half of this frame's value.
            noise_var = max(0.7 * self._noise_var + 0.3 * noise_var, 0.5 * noise_var)
        return state, float(noise_var)

    def _classified(
        self,
        lines: ConstraintLines,
        state: Float[np.ndarray, "k states"],
        found: Float[np.ndarray, "k"],
        noise_var: float,
        *,
        searched_all: bool,
    ) -> Contour:
        """Validity, reason and standard deviation of each fitted point."""
        chosen = self.settings
        edges, reason = np.empty((8, len(lines))), np.empty(len(lines), dtype=np.uint8)
        classify_points(
            state, found, lines.half_width_px, lines.start_px, lines.stop_px, noise_var,
            chosen.polarity, chosen.min_contrast, chosen.max_chi2, 4.0,
            chosen.max_jump * lines.spacing_px, PIXEL_PX, edges, reason,
        )  # fmt: skip
        position, sigma, noise, contrast, level, blur, slope, chi2 = edges
        return Contour(
            lines, position, sigma, noise, reason == PointReason.OK, reason, contrast, level, blur, slope, chi2,
            searched_all,
        )  # fmt: skip


#: Minimum number of neighbouring points without a good fit for which a second edge is searched: kinks have one or two.
_RUN = 3
#: Fraction of valid points below which the whole range is searched: three of eighty may be due to dirt.
_FEW_VALID = 0.96
#: A larger difference in blur from the last frame is a change: twice the noise of its median.
_SAME_BLUR = 0.05
#: Other blurs that are tried if a fit leaves this fraction of the contrast [px].
_BLURS_PX, _POOR = (2.0, 3.5), 0.05
#: Standard deviation of a pixel's box function [px]; adds to the blur in quadrature.
PIXEL_PX = float(np.sqrt(1.0 / 12.0))


def quick_median(values: Float[np.ndarray, "k"]) -> float:
    """Median of a few dozen values: takes a tenth of the time of NumPy's, which supports axes and masks.

    Parameters
    ----------
    values
        One or more finite values.
    """
    ordered, count = np.sort(values), len(values)
    return 0.5 * float(ordered[(count - 1) // 2] + ordered[count // 2])


def _long_runs(points: Bool[np.ndarray, "k"]) -> Bool[np.ndarray, "k"]:
    """The points of runs of at least ``_RUN`` neighbours."""
    whole = np.convolve(points, np.ones(_RUN), mode="valid") == _RUN
    long: Bool[np.ndarray, "k"] = np.convolve(whole, np.ones(_RUN)) > 0.0
    return long


def _first_noise(grey: UInt8[np.ndarray, "rows columns"], lines: ConstraintLines) -> float:
    """Initial estimate of the noise of one pixel [grey levels]: from second differences along rows.

    If noise is mistaken for edges, long distances appear blocked, so that the search stays close
    to the reference. The median excludes edges.
    """
    reach = np.linspace(np.asarray(lines.start_px), np.asarray(lines.stop_px), 9)[..., None]
    points = (np.asarray(lines.origin_px) + reach * np.asarray(lines.direction_px)).reshape(-1, 2)
    column = np.clip(np.rint(points[:, 0]), 1, grey.shape[1] - 2).astype(np.int64)
    row = np.clip(np.rint(points[:, 1]), 0, grey.shape[0] - 1).astype(np.int64)
    left, middle, right = (grey[row, column + i].astype(np.float64) for i in (-1, 0, 1))
    return max(
        2.0, SIGMA_PER_MAD * float(np.median(np.abs(left - 2.0 * middle + right))) / float(np.sqrt(6.0))
    )
