"""Labels of messages and tokens against the definitions of other libraries."""

from __future__ import annotations

import pytest

from visuohaptic.io.ros import ros_messages
from visuohaptic.ros import markers
from visuohaptic.ros.wire.graph import Qos

typesys = pytest.importorskip("rosbags.typesys")


def test_markers_and_points_have_the_labels_of_ros() -> None:
    types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).types
    marker, point = types["visualization_msgs/msg/Marker"], types["sensor_msgs/msg/PointField"]
    assert (marker.LINE_LIST, marker.POINTS, marker.TEXT_VIEW_FACING) == (
        markers.LINES,
        markers.POINTS,
        markers._TEXT,
    )
    assert (marker.ARROW, marker.ADD, marker.DELETEALL) == (markers._ARROW, markers._ADD, markers._DELETE_ALL)
    assert ros_messages._POINT_TYPES == {"float32": point.FLOAT32, "float64": point.FLOAT64}


def test_a_token_omits_the_queue_of_rmw_zenoh() -> None:
    """Its default history is the last 42 messages."""
    assert Qos(depth=42).key() == Qos(depth=41).key().replace("41", "")
    assert Qos.parse(Qos(depth=42).key()).depth == 42
    assert Qos.parse(Qos(depth=41).key()).depth == 41
