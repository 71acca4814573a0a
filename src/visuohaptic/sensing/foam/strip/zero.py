"""The zero reference: what the strip looks like while nothing touches it, and how it drifts."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, UInt8
from pydantic import Field, FiniteFloat

from ....core.errors import CalibrationError, InputError
from ....core.files import decode_image, load_yaml_model, save_yaml
from ...config_fields import Section
from .encoding import UNKNOWN_ENCODING

__all__ = ["DriftSettings", "ZeroReference", "ZeroWatch", "check_width"]

#: Zeroing may measure another width than declared by this fraction: ruler, pose and texture of the edge.
_WIDTH_TOLERANCE = 0.10

#: Arrays of the file.
_ARRAYS = ("reference_px", "width_m", "width_sigma_m", "blur_ratio", "encoded_m")
#: Parallel lines per point in the image of the strip.
PARALLELS = 5
_ZERO_AGAIN = "zero again: visuohaptic sense foam --zero"

Numbers = Annotated[list[FiniteFloat], Field(min_length=8, max_length=2000)]


class _ZeroFile(Section):
    t_s: FiniteFloat
    frames: Annotated[int, Field(ge=1)]
    reference_px: Numbers
    width_m: Numbers
    #: Infinite where the width is not known.
    width_sigma_m: Annotated[list[Annotated[float, Field(ge=0.0)]], Field(min_length=8, max_length=2000)]
    #: Absent in files of older versions: the front is then taken to be as sharp as the base.
    blur_ratio: Numbers | None = None
    #: Absent in files of older versions, that do not say how much of the widths is encoding.
    encoded_m: Numbers | None = None
    #: Absent in files of older versions: nothing is then known of it.
    encoding: Annotated[float, Field(ge=0.0, le=1.0)] = UNKNOWN_ENCODING
    #: Numbers of points that were not seen.
    inferred: Annotated[list[Annotated[int, Field(ge=0)]], Field(max_length=2000)] = Field(default=[])
    #: Eight-bit PNG of the strip in base64, its parallels below each other; absent in files of older versions.
    image_png: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ZeroReference:
    """The strip at rest; K points. Normalised strain is 0 here and 1 at the reference contour.

    The width of a point that was not seen at rest is inferred from its neighbours; where they do not say how uncertain
    that is, the standard deviation is infinite and the deflection unknown in every frame.
    """

    t_s: float  #: time of the last frame that went in
    frames: int  #: how many frames were averaged
    reference_px: Float[np.ndarray, "K"]  #: reference contour along the lines of the geometric model
    width_m: Float[np.ndarray, "K"]  #: distance from back to front
    width_sigma_m: Float[np.ndarray, "K"]  #: its standard deviation
    blur_ratio: Float[np.ndarray, "K"]  #: blur of the front by that of the base
    encoded_m: Float[
        np.ndarray, "K"
    ]  #: what is too much of ``width_m`` if the camera encodes its grey levels; NaN: not known
    #: Mean image of the strip along the lines, parallels beside each point; samples reach beyond the front.
    image: UInt8[np.ndarray, "K parallels samples"]
    inferred: Bool[np.ndarray, "K"]  #: points that were not seen at rest; neighbours share their errors
    encoding: float = UNKNOWN_ENCODING  #: probability that the camera encodes its grey levels

    @property
    def known(self) -> Bool[np.ndarray, "K"]:
        """Points whose width at rest is known."""
        return np.isfinite(self.width_sigma_m)

    @classmethod
    def from_samples(
        cls,
        t_s: float,
        reference_px: Float[np.ndarray, "n K"],
        width_m: Float[np.ndarray, "n K"],
        image: Float[np.ndarray, "K parallels samples"],
        *,
        uncertainty_m: Float[np.ndarray, "K"] | float = 0.0,
        blur_ratio: Float[np.ndarray, "K"] | float = 1.0,
        encoded_m: Float[np.ndarray, "K"] | float = 0.0,
        where: str = "zero",
    ) -> ZeroReference:
        """Average n frames of a strip that nothing touches; NaN marks points that were not seen.

        Parameters
        ----------
        t_s
            Time of the last frame [s].
        reference_px
            Reference contour along the lines [px].
        width_m
            Distance from back to front [m].
        image
            Mean image of the strip along the lines.
        uncertainty_m
            What each width may be wrong by in all frames alike, for example by texture at its edge.
        blur_ratio
            Blur of the front by that of the base.
        encoded_m
            What is too much of the widths if the camera encodes its grey levels [m].
        where
            What error messages name.

        Raises
        ------
        CalibrationError
            No point was seen, or the strip moved while it was zeroed.
        """
        seen = np.isfinite(width_m).sum(axis=0)
        known = seen >= max(1, len(width_m) // 2)
        if not known.any():
            raise CalibrationError(
                where,
                f"none of {len(seen)} contour points was seen in half of the {len(width_m)} frames",
                remedy="free the view of the strip, check T_camera_foam and the light",
            )
        width_m, reference_px = (np.where(known, values, 0.0) for values in (width_m, reference_px))
        width = np.nanmedian(width_m, axis=0)
        scatter = np.nanstd(width_m, axis=0, ddof=1) if len(width_m) > 1 else np.full(len(width), 1e-5)
        if len(width_m) >= 4:
            half = len(width_m) // 2
            step = width_m[half:] - width_m[:1]
            trend = np.nansum(step, axis=0) / np.maximum(np.isfinite(step).sum(axis=0), 1)
            # Over five neighbours: a body that touches a part of the strip moves these, noise does not.
            moved = float(np.max(np.abs(np.convolve(trend, np.full(5, 0.2), mode="valid"))))
            limit = 0.01 * float(np.median(width[known]))
            if moved > limit:
                raise CalibrationError(
                    where,
                    f"the front moved by {moved * 1e3:.2f} mm while zeroing, expected less than "
                    f"{limit * 1e3:.2f} mm",
                    remedy="zero while nothing touches the strip",
                )
        # The median costs a factor sqrt(pi/2) over the mean.
        sigma = np.hypot(1.2533 * scatter / np.sqrt(np.maximum(seen, 1)), uncertainty_m)
        inferred, inferred_sigma = _infer_unseen(np.where(known, width, np.nan))
        return cls(
            t_s,
            len(width_m),
            _infer_unseen(np.where(known, np.nanmedian(reference_px, axis=0), np.nan))[0],
            inferred,
            np.where(known, sigma, inferred_sigma),
            np.broadcast_to(np.asarray(blur_ratio, dtype=np.float64), seen.shape),
            np.broadcast_to(np.asarray(encoded_m, dtype=np.float64), seen.shape),
            np.clip(np.rint(image), 0, 255).astype(np.uint8),
            ~known,
        )

    def save(self, path: Path | str) -> None:
        """Write as YAML, whole or not at all.

        Parameters
        ----------
        path
            Where to write.
        """
        import cv2

        _, coded = cv2.imencode(".png", self.image.reshape(-1, self.image.shape[2]))
        known = [name for name in _ARRAYS if not np.isnan(getattr(self, name)).any()]
        arrays = {name: [float(f"{value:.9g}") for value in getattr(self, name)] for name in known}
        image = base64.b64encode(coded.tobytes()).decode("ascii")
        inferred = [int(k) for k in np.flatnonzero(self.inferred)]
        data = {"t_s": self.t_s, "frames": self.frames, "encoding": float(f"{self.encoding:.6g}")}
        save_yaml(path, data | arrays | {"inferred": inferred, "image_png": image})

    @classmethod
    def load(cls, path: Path | str, count: int) -> ZeroReference:
        """Read a file of :meth:`save`.

        Parameters
        ----------
        path
            The file.
        count
            Number of contour points of the sensor.
        """
        data = load_yaml_model(path, _ZeroFile)
        data.blur_ratio = data.blur_ratio or [1.0] * len(data.width_m)
        data.encoded_m = data.encoded_m or [math.nan] * len(data.width_m)
        arrays = {name: np.array(getattr(data, name)) for name in _ARRAYS}
        for name, values in arrays.items():
            if len(values) != count:
                problem = f"has {len(values)} points, the sensor has {count}"
                raise InputError(path, problem, field=name, remedy=_ZERO_AGAIN)
        if (arrays["width_m"] <= 0).any():
            raise InputError(path, "found widths that are not positive", field="width_m")
        try:
            coded = base64.b64decode(data.image_png or "", validate=True)
            image = decode_image(coded, path, "grey")
            if len(image) != PARALLELS * count:
                raise ValueError
        except (ValueError, InputError) as error:
            problem = "found no image of the strip (an older version's file, or a damaged one)"
            raise InputError(path, problem, field="image_png", remedy=_ZERO_AGAIN) from error
        image = image.reshape(count, PARALLELS, -1)
        inferred = np.isin(np.arange(count), data.inferred)
        return cls(data.t_s, data.frames, **arrays, image=image, inferred=inferred, encoding=data.encoding)


def check_width(measured_m: float, declared_m: float, where: Path | str, *, stripe_m: float = 0.0) -> None:
    """Refuse a zero reference whose strip is not as wide as the foam's file says.

    Measured is the distance between both tracked contours, on the foam's top plane under
    ``T_camera_foam``: the width w along the compression. The height h lies along the view of the camera,
    which cannot measure it.

    Parameters
    ----------
    measured_m
        Median distance from the back to the tracked edge [m].
    declared_m
        ``width_m`` of the foam's file [m].
    where
        What the message names: the file or the step.
    stripe_m
        Width of a colour stripe, whose inner edge is tracked in place of the front [m].

    Raises
    ------
    CalibrationError
        They are more than 10 % apart.
    """
    found = measured_m + stripe_m
    if not abs(found - declared_m) <= _WIDTH_TOLERANCE * declared_m:
        raise CalibrationError(
            where,
            f"the camera measures a strip {1e3 * found:.1f} mm wide, expected {1e3 * declared_m:.1f} mm "
            f"+- {100 * _WIDTH_TOLERANCE:.0f} % (width_m of the foam)",
            remedy="calibrate the foam again with the true --width, or mend T_camera_foam in sensor.yaml",
        )


def _infer_unseen(width_m: Float[np.ndarray, "K"]) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Widths with those of unseen points (NaN) inferred from the nearest seen ones, and the standard deviation of these.

    On the straight line between the neighbours, or as wide as the only one. Predicting each seen point from points at the
    same distances errs by a standard deviation s over n points; the error of an unseen one then has Student's
    distribution, whose variance is n / (n - 2) s^2 and infinite up to n = 2.
    """
    count = len(width_m)
    known = np.flatnonzero(np.isfinite(width_m))
    padded = np.pad(width_m, count, constant_values=np.nan)
    result, sigma = width_m.copy(), np.zeros(count)
    for k in np.setdiff1d(np.arange(count), known):
        nearest = np.concatenate([known[known < k][-1:], known[known > k][:1]])
        weight = np.ones(1) if len(nearest) == 1 else np.abs(nearest[::-1] - k) / np.ptp(nearest)
        pairs = list(zip(weight, nearest, strict=True))
        error = width_m - sum(w * padded[count + i - k : 2 * count + i - k] for w, i in pairs)
        error = error[np.isfinite(error)]
        result[k] = sum(w * width_m[i] for w, i in pairs)
        sigma[k] = math.sqrt((error @ error) / (len(error) - 2)) if len(error) > 2 else math.inf
    return result, sigma


