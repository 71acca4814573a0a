"""One contract for all transports: what a node promises is the same over zenoh, over ROS 2 itself and over Cyclone DDS.

Those whose library is not installed are skipped; the pairs of two different ones show that they speak one language.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from tests.patience import PATIENCE_S
from visuohaptic.core import DeviceError, InputError
from visuohaptic.io.ros import ros_messages as messages
from visuohaptic.ros import Received, RosBase, RosSink, TopicFrames, TopicNode
from visuohaptic.ros.transports import RosOptions, open_node
from visuohaptic.ros.wire import EntityKind, Qos, message_type

from .conftest import free_endpoint, until

STRING = "std_msgs/msg/String"
LIBRARIES = {"zenoh": "zenoh", "rclpy": "rclpy", "cyclonedds": "cyclonedds"}
#: A domain of this process alone (0 to 232; the ports of 102 to 215 may meet those that Linux hands out).
DOMAIN = 1 + os.getpid() % 100

PAIRS = [(name, name) for name in LIBRARIES] + [("rclpy", "cyclonedds"), ("cyclonedds", "rclpy")]


def needs(transport: str) -> Any:
    library = LIBRARIES[transport]
    absent = importlib.util.find_spec(library) is None
    return pytest.mark.skipif(absent, reason=f"{library} is not installed")


def pair(one: str, other: str) -> Any:
    return pytest.param((one, other), id=f"{one}-{other}", marks=[needs(one), needs(other)])


class Pair:
    """Two nodes that meet, and more of the same kinds."""

    def __init__(self, transports: tuple[str, str]) -> None:
        self._transports = transports
        self._places = (free_endpoint(), free_endpoint())
        self._nodes: list[TopicNode] = []
        self.one, self.other = self.join("one", 0), self.join("other", 1)

    def join(self, name: str, side: int, **more: Any) -> TopicNode:
        first = not self._nodes
        listen = (self._places[0],) if first else ()
        connect = () if first else (self._places[0],)
        options = RosOptions(**({"domain": DOMAIN, "connect": connect, "listen": listen} | more))
        self._nodes.append(open_node(name, options, self._transports[side]))
        return self._nodes[-1]

    def close(self) -> None:
        for node in self._nodes:
            node.close()


@pytest.fixture(params=[pair(*names) for names in PAIRS])
def nodes(request: pytest.FixtureRequest) -> Iterator[Pair]:
    both = Pair(request.param)
    yield both
    both.close()


@pytest.fixture(params=[pair(name, name) for name in LIBRARIES])
def same(request: pytest.FixtureRequest) -> Iterator[Pair]:
    """Both nodes on one transport."""
    both = Pair(request.param)
    yield both
    both.close()


def meet(publish: Callable[[], None], arrived: Callable[[], object]) -> None:
    """What is sent before two have met is lost, as in ROS."""

    def again() -> object:
        publish()
        time.sleep(0.02)
        return arrived()

    assert until(again, PATIENCE_S)


def test_messages_arrive_in_order_with_their_numbers(nodes: Pair) -> None:
    got: list[Received] = []
    subscription = nodes.other.subscribe("chatter", STRING, got.append, Qos(depth=100))
    publisher = nodes.one.advertise("/chatter", STRING, Qos(depth=100), wait=True)
    meet(lambda: publisher.publish({"data": "first"}), lambda: got)
    before_ns = time.time_ns()
    for number in range(50):
        publisher.publish({"data": f"Größe {number}"})
    assert until(lambda: got[-1].message.data == "Größe 49", PATIENCE_S)
    assert [r.message.data for r in got if r.message.data != "first"] == [f"Größe {n}" for n in range(50)]
    numbers = [r.attachment.sequence for r in got if r.attachment]
    assert len(numbers) == len(got)
    assert all(after == before + 1 for before, after in itertools.pairwise(numbers))
    assert all(before_ns <= r.attachment.source_ns <= time.time_ns() for r in got[-50:] if r.attachment)
    assert (subscription.received, subscription.damaged) == (len(got), 0)
    assert publisher.heard


@pytest.mark.parametrize("datatype", ["geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/PointCloud2"])
def test_every_value_arrives(nodes: Pair, datatype: str) -> None:
    """Of nested messages, arrays, sequences of messages and of bytes; NaN stays NaN."""
    points = [{"name": "x", "offset": 0, "datatype": 8, "count": 1}]
    cloud = {"height": 1, "width": 2, "fields": points, "is_bigendian": False, "point_step": 8, "row_step": 16,
             "data": np.array([1.5, np.nan]).tobytes(), "is_dense": False}  # fmt: skip
    wrench = {"force": {"x": np.nan, "y": -1.0, "z": 0.1}, "torque": {"x": 1e-300, "y": 2.0, "z": 3.0}}
    message = {"header": messages.header(12.25, "foam_frame")}
    message |= cloud if datatype.endswith("2") else {"wrench": wrench}
    got: list[Received] = []
    nodes.other.subscribe("things", datatype, got.append)
    publisher = nodes.one.advertise("things", datatype)
    meet(lambda: publisher.publish(message), lambda: got)
    header = got[0].message.header
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (12, 250_000_000, "foam_frame")
    if datatype.endswith("2"):
        assert np.frombuffer(bytes(got[0].message.data)).tolist()[0] == pytest.approx(1.5)
        assert got[0].message.fields[0].name == "x"
    else:
        force = got[0].message.wrench.force
        assert np.isnan(force.x)
        assert (force.y, force.z, got[0].message.wrench.torque.x) == pytest.approx((-1.0, 0.1, 1e-300), abs=0)


def test_who_comes_late_gets_what_is_latched(nodes: Pair) -> None:
    latched = Qos(latched=True, depth=1)
    publisher = nodes.one.advertise("/map_name", STRING, latched)
    for name in ("old", "new"):
        publisher.publish({"data": name})
    got: list[str] = []
    nodes.other.subscribe("/map_name", STRING, lambda r: got.append(r.message.data), latched)
    assert until(lambda: got, PATIENCE_S)
    assert got == ["new"]
    publisher.publish({"data": "newer"})
    assert until(lambda: got[-1] == "newer", PATIENCE_S)


def test_each_sees_the_other_until_it_leaves(same: Pair) -> None:
    same.one.advertise("odom", "nav_msgs/msg/Odometry", Qos(reliable=False, depth=5))
    same.other.subscribe("~/scan", "sensor_msgs/msg/LaserScan", lambda _: None)

    def seen() -> dict[Any, Any]:
        return {(e.node, e.kind, e.topic): e for e in same.other.graph(0.3)}

    odom, scan = ("one", EntityKind.PUBLISHER, "/odom"), ("other", EntityKind.SUBSCRIPTION, "/other/scan")
    assert until(lambda: {odom, scan} <= seen().keys(), PATIENCE_S), seen().keys()
    found = seen()[odom]
    assert found.datatype == "nav_msgs/msg/Odometry"
    assert found.type_hash == message_type("nav_msgs/msg/Odometry").type_hash()
    assert not found.qos.reliable
    same.one.close()
    same.one.close()
    assert until(lambda: {node for node, kind, _ in seen() if kind == "NN"} == {"other"}, PATIENCE_S)
    with pytest.raises(DeviceError, match="closed"):
        same.one.advertise("late", STRING)


def test_a_closed_subscription_leaves_the_graph_and_the_node(same: Pair) -> None:
    def listens() -> bool:
        found = {(entity.kind, entity.topic) for entity in same.one.graph()}
        return (EntityKind.SUBSCRIPTION, "/chatter") in found

    publisher, held = same.one.advertise("chatter", STRING), len(same.other._closing)
    for _ in range(2):
        subscription = same.other.subscribe("chatter", STRING, lambda received: None)
        assert until(lambda: publisher.heard and listens(), PATIENCE_S)
        subscription.close()
        subscription.close()
        assert until(lambda: not publisher.heard and not listens(), PATIENCE_S)
    assert len(same.other._closing) == held


def test_other_domains_and_topics_are_not_heard(same: Pair) -> None:
    got: list[Received] = []
    met: list[Received] = []
    far = same.join("far", 1, domain=DOMAIN + 1)
    far.subscribe("a", STRING, got.append)
    same.other.subscribe("b", STRING, got.append)
    same.other.subscribe("a", STRING, met.append)
    publisher = same.one.advertise("a", STRING)
    meet(lambda: publisher.publish({"data": ""}), lambda: len(met) > 10)
    assert got == []


def test_the_given_domain_precedes_that_of_the_environment(
    same: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also domain 0."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN + 2))
    assert [same.join(f"in{n}", 1, domain=n).domain for n in (0, DOMAIN)] == [0, DOMAIN]
    assert same.join("environment", 1, domain=None).domain == DOMAIN + 2


def test_namespaces(same: Pair) -> None:
    arm = same.join("arm", 1, namespace="/robot1")
    assert arm.resolve("wrench") == "/robot1/wrench"
    assert arm.resolve("~/wrench") == "/robot1/arm/wrench"
    assert until(lambda: any(e.namespace == "/robot1" for e in same.one.graph(0.3)), PATIENCE_S)


def test_a_closed_node_says_so(same: Pair) -> None:
    publisher = same.one.advertise("a", STRING)
    same.one.close()
    with pytest.raises(DeviceError, match="cannot be published"):
        publisher.publish({"data": ""})
    with pytest.raises(DeviceError, match=r"no subscriber|is closed"):
        publisher.wait_until_heard(0.05)


def test_a_message_of_other_fields_is_refused(same: Pair) -> None:
    with pytest.raises(InputError, match="data"):
        same.one.advertise("a", STRING).publish({"text": ""})


def test_images_become_frames(nodes: Pair) -> None:
    """640 x 480: larger raw images over best effort are a matter of the system's buffers, see the documentation."""
    picture = np.random.default_rng(2).integers(0, 255, (480, 640), dtype=np.uint8)
    with TopicFrames(nodes.other, "/camera/image", depth=1) as frames:
        camera = nodes.one.advertise("/camera/image", "sensor_msgs/msg/Image", Qos(reliable=False, depth=5))
        stamped = messages.image(3.5, picture, "camera")

        def arrived() -> bool:
            try:
                return np.array_equal(frames.read(0.05).image, picture)
            except DeviceError:
                return False

        meet(lambda: camera.publish(stamped), arrived)


