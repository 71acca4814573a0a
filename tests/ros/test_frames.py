"""Images over topics become frames with identical pixels."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import DeviceError, FrameSource, InputError, StaleFrameError
from visuohaptic.core.camera import Camera
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros import RosNode, RosPublisher, TopicFrames

from .conftest import until

CAMERA = Camera.simple(64, 48, focal_px=70.0, name="cam")
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


def picture(number: int) -> np.ndarray:
    y, x = np.mgrid[:48, :64]
    return ((x + 2 * y + 10 * number) % 256).astype(np.uint8)


def meet(publisher: RosPublisher, source: TopicFrames, message: dict[str, Any]) -> None:
    """Send until one arrives, then forget what has arrived."""
    assert until(lambda: publisher.publish(message) or source._newest is not None)
    time.sleep(0.05)
    while source._waiting:
        source.read()


@pytest.mark.parametrize("kind", ["raw", "compressed"])
def test_images_arrive(robot: RosNode, ours: RosNode, kind: str) -> None:
    compressed = kind == "compressed"
    topic = "/cam/image" + ("/compressed" if compressed else "")
    publisher = robot.advertise(topic, COMPRESSED if compressed else IMAGE)

    def message(number: int) -> dict[str, Any]:
        t_s = 100.0 + number / 30
        if compressed:
            return messages.compressed_image(t_s, picture(number), "cam", None)
        return messages.image(t_s, picture(number), "cam")

    with TopicFrames(ours, topic, camera=CAMERA, depth=10) as source:
        assert isinstance(source, FrameSource)
        meet(publisher, source, message(0))
        for number in range(1, 6):
            publisher.publish(message(number))
        frames = [frame for _, frame in zip(range(5), source, strict=False)]
    assert [f.t_s for f in frames] == pytest.approx([100.0 + n / 30 for n in range(1, 6)], abs=1e-6)
    for number, frame in enumerate(frames, start=1):
        np.testing.assert_array_equal(frame.image, picture(number))
    assert np.diff([f.index for f in frames]).tolist() == [1, 1, 1, 1]
    assert list(source) == []  # closed


def test_a_slow_reader_gets_the_newest_and_sees_the_gap(robot: RosNode, ours: RosNode) -> None:
    publisher = robot.advertise("/cam/image", IMAGE)
    with TopicFrames(ours, "/cam/image", camera=CAMERA, depth=1) as source:
        meet(publisher, source, messages.image(1.0, picture(0), "cam"))
        publisher.publish(messages.image(2.0, picture(1), "cam"))
        first, before = source.read(), source.left_out
        for number in range(3, 8):
            publisher.publish(messages.image(float(number), picture(number), "cam"))
        assert until(lambda: source._newest[0].message.header.stamp.sec == 7)
        last = source.read()
        assert (last.t_s, last.index - first.index) == (7.0, 5)
        assert source.left_out - before == 4
        with pytest.raises(DeviceError, match=r"no image on /cam/image for 0.05 s"):
            source.read(0.05)


def test_the_newest_frame_has_an_age(robot: RosNode, ours: RosNode) -> None:
    publisher = robot.advertise("/cam/image", IMAGE)
    with TopicFrames(ours, "/cam/image", camera=CAMERA) as source:
        with pytest.raises(StaleFrameError, match="no image yet"):
            source.read_latest()
        # A stamp of zero means that the driver has no clock: the time of sending counts.
        before_s = time.time()
        meet(publisher, source, messages.image(0.0, picture(0), "cam"))
        publisher.publish(messages.image(0.0, picture(0), "cam"))
        assert before_s <= source.read_latest(60_000).t_s <= time.time()
        publisher.publish(messages.image(1000.0, picture(0), "cam"))
        assert until(lambda: source._newest[0].message.header.stamp.sec == 1000)
        with pytest.raises(StaleFrameError, match="ms old"):
            source.read_latest()
        # The clock of the camera's machine is an hour ahead: what came long ago is old nevertheless.
        publisher.publish(messages.image(time.time() + 3600.0, picture(0), "cam"))
        assert until(lambda: source._newest[0].message.header.stamp.sec > before_s)
        assert source.read_latest(60_000).t_s > before_s + 3000.0
        time.sleep(0.05)
        with pytest.raises(StaleFrameError, match="ms old, the limit is 20 ms"):
            source.read_latest(20)


def test_the_camera_comes_beside_the_image(robot: RosNode, ours: RosNode) -> None:
    with TopicFrames(ours, "/cam/image/compressed") as source:
        assert source.camera is None
        publisher = robot.advertise("/cam/camera_info", "sensor_msgs/msg/CameraInfo")
        message = messages.camera_info(1.0, CAMERA, "cam")
        assert until(lambda: publisher.publish(message) or source.camera is not None)
        found = source.camera
    assert found is not None
    np.testing.assert_array_equal(found.matrix, CAMERA.matrix)
    assert (found.width, found.height, found.name) == (64, 48, "cam")


def test_a_sender_that_starts_again_goes_on_counting(robot: RosNode, ours: RosNode) -> None:
    with TopicFrames(ours, "/cam/image", camera=CAMERA, depth=50) as source:
        indices = []
        for _ in range(2):
            publisher = robot.advertise("/cam/image", IMAGE)
            seen = source._last
            message = messages.image(1.0, picture(0), "cam")
            assert until(lambda p=publisher, m=message, s=seen: p.publish(m) or source._last > s)
            indices.append(source.read().index)
        assert indices == sorted(indices)


def test_damaged_images_are_left_out_and_others_refused(robot: RosNode, ours: RosNode) -> None:
    publisher = robot.advertise("/cam/image/compressed", COMPRESSED)
    with TopicFrames(ours, "/cam/image/compressed", camera=CAMERA, depth=5) as source:
        good = messages.compressed_image(1.0, picture(0), "cam", None)
        meet(publisher, source, good)
        publisher.publish(good | {"data": good["data"][:100]})
        publisher.publish(good)
        assert source.read().image.shape == (48, 64)
        assert source.damaged == 1
        # Among those of the camera an image of another size is somebody else's, or broken ...
        small = messages.compressed_image(1.0, np.zeros((10, 10), np.uint8), "cam", None)
        publisher.publish(small)
        publisher.publish(good)
        assert source.read().image.shape == (48, 64)
        assert source.damaged == 2
    with TopicFrames(ours, "/cam/image/compressed", camera=CAMERA, depth=5) as source:
        # ... as the first one it says that the model of the camera is wrong; what is sent before both have met is lost.
        assert until(lambda: publisher.publish(small) or "10 x 10, expected 64 x 48" in refusal(source))


def refusal(source: TopicFrames) -> str:
    """Why an image is refused; nothing as long as none comes."""
    with contextlib.suppress(DeviceError):
        try:
            source.read(0.1)
        except InputError as error:
            return str(error)
    return ""
