"""Two nodes that communicate on this machine, without a router and without a network."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("zenoh")

from tests.patience import PATIENCE_S
from tests.ports import free_port
from visuohaptic.ros import RosNode, RosOptions


def free_endpoint() -> str:
    """A port of this machine that nobody uses."""
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def endpoint() -> str:
    """Where the first node listens."""
    return free_endpoint()


@pytest.fixture
def robot(endpoint: str) -> Iterator[RosNode]:
    """The other side: what a real robot would be."""
    with RosNode("robot", RosOptions(connect=(), listen=(endpoint,))) as node:
        yield node


@pytest.fixture
def ours(robot: RosNode, endpoint: str) -> Iterator[RosNode]:
    """Our side, connected to the robot."""
    with RosNode("ours", RosOptions(connect=(endpoint,), listen=())) as node:
        yield node


def until(condition: Callable[[], object], timeout_s: float = PATIENCE_S) -> bool:
    """Wait for something that another thread does: a busy machine may take long."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return bool(condition())
