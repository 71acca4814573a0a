"""Type hashes against those that ROS has published, and against rosbags' own."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from visuohaptic.core import InputError
from visuohaptic.io.ros._ros_definitions import _PARTS
from visuohaptic.ros.wire import Shape, message_type, parse_definition
from visuohaptic.ros.wire.graph import to_dds

STORE = get_typestore(Stores.ROS2_JAZZY)

#: From ROS 2 itself: the design of rmw_zenoh (String), and hashes that others copied out of the type
#: descriptions that ROS 2 Jazzy installs (share/PACKAGE/msg/TYPE.json) or out of ``ros2 topic info -v``.
PUBLISHED = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Header": "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    "builtin_interfaces/msg/Time": "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/WrenchStamped": "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "nav_msgs/msg/OccupancyGrid": "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    "sensor_msgs/msg/Image": "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/CompressedImage": "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a",
    "sensor_msgs/msg/CameraInfo": "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "visualization_msgs/msg/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_hashes_are_those_of_ros(name: str) -> None:
    assert message_type(name).type_hash() == f"RIHS01_{PUBLISHED[name]}"


@pytest.mark.parametrize("short", _PARTS)
def test_all_hashes_are_those_of_rosbags(short: str) -> None:
    name = short.replace("/", "/msg/")
    assert message_type(name).type_hash() == STORE.hash_rihs01(name)


#: Without char: rosbags takes it for a character of IDL, ROS for an uint8.
PLAIN = ["bool", "byte", "int8", "uint8", "int16", "uint32", "int64", "float32", "float64", "string"]


@st.composite
def definitions(draw: st.DrawFn) -> str:
    """A message with an inner one, constants, comments and defaults."""

    def line(number: int) -> str:
        kind = draw(st.sampled_from([*PLAIN, "string<=7", "std_msgs/Header", "test_msgs/Inner", "Inner"]))
        array = draw(st.sampled_from(["", "", "[]", "[3]", "[<=5]"]))
        comment = draw(st.sampled_from(["", "  # in [m]"]))
        return f"{kind}{array} field_{number}{comment}"

    lines = [line(number) for number in range(draw(st.integers(0, 6)))]
    lines.insert(draw(st.integers(0, len(lines))), "uint8 LARGEST=200  # a constant")
    return "\n".join(lines)


@settings(max_examples=60, deadline=None)
@given(definitions())
def test_any_definition_has_the_hash_of_rosbags(text: str) -> None:
    inside = "MSG: test_msgs/Inner\nfloat64 x 1.5\nint32[2] pair\n"
    head = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    time = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    whole = ("=" * 80 + "\n").join([text + "\n", inside, head, time])
    store = get_typestore(Stores.EMPTY)
    for name, part in (("test_msgs/msg/Outer", text), ("test_msgs/msg/Inner", inside.partition("\n")[2])):
        store.register(get_types_from_msg(part, name))
    for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time"):
        store.register({name: STORE.fielddefs[name]})
    ours = parse_definition("test_msgs/msg/Outer", whole)
    assert ours.type_hash() == store.hash_rihs01("test_msgs/msg/Outer")


def test_a_char_is_an_uint8() -> None:
    """As rosidl_adapter translates a .msg file; the hash is that of ROS 2's std_msgs/msg/Char."""
    found = parse_definition("std_msgs/msg/Char", "char data").type_hash()
    assert found == "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9"


def test_a_definition_is_read() -> None:
    kind = parse_definition(
        "test_msgs/Point", "float64 x 1.0\nstring<=9[<=2] names\nuint8 A=1\nstring text '#1'\n# end\n"
    )
    assert kind.name == "test_msgs/msg/Point"
    assert to_dds(kind.name) == "test_msgs::msg::dds_::Point_"
    assert [(f.name, f.shape, f.capacity, f.text_capacity) for f in kind.fields] == [
        ("x", Shape.ONE, 0, 0),
        ("names", Shape.BOUNDED, 2, 9),
        ("text", Shape.ONE, 0, 0),
    ]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("String", "string data", "expected a name as std_msgs/msg/String"),
        ("a/B", "string", "found 'string', expected 'type name'"),
        ("a/B", "wstring data", "wstring is not supported"),
        ("a/B", "c/D data", "the definition of c/msg/D in a/msg/B is missing"),
        ("a/B", "int8<=3 data", "only a string has a bound"),
    ],
)
def test_what_cannot_be_read_is_said(name: str, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")) as caught:
        parse_definition(name, text)
    assert "\n" not in str(caught.value)


def test_an_unknown_message_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="geometry_msgs/Twist"):
        message_type("geometry_msgs/msg/Twirl")
