"""A slice of the campaign on the cluster; all of it is ``python -m benchmarks.cluster``."""

from __future__ import annotations

import pytest

pytest.importorskip("distributed", reason="pip install 'visuohaptic[cluster]'")

from benchmarks import cluster


def test_maps_of_floors_are_the_same_although_a_worker_was_killed() -> None:
    assert cluster.same_bytes(["map build"]) == [{"name": "map build", "same": True, "killed": 1}]


def test_all_that_takes_long_is_tried() -> None:
    assert len(cluster.LONG) == 8
