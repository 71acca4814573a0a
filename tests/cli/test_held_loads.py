"""Loads that a user holds during the set-up: still ones, and new ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from visuohaptic.cli.verbs.system.start import _held


def _found(forces: list[float], before: list[float]) -> float | None:
    readings = iter([SimpleNamespace(valid=True, contacts=(1,), force_N=force) for force in forces])
    sensor: Any = SimpleNamespace(read=lambda _: next(readings))
    profile = _held(sensor, iter([SimpleNamespace()] * len(forces)), before)  # type: ignore[arg-type]
    return None if profile is None else profile.force_N


@pytest.mark.parametrize(
    ("spread", "frames", "held"), [(0.028, 8, True), (0.033, 8, False), (0.028, 7, False)]
)
def test_a_load_is_held_when_eight_frames_agree_within_three_per_cent(
    spread: float, frames: int, held: bool
) -> None:
    """Foam creeps by 5 % while a hand holds it: within a quarter of a second at 30 Hz by half of it."""
    forces = [2.0, *[2.0 * (1.0 - spread)] * (frames - 1)]
    assert (_found(forces, []) is not None) == held


@pytest.mark.parametrize(("ratio", "new"), [(1.18, False), (1.22, True), (0.78, True), (0.82, False)])
def test_a_load_is_new_when_it_differs_by_a_fifth(ratio: float, new: bool) -> None:
    assert (_found([2.0 * ratio] * 8, [2.0, 9.0]) is not None) == new
    assert _found([2.0 * ratio] * 8, [5.0]) == pytest.approx(2.0 * ratio)
