"""The steps of the page to the first wrench, followed literally: a platform of plain rclpy, and only the page's lines."""

from __future__ import annotations

import array
import itertools
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from tests.patience import PATIENCE_S
from visuohaptic.core.files import encode_image
from visuohaptic.rigs import VirtualSensor
from visuohaptic.simulation.foam import PressShape, press

PAGE = Path(__file__).parents[2] / "docs" / "ros.md"
#: A platform that is none of the page's: another topic and colour.
TOPIC, RATE_HZ = "/front_camera/rgb/image_raw/compressed", 30.0
DOMAIN = 61 + os.getpid() % 40


def lines_of_the_page() -> list[str]:
    section = PAGE.read_text(encoding="utf-8").split("## The first wrench")[1]
    return section.split("```sh\n")[1].split("```")[0].splitlines()


def test_five_lines_are_enough() -> None:
    assert len(lines_of_the_page()) <= 5
    assert sum("visuohaptic ros node" in line for line in lines_of_the_page()) == 1


def test_the_lines_lead_to_a_force(tmp_path: Path) -> None:
    import rclpy.executors
    import rclpy.qos
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import CompressedImage

    virtual, rng = VirtualSensor(), np.random.default_rng(7)
    virtual.build(tmp_path, rng, zero_frames=8)
    samples = list(press(PressShape.CYLINDER_12CM, np.linspace(0.0, 0.004, 12), geometry=virtual.geometry))
    renderer = virtual.renderer()
    at_rest = itertools.cycle([renderer.render(samples[0].scene, rng=rng) for _ in range(30)])
    pressed = [renderer.render(sample.scene, rng=rng) for sample in samples]

    words = shlex.split(next(line for line in lines_of_the_page() if "ros node" in line), comments=True)
    words = [word.replace("/bumper/image/compressed", TOPIC) for word in words]
    assert f"image:={TOPIC}" in words
    environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)}
    node = subprocess.Popen([sys.executable, "-m", *words], cwd=tmp_path, env=environment)
    context = rclpy.Context()
    context.init(domain_id=DOMAIN)
    platform = rclpy.create_node("platform", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(platform)
    forces: dict[int, float] = {}
    try:
        camera = platform.create_publisher(CompressedImage, TOPIC, rclpy.qos.qos_profile_sensor_data)

        def heard(message: WrenchStamped) -> None:
            stamp = message.header.stamp
            forces[round(RATE_HZ * (stamp.sec + 1e-9 * stamp.nanosec))] = message.wrench.force.x

        platform.create_subscription(WrenchStamped, "/foam/wrench", heard, 100)
        numbers, end = itertools.count(100), time.monotonic() + PATIENCE_S

        def answer(grey: np.ndarray) -> float | None:
            """What the node says of an image, which has its own noise each time."""
            number = next(numbers)
            grey = grey.copy()
            grey[0] ^= rng.integers(0, 2, grey.shape[1], np.uint8)
            message = CompressedImage(format="rgb8; jpeg compressed bgr8")
            colour = np.repeat(grey[:, :, None], 3, axis=2)
            message.data = array.array("B", encode_image(colour, "jpg", quality=95, where="frame"))
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(round(number * 1e9 / RATE_HZ), 1_000_000_000)
            camera.publish(message)
            until = time.monotonic() + 0.5
            while number not in forces and time.monotonic() < until:
                executor.spin_once(timeout_sec=0.05)
            assert time.monotonic() < end, "no wrench"
            return forces.get(number)

        while not camera.get_subscription_count():
            assert node.poll() is None
            assert time.monotonic() < end, "the node does not listen"
            executor.spin_once(timeout_sec=0.1)
        # The zero reference is taken while nothing is touched; then something presses.
        while answer(next(at_rest)) is None:
            pass
        measured = []
        for grey in pressed:
            found = None
            while found is None:
                found = answer(grey)
            measured.append(found)
    finally:
        node.send_signal(signal.SIGINT)
        code = node.wait(PATIENCE_S)
        executor.shutdown()
        platform.destroy_node()
        context.try_shutdown()
    assert code == 0
    truth = np.array([sample.force_N for sample in samples])
    deep = truth > 0.3
    # As for compressed images: a cylinder beyond the first millimetre.
    np.testing.assert_allclose(np.array(measured)[deep], truth[deep], rtol=0.03)