@dataclass(frozen=True, slots=True)
class DriftSettings:
    """How the zero reference follows slow changes."""

    time_constant_s: float = 30.0  #: of the adaptation while nothing touches
    rest_s: float = 1.0  #: how long nothing must have touched before it adapts
    limit: float = 0.03  #: accumulated drift, as a fraction of the width, beyond which it is not trusted


class ZeroWatch:
    """Follows the zero reference while the sensor is at rest and reports when it has drifted away.

    Parameters
    ----------
    zero
        The zero reference as it was taken.
    settings
        How the zero follows slow changes; the defaults without.
    """

    def __init__(self, zero: ZeroReference, settings: DriftSettings | None = None) -> None:
        self.settings = settings or DriftSettings()
        self.zero = zero
        self._first = zero
        self._rest_since: float | None = None
        self._last_t: float | None = None

    @property
    def drift_m(self) -> float:
        """Mean distance that the zero has moved since it was taken [m]."""
        return float(np.mean(self.zero.width_m - self._first.width_m))

    @property
    def drifted(self) -> bool:
        """Whether the zero is so far away that it has to be taken again."""
        return abs(self.drift_m) > self.settings.limit * float(np.mean(self._first.width_m))

    def sigma_m(self, delta_m: Float[np.ndarray, "K"]) -> float:
        """Standard deviation common to all points [m]: what adaptation may still lag behind.

        A zero that drifts deflects all points alike, and nothing tells that from a body as long as the strip: it may have
        drifted by anything up to the least deflection (root mean square of a uniform distribution from 0). More than
        the limit is no drift, but a body.

        Parameters
        ----------
        delta_m
            Deflection of each point in this frame [m], NaN where it is not known.
        """
        # Over five neighbours, as where the strip moves while zeroing: noise averages out.
        means = np.convolve(delta_m, np.full(5, 0.2), mode="valid")
        least = float(np.min(means[np.isfinite(means)], initial=np.inf))
        drifts = 0.0 < least <= self.settings.limit * float(np.mean(self._first.width_m))
        return math.hypot(0.1 * self.drift_m, least / math.sqrt(3.0) if drifts else 0.0)

    def update(
        self, t_s: float, width_m: Float[np.ndarray, "K"], *, touched: bool, usable: np.ndarray
    ) -> None:
        """Take in one frame; adapts only after a time without any contact.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        width_m
            Distance from back to front [m].
        touched
            Whether anything touches the strip.
        usable
            Points whose width was seen, (K,) bool.
        """
        elapsed = 0.0 if self._last_t is None else max(0.0, t_s - self._last_t)
        self._last_t = t_s
        if touched:
            self._rest_since = None
            return
        if self._rest_since is None:
            self._rest_since = t_s
        if t_s - self._rest_since < self.settings.rest_s:
            return
        rate = min(1.0, elapsed / self.settings.time_constant_s)
        change = np.where(usable, rate * (width_m - self.zero.width_m), 0.0)
        self.zero = replace(self.zero, t_s=t_s, width_m=self.zero.width_m + change)
