"""Third-party recordings, written by the rosbags library, played onto topics over zenoh."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from visuohaptic.core import InputError
from visuohaptic.ros import RosNode
from visuohaptic.ros.wire import LATCHED, Qos

from ..io import test_sqlite_bag
from ..io.test_sqlite_bag import IMAGES, kinds
from .conftest import until
from .test_layers_node import running

bag = test_sqlite_bag.bag  #: the fixture


def test_a_recording_is_played(robot: RosNode, endpoint: str, bag: Path) -> None:
    """Ten kinds and three images, in their order, a second apart as they were recorded, four times as fast."""
    got: dict[str, list[Any]] = {}
    images: list[float] = []
    for number, name in enumerate(kinds()):
        if not name.endswith("OccupancyGrid"):
            robot.subscribe(
                f"/t{number}",
                name,
                lambda r, name=name: got.setdefault(name, []).append(r.message),
                Qos(depth=100),
            )
    robot.subscribe(
        "/camera/image", "sensor_msgs/msg/Image", lambda r: images.append(time.monotonic()), Qos(depth=100)
    )
    with running("play", endpoint, {"file": str(bag), "rate": 4.0, "delay_s": 0.5}) as node:
        assert until(lambda: node.component.status().reason == "played"), node.component.status()
        assert node.component.status().values == {"messages": len(kinds()) + len(IMAGES)}
        assert until(lambda: len(images) == len(IMAGES))
        assert {name: len(found) for name, found in got.items()} == {
            name: 1 for name in kinds() if "Grid" not in name
        }
        assert got["std_msgs/msg/String"][0].data == "Größe"
        # From 5 s to 7 s at four times the speed; a busy machine is late, never early.
        assert images[-1] - images[0] > 0.4
        # A map is latched: who comes late sees it, too.
        late: list[Any] = []
        place = list(kinds()).index("nav_msgs/msg/OccupancyGrid")
        robot.subscribe(f"/t{place}", "nav_msgs/msg/OccupancyGrid", lambda r: late.append(r.message), LATCHED)
        assert until(lambda: late)
        assert list(late[0].data) == [0, 100, -1, 0, 0, 100]
        # Again from its beginning.
        node.deactivate()
        node.activate()
        assert until(lambda: len(got["std_msgs/msg/String"]) == 2)


def test_what_is_no_recording_is_refused(endpoint: str, robot: RosNode, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("no recording")
    with (
        pytest.raises(InputError, match="expected an MCAP file"),
        running("play", endpoint, {"file": str(tmp_path / "a.mcap")}),
    ):
        pass
