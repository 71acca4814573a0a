"""Depth, colour and camera poses of a ROS 2 recording, as a sequence folder."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from ...core import Camera, InputError, decode_image, read_head
from ..ros import REORDER, McapFile, McapMessage, is_bag, open_bag
from ..ros.ros_image import (
    decode_compressed_depth,
    decode_depth,
    decode_raw,
    image_stamp_ns,
)
from ._bag_survey import COMPRESSED, IMAGE, BagSurvey, PoseAt, TopicImages
from .depth_import import ImportedSequence
from .depth_sequence import DepthFrame
from .depth_sequence_out import write_sequence

_log = logging.getLogger(__name__)

#: One unit of 16UC1 [m], by convention (REP 118).
_UNIT_M = 1e-3


def is_recording(path: Path) -> bool:
    """Whether a path is a recording of ROS messages: MCAP, rosbag2, or a bag of ROS 1.

    Parameters
    ----------
    path
        File or folder.
    """
    return is_bag(path) or (path.is_file() and path.suffix in (".mcap", ".bag", ".part"))


@dataclass(slots=True)
class BagImages:
    """Depth images of a recording with colour and poses: iterates over :class:`DepthFrame`.

    Parameters
    ----------
    path
        MCAP file, ``.db3`` file, or folder of a bag.
    depth_topic, color_topic
        Topics; by default the only depth topic, or the one that is registered to a colour camera, and the
        colour images in the same coordinate frame. Colour of a named topic is taken as registered to the depth.
    camera
        Camera model file, instead of the recorded one.
    poses
        ``auto`` (``tf`` if it moves the camera, else the only topic of poses), ``tf``, a topic, a file of poses, or
        ``none``: all frames have the identity.
    depth_scale_m
        Size of one unit of 16-bit depth [m]; by default 1 mm, or as recorded by Intel's recorder. Of depths in metres, the
        unit in which they are written, by default 0.1 mm, which reaches 6.5 m.

    Raises
    ------
    InputError
        The recording has no depth images, camera or poses, or several to choose from.
    """

    path: Path
    depth_topic: str | None = None
    color_topic: str | None = None
    camera: Camera | None = None
    poses: str = "auto"
    depth_scale_m: float | None = None
    notes: list[str] = field(default_factory=list, init=False)  #: topics that were used
    skipped: list[str] = field(default_factory=list, init=False)  #: one line for each image that was not
    poses_source: str = field(default="", init=False)  #: where the poses come from
    _depth: TopicImages = field(init=False)
    _colour: TopicImages | None = field(init=False)
    _pose_at: PoseAt = field(init=False)

    def __post_init__(self) -> None:
        if self.path.is_file() and read_head(self.path, 13).startswith(b"#ROSBAG V2"):
            raise InputError(
                self.path,
                "is a bag of ROS 1",
                remedy="convert it: pip install rosbags; rosbags-convert --dst-typestore ros2_humble"
                f" --src {self.path} --dst {self.path.stem}",
            )
        survey = BagSurvey(open_bag(self.path))
        depth = survey.named(self.depth_topic, "depth", depth=True) if self.depth_topic else survey.depth()
        colour = (
            survey.named(self.color_topic, "images", depth=False)
            if self.color_topic
            else survey.colour(depth)
        )
        self.notes += [
            f"depth: {depth.topic}",
            f"colour: {colour.topic if colour else 'none registered to the depth'}",
        ]
        if self.camera is None:
            self.camera, topic = survey.camera(depth)
            self.notes.append(f"camera: {topic}")
        self._pose_at, self.poses_source = survey.pose_source(self.poses, depth)
        self.notes.append(f"poses: {self.poses_source}")
        if self.depth_scale_m is None:
            recorded = [
                unit for prefix, unit in survey.unit_m.items() if depth.topic.startswith(f"{prefix}/")
            ]
            self.depth_scale_m = recorded[0] if recorded and depth.encoding == "mono16" else None
        self.skipped += survey.problems
        self._depth, self._colour = depth, colour

    @property
    def unit_m(self) -> float:
        """Size of one unit of the sequence [m]: as given or recorded, or 0.1 mm of depths in metres."""
        return self.depth_scale_m or (1e-4 if self._depth.encoding.startswith("32FC1") else _UNIT_M)

    def __iter__(self) -> Iterator[DepthFrame]:
        """Frames in temporal order."""
        recording = open_bag(self.path)
        assert self.camera is not None
        index = 0
        for depth, colour in self._pairs(recording):
            t_s = image_stamp_ns(depth) * 1e-9
            pose, problem = self._pose_at(t_s)
            if pose is None:
                self._skip(f"image at {t_s:.3f} s: {problem}")
                continue
            try:
                depth_m = self._decoded(recording, depth)
                self.camera.check_size(f"{self.path}:{depth.topic}", depth_m.shape[1], depth_m.shape[0])
            except InputError as error:
                self._skip(str(error))
                continue
            yield DepthFrame(t_s, depth_m, self._painted(recording, colour), pose, self.camera, index)
            index += 1
        if not index:
            raise InputError(self.path, f"no image can be used; the first: {self.skipped[0]}")

    def _skip(self, problem: str) -> None:
        _log.warning("image skipped: %s", problem)
        self.skipped.append(problem)

    def _decoded(self, recording: McapFile, message: McapMessage) -> Float32[np.ndarray, "rows columns"]:
        fields, where = recording.decode(message), f"{self.path}:{message.topic}"
        if message.datatype == COMPRESSED:
            depth_m = decode_compressed_depth(fields, where)
        else:
            depth_m = decode_depth(fields, where)
        if self.depth_scale_m and not self._depth.encoding.startswith("32FC1"):
            depth_m *= np.float32(self.depth_scale_m / _UNIT_M)
        return depth_m

    def _painted(
        self, recording: McapFile, message: McapMessage | None
    ) -> UInt8[np.ndarray, "rows columns 3"] | None:
        if message is None:
            return None
        where = f"{self.path}:{message.topic}"
        assert self.camera is not None
        try:
            fields = recording.decode(message)
            if message.datatype == COMPRESSED:
                image = decode_image(fields.data, where, "any", check_pixels=False)
            else:
                image = decode_raw(fields, where)
            self.camera.check_size(where, image.shape[1], image.shape[0])
        except InputError as error:
            _log.warning("colour skipped: %s", error)
            return None
        return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)

    def _pairs(self, recording: McapFile) -> Iterator[tuple[McapMessage, McapMessage | None]]:
        """Depth messages in temporal order, each with the colour message of its time; messages of equal stamps once."""
        partner = _partners(self._depth.stamps_ns, self._colour.stamps_ns if self._colour else [])
        uses: dict[int, list[int]] = {}
        for stamp, other in partner.items():
            uses.setdefault(other, []).append(stamp)
        depths: dict[int, McapMessage] = {}
        colours: dict[int, McapMessage] = {}
        due = deque(sorted(set(self._depth.stamps_ns)))
        for message in recording.messages({one.topic for one in (self._depth, self._colour) if one}):
            if message.datatype not in (IMAGE, COMPRESSED):
                continue
            stamp = image_stamp_ns(message)
            if message.topic != self._depth.topic:
                colours.update((place, message) for place in uses.get(stamp, ()))
            elif due and stamp >= due[0]:
                depths[stamp] = message
            while depths and (
                (due[0] in depths and (due[0] in colours or due[0] not in partner)) or len(depths) > REORDER
            ):
                place = min(depths)
                yield depths.pop(place), colours.pop(place, None)
                while due and due[0] <= place:
                    due.popleft()
        for place in sorted(depths):
            yield depths[place], colours.get(place)


def _partners(depth_ns: list[int], colour_ns: list[int]) -> dict[int, int]:
    """Stamp of the colour message within half a period of each depth stamp, where there is one."""
    stamps, colours = np.unique(depth_ns), np.unique(colour_ns)
    if not len(colours):
        return {}
    half_ns = float(np.median(np.diff(stamps))) / 2 if len(stamps) > 1 else 0.0
    after = np.clip(np.searchsorted(colours, stamps), 1, max(len(colours) - 1, 1))
    near = colours[np.clip(np.stack([after - 1, after]), 0, len(colours) - 1)]
    best = np.take_along_axis(near, np.abs(near - stamps).argmin(axis=0)[None], axis=0)[0]
    return {int(a): int(b) for a, b in zip(stamps, best, strict=True) if abs(int(a) - int(b)) <= half_ns}


def import_bag(images: BagImages, target: Path | str) -> ImportedSequence:
    """Write the images of a recording as a sequence folder.

    Parameters
    ----------
    images
        Of a recording.
    target
        A new or empty folder.

    Returns
    -------
    ImportedSequence
        What was written and from which topics, and what was skipped and why.

    Raises
    ------
    InputError
        No image can be used, or the folder is not empty.
    """
    count = write_sequence(target, images, depth_scale_m=images.unit_m, poses_source=images.poses_source)
    return ImportedSequence(Path(target), "bag", count, images.skipped, images.notes)
