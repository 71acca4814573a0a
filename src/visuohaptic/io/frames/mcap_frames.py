"""MCAP files with ROS 2 images as a source of frames."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8

from ...core import Camera, ImageMode, InputError, decode_image
from ..ros import REORDER, McapDamage, McapMessage, camera_from_message, decode_raw, image_stamp_ns, open_bag
from ..source import RecordedSource

_log = logging.getLogger(__name__)

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


@dataclass(frozen=True, slots=True)
class _Scan:
    """Result of the first pass over the file."""

    topic: str
    stamps_ns: list[int]  #: of every image in file order
    camera: Camera | None
    damage: McapDamage


class McapSource(RecordedSource):
    """Frames of one image topic of an MCAP file.

    The time of a frame is the timestamp in its header, or the recording time if
    that is zero. From a truncated or damaged file, all intact images are read;
    ``damage`` describes the rest. A ``CameraInfo`` in the namespace of the image topic is used as
    camera unless one is given.

    Parameters
    ----------
    path
        The file.
    topic
        Image topic; may be omitted if there is only one.
    camera
        Camera model, instead of the recorded one.
    start_s, stop_s
        Section of the recording, relative to its first frame [s]; ``stop_s`` is exclusive.
    grey
        Whether to convert colour images to grey.

    Raises
    ------
    InputError
        The file is not MCAP, or has no such image topic.
    """

    def __init__(
        self,
        path: Path | str,
        topic: str | None = None,
        *,
        camera: Camera | None = None,
        start_s: float = 0.0,
        stop_s: float = float("inf"),
        grey: bool = False,
    ) -> None:
        self._file = open_bag(path)
        self._grey = grey
        scan = self._scan(topic)
        self.topic = scan.topic
        self.damage = scan.damage
        stamps = np.array(scan.stamps_ns, dtype=np.int64)
        order = np.argsort(stamps, kind="stable")
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        self._rank = rank  #: temporal order of every image of the file
        super().__init__(
            f"{path}:{scan.topic}",
            stamps[order] * 1e-9,
            camera=camera or scan.camera,
            start_s=start_s,
            stop_s=stop_s,
        )

    def _scan(self, topic: str | None) -> _Scan:
        stamps: dict[str, list[int]] = {}
        others: set[str] = set()
        infos: dict[str, McapMessage] = {}
        for message in self._file.messages():
            if message.datatype in (_IMAGE, _COMPRESSED):
                stamps.setdefault(message.topic, []).append(image_stamp_ns(message))
            else:
                others.add(message.topic)
                if message.datatype == "sensor_msgs/msg/CameraInfo":
                    infos.setdefault(message.topic, message)
        path, found = self._file.path, sorted(stamps)
        if topic is None:
            if len(found) != 1:
                listed = ", ".join(found or sorted(others)) or "none"
                kind = "image topics" if found else "no image topic; topics are"
                raise InputError(
                    path,
                    f"has {len(found) or ''} {kind} {listed}, expected exactly one image topic",
                    remedy=f"name one as {path}:/topic" if found else "",
                )
            topic = found[0]
        elif topic not in stamps:
            raise InputError(
                path, f"has no images on {topic!r}; image topics: {', '.join(found) or 'none'}", field=topic
            )
        return _Scan(topic, stamps[topic], self._camera_beside(topic, infos), self._file.damage)

    def _camera_beside(self, topic: str, infos: dict[str, McapMessage]) -> Camera | None:
        """By ROS convention, ``camera_info`` is in the same namespace as the image."""
        name = topic.removesuffix("/compressed").rpartition("/")[0] + "/camera_info"
        if name not in infos:
            return None
        try:
            return camera_from_message(self._file.decode(infos[name]), f"{self._file.path}:{name}", topic)
        except InputError as error:
            _log.warning("camera model ignored: %s", error)
            return None

    def _images(
        self, chosen: Int[np.ndarray, "k"]
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "rows columns *colour"]]]:
        positions = {int(place): position for position, place in enumerate(chosen)}
        waiting: dict[int, McapMessage] = {}
        expected = 0
        count = 0
        for message in self._file.messages({self.topic}):
            if message.datatype not in (_IMAGE, _COMPRESSED) or count >= len(self._rank):
                continue
            position = positions.get(int(self._rank[count]))
            count += 1
            if position is None:
                continue
            waiting[position] = message
            while waiting and (expected in waiting or len(waiting) > REORDER):
                place = min(waiting)
                yield from self._decoded(place, waiting.pop(place))
                expected = place + 1
            if expected >= len(positions):
                return
        for place in sorted(waiting):
            yield from self._decoded(place, waiting[place])

    def _decoded(self, position: int, message: McapMessage) -> Iterator[tuple[int, UInt8[np.ndarray, "..."]]]:
        try:
            fields = self._file.decode(message)
            if message.datatype == _IMAGE:
                image = decode_raw(fields, self._where)
                if self._grey and image.ndim == 3:
                    import cv2

                    image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            else:
                mode: ImageMode = "grey" if self._grey else "any"
                image = decode_image(fields.data, self._where, mode, check_pixels=False)
        except InputError as error:
            if error.field == "encoding":  # affects all frames of the topic
                raise
            _log.warning("frame skipped: %s", error)
            return
        yield position, image
