"""First pass over a ROS 2 recording with depth images: topics, stamps, cameras and poses, without pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...core import Camera, InputError, Pose
from ..ros import McapFile, McapMessage, camera_from_message, image_stamp_ns
from .depth_sequence import NO_POSES
from .poses import POSE_TYPES, read_poses, stamped_message
from .transforms import FrameMotion, TransformTree, frame_name

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"

PoseAt = Callable[[float], tuple[Pose | None, str]]


@dataclass(slots=True)
class TopicImages:
    """One image topic."""

    topic: str
    datatype: str
    frame: str
    encoding: str
    size: tuple[int, int]  #: width, height; zero if compressed
    stamps_ns: list[int] = field(default_factory=list)  #: in file order

    @property
    def depth(self) -> bool:
        """Whether it contains depth; ``mono16`` does on Intel's topics only."""
        if self.datatype == COMPRESSED:
            return "compressedDepth" in self.encoding
        return self.encoding in ("16UC1", "32FC1") or (
            self.encoding == "mono16" and "depth" in self.topic.lower()
        )


class BagSurvey:
    """What a recording contains; problems with single messages are collected.

    Parameters
    ----------
    recording
        Read once, as a whole.
    """

    def __init__(self, recording: McapFile) -> None:
        self.recording = recording
        self.images: dict[str, TopicImages] = {}
        self.cameras: dict[str, Any] = {}  #: first CameraInfo of each topic
        self._trees: dict[str, TransformTree] = {}  #: by the namespace of their topics
        self.poses: dict[
            str, tuple[str, FrameMotion]
        ] = {}  #: moved frame, if the messages name it, and its poses
        self.unit_m: dict[str, float] = {}  #: one unit of depth by the topics of Intel's recorder
        self.problems: list[str] = []
        for message in recording.messages():
            try:
                self._take(message)
            except InputError as error:
                self.problems.append(str(error))
        if recording.damage:
            self.problems.append(f"{recording.path}: {recording.damage}")
        for tree in self._trees.values():
            tree.finish()
        for _, motion in self.poses.values():
            motion.finish()

    def _take(self, message: McapMessage) -> None:
        topic, kind = message.topic, message.datatype
        if kind in (IMAGE, COMPRESSED):
            if topic not in self.images:
                self.images[topic] = self._first(message)
            self.images[topic].stamps_ns.append(image_stamp_ns(message))
        elif kind == "sensor_msgs/msg/CameraInfo":
            if topic not in self.cameras:
                self.cameras[topic] = self.recording.decode(message)
        elif kind.endswith("/TFMessage"):
            static = topic.endswith("tf_static")
            tree = self._trees.setdefault(topic.rpartition("/")[0], TransformTree())
            tree.add(self.recording.decode(message), static=static, log_time_ns=message.log_time_ns)
        elif kind in POSE_TYPES:
            fields = self.recording.decode(message)
            child = frame_name(getattr(fields, "child_frame_id", ""))
            motion = self.poses.setdefault(topic, (child, FrameMotion()))[1]
            motion.poses.append(stamped_message(fields, kind, message.log_time_ns))
        elif topic.endswith("/Depth_Units/value"):
            self.unit_m[topic.partition("/option/")[0]] = float(self.recording.decode(message).data)

    def _first(self, message: McapMessage) -> TopicImages:
        fields = self.recording.decode(message)
        frame = frame_name(fields.header.frame_id)
        if message.datatype == COMPRESSED:
            return TopicImages(message.topic, message.datatype, frame, str(fields.format), (0, 0))
        size = int(fields.width), int(fields.height)
        return TopicImages(message.topic, message.datatype, frame, str(fields.encoding), size)

    def named(self, topic: str, what: str, *, depth: bool) -> TopicImages:
        """The images of a topic that the caller names.

        Parameters
        ----------
        topic, what
            Name of the topic, and of its contents for messages.
        depth
            Whether they must be depth images.
        """
        if topic in self.images and (self.images[topic].depth or not depth):
            return self.images[topic]
        there = sorted(name for name, one in self.images.items() if one.depth == depth)
        raise InputError(
            self.recording.path, f"has no {what} on {topic}; {what} topics: {', '.join(there) or 'none'}"
        )

    def depth(self) -> TopicImages:
        """The depth topic, or the one of several that is registered to a colour camera."""
        found = [one for one in self.images.values() if one.depth]
        colours = {one.frame for one in self.images.values() if not one.depth and one.encoding != "mono8"}
        best = [one for one in found if one.frame in colours] or found
        raw = [one for one in best if one.datatype == IMAGE] or best
        if len(raw) == 1:
            return raw[0]
        if found:
            listed = ", ".join(sorted(one.topic for one in found))
            raise InputError(self.recording.path, f"has depth on {listed}", remedy="name one as depth topic")
        listed = ", ".join(sorted(self.images)) or "none"
        raise InputError(self.recording.path, f"has no depth images; image topics: {listed}")

    def colour(self, depth: TopicImages) -> TopicImages | None:
        """The colour topic of the camera that the depth is registered to, if there is one.

        Parameters
        ----------
        depth
            The depth topic.
        """
        found = [
            one
            for one in self.images.values()
            if not one.depth
            and one.frame == depth.frame
            and (one.datatype == COMPRESSED or one.size == depth.size)
        ]
        found.sort(
            key=lambda one: (one.encoding in ("mono8", "mono16"), one.datatype == COMPRESSED, one.topic)
        )
        return found[0] if found else None

    def camera(self, depth: TopicImages) -> tuple[Camera, str]:
        """Camera model beside the depth topic, and its topic.

        Parameters
        ----------
        depth
            The depth topic.
        """
        folder = depth.topic.removesuffix("/compressedDepth").rpartition("/")[0]
        beside = (f"{folder}/camera_info", f"{folder.rpartition('/')[0]}/info/camera_info")
        same = [
            name for name, info in self.cameras.items() if frame_name(info.header.frame_id) == depth.frame
        ]
        for name in (*beside, *(same if len(same) == 1 else ())):
            if name in self.cameras:
                where = f"{self.recording.path}:{name}"
                return camera_from_message(self.cameras[name], where, depth.topic), name
        listed = ", ".join(sorted(self.cameras)) or "none"
        raise InputError(
            self.recording.path,
            f"has no {beside[0]} of {depth.topic}; camera_info topics: {listed}",
            remedy="give the camera as a camera_info YAML file",
        )

    def pose_source(self, poses: str, depth: TopicImages) -> tuple[PoseAt, str]:
        """Poses of the camera as a function of time, from what is named or found, and a name for them.

        Parameters
        ----------
        poses
            ``auto``, ``tf``, ``none``, a topic or a file.
        depth
            The depth topic.
        """
        path = self.recording.path
        if poses == NO_POSES:
            return (lambda t_s: (Pose.identity(), "")), NO_POSES
        tree = self._tree(depth.topic)
        chain = tree.chain(depth.frame)
        if poses == "tf" or (poses == "auto" and tree.moves(chain)):
            if not tree.moves(chain):
                raise InputError(
                    path, f"has no transforms that move {depth.frame!r}, the frame of {depth.topic}"
                )
            return (lambda t_s: tree.pose(chain, t_s)), f"tf, {depth.frame} in {chain[-1]}"
        if poses == "auto":
            if len(self.poses) != 1:
                found = (
                    f"has poses on {', '.join(sorted(self.poses))}" if self.poses else "has no camera poses"
                )
                raise InputError(path, found, remedy="choose poses: a topic, a file, odometry or none")
            poses = next(iter(self.poses))
        if poses not in self.poses:
            if poses.startswith("/") and not Path(poses).is_file():
                listed = ", ".join(sorted(self.poses)) or "none"
                raise InputError(path, f"has no poses on {poses}; topics of poses: {listed}")
            motion = FrameMotion(read_poses(poses)).finish()
            return motion.at, f"file {Path(poses).name}"
        return self._topic_poses(poses, depth)

    def _tree(self, topic: str) -> TransformTree:
        """All transforms; of several robots with the same frames, those in the namespace of a topic."""
        frames = [frame for tree in self._trees.values() for frame in tree.frames]
        if len(frames) == len(set(frames)):
            return TransformTree.joined(self._trees.values())
        own = [space for space in self._trees if topic.startswith(f"{space}/")]
        if not own:
            found = f"has the same frames on {', '.join(f'{space}/tf' for space in sorted(self._trees))}"
            raise InputError(self.recording.path, f"{found}, none in the namespace of {topic}")
        return self._trees[max(own, key=len)]

    def _topic_poses(self, topic: str, depth: TopicImages) -> tuple[PoseAt, str]:
        child, motion = self.poses[topic]
        if child in ("", depth.frame):
            return motion.at, f"topic {topic}, of {child or 'the camera, as no frame is named'}"
        tree = self._tree(depth.topic)
        chain = tree.chain(depth.frame, child)
        if not chain:
            raise InputError(
                self.recording.path,
                f"has poses of {child} on {topic}, and no transform from it to {depth.frame}, the frame of {depth.topic}",
            )

        def at(t_s: float) -> tuple[Pose | None, str]:
            carrier, problem = motion.at(t_s)
            mounted, other = tree.pose(chain, t_s)
            return (None, problem or other) if carrier is None or mounted is None else (carrier @ mounted, "")

        return at, f"topic {topic}, of {child}, with tf to {depth.frame}"
