"""The zero reference: appearance of the untouched strip, and its drift."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, UInt8
from pydantic import Field, FiniteFloat

from ....core import CalibrationError, InputError, decode_image, load_yaml_model, save_yaml
from ...config_fields import Section
from .encoding import UNKNOWN_ENCODING
from .rest_widths import better_than_inferred, infer_unseen, without_wrong_edges

#: Accepted relative difference between measured and declared width, due to ruler, pose and texture of the edge.
WIDTH_TOLERANCE = 0.10

#: Arrays of the file.
_ARRAYS = ("reference_px", "width_m", "width_sigma_m", "blur_ratio", "encoded_m")
#: Parallel lines per point in the image of the strip.
PARALLELS = 5
#: Length of the image of the strip relative to its width, which includes floor beyond the front.
REACH = 1.3
_ZERO_AGAIN = "zero again: visuohaptic sense foam --zero"

#: While the strip is untouched, its zero adapts with this time constant, after this time without contact [s].
ADAPTATION_S, REST_S = 30.0, 1.0
#: Largest accumulated drift with which the zero holds, as a fraction of the width.
DRIFT_LIMIT = 0.03

Numbers = Annotated[list[FiniteFloat], Field(min_length=8, max_length=2000)]


class _ZeroFile(Section):
    t_s: FiniteFloat
    frames: Annotated[int, Field(ge=1)]
    reference_px: Numbers
    width_m: Numbers
    #: Infinite where the width is unknown.
    width_sigma_m: Annotated[list[Annotated[float, Field(ge=0.0)]], Field(min_length=8, max_length=2000)]
    #: Absent in files of older versions: the front is then assumed to be as sharp as the base.
    blur_ratio: Numbers | None = None
    #: Absent in files of older versions: the shift due to encoding is then unknown.
    encoded_m: Numbers | None = None
    #: Absent in files of older versions: the encoding is then unknown.
    encoding: Annotated[float, Field(ge=0.0, le=1.0)] = UNKNOWN_ENCODING
    #: Indices of points whose width is that of their neighbours.
    inferred: Annotated[list[Annotated[int, Field(ge=0)]], Field(max_length=2000)] = Field(default=[])
    #: Eight-bit PNG of the strip in base64, its parallel lines stacked vertically; absent in files of older versions.
    image_png: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ZeroReference:
    """The strip at rest; K points. Normalised strain is 0 here and 1 at the reference contour.

    The width of a point that was not observed at rest, or less accurately than its neighbours tell it, is inferred from
    these; where its uncertainty cannot be estimated from them, the standard deviation is infinite and the deflection unknown
    in every frame.
    """

    t_s: float  #: time of the last averaged frame
    frames: int  #: number of averaged frames
    reference_px: Float[np.ndarray, "K"]  #: reference contour along the lines of the geometric model
    width_m: Float[np.ndarray, "K"]  #: distance from back to front
    width_sigma_m: Float[np.ndarray, "K"]  #: its standard deviation
    blur_ratio: Float[np.ndarray, "K"]  #: ratio of the blur of the front to that of the base
    encoded_m: Float[
        np.ndarray, "K"
    ]  #: excess of ``width_m`` if the camera encodes its grey levels; NaN: unknown
    #: Mean image of the strip along the lines, parallel lines beside each point; samples reach beyond the front.
    image: UInt8[np.ndarray, "K parallels samples"]
    inferred: Bool[np.ndarray, "K"]  #: points without an own width at rest; neighbours share their errors
    encoding: float = UNKNOWN_ENCODING  #: probability that the camera encodes its grey levels

    @property
    def contrast(self) -> float:
        """Median step of brightness from the foam to what is in front of it, positive if the foam is brighter [grey levels]."""
        at = np.arange(self.image.shape[2]) / self.image.shape[2] * REACH
        foam, beyond = (at > 0.4) & (at < 0.9), at > 1.1
        means = [self.image[:, :, part].mean(axis=(1, 2)) for part in (foam, beyond)]
        return float(np.median(means[0] - means[1]))

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
        """Average n frames of the untouched strip; NaN marks points that were not observed.

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
            Systematic error of each width, common to all frames, for example due to texture at its edge [m].
        blur_ratio
            Ratio of the blur of the front to that of the base.
        encoded_m
            Excess of the widths if the camera encodes its grey levels [m].
        where
            Source named in error messages.

        Raises
        ------
        CalibrationError
            No point was observed, or the strip moved during zeroing.
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
            # Median over five neighbours: a body that touches the strip moves most of them, an edge that is found late single ones.
            moved = float(
                np.max(np.abs(np.median(np.lib.stride_tricks.sliding_window_view(trend, 5), axis=1)))
            )
            limit = 0.01 * float(np.median(width[known]))
            if moved > limit:
                raise CalibrationError(
                    where,
                    f"the front moved by {moved * 1e3:.2f} mm while zeroing, expected less than "
                    f"{limit * 1e3:.2f} mm",
                    remedy="zero while nothing touches the strip",
                )
        # The standard error of the median is sqrt(pi/2) times that of the mean.
        sigma = np.hypot(1.2533 * scatter / np.sqrt(np.maximum(seen, 1)), uncertainty_m)
        known = better_than_inferred(without_wrong_edges(np.where(known, width, np.nan)), sigma)
        inferred, inferred_sigma = infer_unseen(np.where(known, width, np.nan))
        return cls(
            t_s,
            len(width_m),
            infer_unseen(np.where(known, np.nanmedian(reference_px, axis=0), np.nan))[0],
            inferred,
            np.where(known, sigma, inferred_sigma),
            np.broadcast_to(np.asarray(blur_ratio, dtype=np.float64), seen.shape),
            np.broadcast_to(np.asarray(encoded_m, dtype=np.float64), seen.shape),
            np.clip(np.rint(image), 0, 255).astype(np.uint8),
            ~known,
        )

    def save(self, path: Path | str) -> None:
        """Write as YAML, atomically.

        Parameters
        ----------
        path
            File to write.
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
        """Read a file written by :meth:`save`.

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
    """Reject a zero reference whose measured width differs from that in the foam file.

    The measured width w along the compression is the distance between both tracked contours in the top plane of the foam
    given by ``T_camera_foam``. The height h along the viewing direction of the camera
    cannot be measured.

    Parameters
    ----------
    measured_m
        Median distance from the back to the tracked edge [m].
    declared_m
        ``width_m`` of the foam file [m].
    where
        Source named in the message: the file or the step.
    stripe_m
        Width of a colour stripe, whose inner edge is tracked instead of the front [m].

    Raises
    ------
    CalibrationError
        The widths differ by more than 10 %.
    """
    found = measured_m + stripe_m
    if not abs(found - declared_m) <= WIDTH_TOLERANCE * declared_m:
        raise CalibrationError(
            where,
            f"the camera measures a strip {1e3 * found:.1f} mm wide, expected {1e3 * declared_m:.1f} mm "
            f"+- {100 * WIDTH_TOLERANCE:.0f} % (width_m of the foam)",
            remedy="calibrate the foam again with the true --width, or correct T_camera_foam in sensor.yaml",
        )


