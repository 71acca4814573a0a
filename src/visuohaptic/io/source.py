"""Common base of recorded sources: known times, lost frames, sections of a recording."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core import Camera, Closing, DeviceError, Frame, InputError, StaleFrameError
from ..core.ranges import SECONDS, check_numbers

_log = logging.getLogger(__name__)

#: Intervals within this fraction of a multiple of the period count as regular.
_REGULAR = 0.2
#: Longer intervals than this are told, as they may be milliseconds: a camera of 200 Hz has 5 of them [s].
_SLOW_s = 5.0


def indices_from_times(times_s: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Frame number as counted by the camera: at a regular rate, a missing frame leaves a gap.

    The period is the median interval. If at least nine of ten intervals are
    multiples of it (within 20 %), the index advances by that multiple;
    otherwise the frame rate is variable and frames are numbered consecutively.

    Parameters
    ----------
    times_s
        Times of the frames, ascending, shape (n,) [s].

    Returns
    -------
    array
        Numbers from 0, shape (n,).

    Examples
    --------
    >>> indices_from_times(np.array([0.0, 0.1, 0.2, 0.4, 0.5])).tolist()
    [0, 1, 2, 4, 5]
    """
    times = np.asarray(times_s, dtype=np.float64)
    plain = np.arange(len(times))
    if len(times) < 4:
        return plain
    intervals = np.diff(times)
    period = float(np.median(intervals))
    if period <= 0:
        return plain
    periods = intervals / period
    steps = np.maximum(np.rint(periods), 1.0)
    if np.mean(np.abs(periods - steps) <= _REGULAR * steps) < 0.9:
        return plain
    # A gap of more than a minute at 1 kHz is a pause or a clock jump; this limits the index.
    steps = np.minimum(steps, 1e5)
    return np.concatenate([[0], np.cumsum(steps).astype(np.int64)])


class LiveFrames(Closing):
    """Frames that arrive while they are read, of a device or a topic, until the source is closed."""

    frame_count: int | None = None  #: a live source has no end
    _running = True
    _patience_s = 5.0  #: iteration fails if no frame arrives within this time

    @abstractmethod
    def read(self, timeout_s: float = 2.0) -> Frame:
        """Wait for the next frame.

        Parameters
        ----------
        timeout_s
            Maximum wait [s].
        """

    def __iter__(self) -> Iterator[Frame]:
        """Frames until the source is closed; :class:`.DeviceError` if none arrive."""
        while not self._closed():
            try:
                yield self.read(self._patience_s)
            except DeviceError:
                if self._closed():
                    return
                raise

    def _closed(self) -> bool:
        return not self._running

    @staticmethod
    def check_age(age_s: float, max_age_ms: float) -> None:
        """Reject an old frame.

        Parameters
        ----------
        age_s
            Since it was taken [s].
        max_age_ms
            Limit [ms].

        Raises
        ------
        StaleFrameError
            It is older.
        """
        if 1e3 * age_s > max_age_ms:
            raise StaleFrameError(
                f"the newest frame is {1e3 * age_s:.0f} ms old, the limit is {max_age_ms:.0f} ms"
            )


class RecordedSource(Closing):
    """Frames of a recording; implements :class:`visuohaptic.core.robots.FrameSource`.

    Parameters
    ----------
    where
        Name of the recording for messages.
    times_s
        Time of every frame [s], ascending.
    camera
        Camera model, if known; its size must match the images.
    start_s, stop_s
        Section of the recording, relative to its first frame [s]; ``stop_s`` is exclusive.
    """

    def __init__(
        self,
        where: str,
        times_s: Float[np.ndarray, "n"],
        *,
        camera: Camera | None = None,
        start_s: float = 0.0,
        stop_s: float = float("inf"),
    ) -> None:
        times = np.asarray(times_s, dtype=np.float64)
        if not len(times):
            raise InputError(where, "found no frames, expected at least one")
        if not np.isfinite(times).all():
            raise InputError(where, f"frame {int(np.argmin(np.isfinite(times)))} has no finite time")
        check_numbers(where, SECONDS, **{"time of the last frame [s]": float(times[-1])})
        if len(times) > 1 and times[0] == times[-1]:
            raise InputError(
                where, f"has {len(times)} frames, all at {times[0]:g} s, expected ascending times"
            )
        if len(times) > 1 and (step_s := float(np.median(np.diff(times)))) > _SLOW_s:
            _log.warning("%s: its frames are %.3g s apart; expected times in seconds", where, step_s)
        if np.isnan(start_s) or not stop_s > start_s:
            raise InputError(where, f"found start {start_s} s and stop {stop_s} s, expected start < stop")
        since = times - times[0]
        # Half a microsecond: the resolution of epoch times in float64.
        chosen = np.flatnonzero((since >= start_s - 5e-7) & (since < stop_s - 5e-7))
        if not len(chosen):
            raise InputError(where, f"has no frame from {start_s} to {stop_s} s; it lasts {since[-1]:.3f} s")
        self._where = where
        self._camera = camera
        self._chosen = chosen
        self.times_s: Float[np.ndarray, "k"] = times[chosen]  #: times of the selected frames
        self.indices: Int[np.ndarray, "k"] = indices_from_times(times)[chosen]
        self.damaged = 0  #: number of frames that could not be decoded so far
        self._closed = False

    @property
    def camera(self) -> Camera | None:
        """Camera model, if known."""
        return self._camera

    @property
    def frame_count(self) -> int | None:
        """Number of frames."""
        return len(self._chosen)

    @property
    def missing(self) -> int:
        """Number of frames lost between the first and the last one, according to gaps in time."""
        return int(self.indices[-1] - self.indices[0] + 1 - len(self.indices))

    @abstractmethod
    def _images(
        self, chosen: Int[np.ndarray, "k"]
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "rows columns *colour"]]]:
        """Position within ``chosen`` and image, in order; damaged frames are skipped."""

    def __iter__(self) -> Iterator[Frame]:
        """Frames in temporal order; every iteration starts at the first one.

        Raises
        ------
        InputError
            No frame could be decoded, or the size differs from the camera's or changes.
        """
        if self._closed:
            raise InputError(self._where, "is closed", remedy="open the source again")
        self.damaged = 0
        size: tuple[int, int] | None = None
        delivered = 0
        for position, image in self._images(self._chosen):
            found = (image.shape[1], image.shape[0])
            if size is None:
                size = found
                if self._camera:
                    self._camera.check_size(self._where, *found)
            elif size != found:
                raise InputError(
                    self._where,
                    f"frame {self.indices[position]} has {found[0]} x {found[1]}, expected "
                    f"{size[0]} x {size[1]} as before",
                )
            delivered += 1
            yield Frame(image, float(self.times_s[position]), int(self.indices[position]))
        self.damaged = len(self._chosen) - delivered
        if not delivered:
            raise InputError(self._where, f"none of {len(self._chosen)} frames could be decoded")
        if self.damaged:
            _log.warning("%s: %d of %d frames are damaged", self._where, self.damaged, len(self._chosen))

    def close(self) -> None:
        """Release the file; may be called repeatedly."""
        self._closed = True
