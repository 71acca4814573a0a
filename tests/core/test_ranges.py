"""Declared ranges are enforced for every numeric type."""

from __future__ import annotations

import doctest
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError, ranges
from visuohaptic.core.ranges import FINITE, NON_NEGATIVE, POSITIVE, check_ranges, within


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
