"""Labels of messages and tokens against the definitions of other libraries."""

from __future__ import annotations

import argparse
import ast
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from visuohaptic.cli._arguments import Add
from visuohaptic.cli.verbs.system.ros_node import add_transport
from visuohaptic.io.ros import ros_messages
from visuohaptic.ros import markers
from visuohaptic.ros.nodes.transparency_node import part_markers
from visuohaptic.ros.transports.open_node import TRANSPORTS, Transport
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


@pytest.mark.parametrize("count", [0, 1, 2])
def test_panes_are_drawn_by_their_edges_and_replace_earlier_ones(count: int) -> None:
    corners_m = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 0.0, 0.9], [0.0, 0.0, 0.9]])
    panes = tuple(SimpleNamespace(corners_m=corners_m + k) for k in range(count))
    region = SimpleNamespace(centroid_m=np.array([0.1, 0.2, 0.3]), score=0.75)
    clear, text, edges = part_markers(1.0, "map", SimpleNamespace(regions=(region,), panes=panes))  # type: ignore[arg-type]
    assert clear["action"] == markers._DELETE_ALL
    assert text["text"] == "0.75"
    assert (edges["type"], edges["ns"], len(edges["points"])) == (markers.LINES, "panes", 8 * count)
    ends_m = np.array([[point[axis] for axis in "xyz"] for point in edges["points"]]).reshape(-1, 2, 3)
    lengths_m = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1)
    assert lengths_m == pytest.approx([1.0, 0.8, 1.0, 0.8] * count)


def test_transports_of_configuration_and_command_line_have_a_node() -> None:
    parser = argparse.ArgumentParser()
    add_transport(Add(parser))
    choices = next(one.choices for one in parser._actions if one.dest == "transport")
    assert set(TRANSPORTS) == set(get_args(Transport)) == set(choices or ())
    for module, name in TRANSPORTS.values():  # by its text: a transport may not be installed
        spec = find_spec(f"visuohaptic.ros.transports.{module}")
        assert spec is not None
        assert spec.origin is not None
        tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
        assert name in {one.name for one in tree.body if isinstance(one, ast.ClassDef)}
