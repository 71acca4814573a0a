"""Camera images to wrenches on a topic, over DDS: latency, loss, and robustness of a node.

    python -m benchmarks.ros_latency --seconds 30               30 Hz of 1600 x 896 images to the node foam
    python -m benchmarks.ros_latency --kill 100 --malformed 2000    and cameras that are killed, and malformed messages

A node is a separate process (``visuohaptic ros node foam``); images are rendered in advance. Latency is the time
from passing an image to DDS until its wrench is received, and thus includes two transfers over DDS.
The load of the machine is reported, too.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.rigs import VirtualSensor
from visuohaptic.ros.transports import RclpyNode, RosOptions, TopicNode, interface
from visuohaptic.ros.wire import Qos
from visuohaptic.ros.wire.cdr import encode
from visuohaptic.ros.wire.message_types import message_type
from visuohaptic.simulation.foam import PressShape, press

TOPIC, WRENCH, KIND = "/bumper/image", "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/Image"
RATE_HZ = 30.0
PATIENCE_S = 60.0
#: Images that wait in the node.
QUEUE = 10

#: A camera that publishes until it is killed, and receives the resulting wrenches.
_PEER = """
import sys, time, numpy as np
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros.transports import RclpyNode, RosOptions
node = RclpyNode("peer", RosOptions(domain=int(sys.argv[1])))
node.subscribe("/foam/wrench", "geometry_msgs/msg/WrenchStamped", lambda received: None)
camera = node.advertise(sys.argv[2], "sensor_msgs/msg/Image")
camera.wait_until_heard(30.0)
print("heard", flush=True)
while True:
    camera.publish(messages.image(time.time(), np.full((896, 1600), 90, np.uint8), "bumper"))
    time.sleep(0.02)
