"""Rules of sensors tell units apart: seconds and frames, metres and millimetres, newtons and grams."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.tasks.framework._sensor_rules import clock_rules, depth_rules, touch_rules


def _broken(rules: Any) -> list[str]:
    return [name for name, problem in rules if problem]


@pytest.mark.parametrize(("rate", "seconds"), [(0.47, False), (0.53, True), (1.46, True), (1.54, False)])
def test_a_clock_in_seconds_runs_at_half_to_one_and_a_half_times_the_host(rate: float, seconds: bool) -> None:
    """Ticks of frames at 30 Hz and milliseconds are far beyond."""
    now = [0.0]
    rules = clock_rules(lambda: rate * now[0], lambda step_s: now.__setitem__(0, now[0] + step_s), 1.0)
    assert _broken(rules) == ([] if seconds else ["time advances, in seconds"])


@pytest.mark.parametrize(("depth_m", "metres"), [(48.0, True), (53.0, False)])
def test_no_depth_camera_reaches_farther_than_50_metres(depth_m: float, metres: bool) -> None:
    """In millimetres, 5 cm would be as much."""
    times = itertools.count()
    depth: Any = SimpleNamespace(
        camera=SimpleNamespace(height=2, width=3),
        read=lambda: SimpleNamespace(depth_m=np.full((2, 3), depth_m), t_s=0.1 * next(times)),
    )
    assert bool(_broken(depth_rules(depth, lambda _: None))) != metres


@pytest.mark.parametrize(
    ("force_N", "surface_m", "good"),
    [(1.9, 0.0, True), (-2.1, 0.0, False), (0.0, 0.47, True), (0.0, -0.53, False)],
)
def test_an_idle_finger_feels_less_than_two_newtons_within_half_a_metre(
    force_N: float, surface_m: float, good: bool
) -> None:
    """Two newtons are the weight of 200 g; half a metre is 0.5 in millimetres."""
    touch = SimpleNamespace(valid=True, force_N=force_N, surface_m=surface_m)
    frames: Any = [SimpleNamespace()] * 9
    assert bool(_broken(touch_rules(lambda _: touch, frames))) != good
