"""Two nodes on this machine: what one publishes the other receives, and each sees the other."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from visuohaptic.core import DeviceError, InputError
from visuohaptic.ros import Received, RosNode, RosOptions
from visuohaptic.ros.transports import CycloneNode, cyclone_node
from visuohaptic.ros.wire import NO_HASH, Attachment, EntityKind, Qos, message_type
from visuohaptic.ros.wire.graph import to_dds

from .conftest import free_endpoint, until

STRING = "std_msgs/msg/String"


def test_messages_arrive_in_order_with_their_numbers(robot: RosNode, ours: RosNode) -> None:
    got: list[Received] = []
    subscription = ours.subscribe("chatter", STRING, got.append)
    publisher = robot.advertise("/chatter", STRING, wait=True)
    # What is sent before the two have met is lost, as in ROS.
    assert until(lambda: publisher.publish({"data": "first"}) or got)
    begin = len(got)
    before_ns = time.time_ns()
    for number in range(50):
        publisher.publish({"data": f"Größe {number}"})
    assert until(lambda: any(r.message.data == "Größe 49" for r in got))
    texts = [r.message.data for r in got if r.message.data != "first"]
    assert texts == [f"Größe {number}" for number in range(50)]
    numbers = [r.attachment.sequence for r in got[begin:] if r.attachment]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len({r.attachment.gid for r in got if r.attachment}) == 1
    assert all(before_ns <= r.attachment.source_ns <= time.time_ns() for r in got[-50:] if r.attachment)
    assert subscription.received == len(got)
    assert subscription.damaged == 0


def test_each_sees_the_other_until_it_leaves(ours: RosNode, robot: RosNode) -> None:
    robot.advertise("odom", "nav_msgs/msg/Odometry", Qos(reliable=False, depth=5))
    ours.subscribe("~/scan", "sensor_msgs/msg/LaserScan", lambda _: None)
    assert until(lambda: len(ours.graph()) == 4)
    found = {(e.node, e.kind): e for e in ours.graph()}
    odometry = found["robot", EntityKind.PUBLISHER]
    assert (odometry.topic, odometry.datatype) == ("/odom", "nav_msgs/msg/Odometry")
    assert odometry.type_hash == message_type("nav_msgs/msg/Odometry").type_hash()
    assert odometry.qos == Qos(reliable=False, depth=5)
    assert found["ours", EntityKind.SUBSCRIPTION].topic == "/ours/scan"
    robot.close()
    robot.close()
    assert until(lambda: {e.node for e in ours.graph()} == {"ours"})
    with pytest.raises(DeviceError, match="closed"):
        robot.advertise("late", STRING)


def test_late_subscribers_get_what_is_latched(robot: RosNode, ours: RosNode) -> None:
    latched = Qos(latched=True, depth=1)
    publisher = robot.advertise("/map_name", STRING, latched)
    for name in ("old", "new"):
        publisher.publish({"data": name})
    got: list[str] = []
    ours.subscribe("/map_name", STRING, lambda r: got.append(r.message.data), latched)
    assert until(lambda: got)
    assert got == ["new"]
    publisher.publish({"data": "newer"})
    assert until(lambda: got[-1] == "newer")


@pytest.mark.parametrize("case", ["domain", "type", "topic", "hash"])
def test_what_differs_does_not_meet(robot: RosNode, endpoint: str, case: str) -> None:
    options = RosOptions(
        domain=int(case == "domain"), type_hashes=case != "hash", connect=(endpoint,), listen=()
    )
    got: list[Received] = []
    met = threading.Event()
    with RosNode("other", options) as other:
        datatype = "sensor_msgs/msg/JointState" if case == "type" else STRING
        other.subscribe("b" if case == "topic" else "a", datatype, got.append)
        control = RosNode("control", RosOptions(connect=(endpoint,), listen=()))
        with control:
            control.subscribe("a", STRING, lambda _: met.set())
            publisher = robot.advertise("a", STRING)
            assert until(lambda: publisher.publish({"data": ""}) or met.is_set())
            publisher.publish({"data": ""})
            time.sleep(0.05)
    assert got == []


def test_humble_has_no_hashes() -> None:
    endpoint = free_endpoint()
    got: list[Received] = []
    with (
        RosNode("a", RosOptions(type_hashes=False, connect=(), listen=(endpoint,))) as a,
        RosNode("b", RosOptions(type_hashes=False, connect=(endpoint,), listen=())) as b,
    ):
        b.subscribe("chatter", STRING, got.append)
        publisher = a.advertise("chatter", STRING)
        assert next(e for e in b.graph() if e.topic).type_hash == NO_HASH == "TypeHashNotSupported"
        assert until(lambda: publisher.publish({"data": ""}) or got)


def test_namespaces(endpoint: str, robot: RosNode) -> None:
    with RosNode("arm", RosOptions(namespace="/robot1", connect=(endpoint,), listen=())) as node:
        assert node.resolve("wrench") == "/robot1/wrench"
        assert node.resolve("~/wrench") == "/robot1/arm/wrench"
        assert until(lambda: any(e.namespace == "/robot1" for e in robot.graph()))


def test_bytes_that_are_no_message_are_counted(robot: RosNode, ours: RosNode) -> None:
    """A foreign sender: no attachment, a wrong one, bytes that are cut."""
    got: list[Received] = []
    subscription = ours.subscribe("chatter", STRING, got.append)
    kind = message_type(STRING)
    key = f"0/chatter/{to_dds(kind.name)}/{kind.type_hash()}"
    good = b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00"
    put = robot._session.put
    assert until(lambda: put(key, good) or got)
    assert got[0].attachment is None
    put(key, good, attachment=b"junk")
    put(key, good[:-2])
    put(key, b"")
    assert until(lambda: subscription.damaged == 3)
    put(key, good, attachment=Attachment(7, 8, bytes(16)).pack())
    assert until(lambda: got[-1].attachment is not None)
    assert got[-1].attachment == Attachment(7, 8, bytes(16))


def test_no_router_is_said_in_one_line(endpoint: str) -> None:
    with pytest.raises(DeviceError, match=r"no connection.*rmw_zenohd") as caught:
        RosNode("lonely", RosOptions(connect=(endpoint,), patience_s=0.2))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"connect": ("nowhere",)}, "is not a zenoh configuration"),
        ({"zenoh_config": Path("absent.json5")}, "absent.json5: does not exist"),
        ({"domain": 233}, "expected 0 to 232"),
        ({"namespace": "a"}, "found 'a!'"),
    ],
)
def test_options_that_cannot_be(options: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        RosNode("a", RosOptions(**({"connect": (), "listen": ()} | options)))


def test_a_zenoh_file(tmp_path: Path) -> None:
    path = tmp_path / "session.json5"
    path.write_text('{mode: "peer", scouting: {multicast: {enabled: false}}, listen: {endpoints: []}}')
    with RosNode("filed", RosOptions(zenoh_config=path)) as node:
        assert [e.node for e in node.graph(0.2)] == ["filed"]
    path.write_text("{mode: 3")
    with pytest.raises(InputError, match=r"session\.json5: is not a zenoh configuration"):
        RosNode("filed", RosOptions(zenoh_config=path))


def test_no_node_is_unprotected_where_protection_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    for node, remedy in ((RosNode, "zenoh_config"), (CycloneNode, "CYCLONEDDS_URI")):
        with pytest.raises(
            InputError, match=f"ROS_SECURITY_ENABLE: found true, .*{remedy}.* or the transport rclpy"
        ):
            node("bare", RosOptions(connect=(), listen=()))
    # Most configurations of Cyclone DDS name the network alone.
    lan = '<General><Interfaces><NetworkInterface name="lo"/></Interfaces></General>'
    (tmp_path / "lan.xml").write_text(f"<CycloneDDS><Domain>{lan}<!-- <Security> --></Domain></CycloneDDS>")
    for uri in (
        lan,
        f"file://{tmp_path / 'lan.xml'}",
        "file:///nowhere.xml",
        f"{tmp_path / 'lan.xml'},{lan}",
    ):
        monkeypatch.setenv("CYCLONEDDS_URI", uri)
        with pytest.raises(InputError, match="would be unprotected; name a configuration with <Security>"):
            CycloneNode("bare")
    (tmp_path / "keys.xml").write_text(
        f"<CycloneDDS><Domain>{lan}<Security></Security></Domain></CycloneDDS>"
    )
    for uri in ("<Security><Authentication/></Security>", f"{lan},file://{tmp_path / 'keys.xml'}"):
        monkeypatch.setenv("CYCLONEDDS_URI", uri)
        assert cyclone_node._is_protected()
    path = tmp_path / "session.json5"
    head = 'mode: "peer", scouting: {multicast: {enabled: false}}, listen: {endpoints: []}'
    for link in (
        "",
        ', connect: {endpoints: ["tls/localhost:7447"]}',
        ", transport: {link: {tls: {enable_mtls: true}}}",
        ', transport: {link: {protocols: ["tls"]}}',
        ', transport: {link: {protocols: ["tls", "tcp"], tls: {enable_mtls: true}}}',
        ', transport: {link: {protocols: ["tls"], tls: {enable_mtls: false}}}',
        ", transport: {link: {protocols: [], tls: {enable_mtls: true}}}",
    ):
        path.write_text(f"{{{head}{link}}}")
        with pytest.raises(InputError, match="would be unprotected; name a zenoh_config with transport/link"):
            RosNode("filed", RosOptions(zenoh_config=path))
    path.write_text(
        f'{{{head}, transport: {{link: {{protocols: ["tls", "quic"], tls: {{enable_mtls: true}}}}}}}}'
    )
    with RosNode("filed", RosOptions(zenoh_config=path)) as filed:
        assert [e.node for e in filed.graph(0.2)] == ["filed"]
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "false")
    RosNode("bare", RosOptions(connect=(), listen=())).close()
