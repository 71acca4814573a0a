"""Memory of a node in a live graph: images reuse the memory of earlier ones."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed")

from benchmarks import ros_soak

if sys.platform != "linux":
    pytest.skip("needs /proc", allow_module_level=True)

DOMAIN = 101 + os.getpid() % 100


def _taken_MB(process: int) -> float:
    """Memory that a process has taken from the system so far: it grows by no more."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return int(fields[7]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_images_take_no_new_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither valid nor malformed images, once the queues have been full."""
    monkeypatch.setattr(ros_soak, "STOPS", 3)
    with ros_soak.campaign(DOMAIN, 10.0) as campaign:
        campaign.images_of(4.0)  # caches of the sensor
        before, memory_MB = _taken_MB(campaign.node.process.pid), campaign.node.use()["memory_MB"]
        campaign.images_of(8.0, malformed=200)
        time.sleep(1.0)
        taken, used = _taken_MB(campaign.node.process.pid), campaign.node.use()["memory_MB"]
    # Of 80 images, each of which passes through two buffers.
    assert taken - before < 4 * ros_soak.IMAGE_MB
    assert used - memory_MB < ros_soak.IMAGE_MB
