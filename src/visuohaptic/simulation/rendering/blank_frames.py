"""Frames that advance a simulated world; blank unless the world renders its camera's view."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt8

from ...core import Camera, Closing, Frame


class BlankFrames(Closing):
    """A ``robots.FrameSource`` that advances the world by one frame period per frame; worlds implement :meth:`advance`."""

    frame_rate_Hz: float
    duration_s: float = math.inf
    _index: int = 0

    @abstractmethod
    def advance(self, dt_s: float) -> float:
        """Advance the simulation; returns the new time [s].

        Parameters
        ----------
        dt_s
            Simulated time [s].
        """

    @property
    def camera(self) -> Camera | None:
        """The camera's model; None: nothing is rendered."""
        return None

    def image(self, t_s: float) -> UInt8[np.ndarray, "rows columns"]:
        """Current view of the camera; blank by default.

        Parameters
        ----------
        t_s
            The world's time [s].
        """
        return np.zeros((2, 2), np.uint8)

    @property
    def frame_count(self) -> int | None:
        """Number of frames; ``None`` if endless."""
        return None if math.isinf(self.duration_s) else round(self.duration_s * self.frame_rate_Hz)

    def __iter__(self) -> Iterator[Frame]:
        while self.frame_count is None or self._index < self.frame_count:
            t_s = self.advance(1.0 / self.frame_rate_Hz)
            frame = Frame(self.image(t_s), t_s, self._index)
            self._index += 1
            yield frame

    def close(self) -> None:
        """Nothing to release."""
