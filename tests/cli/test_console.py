"""Progress on a terminal and in a log file, JSON of unusual values, format of the log."""

from __future__ import annotations

import io
import json
import logging
from dataclasses import dataclass

import numpy as np
import pytest

from visuohaptic.cli._console import Console, LiveLine, Progress
from visuohaptic.cli._result_text import result_lines
from visuohaptic.core import ErrorBudget, Reason
from visuohaptic.core.files import plain_json


class Clock:
    """Time that the test moves."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_plain_progress_prints_every_five_seconds():
    clock, stream = Clock(), io.StringIO()
    for _ in Progress(range(1000), "reading", stream=stream, clock=clock):
        clock.now_s += 0.02  # 20 s in all: at most one line per tenth, 2 s apart
    lines = stream.getvalue().splitlines()
    assert len(lines) == 10
    assert lines[0] == "reading: 100/1000 (10 %), 2 s, about 18 s left"
    assert lines[-1] == "reading: 1000/1000 (100 %), 20 s"


def test_plain_progress_of_unknown_length_prints_by_time():
    clock, stream = Clock(), io.StringIO()
    with Progress(0, "waiting", stream=stream, clock=clock) as progress:
        for _ in range(12):
            clock.now_s += 1.0
            progress.advance(text="contact")
    assert stream.getvalue().splitlines() == [
        "waiting: 5, 5 s, contact",
        "waiting: 10, 10 s, contact",
        "waiting: 12, 12 s, contact",
    ]


def test_short_work_prints_one_line():
    stream = io.StringIO()
    assert list(Progress([1, 2, 3], "reading", stream=stream, clock=Clock())) == [1, 2, 3]
    assert stream.getvalue() == "reading: 3/3 (100 %), 0 s\n"


def test_quiet_progress_prints_nothing():
    stream = io.StringIO()
    assert list(Progress([1, 2], "reading", quiet=True, stream=stream)) == [1, 2]
    assert stream.getvalue() == ""


def test_a_terminal_gets_a_bar():
    stream = Terminal()
    assert list(Progress([1, 2], "reading", stream=stream)) == [1, 2]
    assert "2/2" in stream.getvalue()


def test_an_error_inside_passes_through():
    with pytest.raises(ZeroDivisionError), Progress(3, "reading", stream=io.StringIO()):
        raise ZeroDivisionError


def test_json_of_our_own_types():
    @dataclass
    class Result:
        reason: Reason
        budget: ErrorBudget
        points: np.ndarray

    result = Result(Reason.OCCLUDED, ErrorBudget(image_N=0.5), np.array([[1.0, np.inf], [np.nan, 2.0]]))
    assert json.loads(plain_json.dumps({"a": result, 3: np.int64(4)})) == {
        "a": {
            "reason": "occluded",
            "budget": {"image_N": 0.5, "calibration_N": 0.0, "model_N": 0.0, "zero_N": 0.0},
            "points": [[1.0, None], [None, 2.0]],
        },
        "3": 4,
    }


def test_json_refuses_what_it_does_not_know():
    with pytest.raises(TypeError, match="a value of type object"):
        plain_json.dumps({"a": object()})


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        ({}, ["warning", "error"]),
        ({"quiet": True}, ["error"]),
        ({"verbose": True}, ["debug", "warning", "error"]),
    ],
)
def test_the_log_goes_to_stderr(capsys, options, shown):
    Console(**options).start_logging()
    for level in (logging.DEBUG, logging.WARNING, logging.ERROR):
        logging.getLogger("visuohaptic.sensing").log(level, "text")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [f"visuohaptic: {name}: text" for name in shown]


def test_the_newest_state_is_written_over_on_a_terminal_and_a_line_a_second_elsewhere():

    now = [0.0]
    shown = Terminal()
    with LiveLine(stream=shown, clock=lambda: now[0]) as line:
        for now[0] in (0.0, 0.05, 0.2):
            line.show(f"{now[0]:.2f} N")
    assert shown.getvalue() == "\r\x1b[K0.00 N\r\x1b[K0.20 N\n"
    log = io.StringIO()
    with LiveLine(stream=log, clock=lambda: now[0]) as line:
        for now[0] in (1.0, 1.5, 2.5):
            line.show(f"{now[0]:.1f} N")
    assert log.getvalue() == "1.0 N\n2.5 N\n"


def test_a_result_has_units_whose_prefixes_fit():
    result = {
        "height_m": 0.1713,
        "volume_m3": 0.0002965,
        "stiffness_N_per_m": {"min": 972.8, "percentile_95": 5.768e6},
        "place_m": [0.03, -0.2, 1.5],
        "mass_kg": 0.061,
        "length_m": 4000.0,
        "depth_m": 0.0,
        "start_s": 1.7e9 + 0.25,
        "width_m": None,
        "holds": True,
        "vertices": 11040,
        "notes": ["a" * 60, "b" * 60],
        "names": ["a" * 49, "b" * 49],
    }
    assert list(result_lines(result)) == [
        "height: 171.3 mm",
        "volume: 296.5 mL",
        "stiffness",
        "  min: 972.8 N/m",
        "  percentile 95: 5.768 MN/m",
        "place: 0.03, -0.2, 1.5 m",
        "mass: 61 g",
        "length: 4000 m",
        "depth: 0 m",
        "start: 1700000000.250 s",
        "width: none",
        "holds: yes",
        "vertices: 11040",
        "notes",
        "  " + "a" * 60,
        "  " + "b" * 60,
        f"names: {'a' * 49}, {'b' * 49}",  # a hundred characters are one line
    ]
