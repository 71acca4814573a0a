"""A slice of the campaign on the cluster; all of it is ``python -m benchmarks.cluster``."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from benchmarks import cluster

# Found, not imported: its import takes 1.5 s in each worker that collects this file.
pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="pip install 'visuohaptic[cluster]'")


def test_maps_of_floors_are_the_same_although_a_worker_was_killed() -> None:
    assert cluster.same_bytes(["map build"]) == [{"name": "map build", "same": True, "killed": 1}]


def test_all_that_takes_long_is_tried() -> None:
    assert len(cluster.LONG) == 8
