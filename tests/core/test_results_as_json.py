"""Results as JSON: every type that verbs return, and no invalid JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.core import Reason
from visuohaptic.core.files.plain_json import dumps


@dataclass(frozen=True)
class Result:
    force_N: np.ndarray
    reason: Reason
    file: Path


def test_every_kind_arrives_as_json_has_it() -> None:
    result = Result(np.array([[1.5, np.nan], [np.inf, 2.0]]), Reason.OK, Path("a") / "é.csv")
    value = {
        "result": result,
        1: (True, None, {3}, frozenset({4})),
        Reason.MOVED: np.float32(0.5),
        "count": np.int64(7),
        "flag": np.bool_(False),
        "none": -math.inf,
    }
    text = dumps(value)
    assert "\n" not in text
    assert "é" in text
    assert json.loads(text) == {
        "result": {"force_N": [[1.5, None], [None, 2.0]], "reason": "ok", "file": str(Path("a") / "é.csv")},
        "1": [True, None, [3], [4]],
        "moved": 0.5,
        "count": 7,
        "flag": False,
        "none": None,
    }


@pytest.mark.parametrize("value", [object(), Result, {"a": [b"bytes"]}, 1j])
def test_what_json_cannot_hold_is_a_mistake_of_the_verb(value: object) -> None:
    with pytest.raises(TypeError, match=r"a result has a value of type .*, which JSON cannot represent"):
        dumps(value)
