"""Could foam do this? Tests of a contour by what foam, robot and lens can do, not by how it looks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

__all__ = [
    "FocusWatch",
    "OnsetWatch",
    "local_roughness",
    "rest_offset",
    "roughness",
    "thicker_than_at_rest",
]

#: Beside its noise a deflection may change by this much without a question [m].
_MARGIN_M = 5e-4
#: Fourth differences around a point that give the scatter there, an odd number.
_AROUND = 21
#: Largest bulge of free foam by the deflection that it comes from: what swings back furthest is a beam on an
#: elastic foundation that is pressed at its free end, exp(-x) cos(x), down to -exp(-3 pi / 4) / sqrt(2). Foam,
#: which carries more by tension and shear, swings back by a fraction of this.
_MAX_BULGE = float(np.exp(-0.75 * np.pi) / np.sqrt(2.0))
#: Two blurs that differ by more than this fraction are a different focus.
_BLUR_CHANGE = 0.12


class OnsetWatch:
    """Finds points whose front moved faster towards the base than anything can push it.

    A hand or a cable in front of the foam shows an edge that looks like a contact, but it is
    there from one frame to the next. A point that jumped stays suspect until it falls back.
    Release may be as quick as it likes: foam springs back. Points that are suspect for another
    reason (:func:`~._flank.stepped_points`) stay so until they fall, too.

    Parameters
    ----------
    points
        K, points along the strip.
    speed_m_s
        Largest speed of a contact.
    """

    def __init__(self, points: int, speed_m_s: float) -> None:
        self.speed_m_s = speed_m_s
        self._trusted_m = np.full(points, np.nan)
        self._since_s = np.full(points, np.nan)
        self._suspect = np.zeros(points, dtype=bool)
        self._stepped = np.zeros(points, dtype=bool)
        self._last_m = np.full(points, np.nan)
        self._last_s = np.full(points, np.nan)

    def start(self, t_s: float) -> None:
        """All points were free at this time: what is pressed later has come since.

        Parameters
        ----------
        t_s
            Time [s].
        """
        self._trusted_m[:], self._since_s[:] = 0.0, t_s
        self._last_m[:], self._last_s[:] = 0.0, t_s

    def check(
        self,
        t_s: float,
        delta_m: Float[np.ndarray, "K"],
        sigma_m: Float[np.ndarray, "K"],
        seen: Bool[np.ndarray, "K"],
        stepped: Bool[np.ndarray, "K"] | None = None,
    ) -> Bool[np.ndarray, "K"]:
        """Suspect points of one frame; what is not suspect is what the next frame is compared with.

        ``stepped`` are points that something else than their speed speaks against.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        delta_m, sigma_m
            Deflection and its standard deviation [m].
        seen
            Points that can be used.
        stepped
            Points that are suspect for another reason than their speed.
        """
        # A contact may also come from the side: what a neighbour had is no surprise.
        before = _largest_of_three(self._trusted_m)
        # A clock that starts again is another recording's, of which nothing is known.
        known = seen & np.isfinite(before) & (t_s > self._since_s)
        margin = _MARGIN_M + 5.0 * sigma_m
        reach = margin + self.speed_m_s * (t_s - self._since_s)
        rise = delta_m - before
        with np.errstate(invalid="ignore"):
            # What jumped has to jump back; an edge that crept in may creep away.
            pace = np.where(self._stepped, 0.0, self.speed_m_s)
            fell = self._last_m - delta_m > margin + pace * (t_s - self._last_s)
            back = (rise <= margin) | (fell & (rise <= reach))
            jumped = np.where(self._suspect, ~back, rise > reach)
        suspect: Bool[np.ndarray, "K"] = known & jumped
        if stepped is not None:
            suspect |= seen & stepped
            self._stepped = np.where(seen, stepped | (self._stepped & suspect), self._stepped)
        calm = seen & ~suspect
        self._trusted_m[calm], self._since_s[calm] = delta_m[calm], t_s
        self._last_m[seen], self._last_s[seen] = delta_m[seen], t_s
        self._suspect = np.where(seen, suspect, self._suspect)
        return suspect


class FocusWatch:
    """Detects while the blur of the edges changes: positions lag behind until the fit has followed."""

    def __init__(self) -> None:
        self._last_px = float("nan")

    def changing(self, blur_px: float) -> bool:
        """Whether the median blur of a contour, pixel included, differs from the last frame's.

        Parameters
        ----------
        blur_px
            Median blur of the contour, pixel included [px].
        """
        last = self._last_px
        if np.isfinite(blur_px):
            self._last_px = blur_px
        return bool(abs(blur_px - last) > _BLUR_CHANGE * last)


def roughness(
    delta_m: Float[np.ndarray, "K"], sigma_m: Float[np.ndarray, "K"], seen: Bool[np.ndarray, "K"]
) -> float:
    """Scatter from point to point in declared standard deviations; about 1 when these are true.

    The median of fourth differences: a contact's curve, even of 2 cm radius, changes
    them by less than the noise, and its few kinks do not move the median.

    Parameters
    ----------
    delta_m, sigma_m
        Deflection and its standard deviation [m].
    seen
        Points that can be used.
    """
    if len(delta_m) < 12:
        return 1.0
    weight = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    windows = np.lib.stride_tricks.sliding_window_view
    complete = windows(seen, 5).all(axis=1)
    if complete.sum() < 8:
        return 1.0
    difference = windows(np.where(seen, delta_m, 0.0), 5)[complete] @ weight
    spread = windows(np.where(seen, sigma_m, 0.0) ** 2, 5)[complete] @ weight**2
    return float(np.median(np.abs(difference) / np.sqrt(np.maximum(spread, 1e-18)))) / 0.6745


def local_roughness(
    delta_m: Float[np.ndarray, "K"], sigma_m: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """:func:`roughness` around each of K points that were seen.

    Over 21 points, of which a step or a kink changes the fourth differences of eight at most.

    Parameters
    ----------
    delta_m, sigma_m
        Deflection of seen points and its standard deviation [m].
    """
    windows = np.lib.stride_tricks.sliding_window_view
    if len(delta_m) < _AROUND + 4:
        return np.full(len(delta_m), roughness(delta_m, sigma_m, np.ones(len(delta_m), dtype=bool)))
    weight = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    spread = np.sqrt(np.maximum(windows(sigma_m**2, 5) @ weight**2, 1e-18))
    scatter = np.abs(windows(delta_m, 5) @ weight) / spread
    middle = np.median(windows(scatter, _AROUND), axis=1) / 0.6745
    result: Float[np.ndarray, "K"] = np.pad(middle, (len(delta_m) - len(middle)) // 2, mode="edge")
    return result


def thicker_than_at_rest(
    delta_m: Float[np.ndarray, "K"], sigma_m: Float[np.ndarray, "K"], width_m: float, deepest_m: float = 0.0
) -> Bool[np.ndarray, "K"]:
    """Points further out than foam can be: that edge is another one.

    Foam bulges beside a contact, by a part of the deepest deflection ``deepest_m`` [m] of the strip.

    Parameters
    ----------
    delta_m, sigma_m
        Deflection and its standard deviation [m].
    width_m
        Width of the strip at rest [m].
    deepest_m
        Deepest deflection of the strip [m].
    """
    return delta_m < -(0.02 * width_m + _MAX_BULGE * max(deepest_m, 0.0) + 5.0 * sigma_m)


def rest_offset(
    delta_m: Float[np.ndarray, "K"], sigma_m: Float[np.ndarray, "K"], seen: Bool[np.ndarray, "K"]
) -> float:
    """Deflection of the least deflected tenth of the strip, beyond its noise [m].

    It is zero while a fifth of the strip is free, unless foam, camera or zero reference have
    changed. Where everything is deflected it is an upper bound: a wide plate looks the same.

    Parameters
    ----------
    delta_m, sigma_m
        Deflection and its standard deviation [m].
    seen
        Points that can be used.
    """
    if seen.sum() < 10:
        return 0.0
    noise = float(np.median(sigma_m[seen]))
    # A tenth of Gaussian noise lies below -1.28 sigma.
    offset = float(np.quantile(delta_m[seen], 0.1)) + 1.28 * noise
    return offset if abs(offset) > noise else 0.0


def _largest_of_three(values: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
    """Largest of each value and its two neighbours; NaN only where all are."""
    padded = np.concatenate([[np.nan], values, [np.nan]])
    result: Float[np.ndarray, "K"] = np.fmax(np.fmax(padded[:-2], padded[1:-1]), padded[2:])
    return result
