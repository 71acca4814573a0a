"""A trace survives JSON and tells where things went."""

from __future__ import annotations

import json

import pytest

from visuohaptic.core import InputError
from visuohaptic.tasks.mobile.travel import TravelRecord, final_places, trace_from_json, trace_to_json

TRACE = (
    TravelRecord(0.5, "plan", "planned", (1.0, 2.0, 0.5), values={"reachable": True, "tasks": ["navigate"]}),
    TravelRecord(9.0, "plan", "looked", (1.0, 2.0, 0.5), "box", {"place_m": [1.0, 2.0, 0.1]}),
    TravelRecord(9.5, "plan", "looked", (1.0, 2.0, 0.5), "box", {"place_m": [1.5, 2.0, 0.2]}),
)


def test_round_trip():
    assert trace_from_json(json.loads(json.dumps(trace_to_json(TRACE)))) == TRACE


def test_the_last_look_counts():
    assert final_places(TRACE) == {"box": (1.5, 2.0, 0.2)}


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"state": "plan"}, r"trace\[0\]: pose_m: is missing"),
        ({"pose_m": [0, 0], "t_s": 1, "state": "", "event": ""}, "is no record"),
        ({"pose_m": [0, 0, "nan"], "t_s": 1, "state": "", "event": ""}, "not finite"),
        (7, "is no record"),
    ],
)
def test_bad_records(entry, text):
    with pytest.raises(InputError, match=text):
        trace_from_json([entry])
