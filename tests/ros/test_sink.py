"""Maps, poses and arrows over the wire, and a scene as a reader of the bridge."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.io import helpers
from tests.sensing import scenes
from visuohaptic.core import Reason
from visuohaptic.core.camera import Frame, Pose
from visuohaptic.core.files import save_yaml
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.io.ros._ros_definitions import definition
from visuohaptic.io.sinks import MeasurementSink
from visuohaptic.ros import RosNode, RosSink, contact_markers, markers
from visuohaptic.ros.bridge_config import sensor_kind
from visuohaptic.ros.wire import Qos, decode, encode, message_type
from visuohaptic.sensing import load_reader

from .conftest import until


def test_kinds_of_markers_are_those_of_the_message() -> None:
    text = definition("visualization_msgs/msg/Marker")
    values = {name: int(value) for name, value in re.findall(r"^int32 ([A-Z_]+)=(\d+)$", text, re.MULTILINE)}
    ours = (markers._ARROW, markers.LINES, markers.POINTS, markers._TEXT, markers._ADD, markers._DELETE_ALL)
    names = ("ARROW", "LINE_LIST", "POINTS", "TEXT_VIEW_FACING", "ADD", "DELETEALL")
    assert dict(zip(names, ours, strict=True)) == {name: values[name] for name in names}


def test_a_map_waits_for_those_who_come_late(robot: RosNode, ours: RosNode) -> None:
    cells = np.random.default_rng(0).choice(np.array([-1, 0, 100], np.int8), (30, 40))
    grid = OccupancyMap(cells, 0.05, (-1.0, 2.0, 0.5))
    sink = RosSink(robot, frame="map")
    sink.write_map(grid, 3.0)
    got: list = []
    ours.subscribe("/map", "nav_msgs/msg/OccupancyGrid", lambda r: got.append(r.message), Qos(latched=True))
    assert until(lambda: got)
    back = OccupancyMap.from_message(got[0])
    np.testing.assert_array_equal(back.cells, cells)
    assert back.resolution_m == pytest.approx(0.05)
    assert back.origin == pytest.approx((-1.0, 2.0, 0.5))


def test_poses_and_their_covariance(robot: RosNode, ours: RosNode) -> None:
    got: list = []
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    ours.subscribe("/tip", kind, lambda r: got.append(r.message))
    sink = RosSink(robot)
    pose = Pose.from_rotation_vector([0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
    covariance = np.diag(np.arange(1.0, 7.0))
    assert until(lambda: sink.write_pose(pose, 1.0, "/tip", frame="base", covariance=covariance) or got)
    found = got[0].pose
    assert (found.pose.position.x, found.pose.position.z) == (1.0, 3.0)
    np.testing.assert_array_equal(found.covariance.reshape(6, 6), covariance)
    assert sink.sent >= 1


@pytest.mark.parametrize("valid", [True, False])
def test_arrows_are_of_contacts_that_can_be_trusted(valid: bool) -> None:
    profile = helpers.profile(valid=valid)
    kind = message_type("visualization_msgs/msg/MarkerArray")
    markers = decode(encode(contact_markers(profile, "foam"), kind), kind).markers
    assert markers[0].action == 3  # what was drawn before goes
    assert len(markers) == 1 + valid
    if valid:
        start, end = markers[1].points
        assert start.x - end.x == pytest.approx(0.02 * profile.contacts[0].force_N)
        assert (start.y, start.z) == (end.y, 0.0)


class Kept(MeasurementSink):
    """Keeps what it is given, after a way through its bytes."""

    frame = "sensor"

    def __init__(self) -> None:
        self.messages: dict[str, list] = {}

    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        kind = message_type(datatype)
        self.messages.setdefault(topic, []).append(decode(encode(message, kind), kind))


def test_a_scene_is_read(tmp_path: Path) -> None:
    rig, rng = scenes.RIG, np.random.default_rng(0)
    rig.camera.save(tmp_path / "camera.yaml")
    described = rig.T_camera_foam.fields
    path = tmp_path / "scene.yaml"
    save_yaml(path, {"kind": "scene", "camera": "camera.yaml", "T_camera_foam": described})
    assert sensor_kind(path) == "scene"
    reader = load_reader(path, "ahead")
    assert reader.zeroed
    assert reader.camera.width == rig.camera.width
    sink, render = Kept(), scenes.renderer(rig)
    reasons = []
    for i in range(6):
        image = render.render(scenes.scene(i / 30, scenes.planar(0.004 * i, 0, 0), []), rng=rng)
        reasons.append(reader.read(Frame(image, i / 30, i), sink).reason)
    reader.blank(1.0, sink)
    reader.close()
    assert reasons[1:] == [Reason.OK] * 5
    told = sink.messages["/ahead/diagnostics"]
    assert [one.status[0].message for one in told[1:]] == ["ok"] * 5 + ["stale"]
    # It drove 4 mm a frame; the floor tells that to a tenth.
    driven = sink.messages["/ahead/pose"][-1].pose.pose.position.x
    assert driven == pytest.approx(0.020, abs=0.002)
    assert set(reader.topics) <= set(sink.messages)


def test_a_beam_is_read(tmp_path: Path) -> None:
    from visuohaptic.core.camera import Camera
    from visuohaptic.rigs import VirtualBeam
    from visuohaptic.sensing import BeamReader
    from visuohaptic.sensing.beam import TrackedBeam
    from visuohaptic.simulation.beam import RodRig
    from visuohaptic.simulation.rendering import CameraEffects

    virtual = VirtualBeam(
        RodRig(), Camera.simple(800, 448, 900.0), CameraEffects(blur_px=0.7, noise_sigma=3.0)
    )
    virtual.write(tmp_path)
    renderer, rng = virtual.renderer(), np.random.default_rng(3)
    path = tmp_path / "sensor.yaml"
    assert sensor_kind(path) == "beam"
    reader, sink = BeamReader(TrackedBeam.load(path), "probe"), Kept()
    assert not reader.zeroed
    reader.zero(virtual.frames(np.zeros((12, 6)), rng, start_s=-1.0, renderer=renderer))
    assert reader.zeroed
    load = np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    for frame in virtual.frames(np.tile(load, (3, 1)), rng, renderer=renderer):
        assert reader.read(frame, sink).reason is Reason.OK
    reader.blank(9.0, sink)
    reader.close()
    *measured, last = sink.messages["/probe/wrench"]
    assert [m.wrench.force.y for m in measured] == pytest.approx([2.0] * 3, abs=0.1)
    assert np.isnan(last.wrench.force.y)
    assert sink.messages["/probe/diagnostics"][-1].status[0].message == "stale"
    assert set(reader.topics) == set(sink.messages)