class ZeroWatch:
    """Adapts the zero reference while the sensor is at rest and reports excessive drift.

    Parameters
    ----------
    zero
        The original zero reference.
    """

    def __init__(self, zero: ZeroReference) -> None:
        self.zero = zero
        self._first = zero
        self._rest_since: float | None = None
        self._last_t: float | None = None
        self.forget()

    def forget(self, rest_t_s: float = -math.inf) -> None:
        """Discard how the deflection came about.

        Parameters
        ----------
        rest_t_s
            Time at which the strip was at rest [s].
        """
        # Time of the last frame, its smallest deflection, and the part of it that may be drift [m].
        self._slow = rest_t_s, 0.0, 0.0

    @property
    def drift_m(self) -> float:
        """Mean drift since the zero reference was taken [m]."""
        return float(np.mean(self.zero.width_m - self._first.width_m))

    @property
    def drifted(self) -> bool:
        """Whether the drift is so large that the zero reference has to be taken again."""
        return abs(self.drift_m) > DRIFT_LIMIT * float(np.mean(self._first.width_m))

    def sigma_m(self, t_s: float, delta_m: Float[np.ndarray, "K"]) -> float:
        """Standard deviation common to all points in the next frame [m], due to the lag of the adaptation.

        A drift of the zero deflects all points equally and cannot be distinguished from a slow body as long as the strip: it
        is uniformly distributed from 0 to the part of the smallest deflection that has come slowly, of which the root mean
        square is returned. A drift takes ``REST_S`` or more to reach its limit: what comes faster, or exceeds the limit, is due
        to a body. Before the first frame, any part may be drift.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        delta_m
            Deflection of each point in this frame [m], NaN where it is not known.
        """
        # Over five neighbours, as where the strip moves while zeroing: noise averages out.
        means = np.convolve(delta_m, np.full(5, 0.2), mode="valid")
        means = means[np.isfinite(means)]
        if not len(means):
            return 0.1 * abs(self.drift_m)
        least, limit = max(float(means.min()), 0.0), DRIFT_LIMIT * float(np.mean(self._first.width_m))
        since_s, before, slow = self._slow
        reach = limit / REST_S * max(t_s - since_s, 0.0)
        slow = min(max(slow + min(max(least - before, -reach), reach), 0.0), least)
        self._slow = t_s, least, slow
        return math.hypot(0.1 * self.drift_m, slow / math.sqrt(3.0) if least <= limit else 0.0)

    def update(
        self, t_s: float, width_m: Float[np.ndarray, "K"], *, touched: bool, usable: np.ndarray
    ) -> None:
        """Process one frame; adapts only after a time without contact.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        width_m
            Distance from back to front [m].
        touched
            Whether anything touches the strip.
        usable
            Points whose width was measured, (K,) bool.
        """
        elapsed = 0.0 if self._last_t is None else max(0.0, t_s - self._last_t)
        self._last_t = t_s
        if touched:
            self._rest_since = None
            return
        if self._rest_since is None:
            self._rest_since = t_s
        if t_s - self._rest_since < REST_S:
            return
        rate = min(1.0, elapsed / ADAPTATION_S)
        change = np.where(usable, rate * (width_m - self.zero.width_m), 0.0)
        self.zero = replace(self.zero, t_s=t_s, width_m=self.zero.width_m + change)
