"""A slice of the campaign that runs verbs again under other hash seeds, threads and cores."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import determinism


def test_a_plan_is_the_same_and_what_differs_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    (one,) = [run for name, run in determinism.cases(0) if name == "plan"]
    assert one() == {"tried": 2, "wrong": 0}

    def changing(words: str, folder: Path, number: int) -> bytes:
        return json.dumps({"cost_s": 1.0 + number, "search_s": 0.1 * number}).encode()

    monkeypatch.setattr(determinism, "_run", changing)
    assert determinism._compare("plan", 5) == {"tried": 5, "wrong": 4}
    monkeypatch.setattr(
        determinism, "_run", lambda words, folder, number: json.dumps({"search_s": number}).encode()
    )
    assert determinism._compare("plan", 5) == {"tried": 5, "wrong": 0}
