"""Search for lost templates: synchronous, or in a separate thread so that no frame waits (Alt 2016, Sec. 2.3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from ..points.homography import apply_homography
from .detector import Detection, DetectorSettings, detect_templates
from .template import Template


@dataclass(frozen=True, slots=True, eq=False)
class LostPlace:
    """A lost template and its search area."""

    template: Template
    last_seen: Float[np.ndarray, "3 3"] | None  #: homography before it was lost
    near: bool  #: search only around that position; otherwise in the whole image

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """Box x0, y0, x1, y1 around the last position, extended by half its size on every side [px]; None: whole image."""
        if not self.near or self.last_seen is None:
            return None
        corners = apply_homography(self.last_seen, self.template.esm.corners)
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = np.maximum(0.5 * (high - low), 40.0)
        box = np.concatenate([low - margin, high + margin])
        return int(box[0]), int(box[1]), int(box[2]) + 1, int(box[3]) + 1


class LostSearch:
    """Searches for lost templates, one search at a time.

    Parameters
    ----------
    settings
        Effort and thresholds of the detection.
    threaded
        Search in a thread; the result is collected in a later frame.
    """

    def __init__(self, settings: DetectorSettings, *, threaded: bool) -> None:
        self.settings = settings
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="detector") if threaded else None
        self._pending: Future[dict[str, Detection]] | None = None

    @property
    def busy(self) -> bool:
        """Whether a search is running in the thread."""
        return self._pending is not None

    def search(
        self, places: Sequence[LostPlace], grey: UInt8[np.ndarray, "height width"]
    ) -> dict[str, Detection]:
        """Search one image for templates.

        Parameters
        ----------
        places
            Templates to search for, and where.
        grey
            The image.

        Returns
        -------
        dict of str to Detection
            Detections by name; empty with a thread, whose result :meth:`collected` returns later.
        """
        if self._worker is None:
            return _detect(places, grey, self.settings)
        # The thread gets only copies: its input does not change meanwhile.
        self._pending = self._worker.submit(_detect, tuple(places), grey.copy(), self.settings)
        return {}

    def collected(self) -> dict[str, Detection]:
        """Detections of the thread since the last call."""
        if self._pending is None or not self._pending.done():
            return {}
        found, self._pending = self._pending.result(), None
        return found

    def forget(self) -> None:
        """Discard the running search."""
        if self._pending is not None:
            self._pending.cancel()
            self._pending = None

    def close(self) -> None:
        """End the thread; may be called repeatedly."""
        if self._worker is not None:
            self._worker.shutdown(wait=True, cancel_futures=True)
            self._worker = None


def _detect(
    places: Sequence[LostPlace], grey: UInt8[np.ndarray, "height width"], settings: DetectorSettings
) -> dict[str, Detection]:
    """Search for templates with a region there, for the others in the whole image, in one call."""
    found: dict[str, Detection] = {}
    for place in places:
        if place.region is not None:
            hints = {} if place.last_seen is None else {place.template.name: place.last_seen}
            found |= detect_templates((place.template,), grey, settings, region=place.region, last_seen=hints)
    everywhere = tuple(place.template for place in places if place.region is None)
    if everywhere:
        found |= detect_templates(everywhere, grey, settings)
    return found
