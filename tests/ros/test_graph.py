"""Names and tokens against the examples that rmw_zenoh's design gives."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.ros.wire import Entity, EntityKind, Qos, message_type, resolve_name, topic_key
from visuohaptic.ros.wire.graph import LATCHED, check_node

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
#: Printed in the design document of rmw_zenoh, section Graph Cache.
NODE = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
LISTENER = (
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,"
)
TALKER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING}/::,7:,:,:,,"
)
SERVER = (
    "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
    "example_interfaces::srv::dds_::AddTwoInts_/"
    "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a/::,10:,:,:,,"
)


@pytest.mark.parametrize("token", [NODE, LISTENER, TALKER, SERVER])
def test_printed_tokens_are_read_and_written(token: str) -> None:
    assert Entity.parse(token).token() == token


def test_what_a_token_says() -> None:
    found = Entity.parse(TALKER)
    assert (found.domain, found.kind, found.namespace, found.node) == (2, EntityKind.PUBLISHER, "/", "talker")
    assert (found.topic, found.datatype, found.type_hash) == ("/chatter", "std_msgs/msg/String", STRING)
    assert found.qos == Qos(depth=7)


@pytest.mark.parametrize(
    ("topic", "key"),
    [
        ("/chatter", f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"),
        ("/robot1/chatter", f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}"),
    ],
)
def test_printed_topic_keys(topic: str, key: str) -> None:
    kind = message_type("std_msgs/msg/String")
    assert topic_key(0, topic, kind.name, kind.type_hash()) == key


@given(st.booleans(), st.booleans(), st.integers(1, 100_000))
def test_quality_of_service_survives(reliable: bool, latched: bool, depth: int) -> None:
    qos = Qos(reliable, latched, depth)
    assert Qos.parse(qos.key()) == qos


def test_quality_of_service_of_rmw() -> None:
    """Best effort is 2 and transient local 1 in rmw's enumerations; the depth of 42 is its default."""
    assert Qos(False, True, 42).key() == "2:1:,:,:,:,,"
    assert Qos.parse("1:2:1,5:,:,:1,,") == Qos(depth=5)
    assert LATCHED.key() == ":1:,1:,:,:,,"  # the last message alone


WORD = st.from_regex(r"\A[a-z][a-z0-9]{0,5}(_[a-z0-9]{1,3})?\Z")


@given(st.lists(WORD, min_size=1, max_size=4), st.lists(WORD, max_size=2), WORD)
def test_entities_survive(topic: list[str], namespace: list[str], node: str) -> None:
    entity = Entity(
        3,
        "ab12",
        0,
        5,
        EntityKind.PUBLISHER,
        "/" + "/".join(namespace),
        node,
        "/" + "/".join(topic),
        "geometry_msgs/msg/Twist",
        STRING,
        Qos(reliable=False),
    )
    assert Entity.parse(entity.token()) == entity


@pytest.mark.parametrize(
    "token",
    ["", "@ros2_lv/0/a/0/0/NN/%/%", "@ros2_lv/x/a/0/0/NN/%/%/n", "@ros2_lv/0/a/0/0/XX/%/%/n",
     "@ros2_lv/0/a/0/0/MP/%/%/n", TALKER.replace("::,7:,:,:,,", "::,x:,:,:,,"),
     TALKER.replace("::,7:,:,:,,", "1:2:1,7"), LISTENER.replace("/%chatter/", "//"), 400 * "\x1b", f"@ros2_lv/{400 * chr(27)}/a/0/0/NN/%/%/n"],
)  # fmt: skip
def test_other_tokens_are_refused(token: str) -> None:
    with pytest.raises(InputError, match="liveliness token") as caught:
        Entity.parse(token)
    assert len(str(caught.value)) < 300  # found by fuzzing: a control character is four in a message


@pytest.mark.parametrize(
    ("name", "namespace", "whole"),
    [
        ("/a/b", "/r", "/a/b"),
        ("a", "/", "/a"),
        ("a/b_1", "/r", "/r/a/b_1"),
        ("~/a", "/r", "/r/n/a"),
    ],
)
def test_names_are_resolved(name: str, namespace: str, whole: str) -> None:
    assert resolve_name(name, namespace, f"{namespace.rstrip('/')}/n") == whole


@pytest.mark.parametrize(
    "name", ["", "/", "a//b", "1a", "a b", "a__b", "/a/", "a*", "**", "a%b", "a/$b", "ä"]
)
def test_names_that_ros_does_not_know(name: str) -> None:
    """``*``, ``$``, ``%`` and ``#`` mean something in key expressions: they must never get there."""
    with pytest.raises(InputError, match="letters, digits and _"):
        resolve_name(name)


@pytest.mark.parametrize(("namespace", "node"), [("/", "a b"), ("r", "n"), ("/r/", "n"), ("/", "")])
def test_nodes_that_ros_does_not_know(namespace: str, node: str) -> None:
    with pytest.raises(InputError):
        check_node(namespace, node)
