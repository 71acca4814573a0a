"""Declared ranges are enforced for every numeric type."""

from __future__ import annotations

import doctest
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError, ranges
from visuohaptic.core.ranges import (
    FINITE,
    NON_NEGATIVE,
    POSITIVE,
    check_choice,
    check_ranges,
    finite_array,
    within,
)


@dataclass(frozen=True, slots=True)
class Sample:
    length_m: Any = field(default=1.0, metadata=POSITIVE)
    sigma_m: Any = field(default=0.0, metadata=NON_NEGATIVE)
    count: int = field(default=4, metadata=within(2, 8))
    optional: Any = field(default=None, metadata=POSITIVE)
    free: Any = "anything"

    __post_init__ = check_ranges


@pytest.mark.parametrize(
    "good",
    [
        {},
        {"length_m": 1e-300},
        {"length_m": np.array([1.0, 2.0])},
        {"count": 2},
        {"count": 8},
        {"optional": 3},
    ],
)
def test_what_is_inside_passes(good):
    Sample(**good)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"length_m": 0.0}, "Sample: length_m: found 0.0, expected more than 0"),
        ({"length_m": float("nan")}, "expected more than 0"),
        ({"length_m": float("inf")}, "expected more than 0"),
        ({"length_m": np.array([1.0, -1.0])}, "expected more than 0"),
        ({"length_m": "long"}, "found 'long', expected more than 0"),
        ({"length_m": 10**400}, "expected more than 0"),
        ({"sigma_m": -1e-9}, "expected at least 0"),
        ({"count": 9}, "count: found 9, expected 2 to 8"),
        ({"count": None}, "found None, expected 2 to 8"),
        ({"optional": 0.0}, "expected more than 0"),
    ],
)
def test_what_is_outside_is_refused_in_one_line(bad, said):
    with pytest.raises(InputError) as refusal:
        Sample(**bad)
    assert said in str(refusal.value)


def test_the_example_runs():
    assert doctest.testmod(ranges).failed == 0


def test_a_range_for_the_fields_without_their_own() -> None:
    @dataclass(frozen=True)
    class Settings:
        speed_m_s: float = 0.1
        tilts_rad: tuple[float, ...] = field(default=(), metadata=FINITE)

        def __post_init__(self) -> None:
            check_ranges(self, POSITIVE)

    Settings(tilts_rad=(-0.1, 0.0))
    with pytest.raises(InputError, match=r"speed_m_s: found 0\.0, expected more than 0"):
        Settings(speed_m_s=0.0)
    with pytest.raises(InputError, match=r"tilts_rad: found .*, expected a finite number"):
        Settings(tilts_rad=(float("nan"),))


@pytest.mark.parametrize(
    ("values", "shape", "said"),
    [
        (np.zeros(3), (None, 2), r"found shape \(3,\), expected finite numbers \(n, 2\), n >= 2$"),
        (np.zeros((1, 2)), (None, 2), r"found shape \(1, 2\), expected .*n >= 2$"),
        ([[0.0, math.nan], [0, 1]], (None, 2), r"found NaN or infinity, expected finite numbers \(n, 2\)"),
        ([0.0, 1.0], (3,), r"outline: found shape \(2,\), expected finite numbers \(3,\)"),
        ("x", (3,), r"outline: found 'x', expected numbers$"),
        ([[0.0], [1.0, 2.0]], (None, 2), r"outline: found \[\[0.0\], \[1.0, 2.0\]\], expected numbers$"),
        ([abs, 1.0], (2,), r"outline: found .*abs.*, expected numbers$"),
        ([10**400, 1.0], (2,), r"outline: found \[1000.*, expected numbers$"),
        ([16**5000, 1.0], (2,), r"outline: found \[an integer of 20001 bits, 1.0\], expected numbers$"),
    ],
)
def test_arrays_of_another_shape_or_that_are_not_finite_are_refused(values, shape, said):
    with pytest.raises(InputError, match=said):
        finite_array("prism", values, *shape, field="outline", least=2)


def test_numbers_of_the_right_shape_are_float64_in_rows():
    assert finite_array("prism", [[1, 2], [3, 4]], None, 2).dtype == np.float64
    assert finite_array("prism", np.zeros((2, 5)).T, 5, 2).flags.c_contiguous
    assert finite_array("prism", np.zeros((0, 3)), None, 3, least=0).shape == (0, 3)


def test_a_choice_that_is_not_known_is_refused_with_those_that_are():
    check_choice("sheet", ("A4", "A3"), "A3")
    with pytest.raises(InputError, match="sheet: paper: found 'A5', expected one of A4, A3"):
        check_choice("sheet", ("A4", "A3"), "A5", field="paper")
    for known, value in (({"A4": 1.0, "A3": 1.4}, ["A4"]), (("A4", "A3"), np.zeros(2))):
        with pytest.raises(InputError, match=r"sheet: found .*, expected one of A4, A3"):
            check_choice("sheet", known, value)