"""


def pictures(folder: Path, count: int) -> list[np.ndarray]:
    """A calibrated sensor in files, and rendered images of a press."""
    virtual, rng = VirtualSensor(), np.random.default_rng(2)
    virtual.build(folder, rng, zero_frames=8)
    samples = press(PressShape.CYLINDER_12CM, np.linspace(0.0, 0.005, count), geometry=virtual.geometry)
    renderer = virtual.renderer()
    return [renderer.render(sample.scene, rng=rng) for sample in samples]


class Node:
    """The node foam in a process of its own."""

    def __init__(self, folder: Path, domain: int) -> None:
        words = [f"config:={folder / 'sensor.yaml'}", f"image:={TOPIC}", f"queue:={QUEUE}"]
        command = [sys.executable, "-m", "visuohaptic", "ros", "node", "foam", "--domain", str(domain)]
        command += [word for one in words for word in ("--param", one)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def use(self) -> dict[str, float]:
        """Memory (that which it shares with its cameras apart), handles and threads now, and CPU time so far (Linux)."""
        place = Path(f"/proc/{self.process.pid}")
        status = dict(line.split(":", 1) for line in (place / "status").read_text().splitlines())
        spent = (place / "stat").read_text().rpartition(")")[2].split()[11:13]  # user and system
        return {
            "memory_MB": int(status["VmRSS"].split()[0]) / 1000,
            "shared_MB": int(status["RssShmem"].split()[0]) / 1000,
            "handles": len(list((place / "fd").iterdir())),
            "threads": int(status["Threads"]),
            "cpu_s": sum(map(int, spent)) / os.sysconf("SC_CLK_TCK"),
        }

    def alive(self) -> bool:
        """Whether it still runs."""
        return self.process.poll() is None

    def end(self) -> int:
        """Ctrl-C; its exit code."""
        self.process.terminate()
        _, said = self.process.communicate(timeout=PATIENCE_S)
        if self.process.returncode:
            sys.stderr.write(said)
        return self.process.returncode


@dataclass(frozen=True, slots=True)
class Answer:
    """A received wrench."""

    at_s: float
    valid: bool


class Heard:
    """Wrenches by the stamp of their image, until they are taken."""

    def __init__(self, node: TopicNode) -> None:
        self._answers: dict[int, Answer] = {}
        node.subscribe("/foam/wrench", WRENCH, self._hear, Qos(depth=100))

    def _hear(self, received: Any) -> None:
        stamp, force_N = received.message.header.stamp, received.message.wrench.force.x
        self._answers[stamp.sec * 1_000_000_000 + stamp.nanosec] = Answer(
            time.perf_counter(), bool(np.isfinite(force_N))
        )

    def take(self, stamp_ns: int) -> Answer | None:
        """The wrench of an image; older ones are discarded, also those of other cameras and of start-up."""
        for old in [stamp for stamp in list(self._answers) if stamp < stamp_ns]:
            del self._answers[old]
        return self._answers.pop(stamp_ns, None)

    def wait(self, count: int, timeout_s: float) -> bool:
        """Whether this number has arrived in time."""
        end = time.monotonic() + timeout_s
        while len(self._answers) < count and time.monotonic() < end:
            time.sleep(0.01)
        return len(self._answers) >= count


def latency(node: TopicNode, heard: Heard, images: list[np.ndarray], seconds: float) -> dict[str, Any]:
    """Publish at 30 Hz and wait for the wrenches."""
    camera = node.advertise(TOPIC, KIND, Qos(reliable=False, depth=5))
    heard.wait(1, PATIENCE_S)  # stale: it runs
    camera.wait_until_heard(PATIENCE_S)
    raw = [messages.image(0.0, image, "bumper") for image in images]
    # Forwards and backwards, as a hand that presses; the first second is for discovery and is not counted.
    order = [*range(len(raw)), *range(len(raw) - 2, 0, -1)]
    sent: dict[int, float] = {}
    begin = time.perf_counter()
    for number in range(int((seconds + 1.0) * RATE_HZ)):
        time.sleep(max(0.0, begin + number / RATE_HZ - time.perf_counter()))
        now_s = time.time()
        message = raw[order[number % len(order)]] | {"header": messages.header(now_s, "bumper")}
        at_s = time.perf_counter()
        camera.publish(message)
        if number >= RATE_HZ:
            sent[messages.stamp_ns(now_s)] = at_s
    time.sleep(2.0)
    delays_ms = np.array(
        [1e3 * (found.at_s - at) for stamp, at in sent.items() if (found := heard.take(stamp)) is not None]
    )
    return {
        "sent": len(sent),
        "lost": len(sent) - len(delays_ms),
        "median_ms": round(float(np.median(delays_ms)), 1),
        "p99_ms": round(float(np.quantile(delays_ms, 0.99)), 1),
        "load": os.getloadavg()[0],
    }


class Malformed:
    """Sends invalid messages on the image topic: truncated, corrupted, or too long."""

    def __init__(self, node: RclpyNode) -> None:
        self._rng = np.random.default_rng(4)
        self._publisher = node.inner.create_publisher(interface(KIND), TOPIC, 10)
        self._good = encode(messages.image(1.0, np.zeros((9, 16), np.uint8), "bumper"), message_type(KIND))
        while not self._publisher.get_subscription_count():
            time.sleep(0.05)

    def send(self) -> None:
        """One more."""
        rng, data = self._rng, np.frombuffer(self._good, np.uint8).copy()
        places = rng.integers(4, len(data), rng.integers(1, 8))
        data[places] = rng.integers(0, 256, len(places))
        self._publisher.publish(data.tobytes()[: rng.integers(4, len(data) + 1)])


def kill_a_peer(domain: int) -> None:
    """Start a camera, and kill it while it publishes."""
    command = [sys.executable, "-c", _PEER, str(domain), TOPIC]
    peer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert peer.stdout is not None
    peer.stdout.readline()
    time.sleep(0.1)
    peer.kill()
    peer.communicate()


def main() -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of images at 30 Hz")
    parser.add_argument("--kill", type=int, default=0, metavar="N", help="peers that are killed")
    parser.add_argument("--malformed", type=int, default=0, metavar="N", help="messages that are none")
    parser.add_argument("--domain", type=int, default=100)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        images = pictures(Path(folder), 30)
        node = Node(Path(folder), args.domain)
        with RclpyNode("camera", RosOptions(domain=args.domain)) as camera:
            heard = Heard(camera)
            result: dict[str, Any] = {"latency": latency(camera, heard, images, args.seconds)}
            before = node.use()
            if args.malformed:
                spoil = Malformed(camera)
                for _ in range(args.malformed):
                    spoil.send()
                    time.sleep(0.002)
            killed = 0
            while killed < args.kill and node.alive():
                kill_a_peer(args.domain)
                killed += 1
            result |= {"malformed": args.malformed, "killed": killed}
            result["alive"] = node.alive()
            result["use"] = {name: [before[name], after] for name, after in node.use().items()}
            result["after"] = latency(camera, heard, images, 5.0)
        result["exit_code"] = node.end()
    print(json.dumps(result, indent=1))
    return 0 if result["alive"] and result["exit_code"] == 0 else 1


if __name__ == "__main__":
    raise SystemExit(main())
