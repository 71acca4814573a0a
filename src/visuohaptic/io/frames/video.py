"""Video files as a source of frames, with exact timestamps."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int, UInt8

from ...core import MAX_PIXELS, Camera, check_image_size
from ...core.errors import InputError, needs
from ..source import RecordedSource

_log = logging.getLogger(__name__)


def _av() -> Any:
    with needs("av", "recording", "reading video"):
        import av
    return av


class VideoSource(RecordedSource):
    """Frames of a video file.

    The time of a frame is its presentation timestamp times the time base of
    the stream, exact also for variable frame rates. The timestamps are
    read from the packets when the file is opened, without decoding.

    Parameters
    ----------
    path
        The file.
    camera
        Camera model, if known; its size must match the images.
    start_s, stop_s
        Section of the recording, relative to its first frame [s]; ``stop_s`` is exclusive.
    grey
        Whether to decode images as grey.

    Raises
    ------
    InputError
        The file is missing, not a video, truncated before its index, or contains no frames.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        camera: Camera | None = None,
        start_s: float = 0.0,
        stop_s: float = float("inf"),
        grey: bool = False,
    ) -> None:
        self._path = Path(path)
        self._grey = grey
        container, stream = self._open()
        with container:
            width, height = stream.codec_context.width, stream.codec_context.height
            check_image_size(path, width, height)
            stamps = self._stamps(container, stream)
            if not stamps:
                raise InputError(path, "found no frames, expected at least one")
            self._time_base = stream.time_base
        self._stamps_list = stamps
        times = np.array([float(stamp * self._time_base) for stamp in stamps])
        super().__init__(str(path), times, camera=camera, start_s=start_s, stop_s=stop_s)

    def _open(self) -> tuple[Any, Any]:
        av = _av()
        if not self._path.is_file():
            raise InputError(self._path, "is not a file")
        try:
            container = av.open(str(self._path), "r")
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise InputError(
                self._path, f"is not a readable video ({error})", remedy="a truncated MP4 has no index"
            ) from error
        if not container.streams.video:
            container.close()
            raise InputError(self._path, "has no video stream")
        stream = container.streams.video[0]
        if stream.codec_context is None or stream.time_base is None:
            container.close()
            raise InputError(self._path, "its video stream has an unknown codec or no time base")
        # Also limits the decoder: the size in the stream may differ from that in the container.
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        stream.thread_type = "AUTO"
        return container, stream

    def _stamps(self, container: Any, stream: Any) -> list[int]:
        """Presentation timestamps, ascending."""
        av = _av()
        stamps: set[int] = set()
        try:
            for packet in container.demux(stream):
                if packet.pts is not None and packet.size and not packet.is_discard:
                    stamps.add(packet.pts)
        except av.error.FFmpegError as error:
            _log.warning("%s: ends early after %d frames (%s)", self._path, len(stamps), error)
        return sorted(stamps)

    def _images(
        self, chosen: Int[np.ndarray, "k"]
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "rows columns *colour"]]]:
        av = _av()
        positions = {self._stamps_list[place]: position for position, place in enumerate(chosen)}
        last = self._stamps_list[chosen[-1]]
        container, stream = self._open()
        with container:
            form = "gray" if self._grey or "gray" in (stream.codec_context.pix_fmt or "") else "bgr24"
            try:
                for frame in self._from(self._stamps_list[chosen[0]], container, stream, av):
                    position = positions.get(frame.pts)
                    if position is None or frame.is_corrupt:
                        continue
                    yield position, frame.to_ndarray(format=form)
                    if frame.pts == last:
                        return
            except av.error.FFmpegError as error:
                _log.warning("%s: ends early (%s)", self._path, error)

    def _from(self, stamp: int, container: Any, stream: Any, av: Any) -> Iterator[Any]:
        """Decoded frames from the key frame before a stamp on, or an earlier one."""
        if stamp > self._stamps_list[0]:
            container.seek(stamp, stream=stream, backward=True, any_frame=False)
            frames = self._decoded(container, stream, av)
            first = next(frames, None)
            if first is not None and first.pts is not None and first.pts <= stamp:
                yield first
                yield from frames
                return
            # Without an index, as in a transport stream, the place is only estimated.
            container.seek(self._stamps_list[0], stream=stream, backward=True, any_frame=False)
        yield from self._decoded(container, stream, av)

    @staticmethod
    def _decoded(container: Any, stream: Any, av: Any) -> Iterator[Any]:
        """Decoded frames; packets that cannot be decoded are skipped."""
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except ValueError as error:
                # Also av.error.InvalidDataError: a corrupted header may name no codec.
                _log.warning("packet at stamp %s skipped (%s)", packet.pts, error)
                continue
            yield from frames
