"""Texts of the report: suitable units, remaining time, singular and plural."""

from __future__ import annotations

import pytest

from visuohaptic.demo.drive_chapters import pushed_text
from visuohaptic.demo.report import measure_texts
from visuohaptic.demo.results import Measure, counted
from visuohaptic.demo.story import Chapter, _left_s
from visuohaptic.tasks.mobile.travel import TravelRecord


@pytest.mark.parametrize(
    ("measure", "texts"),
    [
        (Measure("distance of its middle from the axis [m]", 0.000585, None),
         ("distance of its middle from the axis [mm]", "0.585", "\u2013")),
        (Measure("height [m]", 0.197, 0.195), ("height [m]", "0.197", "0.195")),
        (Measure("mass felt [kg]", 0.0218, 0.0203), ("mass felt [g]", "21.8", "20.3")),
        (Measure("declared standard deviation [N]", 0.0123, None), ("declared standard deviation [mN]", "12.3", "\u2013")),
        (Measure("force [N]", 0.05, 3.2), ("force [N]", "0.05", "3.2")),
        (Measure("rms error of the force [N]", 0.118, None), ("rms error of the force [mN]", "118", "\u2013")),
        (Measure("lifted [m]", 0.1, 0.0995), ("lifted [mm]", "100", "99.5")),
        (Measure("light bin: fixed", False, False), ("light bin: fixed", "no", "no")),
        (Measure("mass felt [kg]", None, 0.0203), ("mass felt [g]", "\u2013", "20.3")),
    ],
)  # fmt: skip
def test_a_measure_is_shown_in_a_unit_that_fits_it(measure, texts):
    assert measure_texts(measure) == texts


def test_the_time_that_is_left_follows_the_pace_of_what_is_done():
    chapters = [
        Chapter(name, name, (), lambda mission: None, seconds)
        for name, seconds in zip("abc", (10, 30, 20), strict=True)
    ]
    assert _left_s(chapters, 0, 0.0) == pytest.approx(60.0)  # nothing is known yet: as is typical
    slow = _left_s(chapters, 2, 200.0)  # five times as slow as is typical
    assert 60.0 < slow <= 100.0
    assert _left_s(chapters, 3, 200.0) == 0.0


def test_one_push_and_two_pushes():
    assert [counted(n, "push", "pushes") for n in (0, 1, 2)] == ["0 pushes", "1 push", "2 pushes"]
    assert counted(2, "plan") == "2 plans"


def test_what_withstood_a_push_is_not_called_pushed_aside():
    def record(event, name, **values):
        return TravelRecord(1.0, "push", event, (0.0, 0.0, 0.0), name, values)

    heavy = record("pushed", "crate", end="too heavy", moved_m=[0.004, 0.0])
    light = record("pushed", "bin", end="astray", moved_m=[0.3, 0.04])
    beside = record("brushed", "stool", end="done", moved_m=0.2)
    assert pushed_text([heavy, light, record("drove", "")]) == "bin pushed aside, crate did not move"
    assert pushed_text([beside, light]) == "bin, stool pushed aside"
    assert pushed_text([]) == "nothing had to be pushed"