def test_a_platform_is_driven_and_a_map_is_served(same: Pair) -> None:
    """The adapters know nothing of the transport."""
    heard: list[Received] = []
    same.one.subscribe("cmd_vel", "geometry_msgs/msg/Twist", heard.append)
    odometry = same.one.advertise("odom", "nav_msgs/msg/Odometry")
    pose = {
        "position": {"x": 1.0, "y": 2.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    state = {"header": messages.header(5.0, "odom"), "child_frame_id": "base_link",
             "pose": {"pose": pose, "covariance": [0.0] * 36},
             "twist": {"twist": {"linear": zero, "angular": zero}, "covariance": [0.0] * 36}}  # fmt: skip
    with RosBase(same.other, max_age_s=5.0) as base:

        def known() -> bool:
            try:
                return base.state().x_m == pytest.approx(1.0)
            except DeviceError:
                return False

        meet(lambda: odometry.publish(state), known)
        assert until(lambda: base._publisher.heard, PATIENCE_S)
        base.drive(0.25, -0.5)
        assert until(lambda: heard and heard[-1].message.linear.x == pytest.approx(0.25), PATIENCE_S)
    assert until(lambda: heard[-1].message.linear.x == pytest.approx(0.0), PATIENCE_S)
    RosSink(same.one).write("/name", STRING, 0.0, {"data": "kitchen"})
