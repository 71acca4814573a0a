"""The slope of a node's memory and its verdict."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import ros_soak


def _verdict(memory_MB: np.ndarray) -> tuple[float, str]:
    minute = {"process": 1, "alive": True, "sent": 1, "answered": 1, "valid": 1, "killed": 0, "malformed": 0,
              "shared_MB": 66.0, "handles": 19, "threads": 21, "cpu_s": 0.0}  # fmt: skip
    rows = ros_soak._rows([minute | {"memory_MB": float(one)} for one in memory_MB])
    (row,) = [row for row in rows if row["name"].startswith("slope")]
    return row["ours"], row["note"]


def test_the_limit_covers_the_slope() -> None:
    rng, minutes, slope = np.random.default_rng(7), np.arange(20) / 60.0, 3.0
    limits = [ros_soak.slope_MB_h(list(slope * minutes + rng.normal(0.0, 0.2, 20)))[2] for _ in range(2000)]
    # 95 % of 2,000: binomial standard deviation 0.5 %
    assert np.mean(np.array(limits) > slope) == pytest.approx(0.95, abs=0.02)


def test_memory_that_grows_by_two_images_an_hour_is_not_flat() -> None:
    noise = np.random.default_rng(8).normal(0.0, 0.05, 62)
    grown = 2.0 * ros_soak.IMAGE_MB * np.arange(62) / 60.0
    assert ": flat," in _verdict(370.0 + noise)[1]
    filled = np.minimum(np.arange(62), 20) * 0.2  # once
    assert ": flat," in _verdict(370.0 + filled + noise)[1]
    limit, note = _verdict(370.0 + grown + noise)
    assert limit > 2.0 * ros_soak.IMAGE_MB
    assert "not shown to be flat" in note
    late = ros_soak.IMAGE_MB * np.array(
        [0] * 35 + [1] * 10 + [2] * 10 + [4] * 7
    )  # as arenas grew in one hour
    assert "not shown to be flat" in _verdict(370.0 + late + noise)[1]
